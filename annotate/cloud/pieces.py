"""Pieces of a mask that lie apart in space."""

import numpy as np
from scipy import ndimage

from annotate.array_types import Bool, Float32, Int32

CELL_M = 0.1  # side of a cube; points in touching cubes belong together; untuned


def pieces_apart(mask: Bool, points_m: Float32) -> Int32:
    """Return ids int32 (h, w) of the pieces of a mask in space, the largest piece first; 0 = outside.

    mask: bool (h, w). points_m: float32 (h, w, 3), metres, camera frame, finite on the mask. Pieces are at
    least one cube of side ``CELL_M`` apart. A pixel counts by the area that it covers: its depth squared.
    """
    ids = np.zeros(mask.shape, np.int32)
    points = points_m[mask]
    if len(points):
        cells = np.floor(points / np.float32(CELL_M)).astype(np.int64)
        cells -= cells.min(axis=0)
        grid = np.zeros(cells.max(axis=0) + 1, np.bool_)
        grid[tuple(cells.T)] = True
        numbers = ndimage.label(grid, np.ones((3, 3, 3)))[0][tuple(cells.T)]
        area = np.bincount(numbers, np.square(points[:, 2].astype(np.float64)))
        rank = np.empty(len(area), np.int32)
        rank[np.argsort(-area, kind="stable")] = np.arange(1, len(area) + 1)
        ids[mask] = rank[numbers]
    return ids
