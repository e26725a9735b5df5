"""Inputs of the suit network for frames of depth alone, without the constant ones of ``network_input``."""

import numpy as np
from numba import njit

from annotate.array_types import Float32, UInt8
from annotate.segmentation.input_channels import FELT, FIXED, OTHER, SEEN, SUBJECT, VALID, write_one_hot

DEPTH_BITS, DEPTH_RANGES = (VALID, SUBJECT, OTHER), 3
"""Flags without colour and temperature; number of the first channels of ``RANGES``, which depth gives."""


def is_depth_alone(planes: UInt8) -> bool:
    """Return whether channels (n, h, w) hold no temperature, no colour and no likelihood."""
    return not planes[0].size or not (
        int(np.bitwise_or.reduce(planes[0], axis=None)) & (FELT | SEEN) or planes[len(FIXED) - 2 :].max()
    )


def inputs_by_depth(parts: int) -> list[int]:
    """Return the numbers of the inputs (see ``network_input``) that are not constant in ``is_depth_alone``.

    parts: as in ``network_input``.
    """
    bits = [(VALID, FELT, SEEN, SUBJECT, OTHER).index(bit) for bit in DEPTH_BITS]
    return [*bits, *range(5, 5 + parts + DEPTH_RANGES)]


@njit(cache=True, nogil=True)
def depth_input(planes: UInt8, parts: int) -> Float32:
    """Return the inputs ``inputs_by_depth``, float32 (m, h, w), of ``network_input`` for channels (n, h, w)
    of depth alone.
    """
    _, height, width = planes.shape
    first, unit = len(DEPTH_BITS) + parts, np.float32(1 / 64)
    made = np.empty((first + DEPTH_RANGES, height, width), np.float32)
    flags, row = np.empty(width, np.uint8), np.empty(width, np.uint8)
    for v in range(height):
        flags[:] = planes[0, v]  # copies side by side, so that the loops vectorise
        row[:] = planes[1, v]
        write_one_hot(made, v, (flags, row), DEPTH_BITS, parts)
        for i in range(DEPTH_RANGES):
            row[:] = planes[2 + i, v]
            for u in range(width):
                value = (np.float32(row[u]) - np.float32(127.5)) * unit
                made[first + i, v, u] = value if flags[u] & VALID else np.float32(0)
    return made
