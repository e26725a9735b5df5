"""Room for many rows: few in memory, many in a nameless file that goes with the process."""

import math
import os
from tempfile import TemporaryFile, gettempdir
from typing import TypeVar

import numpy as np
from numpy.typing import DTypeLike, NDArray

from sensors.errors import CloudError

IN_MEMORY = 16_000_000
"""Bytes that are held in memory. What the system reads from a file, it can give back when memory is short."""
BLOCK = 512
"""Rows that are worked on at once, where a result would otherwise need as much memory again."""

K = TypeVar("K", bound=np.generic)


def room(shape: tuple[int, ...], kind: DTypeLike) -> NDArray[K]:
    """Zeros. Raises CloudError where the disk has no room for them."""
    size = math.prod(shape) * np.dtype(kind).itemsize
    if size <= IN_MEMORY:
        return np.zeros(shape, kind)
    try:
        with TemporaryFile() as file:
            # Or a full disk would end the process in the middle of its work.
            os.posix_fallocate(file.fileno(), 0, size)
            return np.asarray(np.memmap(file, kind, "r+", shape=shape))
    except (OSError, OverflowError) as error:
        raise CloudError(
            f"{size} bytes do not fit into {gettempdir()}; set TMPDIR to a folder with more room"
        ) from error


def blocks(rows: int) -> list[slice]:
    """Slices of at most BLOCK rows, in order."""
    return [slice(start, min(start + BLOCK, rows)) for start in range(0, rows, BLOCK)]
