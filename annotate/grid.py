"""The pixel grid of a depth image as a graph: neighbours are joined where the surface goes on.

Two 4-neighbours are joined when their depths differ by no more than a share of the nearer one, since
both the sampling distance and the noise of a depth camera grow with range.
"""

import heapq

import numpy as np
from numba import njit
from numpy.typing import NDArray

JUMP = 0.025
"""Depth difference of neighbouring pixels, as a share of the depth, above which a surface ends: 5 cm
at 2 m, what 84 degrees of slant give at 365 pixels of focal length."""


def components(
    mask: NDArray[np.bool_], depth_m: NDArray[np.float32], jump: float = JUMP
) -> tuple[NDArray[np.int32], int]:
    """Connected components of a mask (h, w), cut at depth jumps -> labels (h, w) from 1, 0 outside; count.

    depth_m: float32 (h, w), positive on the mask.
    """
    labels, count = _components(mask, depth_m.astype(np.float32), np.float32(jump))
    return labels, int(count)


def flood(
    markers: NDArray[np.uint8], depth_m: NDArray[np.float32], reach_m: NDArray[np.float32], jump: float = JUMP
) -> NDArray[np.uint8]:
    """Give every undecided pixel the mark that reaches it over the smallest depth steps.

    A minimum spanning forest on the steps (Cousty et al. 2009: the watershed cut), which stops at depth
    jumps and after ``reach_m`` of path, so that no mark leaks far into the unknown.
    markers: uint8 (h, w), 0 = undecided, 255 = no pixel. depth_m: metres. reach_m: the pixels' own
    (h, w) budget of path, in pixels. Returns the marks; what is not reached stays 0.
    """
    return _flood(markers, depth_m.astype(np.float32), reach_m.astype(np.float32), np.float32(jump))


@njit(cache=True, nogil=True, forceinline=True)
def _find(parent: NDArray[np.int32], i: int) -> int:
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@njit(cache=True, nogil=True)
def _components(
    mask: NDArray[np.bool_], depth: NDArray[np.float32], jump: np.float32
) -> tuple[NDArray[np.int32], int]:
    height, width = mask.shape
    parent = np.arange(height * width).astype(np.int32)
    for v in range(height):
        for u in range(width):
            if not mask[v, u]:
                continue
            for w in range(2):
                above, left = v - (w == 0), u - (w == 1)
                if above < 0 or left < 0 or not mask[above, left]:
                    continue
                near = min(depth[v, u], depth[above, left])
                if abs(depth[v, u] - depth[above, left]) <= jump * near:
                    a, b = _find(parent, v * width + u), _find(parent, above * width + left)
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
def _flood(
    markers: NDArray[np.uint8], depth: NDArray[np.float32], reach: NDArray[np.float32], jump: np.float32
) -> NDArray[np.uint8]:
    height, width = markers.shape
    marks = markers.copy()
    path = np.zeros(height * width, np.float32)
    heap = [(np.float32(0), 0, 0) for _ in range(0)]
    for start in range(height * width):
        if 0 < marks[start // width, start % width] < 255:
            _push(heap, marks, depth, path, reach, jump, start)
    while heap:
        _, source, target = heapq.heappop(heap)
        v, u = target // width, target % width
        if marks[v, u] == 0:
            marks[v, u] = marks[source // width, source % width]
            path[target] = path[source] + 1
            _push(heap, marks, depth, path, reach, jump, target)
    return marks


@njit(cache=True, nogil=True)
def _push(heap, marks, depth, path, reach, jump, source):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    """Queue the undecided neighbours of a pixel by the depth step to them."""
    height, width = marks.shape
    v, u = source // width, source % width
    if path[source] >= reach[v, u]:
        return
    for dv, du in ((-1, 0), (0, -1), (0, 1), (1, 0)):
        r, c = v + dv, u + du
        if 0 <= r < height and 0 <= c < width and marks[r, c] == 0:
            step = abs(depth[r, c] - depth[v, u]) / min(depth[r, c], depth[v, u])
            if step <= jump:
                heapq.heappush(heap, (step, source, r * width + c))
