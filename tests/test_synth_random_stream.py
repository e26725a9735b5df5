"""Streams of random numbers by name are unlike each other, and unlike streams by tuples."""

from itertools import product

import numpy as np

from synth.random_stream import stream

NAMES = ("unit of the cameras", "pyrometer", "shot", "order", "")


def first(rng: np.random.Generator) -> int:
    return int(rng.integers(2**63))


def test_no_two_streams_are_the_same():
    keys = [(), (0,), (1,), (0, 0), (1, 0), (0, 1)]
    drawn = [first(stream(seed, name, *own)) for seed, name, own in product(range(20), NAMES, keys)]
    tuples = [first(np.random.default_rng((seed, n))) for seed, n in product(range(20), range(40))]
    assert len({*drawn, *tuples}) == len(drawn) + len(tuples)
    assert first(stream(5, "shot", 7)) == first(stream(5, "shot", 7))
