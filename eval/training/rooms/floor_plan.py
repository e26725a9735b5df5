"""Floor plan of a scene: which places are taken. Constants are untuned."""

from collections.abc import Sequence

import cv2
import numpy as np

from annotate.array_types import Float32, Float64, Index, UInt8
from synth.surface.rasterize import Mesh

CELL_M, HALF_M = 0.03, 10.0  # side of a cell, and half the side of the plan
MANY_FACES = 1000  # of a mesh whose faces are smaller than a cell: a body
_SIDE = int(2 * HALF_M / CELL_M)


class FloorPlan:
    """Cells of the floor (world x, y) that people and things take, seen from above."""

    def __init__(self) -> None:
        self._taken: UInt8 = np.zeros((_SIDE, _SIDE), np.uint8)

    def take(self, meshes: Sequence[Mesh]) -> bool:
        """Take the cells under meshes; return False and take none if one is taken or lies off the plan."""
        above = [_seen_from_above(mesh) for mesh in meshes]
        low = np.min([corner for corner, _ in above], axis=0)
        high = np.max([corner + shape.shape for corner, shape in above], axis=0)
        if (low < 0).any() or (high > _SIDE).any():
            return False
        own = np.zeros(high - low, np.uint8)
        for corner, shape in above:
            i, j = corner - low
            own[i : i + shape.shape[0], j : j + shape.shape[1]] |= shape
        window = self._taken[low[0] : high[0], low[1] : high[1]]
        if (window & own).any():
            return False
        window |= own
        return True

    def take_circle(self, centre_m: Float64, radius_m: float) -> None:
        """Take a circle about a place (2,) or (3,)."""
        i, j = (int((c + HALF_M) / CELL_M) for c in centre_m[:2])
        cv2.circle(self._taken, (j, i), round(radius_m / CELL_M), 1, -1)


def _seen_from_above(mesh: Mesh) -> tuple[Index, UInt8]:
    """Return the first cell (2,) and the cells (n, m) of a mesh's triangles."""
    cells: Float32 = (mesh.vertices_m[:, :2] + np.float32(HALF_M)) / np.float32(CELL_M)
    corner = np.floor(cells.min(axis=0)).astype(np.intp)
    local = np.floor(cells - corner).astype(np.int32)
    shape = np.zeros(local.max(axis=0) + 1, np.uint8)
    if len(mesh.faces) > MANY_FACES:
        shape[local[:, 0], local[:, 1]] = 1
        closed = cv2.morphologyEx(shape, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
        return corner, closed.astype(np.uint8)
    for triangle in local[mesh.faces][..., ::-1]:
        cv2.fillConvexPoly(shape, np.ascontiguousarray(triangle), 1)
    return corner, shape
