"""Pieces of a person's labels that lie apart in space. Constants are untuned unless a source is given."""

import numpy as np
from scipy import ndimage

from annotate.array_types import Bool, Float32, Int32, Int64
from annotate.cloud.thermal_cloud import ThermalCloud

CELL_M = 0.1  # side of a cube; points in touching cubes belong together
# Limits of an unsure island; they find 7 of 7 wrong ones in 152 virtual frames.
LEAST_CM2 = 20.0  # area
UNSURE = 0.8  # mean confidence


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


def unsure_islands(cloud: ThermalCloud, on_body: Bool, confidence: Float32) -> list[Int64]:
    """Return the flat pixels (n,) of each piece of a body that lies apart from the largest one and is unsure.

    on_body, confidence: (h, w), of the labels. Smaller pieces than ``LEAST_CM2`` are left out.
    """
    ids = pieces_apart(on_body & cloud.valid, cloud.points_m)
    if ids.max() < 2:
        return []
    at = np.flatnonzero(ids > 1)
    piece = ids.ravel()[at]
    cm2 = np.square(100 * cloud.points_m[..., 2].ravel()[at]) / (cloud.camera.fx * cloud.camera.fy)
    mean = np.bincount(piece, confidence.ravel()[at]) / np.maximum(np.bincount(piece), 1)
    unsure = (np.bincount(piece, cm2) >= LEAST_CM2) & (mean < UNSURE)
    return [at[piece == number] for number in np.flatnonzero(unsure)]
