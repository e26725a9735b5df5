"""How sure a supervoxel's label is: the share of its pixels that will be right, calibrated on the virtual rig."""

import cv2
import numpy as np
from numpy.typing import NDArray

from annotate.supervoxels import Supervoxels

FEATURES = ("odds", "own color", "stray color", "unread", "border", "outline", "size", "frame")
WEIGHTS = np.array([0.4, 2.0, 0.3, -1.0, -2.0, -0.5, 0.1, 1.0])
INTERCEPT = 0.5

_Array = NDArray[np.float64]


def features(
    belief: _Array,
    evidence: _Array,
    readable: NDArray[np.bool_],
    parts: NDArray[np.uint8],
    mask: NDArray[np.bool_],
    groups: Supervoxels,
) -> _Array:
    """What tells a supervoxel's right labels from wrong ones (G, 8), see FEATURES.

    belief: (G, 11). evidence: (n, 11) of the points, readable: (n,), parts: uint8 (h, w) as chosen, mask:
    (h, w) of the points, row-major.
    """
    chosen = parts[mask].astype(np.intp) - 1
    best = evidence.max(axis=1)
    own = np.where(readable, evidence[np.arange(len(chosen)), chosen] - best, 0)
    border, outline = _edges(parts, mask)
    top = np.sort(np.maximum(belief, 1e-4), axis=1)[:, -2:]
    by_point = np.stack([np.exp(own), np.where(readable, best, 0), ~readable, border, outline], axis=1)
    means = groups.mean(by_point)
    means[:, 1] = np.maximum(means[:, 1], -4)
    frame = np.full(groups.count, np.exp(own).mean())
    return np.column_stack([np.log(top[:, 1] / top[:, 0]), means, np.log(groups.sizes), frame])


def calibrated(found: _Array) -> _Array:
    """Expected share (G,) of right pixels from ``features`` (G, 8): a logistic curve."""
    return np.asarray(1 / (1 + np.exp(-(found @ WEIGHTS + INTERCEPT))))


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
