"""Average of the outputs for an image and for its flip: sides are aligned first."""

import numpy as np
import pytest

from annotate.parts import PAPER
from eval.architecture.kinds import Kinds
from eval.network.flip_averaging import averaged, flipped_back, mean_of_factors
from eval.scores.joints import N_JOINTS, TWIN

TWINS = PAPER.twin_classes


def outputs(seed, count=3, size=8):
    rng = np.random.default_rng(seed)
    angle = rng.uniform(-3, 3, count)
    shapes = (12, size, size), (2,), (6,), (N_JOINTS, 3), (N_JOINTS, 2), (N_JOINTS, 3)
    made = [rng.random((count, *shape), np.float32) for shape in shapes]
    made[1] = 0.6 * np.column_stack([np.cos(angle), np.sin(angle)]).astype(np.float32)
    return made


def exchanged(one):
    planes, facing, posture, *joints = one
    return [planes[:, TWINS], -facing, posture, *(values[:, TWIN] for values in joints)]


def test_a_flip_of_a_flip_changes_nothing():
    for found, expected in zip(flipped_back(flipped_back(outputs(0), TWINS), TWINS), outputs(0), strict=True):
        np.testing.assert_allclose(found, expected, atol=1e-6)
    (planes,) = flipped_back(outputs(0)[:1], TWINS)
    np.testing.assert_array_equal(planes, outputs(0)[0][:, TWINS, :, ::-1])


@pytest.mark.parametrize(("sure", "kept"), [(1.0, 0), (0.5, 0), (1.5, 1)])
def test_sides_of_the_less_sure_look_are_exchanged_and_of_the_flip_where_both_are_as_sure(sure, kept):
    own = outputs(1)
    other = exchanged(own)
    other[1] = other[1] * np.float32(sure)
    found = averaged(own, other, TWINS)
    expected = [own, other][kept]
    for i, (values, wanted) in enumerate(zip(found, expected, strict=True)):
        if i != 1:
            np.testing.assert_allclose(values, wanted, atol=1e-6)
    assert ((found[1] * expected[1]).sum(axis=1) > 0).all()


def test_looks_that_agree_are_averaged_one_image_at_a_time():
    own, other = outputs(2), [values + np.float32(0.01) for values in outputs(2)]
    other[1] = np.float32(0.9) * own[1]
    mixed = [np.concatenate([a[:1], b[1:]]) for a, b in zip(other, exchanged(other), strict=True)]
    for values, a, b in zip(averaged(own, mixed, TWINS), own, other, strict=True):
        np.testing.assert_allclose(values[0], (a[0] + b[0]) / 2, atol=1e-6)
        if values.shape[1:] != (2,):
            np.testing.assert_allclose(values[1:], ((a + b) / 2)[1:], atol=1e-6)
    planes = averaged(own[:1], other[:1], TWINS)[0]
    np.testing.assert_allclose(planes, (own[0] + other[0]) / 2, atol=1e-6)


def factored(one):
    """Return outputs with random probabilities (1, 12, 8, 8), and the same with their factors."""
    rng, kinds = np.random.default_rng(one), Kinds.of(PAPER)
    odds, left = (
        rng.random((1, len(kinds), 2, 2, 4, 4), np.float32) + 0.1,
        rng.random((2, 2, 4, 4), np.float32),
    )
    shares = np.stack([np.ones_like(left), left, 1 - left])[np.array(kinds.sides)]
    cells = odds[0][list(kinds.of_class)] / odds[0].sum(axis=0) * shares
    planes = cells.transpose(0, 3, 1, 4, 2).reshape(1, 12, 8, 8)
    factors = [odds.reshape(1, -1, 4, 4), left.reshape(1, 4, 4, 4)]
    return [planes, *outputs(one, 1)[1:]], [*factors, *outputs(one, 1)[1:]]


@pytest.mark.parametrize("seeds", [[3], [3, 4], [3, 5], [4, 3], [6, 9]])
def test_factors_of_the_probabilities_give_the_same_mean(seeds):
    looks = [factored(seed) for seed in seeds]
    depth = np.random.default_rng(0).random((8, 8), np.float32)
    depth[2:4, 1:6] = 0
    wholes = [whole for whole, _ in looks]
    for i, whole in enumerate(wholes):
        seen = depth if i == 0 else depth[:, ::-1]
        whole[0] = np.where(seen > 0, whole[0], np.float32(0))
        whole[0][:, 0] += seen == 0
    expected = averaged(wholes[0], flipped_back(wholes[1], TWINS), TWINS) if len(looks) > 1 else wholes[0]
    found = mean_of_factors(depth, [factors for _, factors in looks], Kinds.of(PAPER))
    for values, wanted in zip(found, expected, strict=True):
        np.testing.assert_allclose(values, wanted, atol=1e-6)


def test_factors_of_other_kinds_are_refused():
    _, (odds, *others) = factored(1)
    with pytest.raises(ValueError, match="kinds"):
        mean_of_factors(np.ones((8, 8), np.float32), [[odds[:, :-4], *others]], Kinds.of(PAPER))
