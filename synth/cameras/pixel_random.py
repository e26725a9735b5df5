"""Random numbers of a pixel: hashes of a key and a place, so that no pixel depends on another's draws."""

import numba
import numpy as np
from scipy.special import ndtri

from annotate.array_types import Float32
from synth.surface.rasterize import EXACT

NORMALS = ndtri((np.arange(4096) + 0.5) / 4096)
NORMALS = (NORMALS / NORMALS.std()).astype(np.float32)
"""The normal distribution by its inverse: twelve random bits make a number, 3.7 sigma at most."""


@numba.njit(cache=True)
def hashed(key: np.uint64, counter: int) -> np.uint64:
    """64 random bits of a key and a counter. Source: splitmix64, Steele et al. 2014."""
    z = np.uint64(key) + np.uint64(counter + 1) * np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


@numba.njit(cache=True)
def share_of(bits: np.uint64) -> np.float32:
    """The sixteen low bits as a number in [0, 1)."""
    return np.float32(bits & np.uint64(0xFFFF)) * np.float32(1 / 65536)


@numba.njit(cache=True)
def normal_of(bits: np.uint64, normals: Float32) -> np.float32:
    """The twelve low bits as a standard normal number; normals: ``NORMALS``."""
    return np.float32(normals[bits & np.uint64(4095)])


@numba.njit(cache=True)
def block_bits(key: np.uint64, v: int, u: int, side: int) -> np.uint64:
    """64 random bits of the square block, ``side`` pixels wide, that holds pixel (v, u)."""
    return hashed(key, (v // side) * 65536 + u // side)


@numba.njit(cache=True, fastmath=EXACT)
def smooth_noise(key: np.uint64, v: int, u: int, side: int, normals: Float32) -> np.float32:
    """Standard normal noise that is alike within about ``side`` pixels, at pixel (v, u).

    Value noise: bilinear between independent normal numbers every ``side`` pixels, divided by the standard
    deviation at the pixel, so that its strength is the same everywhere.
    """
    row, column = v // side, u // side
    y = (np.float32(v - row * side) + np.float32(0.5)) / np.float32(side)
    x = (np.float32(u - column * side) + np.float32(0.5)) / np.float32(side)
    total, square = np.float32(0), np.float32(0)
    for i in range(2):
        for j in range(2):
            weight = (y if i else np.float32(1) - y) * (x if j else np.float32(1) - x)
            total += weight * normal_of(hashed(key, (row + i) * 65536 + column + j), normals)
            square += weight * weight
    return np.float32(total / np.sqrt(square))
