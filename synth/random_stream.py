"""Independent random streams by name."""

from zlib import crc32

import numpy as np


def stream(seed: int, name: str, *keys: int) -> np.random.Generator:
    """Return a generator that depends on seed, name and keys alone.

    The streams of two tuples can be equal, as of ``(seed, 3)`` and ``(seed, 3, 0)``; a name in the spawn key
    prevents that (numpy.random.SeedSequence).
    """
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(crc32(name.encode()), *keys)))
