"""Graph of a depth image's pixels, with neighbours joined where the surface goes on.

Two pixels at most two apart are joined when their depths differ by no more than a share of the nearer
one, since both the sampling distance and the noise of a depth camera grow with range. Two, because half
of the pixels on dark hair and cloth have no reading: with four neighbours such a surface falls to pieces
(site percolation needs 0.59 of them with 4 neighbours, 0.41 with 8, 0.17 with the 24 used here).
"""

import heapq

import cv2
import numpy as np
from numba import njit

from annotate.array_types import Bool, Float32, Int32, Int64, UInt8

JUMP = 0.025
"""Depth difference of neighbouring pixels, as a share of the depth, above which a surface ends: 5 cm at 2 m,
a slant of 84 degrees at 365 pixels of focal length. Chosen by eye."""
SMOOTH_STEP = 0.004
"""Unit of depth steps, as a share of the depth: 8 mm at 2 m, the sensor's noise. Chosen by eye."""
ALL_NEIGHBOURS = np.array([(v, u) for v in range(-2, 3) for u in range(-2, 3) if (v, u) != (0, 0)])
"""(v, u) to all neighbours, in the order of the image; the first half are earlier in it."""
STEP_BIT, PATH_BIT, PIXEL_BIT = 55, 30, 5
"""Lowest bits of depth step, path and source in an entry of a flood's queue, a 64-bit integer; below them the
number of the neighbour. Images have up to 2 ** 25 pixels."""
NO_PIXEL = 255
"""Mark of pixels out of a flood."""


def grown(mask: Bool, reach_px: float) -> Bool:
    """Mask (h, w) grown by ``reach_px`` pixels to every side, by a square."""
    side = 2 * round(reach_px) + 1
    return np.asarray(cv2.dilate(mask.astype(np.uint8), np.ones((side, side), np.uint8)) > 0, np.bool_)


def components(mask: Bool, depth_m: Float32, jump: float = JUMP) -> tuple[Int32, int]:
    """Labels int32 (h, w) of a mask's connected components, cut at depth jumps, and their count.

    Labels count from 1; 0 is off the mask (bool (h, w)). depth_m: float32 (h, w), positive on the mask.
    """
    return _components(mask, depth_m.astype(np.float32), np.float32(jump))


def flood(marks: UInt8, depth_m: Float32, reach_px: float) -> UInt8:
    """Marks uint8 (h, w), spread to undecided pixels over the smoothest surface, then by the shortest path.

    Minimum spanning forest on the depth steps in units of SMOOTH_STEP (watershed cut of Cousty et al. 2009),
    ties going to the shorter path. It stops at depth jumps and after ``reach_px`` steps, so that no mark
    leaks far; pixels out of reach stay 0. marks: uint8 (h, w), 0 = undecided, NO_PIXEL = none. depth_m:
    float32 (h, w), positive on all but these.
    """
    return _flood(marks, depth_m.astype(np.float32), reach_px)


@njit(cache=True, nogil=True, forceinline=True)
def _find(parent: Int32, i: int) -> int:
    """Root of ``i`` in a forest of parents (n,), paths halved."""
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@njit(cache=True, nogil=True)
def _components(mask: Bool, depth: Float32, jump: np.float32) -> tuple[Int32, int]:
    """As ``components``, by union-find over the earlier neighbours."""
    height, width = mask.shape
    parent = np.arange(height * width).astype(np.int32)
    for v in range(height):
        for u in range(width):
            if not mask[v, u]:
                continue
            for k in range(len(ALL_NEIGHBOURS) // 2):
                r, c = v + ALL_NEIGHBOURS[k, 0], u + ALL_NEIGHBOURS[k, 1]
                if r < 0 or c < 0 or c >= width or not mask[r, c]:
                    continue
                if abs(depth[v, u] - depth[r, c]) <= jump * min(depth[v, u], depth[r, c]):
                    a, b = _find(parent, v * width + u), _find(parent, r * width + c)
                    parent[max(a, b)] = min(a, b)
    labels = np.zeros((height, width), np.int32)
    count = 0
    for v in range(height):
        for u in range(width):
            if mask[v, u]:
                root = _find(parent, v * width + u)
                if root == v * width + u:
                    count += 1
                    labels[v, u] = count
                else:
                    labels[v, u] = labels[root // width, root % width]
    return labels, count


@njit(cache=True, nogil=True)
def _flood(marks: UInt8, depth: Float32, reach_px: float) -> UInt8:
    """As ``flood``, by Prim's algorithm."""
    marks = marks.copy()
    width, flat = marks.shape[1], marks.reshape(-1)
    path = np.zeros(marks.size, np.int64)
    least = np.full(marks.size, np.int64(1) << 62)
    queue = [np.int64(0) for _ in range(0)]
    for start in range(marks.size):
        if 0 < flat[start] < NO_PIXEL:
            _queue_neighbours(queue, marks, depth, path, least, start)
    while queue:
        entry = heapq.heappop(queue)
        source, k = (entry >> PIXEL_BIT) & ((1 << (PATH_BIT - PIXEL_BIT)) - 1), entry & ((1 << PIXEL_BIT) - 1)
        target = source + ALL_NEIGHBOURS[k, 0] * width + ALL_NEIGHBOURS[k, 1]
        if flat[target] == 0:
            flat[target] = flat[source]
            path[target] = path[source] + 1
            if path[target] < reach_px:
                _queue_neighbours(queue, marks, depth, path, least, target)
    return marks


@njit(cache=True, nogil=True)
def _queue_neighbours(
    queue: list[np.int64], marks: UInt8, depth: Float32, path: Int64, least: Int64, source: int
) -> None:
    """Queue a pixel's undecided neighbours by the depth step to them, then by the path.

    least: the best rank queued for every pixel so far; a worse one would never be used.
    """
    height, width = marks.shape
    v, u = source // width, source % width
    for k in range(ALL_NEIGHBOURS.shape[0]):
        r, c = v + ALL_NEIGHBOURS[k, 0], u + ALL_NEIGHBOURS[k, 1]
        if 0 <= r < height and 0 <= c < width and marks[r, c] == 0:
            target = r * width + c
            step = abs(depth[r, c] - depth[v, u]) / min(depth[r, c], depth[v, u])
            if not step <= np.float32(JUMP):
                continue
            rank = (np.int64(step / SMOOTH_STEP) << STEP_BIT) + (path[source] << PATH_BIT)
            if rank < least[target]:
                least[target] = rank
                heapq.heappush(queue, rank + (np.int64(source) << PIXEL_BIT) + k)
