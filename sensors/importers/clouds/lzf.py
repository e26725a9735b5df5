"""LZF, the compression of PCD files (liblzf's format, as PCL's ``lzf.cpp`` reads it)."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

MOST_EXPANSION = 90
"""Bytes that a compressed byte can stand for, rounded up: three give a run of 264 (liblzf)."""


def expand_lzf(data: bytes, size: int) -> NDArray[np.uint8]:
    """Expand to ``size`` bytes. Raises ValueError where ``data`` does not hold exactly these."""
    if size > MOST_EXPANSION * len(data):
        raise ValueError(f"{len(data)} compressed bytes cannot hold {size}")
    out = np.zeros(size, np.uint8)
    if _expand(np.frombuffer(data, np.uint8), out) != size:
        raise ValueError(f"its compressed data is damaged or is not {size} bytes")
    return out


@njit(cache=True, nogil=True)
def _expand(data: NDArray[np.uint8], out: NDArray[np.uint8]) -> int:
    """Fill ``out``; returns the number of bytes, or -1 where a run leaves the data or the output."""
    at, to = 0, 0
    while at < len(data):
        control = int(data[at])
        at += 1
        if control < 32:
            run = control + 1
            if at + run > len(data) or to + run > len(out):
                return -1
            for _ in range(run):
                out[to] = data[at]
                to += 1
                at += 1
            continue
        run = control >> 5
        if run == 7:
            if at >= len(data):
                return -1
            run += int(data[at])
            at += 1
        if at >= len(data):
            return -1
        back = to - ((control & 31) << 8) - int(data[at]) - 1
        at += 1
        run += 2
        if back < 0 or to + run > len(out):
            return -1
        for _ in range(run):
            out[to] = out[back]
            to += 1
            back += 1
    return to
