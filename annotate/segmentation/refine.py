"""Parts (n,) at depth resolution, by every pixel's own colour, its supervoxel and its neighbours."""

import numpy as np
from numba import njit

from annotate.array_types import Bool, Float32, Float64, Int32, UInt8

NEIGHBOUR = 0.5
"""Log score that each of the eight neighbours adds to its own part at a pixel. Chosen by eye."""
JUMP_M = 0.03
"""Depth difference in metres of neighbours on different surfaces. Chosen by eye."""
REFINE_ROUNDS = 6
"""Rounds of iterated conditional modes at most. Chosen by eye."""


def refine(scores: Float64, start: UInt8, depth_m: Float32, mask: Bool) -> UInt8:
    """Part indices uint8 (n,) of the masked pixels by iterated conditional modes (Besag 1986).

    scores: (n, k), log score of each part for the masked pixels in row-major order, -inf for forbidden parts.
    start: uint8 (n,), part indices to begin with. depth_m, mask: (h, w).
    """
    index = np.full(mask.shape, -1, np.int32)
    index[mask] = np.arange(len(start))
    return np.asarray(_modes(scores, start, depth_m.astype(np.float32), index), np.uint8)


@njit(cache=True, nogil=True)
def _modes(scores: Float64, start: UInt8, depth: Float32, index: Int32) -> UInt8:
    """Part indices (n,); index: (h, w), place of each pixel in ``scores``, -1 off the mask. As ``refine``."""
    height, width = index.shape
    chosen = start.copy()
    total = np.empty(scores.shape[1])
    for _ in range(REFINE_ROUNDS):
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
