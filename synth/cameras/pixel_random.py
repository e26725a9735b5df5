"""Random numbers of pixels: hashes of key and position. Blocks are squares of 2^``log2`` pixels a side."""

from functools import cache

import numba
import numpy as np
from scipy.special import ndtri

from annotate.array_types import Float32
from synth.surface.rasterize import EXACT

NORMALS = ndtri((np.arange(4096) + 0.5) / 4096)
NORMALS = (NORMALS / NORMALS.std()).astype(np.float32)  # normal numbers by twelve random bits


@numba.njit(cache=True)
def hashed(key: np.uint64, counter: int) -> np.uint64:
    """Return 64 random bits of a key and a counter (splitmix64, Steele et al. 2014)."""
    z = np.uint64(key) + np.uint64(counter + 1) * np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


@numba.njit(cache=True)
def share_of(bits: np.uint64) -> np.float32:
    """Return the sixteen low bits as a number in [0, 1)."""
    return np.float32(bits & np.uint64(0xFFFF)) * np.float32(1 / 65536)


@numba.njit(cache=True, fastmath=EXACT)
def chance_of(normal: np.float32) -> np.float32:
    """Return the value of the normal distribution function to 0.01 (logistic, Bowling et al. 2009)."""
    return np.float32(np.float32(1) / (np.float32(1) + np.exp(np.float32(-1.702) * normal)))


@numba.njit(cache=True)
def block_bits(key: np.uint64, v: int, u: int, log2: int) -> np.uint64:
    """Return 64 random bits of the block of pixel (v, u)."""
    return hashed(key, (v >> log2) * 65536 + (u >> log2))


@cache
def ramps(log2: int) -> Float32:
    """Return the bilinear weights (side, side, 4) of a block's corners at its pixels; the weighted sum has
    unit variance.
    """
    x = (np.arange(2**log2) + 0.5) / 2**log2
    ends = np.stack([1 - x, x], axis=1)
    ends /= np.linalg.norm(ends, axis=1, keepdims=True)
    corners = ends[:, None, :, None] * ends[None, :, None, :]
    return np.asarray(corners.reshape(2**log2, 2**log2, 4), np.float32)


@numba.njit(cache=True)
def lattice(key: np.uint64, height: int, width: int, log2: int, normals: Float32) -> Float32:
    """Return a normal random number for every corner of an image's square blocks, (rows, columns).

    log2: of the blocks' edge in pixels. normals: table ``NORMALS``.
    """
    corners = np.empty(((height >> log2) + 2, (width >> log2) + 2), np.float32)
    for i in range(corners.shape[0]):
        for j in range(corners.shape[1]):
            corners[i, j] = normals[hashed(key, i * 65536 + j) & np.uint64(4095)]
    return corners


@numba.njit(cache=True, fastmath=EXACT)
def smooth(corners: Float32, weights: Float32, v: int, u: int, log2: int) -> np.float32:
    """Return smooth (value) noise with a normal distribution at pixel (v, u).

    corners: from ``lattice``. weights: from ``ramps``.
    """
    i, j, side = v >> log2, u >> log2, (1 << log2) - 1
    weight = weights[v & side, u & side]
    return np.float32(
        weight[0] * corners[i, j]
        + weight[1] * corners[i, j + 1]
        + weight[2] * corners[i + 1, j]
        + weight[3] * corners[i + 1, j + 1]
    )
