"""Shares of red and green in the light of many colours, compiled."""

import numpy as np
from numba import njit

from annotate.array_types import Float64, UInt8


@njit(cache=True, nogil=True)
def shares(rgb: UInt8, linear: Float64) -> Float64:
    """Chromaticities (n, 2) of colours (n, 3); linear: (256,), light of every value."""
    shares = np.empty((len(rgb), 2))
    for i in range(len(rgb)):
        red, green, blue = linear[rgb[i, 0]], linear[rgb[i, 1]], linear[rgb[i, 2]]
        total = red + green + blue
        shares[i, 0], shares[i, 1] = red / total, green / total
    return shares
