"""Borders between parts at depth resolution: every pixel's own colour, its supervoxel and its neighbours."""

import numpy as np
from numba import njit

from annotate.array_types import Bool, Float32, Float64, Int32, UInt8

NEIGHBOUR = 0.5
"""What each of the eight neighbours of the same part adds to a pixel's log score."""
JUMP_M = 0.03
"""Neighbouring pixels further apart than this along the view lie on different surfaces."""
ROUNDS = 6


def refine(scores: Float64, start: UInt8, depth_m: Float32, mask: Bool) -> UInt8:
    """Settle the part index of every masked pixel by iterated conditional modes (Besag 1986).

    scores: (n, k) log score of each part for the masked pixels in row-major order, -inf where it may not be
    taken. start: uint8 (n,). depth_m, mask: (h, w). Returns part indices uint8 (n,).
    """
    index = np.full(mask.shape, -1, np.int32)
    index[mask] = np.arange(len(start))
    return np.asarray(_modes(scores, start, depth_m.astype(np.float32), index), np.uint8)


@njit(cache=True, nogil=True)
def _modes(scores: Float64, start: UInt8, depth: Float32, index: Int32) -> UInt8:
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
