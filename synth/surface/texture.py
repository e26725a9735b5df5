"""Smooth noise in space: one tile of it, from which seams stray, cloth folds and wood has its grain."""

from functools import cache

import numba
import numpy as np
from scipy.ndimage import gaussian_filter

from annotate.array_types import Float32
from synth.surface.rasterize import EXACT

TILE_CELLS = 64
"""Cells a side of the tile, a power of two."""
CORRELATION_CELLS = 2.0
"""Sigma of the filter that makes the noise smooth: wide enough that interpolation takes no variance away."""


@cache
def noise_tile() -> Float32:
    """Noise float32 (64, 64, 64) of mean 0 and standard deviation 1 that repeats without a seam."""
    rng = np.random.default_rng(64)
    noise = gaussian_filter(rng.standard_normal((TILE_CELLS,) * 3), CORRELATION_CELLS, mode="wrap")
    tile = np.asarray((noise - noise.mean()) / noise.std(), np.float32)
    tile.flags.writeable = False
    return tile


def wavelength_cells(wavelength_m: float) -> float:
    """Cells of the tile a metre spans when its bumps shall lie about ``wavelength_m`` apart."""
    return 5 * CORRELATION_CELLS / wavelength_m


@numba.njit(cache=True, fastmath=EXACT)
def smooth_noise(tile: Float32, x: float, y: float, z: float) -> float:
    """Noise at a place given in cells, trilinear between them."""
    i, j, k = int(np.floor(x)), int(np.floor(y)), int(np.floor(z))
    a, b, c = x - i, y - j, z - k
    i0, j0, k0 = i & (TILE_CELLS - 1), j & (TILE_CELLS - 1), k & (TILE_CELLS - 1)
    i1, j1, k1 = (i + 1) & (TILE_CELLS - 1), (j + 1) & (TILE_CELLS - 1), (k + 1) & (TILE_CELLS - 1)
    low = (1 - b) * ((1 - c) * tile[i0, j0, k0] + c * tile[i0, j0, k1])
    low += b * ((1 - c) * tile[i0, j1, k0] + c * tile[i0, j1, k1])
    high = (1 - b) * ((1 - c) * tile[i1, j0, k0] + c * tile[i1, j0, k1])
    high += b * ((1 - c) * tile[i1, j1, k0] + c * tile[i1, j1, k1])
    value: float = (1 - a) * low + a * high
    return value
