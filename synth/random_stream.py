"""Independent random streams by name."""

from zlib import crc32

import numpy as np


def stream(seed: int, name: str, *keys: int) -> np.random.Generator:
    """Return a generator that depends on the seed, the name and the keys, and on nothing else.

    ``default_rng((seed, 3))`` is also the stream of subject 3 of that seed, and of ``(seed, 3, 0)``. A name
    in the spawn key cannot meet such a tuple (numpy.random.SeedSequence).
    """
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(crc32(name.encode()), *keys)))
