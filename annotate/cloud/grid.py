"""Graph of a depth image's pixels, with neighbours joined along surfaces.

Pixels at most two rows and columns apart are joined if their depths differ by at most ``JUMP``. The reach is
two, because half of the pixels on dark hair and cloth lack a reading. Site percolation needs 0.59 of the
pixels with 4 neighbours, 0.41 with 8, 0.17 with 24.
"""

import cv2
import numpy as np
from numba import njit

from annotate.array_types import Bool, Float32, Int32

JUMP = 0.025  # depth difference of neighbours, share of the depth, above which a surface ends; untuned
ALL_NEIGHBOURS = np.array([(v, u) for v in range(-2, 3) for u in range(-2, 3) if (v, u) != (0, 0)])
"""(v, u) to all neighbours; the first half are earlier in the image."""


def grown(mask: Bool, reach_px: float) -> Bool:
    """Dilate a mask (h, w) by ``reach_px`` pixels to every side, with a square."""
    side = 2 * round(reach_px) + 1
    return np.asarray(cv2.dilate(mask.astype(np.uint8), np.ones((side, side), np.uint8)) > 0, np.bool_)


def components(mask: Bool, depth_m: Float32) -> tuple[Int32, int]:
    """Return ids int32 (h, w) of a mask's components, from 1, split at depth jumps, and their number.

    depth_m: float32 (h, w), positive on the mask (bool (h, w)).
    """
    return _components(mask, depth_m.astype(np.float32), np.float32(JUMP))


@njit(cache=True, nogil=True, forceinline=True)
def _find(parent: Int32, i: int) -> int:
    """Return the root of ``i`` in a union-find forest of parents (n,), with path halving."""
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@njit(cache=True, nogil=True)
def _components(mask: Bool, depth: Float32, jump: np.float32) -> tuple[Int32, int]:
    """Compute ``components`` by union-find over the earlier neighbours."""
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
