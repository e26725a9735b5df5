"""Reliability of the confidence of labels, against the truth of simulated sessions."""

from dataclasses import dataclass

import numpy as np

from annotate.cloud.fuse import Fuser
from annotate.cloud.supervoxels import Supervoxels, supervoxels
from annotate.labelset.label_set import LabelSet
from annotate.parts import UNDEFINED, on_body
from sensors.session.reader import Session

BINS = 15  # of equal width (Guo et al. 2017)
FIRST_SHARE = 0.3  # of the supervoxels, reviewed first
SEED_M = 0.05  # m between supervoxels; a forearm is 7 cm thick


@dataclass(frozen=True)
class Reliability:
    """Confidence and correctness of labelled pixels (n,).

    found_first: share of the wrong pixels in the supervoxels that are reviewed first.
    """

    confidence: np.ndarray
    right: np.ndarray
    found_first: float

    @property
    def ece(self) -> float:
        """Expected calibration error, pixel by pixel."""
        bins = np.minimum((self.confidence * BINS).astype(int), BINS - 1)
        gaps = np.bincount(bins, self.confidence - self.right, BINS)
        return float(np.abs(gaps).sum() / len(bins))


def worst_first(confidence: np.ndarray, groups: Supervoxels) -> np.ndarray:
    """Return supervoxels (G,), most expected wrong pixels first; confidence: (n,), of the points."""
    return np.argsort(-(1 - groups.mean(confidence)) * groups.sizes, kind="stable")


def reliability(labels: LabelSet, truth: LabelSet, session: Session) -> Reliability:
    """Measure the confidence of a session's labels."""
    fuser = Fuser(session.calibration)
    rows, found, wrong_all = [], 0, 0
    for frame in session:
        guess, known = labels.read(f"{frame.index:06d}"), truth.read(f"{frame.index:06d}").parts
        named = on_body(guess.parts)
        if not named.any():
            continue
        right, counted = (guess.parts == known)[named], (known != UNDEFINED)[named]
        rows.append((guess.confidence[named][counted], right[counted]))
        cloud = fuser.fuse_frame(frame)
        groups = supervoxels(cloud.points_m[named], cloud.color_rgb[named], seed_m=SEED_M)
        wrong = np.bincount(groups.ids, counted & ~right, groups.count)
        order = worst_first(guess.confidence[named], groups)
        found += wrong[order[: int(np.ceil(FIRST_SHARE * groups.count))]].sum()
        wrong_all += wrong.sum()
    confidence, right = (np.concatenate(column) for column in zip(*rows, strict=True))
    return Reliability(confidence, right, found / max(wrong_all, 1))
