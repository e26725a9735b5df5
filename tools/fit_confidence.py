"""Fit the constants of annotate.segmentation.confidence to the truth of simulated sessions, seeds 100 to 199.

python -m tools.fit_confidence SESSION.mcap...
Labels every session as ``label`` does, within the person as extracted. Prints the constants, and how well
each session is calibrated by the others' fit.
"""

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from unittest.mock import patch

import numpy as np

from annotate.cloud.fuse import Fuser
from annotate.cloud.supervoxels import Supervoxels
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.frame_labels import FrameLabels
from annotate.labelset.store import LabelSet
from annotate.parts import UNDEFINED
from annotate.person.extract import extract_person
from annotate.second_look.look import look_again
from annotate.segmentation import confidence, segment
from annotate.suit.palette import Suit, load_suit
from sensors.session.reader import Session
from synth.rig.simulate import suit_path, truth_path

EVERY, PIXELS_PER_WITNESS = 5, 20.0
"""Every so manieth pixel is fitted to. Neighbours are right or wrong together: so many count as one."""
RIDGE = 1.0
STEPS = 40
FIRST_SHARE, BINS = 0.3, 15


@dataclass(frozen=True)
class Seen:
    """One frame's points: features (n, k), which labels are right, which are counted at all (n,), pieces."""

    found: np.ndarray
    right: np.ndarray
    counted: np.ndarray
    groups: Supervoxels


def clouds(path: Path) -> Iterator[tuple[ThermalCloud, np.ndarray]]:
    """Every frame of a session with its true parts."""
    session, truth = Session(path), LabelSet.open(truth_path(path))
    fuser = Fuser(session.calibration)
    for frame in session:
        yield fuser.fuse_frame(frame), truth.read(f"{frame.index:06d}").parts


def observed(frames: Iterator[tuple[ThermalCloud, np.ndarray]], suit: Suit) -> list[Seen]:
    """What the features of a session's frames were, and what came of them."""
    seen, before, given = [], None, []

    def keep(cloud, parts, reading):
        given[:] = (reading, confidence.features(cloud, parts, reading))
        return given[-1]

    with patch.object(segment, "features", keep):
        for cloud, known in frames:
            person = extract_person(cloud, None, before, suit)
            if not person.trusted:
                before = None
                continue
            given.clear()
            labels, person = look_again(
                cloud, person, segment.segment(cloud, person.mask, suit, before), before
            )
            persons = person.mask.astype(np.uint8)
            before = FrameLabels("x", cloud.depth_mm, labels.parts, labels.confidence, persons=persons)
            if given:
                (reading, found), right = given, (known == labels.parts)[given[0].mask]
                counted = ((known != UNDEFINED) & (labels.parts != UNDEFINED))[reading.mask]
                seen.append(Seen(found.astype(np.float32), right, counted, reading.groups))
    return seen


def fitted(seen: list[Seen]) -> np.ndarray:
    """Weights and, last, the intercept: logistic regression by Newton's method."""
    found = np.concatenate([s.found[s.counted][::EVERY] for s in seen])
    right = np.concatenate([s.right[s.counted][::EVERY] for s in seen])
    columns = np.column_stack([found, np.ones(len(found))]).astype(np.float64)
    ridge = RIDGE * np.diag([1.0] * found.shape[1] + [0.0])
    weights = np.zeros(columns.shape[1])
    for _ in range(STEPS):
        share = 1 / (1 + np.exp(-columns @ weights))
        slope = columns.T @ (right - share) / PIXELS_PER_WITNESS - ridge @ weights
        curve = (columns * (share * (1 - share))[:, None]).T @ columns / PIXELS_PER_WITNESS
        step = np.linalg.solve(curve + ridge, slope)
        weights += step
        if np.abs(step).max() < 1e-6:
            break
    return weights


def report(name: str, seen: list[Seen], weights: np.ndarray) -> None:
    first, wrong_all, gaps, right, pixels = 0, 0, np.zeros(BINS), 0, 0
    for s in seen:
        share = 1 / (1 + np.exp(-(s.found @ weights[:-1] + weights[-1])))
        wrong = np.bincount(s.groups.ids, s.counted & ~s.right, s.groups.count)
        order = confidence.worst_first(share, s.groups)
        first += wrong[order[: int(np.ceil(FIRST_SHARE * len(wrong)))]].sum()
        wrong_all += wrong.sum()
        bins = np.minimum((share * BINS).astype(int), BINS - 1)[s.counted]
        gaps += np.bincount(bins, (share - s.right)[s.counted], BINS)
        right, pixels = right + (s.right & s.counted).sum(), pixels + s.counted.sum()
    ece = np.abs(gaps).sum() / pixels
    figures = f"calibration error {ece:.4f}, first 30 %: {first / wrong_all:.3f}"
    print(f"{name}: right {right / pixels:.4f}, {figures}")


def main(sets: dict[str, list[Seen]]) -> None:
    """Print the fit to all sessions, and each session's figures by the fit to the others and to all."""
    weights = fitted([s for seen in sets.values() for s in seen])
    for name, weight in zip(confidence.WEIGHTS, weights, strict=False):
        print(f'    "{name}": {weight:.2f},')
    print(f"INTERCEPT = {weights[-1]:.2f}")
    for name, seen in sets.items():
        if others := [s for other in sets if other != name for s in sets[other]]:
            report(f"{name}, by the others", seen, fitted(others))
        report(f"{name}, by all", seen, weights)


if __name__ == "__main__":
    paths = [Path(p) for p in sys.argv[1:]]
    main({path.stem: observed(clouds(path), load_suit(suit_path(path))) for path in paths})
