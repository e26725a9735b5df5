"""Projection of a cloud onto the screen. No window here.

Screen coordinates are Qt's logical pixels, x right and y down from the view's upper left corner, whatever
the screen's pixel ratio, so that a selection is under the pointer on high-resolution screens too.
"""

import numpy as np

from annotate.array_types import Bool, Float32, Float64
from annotate.correction.select import CELL_PX, ScreenPoints

CELL_SPACINGS = 2.2
"""Side of a view's cells in distances of neighbouring points, without gaps for points behind. Chosen by
eye."""


def project(
    points_m: Float32, shown: Bool, screen_from_world: Float64, size_px: tuple[int, int], spacing_px: float
) -> ScreenPoints:
    """Project points (n, 3), depth-camera frame, with a VTK composite matrix (4, 4) onto a view.

    shown: bool (n,); the others neither hide nor can be chosen. size_px: (width, height). spacing_px:
    distance of neighbouring points on the screen. Points at or behind the eye are not on the screen.
    """
    matrix = screen_from_world.astype(np.float32)
    at = np.flatnonzero(shown)
    points = points_m[at]
    x, y, w = (points @ matrix[row, :3] + matrix[row, 3] for row in (0, 1, 3))
    with np.errstate(divide="ignore", invalid="ignore"):
        w = np.where(w > 0, w, np.float32(np.nan))
        xy = np.stack([(x / w + 1) / 2 * size_px[0], (1 - y / w) / 2 * size_px[1]], axis=1)
    xy_px = np.full((len(points_m), 2), np.nan, np.float32)
    distance_m = np.full(len(points_m), np.nan, np.float32)
    xy_px[at], distance_m[at] = xy, w
    return ScreenPoints(xy_px, distance_m, size_px, max(CELL_PX, round(CELL_SPACINGS * spacing_px)))
