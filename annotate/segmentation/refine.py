"""Borders between parts at depth resolution: every pixel's own colour, its supervoxel and its neighbours."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

NEIGHBOUR = 0.5
"""What each of the eight neighbours of the same part adds to a pixel's log score."""
JUMP_M = 0.03
"""Neighbouring pixels further apart than this along the view lie on different surfaces."""
ROUNDS = 6

_Array = NDArray[np.float64]


def refine(
    scores: _Array, start: NDArray[np.uint8], depth_m: NDArray[np.float32], mask: NDArray[np.bool_]
) -> NDArray[np.uint8]:
    """Settle the part index of every masked pixel by iterated conditional modes (Besag 1986).

    scores: (n, k) log score of each part for the masked pixels in row-major order, -inf where it may not be
    taken. start: uint8 (n,). depth_m, mask: (h, w). Returns part indices uint8 (n,).
    """
    index = np.full(mask.shape, -1, np.int32)
    index[mask] = np.arange(len(start))
    return np.asarray(_modes(scores, start, depth_m.astype(np.float32), index), np.uint8)


@njit(cache=True, nogil=True)
def _modes(
    scores: _Array, start: NDArray[np.uint8], depth: NDArray[np.float32], index: NDArray[np.int32]
) -> NDArray[np.uint8]:
    height, width = index.shape
    chosen = start.copy()
    total = np.empty(scores.shape[1])
    for _ in range(ROUNDS):
        last = chosen.copy()
        for v in range(height):
            for u in range(width):
                i = index[v, u]
                if i < 0:
                    continue
                total[:] = scores[i]
                for dv in range(-1, 2):
                    for du in range(-1, 2):
                        r, c = v + dv, u + du
                        if (dv == 0 and du == 0) or r < 0 or c < 0 or r >= height or c >= width:
                            continue
                        j = index[r, c]
                        if j >= 0 and abs(depth[r, c] - depth[v, u]) <= JUMP_M:
                            total[last[j]] += NEIGHBOUR
                chosen[i] = np.argmax(total)
        if np.array_equal(chosen, last):
            break
    return chosen
