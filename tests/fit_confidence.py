"""Fit the constants of annotate.confidence to the truth of simulated sessions (seeds 100 to 199).

python -m tests.fit_confidence SESSION.mcap...
Every session is labelled twice: within the person as extracted and within the true one, so that the curve
knows both good outlines and bad ones. Prints the constants, and how well they are calibrated.
"""

import sys
from pathlib import Path
from unittest.mock import patch

import numpy as np

from annotate import confidence, segment
from annotate.fuse import Fuser
from annotate.labels import FrameLabels
from annotate.parts import BACKGROUND, UNDEFINED
from annotate.person import extract_person
from annotate.store import LabelSet
from annotate.suit import load_suit
from sensors.replay import Session
from synth.simulate import suit_path, truth_path

PIXELS_PER_WITNESS = 20.0
"""Pixels of a supervoxel are right or wrong together: so many count as one."""
RIDGE = 1.0
STEPS = 40


def observed(path: Path, true_outline: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Features (n, 11), right and all pixels (n,) of every supervoxel of a session."""
    session, truth = Session(path), LabelSet.open(truth_path(path))
    suit, fuser, before, rows, seen = load_suit(suit_path(path)), Fuser(session.calibration), None, [], []

    def keep(*given):
        seen.append(given[-2:])
        rows.append([confidence.features(*given)])
        return rows[-1][0]

    with patch.object(segment, "features", keep):
        for frame in session:
            cloud, known = fuser.fuse_frame(frame), truth.read(f"{frame.index:06d}").parts
            person = extract_person(cloud, None, before, suit).mask
            if true_outline:
                person = (known != BACKGROUND) & (known != UNDEFINED)
            done, labelled = len(rows), segment.segment(cloud, person, suit, before)
            before = FrameLabels(str(frame.index), cloud.depth_mm, labelled.parts, labelled.confidence)
            if len(rows) > done:
                mask, groups = seen.pop()
                counted = (known != UNDEFINED) & (labelled.parts != UNDEFINED)
                right = counted & (known == labelled.parts)
                rows[-1] += [np.bincount(groups.ids, x[mask], groups.count) for x in (right, counted)]
    return tuple(np.concatenate(column) for column in zip(*rows, strict=True))


def fitted(found: np.ndarray, right: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Weights and, last, the intercept: logistic regression by Newton's method."""
    columns = np.column_stack([found, np.ones(len(found))])
    ridge = RIDGE * np.diag([1.0] * found.shape[1] + [0.0])
    weights = np.zeros(columns.shape[1])
    for _ in range(STEPS):
        share = 1 / (1 + np.exp(-columns @ weights))
        slope = columns.T @ (right - pixels * share) / PIXELS_PER_WITNESS - ridge @ weights
        curve = (columns * (pixels * share * (1 - share))[:, None]).T @ columns / PIXELS_PER_WITNESS
        weights += np.linalg.solve(curve + ridge, slope)
    return weights


def report(name: str, share: np.ndarray, right: np.ndarray, pixels: np.ndarray) -> None:
    bins = np.minimum((share * 15).astype(int), 14)
    ece = np.abs(np.bincount(bins, share * pixels - right)).sum() / pixels.sum()
    first = confidence.worst_first(share, pixels)[: int(0.3 * len(share))]
    found = (pixels - right)[first].sum() / (pixels - right).sum()
    rate = right.sum() / pixels.sum()
    print(f"{name}: right {rate:.4f}, calibration error {ece:.4f}, first 30 %: {found:.3f}")


if __name__ == "__main__":
    given = [(Path(p), outline) for p in sys.argv[1:] for outline in (False, True)]
    sets = [observed(*one) for one in given]
    weights = fitted(*(np.concatenate(column) for column in zip(*sets, strict=True)))
    print(dict(zip(confidence.WEIGHTS, np.round(weights[:-1], 2).tolist(), strict=True)))
    print(f"INTERCEPT = {weights[-1]:.2f}")
    for (path, outline), (found, right, pixels) in zip(given, sets, strict=True):
        share = 1 / (1 + np.exp(-(found @ weights[:-1] + weights[-1])))
        report(f"{path.stem}, {'true' if outline else 'extracted'} outline", share, right, pixels)
