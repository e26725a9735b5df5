"""Class probabilities on disk: back to half a step, and nothing malformed gets in."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from annotate.crop import SIZE, Crop
from annotate.labelset.images import Probabilities, decode_probabilities, encode_probabilities
from annotate.parts import N_CLASSES
from sensors.errors import FormatError

law = settings(deadline=None, max_examples=10)

UNIFORM = np.full((N_CLASSES, SIZE, SIZE), 1 / N_CLASSES, np.float32)


@law
@given(st.integers(0, 2**32 - 1))
def test_probabilities_round_trip_to_half_a_step(seed):
    planes = np.random.default_rng(seed).dirichlet(np.full(N_CLASSES, 0.2), (SIZE, SIZE)).astype(np.float32)
    given_ = Probabilities(Crop(-3, 5, 300), np.ascontiguousarray(planes.transpose(2, 0, 1)))
    back = decode_probabilities(encode_probabilities(given_), given_.note())
    assert back.crop == given_.crop
    np.testing.assert_allclose(back.planes, given_.planes, atol=0.03)


@pytest.mark.parametrize("crop", [None, [1, 2], [0, 0, 0], [0, 0, 1.5], [0, 0, 10**9], "abc", [True, 0, 9]])
def test_a_malformed_crop_is_named(crop):
    data = encode_probabilities(Probabilities(Crop(0, 0, SIZE), UNIFORM))
    with pytest.raises(FormatError, match="probability_crop"):
        decode_probabilities(data, {"probability_crop": crop})
