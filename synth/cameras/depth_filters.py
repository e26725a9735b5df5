"""Filters that makers apply to stereo depth, as in librealsense (``src/proc``): decimation, smoothing between
edges, and hole filling.

Images hold disparity or depth, float32, 0 without a reading. Sources are flat indices of clean pixels, as in
``Reading``.
"""

from enum import IntEnum

import numba
import numpy as np

from annotate.array_types import Float32, Int32
from synth.cameras.relief import Number
from synth.surface.rasterize import EXACT


class Fill(IntEnum):
    """Mode of hole filling: librealsense's number plus 1, 0 for none."""

    NONE = 0
    LEFT = 1
    FARTHEST = 2
    NEAREST = 3


@numba.njit(cache=True, fastmath=EXACT)
def decimate(image: Float32, source: Int32, cell_px: float) -> tuple[Float32, Int32]:
    """Return an image (h', w') of cells, ``cell_px`` >= 1 pixels a side, and its sources.

    A cell has the median of its readings, the lower one of an even number (``decimation-filter.cpp``).
    """
    height, width = image.shape
    rows, columns = cell_of(height - 1, cell_px) + 1, cell_of(width - 1, cell_px) + 1
    small, origin = np.zeros((rows, columns), np.float32), np.full((rows, columns), np.int32(-1))
    most = int(np.ceil(cell_px)) + 1
    values, indices = np.empty(most * most, np.float32), np.empty(most * most, np.int32)
    for i in range(rows):
        top, bottom = _first(i, cell_px), min(_first(i + 1, cell_px), height)
        for j in range(columns):
            left, right = _first(j, cell_px), min(_first(j + 1, cell_px), width)
            n = 0
            for v in range(top, bottom):
                for u in range(left, right):
                    if image[v, u] > 0:
                        k = n
                        while k > 0 and values[k - 1] > image[v, u]:
                            values[k], indices[k] = values[k - 1], indices[k - 1]
                            k -= 1
                        values[k], indices[k] = image[v, u], source[v, u]
                        n += 1
            if n:
                small[i, j], origin[i, j] = values[(n - 1) // 2], indices[(n - 1) // 2]
    return small, origin


@numba.njit(cache=True)
def cell_of(pixel: int, cell_px: float) -> int:
    """Return the row or column of the cell that contains the middle of a pixel."""
    return int((pixel + 0.5) / cell_px)


@numba.njit(cache=True)
def _first(cell: int, cell_px: float) -> int:
    """Return the first pixel of a cell."""
    return int(np.ceil(cell * cell_px - 0.5))


@numba.njit(cache=True, fastmath=EXACT)
def smooth_between_edges(image: Float32, alpha: Number, delta: Number, passes: int) -> None:
    """Smooth an image in place, along rows and columns in both directions (``spatial-filter.cpp``; domain
    transform of Gastal & Oliveira 2011).

    alpha: weight of the current pixel. delta: step between neighbours that is an edge. Edges and holes
    restart the recursion.
    """
    height, width = image.shape
    state, before = np.empty(width, np.float32), np.empty(width, np.float32)
    for _ in range(passes):
        for v in range(height):
            _smooth_row(image[v], alpha, delta)
            _smooth_row(image[v, ::-1], alpha, delta)
        for first, step in ((0, 1), (height - 1, -1)):
            state[:], before[:] = image[first], image[first]
            for k in range(1, height):
                _smooth_next(image[first + step * k], state, before, alpha, delta)


@numba.njit(cache=True, fastmath=EXACT)
def _smooth_row(row: Float32, alpha: Number, delta: Number) -> None:
    state = before = row[0]
    for u in range(1, len(row)):
        here = row[u]
        if here > 0:
            if before > 0 and abs(before - here) < delta:
                state = here * alpha + state * (np.float32(1) - alpha)
                row[u] = state
            else:
                state = here
        before = here


@numba.njit(cache=True, fastmath=EXACT)
def _smooth_next(row: Float32, state: Float32, before: Float32, alpha: Number, delta: Number) -> None:
    """Continue the recursion of all columns (w,) into the next row (w,)."""
    for u in range(len(row)):
        here = row[u]
        near = (before[u] > 0) & (abs(before[u] - here) < delta)
        state[u] = here * alpha + state[u] * (np.float32(1) - alpha) if near else here
        before[u] = here
        row[u] = state[u] if here > 0 else here


@numba.njit(cache=True)
def fill_holes(depth: Float32, source: Int32, mode: int) -> None:
    """Fill holes of a depth image in place, with their sources (``hole-filling-filter.h``).

    A hole takes its left neighbour, or the farthest or nearest of the pixels above, below and to the left.
    Pixels filled earlier count. ``Fill.NEAREST`` keeps a hole below a hole.
    """
    height, width = depth.shape
    if mode == Fill.LEFT:
        for v in range(height):
            for u in range(1, width):
                if depth[v, u] == 0:
                    depth[v, u], source[v, u] = depth[v, u - 1], source[v, u - 1]
    elif mode != Fill.NONE:
        for v in range(1, height - 1):
            for u in range(1, width):
                if depth[v, u] == 0:
                    y, x = _filler(depth, v, u, mode == Fill.NEAREST)
                    depth[v, u], source[v, u] = depth[y, x], source[y, x]


@numba.njit(cache=True)
def _filler(depth: Float32, v: int, u: int, nearest: bool) -> tuple[int, int]:
    y, x = v - 1, u
    for i, j in ((v - 1, u - 1), (v, u - 1), (v + 1, u - 1), (v + 1, u)):
        if 0 < depth[i, j] < depth[y, x] if nearest else depth[i, j] > depth[y, x]:
            y, x = i, j
    return y, x
