"""Compiled functions for vectors of three numbers, barycentric coordinates and smooth noise."""

from functools import cache

import numba
import numpy as np

from annotate.array_types import Float32, Int32
from synth.surface.rasterize import EXACT

Triple = tuple[float, float, float]


@numba.njit(cache=True, fastmath=EXACT)
def shares(vertices: Float32, faces: Int32, f: int, p: Triple) -> Triple:
    """Return a point's barycentric coordinates in a face's plane, clamped to the face."""
    a = faces[f, 0]
    e, g = edge(vertices, a, faces[f, 1]), edge(vertices, a, faces[f, 2])
    d = (p[0] - vertices[a, 0], p[1] - vertices[a, 1], p[2] - vertices[a, 2])
    ee, eg, gg, de, dg = dot(e, e), dot(e, g), dot(g, g), dot(d, e), dot(d, g)
    area = ee * gg - eg * eg
    if area <= 0:
        return (1.0, 0.0, 0.0)
    b = min(max((gg * de - eg * dg) / area, 0.0), 1.0)
    c = min(max((ee * dg - eg * de) / area, 0.0), 1.0 - b)
    return (1 - b - c, b, c)


@numba.njit(cache=True, fastmath=EXACT)
def mix(values: Float32, faces: Int32, f: int, s: Triple) -> Triple:
    """Return the corners' values (V, 3) of face f, interpolated at barycentric coordinates s."""
    a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
    return (
        s[0] * values[a, 0] + s[1] * values[b, 0] + s[2] * values[c, 0],
        s[0] * values[a, 1] + s[1] * values[b, 1] + s[2] * values[c, 1],
        s[0] * values[a, 2] + s[1] * values[b, 2] + s[2] * values[c, 2],
    )


@numba.njit(cache=True, fastmath=EXACT)
def mix_column(fields: Float32, n: int, faces: Int32, f: int, s: Triple) -> float:
    """Return column n of values (V, n), interpolated as ``mix`` does."""
    value: float = (
        s[0] * fields[faces[f, 0], n] + s[1] * fields[faces[f, 1], n] + s[2] * fields[faces[f, 2], n]
    )
    return value


@numba.njit(cache=True, fastmath=EXACT)
def edge(vertices: Float32, a: int, b: int) -> Triple:
    return (
        np.float64(vertices[b, 0]) - vertices[a, 0],
        np.float64(vertices[b, 1]) - vertices[a, 1],
        np.float64(vertices[b, 2]) - vertices[a, 2],
    )


@numba.njit(cache=True, fastmath=EXACT)
def cross(a: Triple, b: Triple) -> Triple:
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


@numba.njit(cache=True, fastmath=EXACT)
def dot(a: Triple, b: Triple) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@numba.njit(cache=True, fastmath=EXACT)
def unit(a: Triple) -> Triple:
    """Return the vector scaled to length 1; a vector of length 0 is unchanged."""
    length = np.sqrt(dot(a, a)) + 1e-12
    return (a[0] / length, a[1] / length, a[2] / length)


TILE_CELLS = 64  # a power of two
CORRELATION_CELLS = 2.0  # sigma of the noise's filter; interpolation lowers the variance of finer noise


@cache
def noise_tile() -> Float32:
    """Return periodic noise float32 (64, 64, 64) of mean 0 and standard deviation 1."""
    from scipy.ndimage import gaussian_filter

    rng = np.random.default_rng(64)
    noise = gaussian_filter(rng.standard_normal((TILE_CELLS,) * 3), CORRELATION_CELLS, mode="wrap")
    tile = np.asarray((noise - noise.mean()) / noise.std(), np.float32)
    tile.flags.writeable = False
    return tile


def wavelength_cells(wavelength_m: float) -> float:
    """Return the resolution, in texture cells per metre, for bumps with a spacing of ``wavelength_m``."""
    return 5 * CORRELATION_CELLS / wavelength_m


@numba.njit(cache=True, fastmath=EXACT)
def smooth_noise(tile: Float32, x: float, y: float, z: float) -> float:
    """Return the tile's noise, interpolated trilinearly at a position in cells."""
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
