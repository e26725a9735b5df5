"""How sure a supervoxel's label is: the share of its pixels that will be right."""

import cv2
import numpy as np
from numpy.typing import NDArray

from annotate.supervoxels import Supervoxels

WEIGHTS = {
    "odds": 0.24,
    "own color": 1.32,
    "stray color": 0.39,
    "unread": -0.43,
    "touches border": -5.83,
    "border": 4.15,
    "outline": -0.5,
    "size": 0.04,
    "cold": -0.1,
    "no warmth": -0.02,
    "frame": 0.83,
}
INTERCEPT = 1.0
"""Fitted by tests/fit_confidence.py on the virtual rig, `normal` and `hard`, 128 frames of seeds 100 to 199.

odds: log of the likeliest part's belief over the next one's, own color: how well the points' own colours
fit their part, against the part they fit best. stray color: how well any. unread: share of points without
a readable colour. touches border, border: square root and share of points beside another part. outline:
share on the person's outline. size: log number of points. cold: degrees below the person's median. no
warmth: share of points without a temperature. frame: own color over the frame."""

LEAST_BELIEF, STRAYEST, COLDEST_C = 1e-4, -4.0, 6.0
"""Beyond these a feature says no more."""

_Array = NDArray[np.float64]


def features(
    belief: _Array,
    evidence: _Array,
    readable: NDArray[np.bool_],
    temperature_c: NDArray[np.float32],
    parts: NDArray[np.uint8],
    mask: NDArray[np.bool_],
    groups: Supervoxels,
) -> _Array:
    """What tells a supervoxel's right labels from wrong ones (G, 11), in the order of WEIGHTS.

    belief: (G, 11). evidence: (n, 11) of the points, readable, temperature_c: (n,), parts: uint8 (h, w) as
    chosen, mask: (h, w) of the points, row-major.
    """
    chosen = parts[mask].astype(np.intp) - 1
    best = evidence.max(axis=1)
    own = np.exp(np.where(readable, evidence[np.arange(len(chosen)), chosen] - best, 0))
    border, outline = _edges(parts, mask)
    felt = np.isfinite(temperature_c)
    usual_c = np.median(temperature_c[felt]) if felt.any() else 0
    cold = np.where(felt, np.clip(usual_c - temperature_c, 0, COLDEST_C), 0)
    stray = np.where(readable, np.maximum(best, STRAYEST), 0)
    of_points = groups.mean(np.stack([own, stray, ~readable, border, outline, cold, ~felt], axis=1))
    second, first = np.sort(np.maximum(belief, LEAST_BELIEF), axis=1)[:, -2:].T
    return np.column_stack(
        [
            np.log(first / second),
            of_points[:, :3],
            np.sqrt(of_points[:, 3]),
            of_points[:, 3:5],
            np.log(groups.sizes),
            of_points[:, 5:],
            np.full(groups.count, own.mean()),
        ]
    )


def calibrated(found: _Array) -> _Array:
    """Expected share (G,) of right pixels from ``features`` (G, 11): a logistic curve."""
    return np.asarray(1 / (1 + np.exp(-(found @ np.array(list(WEIGHTS.values())) + INTERCEPT))))


def worst_first(confidence: _Array, sizes: NDArray[np.int64]) -> NDArray[np.intp]:
    """Supervoxels in the order they are worth looking at: the most wrong pixels to be expected first."""
    return np.argsort(-(1 - confidence) * sizes, kind="stable")


def _edges(parts: NDArray[np.uint8], mask: NDArray[np.bool_]) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Which points touch another part, and which the person's outline: (n,) each."""
    square = np.ones((3, 3), np.uint8)
    highest = cv2.dilate(parts, square)
    lowest = cv2.erode(np.where(mask, parts, np.uint8(255)), square)
    return np.asarray(highest != lowest)[mask], np.asarray(cv2.erode(mask.astype(np.uint8), square) == 0)[
        mask
    ]
