"""Blankets and boards hide the pixels under them, and are background."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from annotate.crop import LEAST_VALUE, SIZE
from annotate.parts import BACKGROUND
from eval.training.occluders import ROUGH, THICK, add_blanket, add_board, blanket_band, sensor_noise

law = settings(deadline=None, max_examples=25)
seeds = st.integers(0, 9999)


def standing() -> tuple[np.ndarray, np.ndarray]:
    """A person as a post: head, trunk, an arm before it, hip, two legs with a gap between them."""
    parts = np.zeros((SIZE, SIZE), np.uint8)
    for part, rows in ((1, (5, 40)), (2, (40, 100)), (7, (100, 110)), (8, (110, 160)), (10, (160, 205))):
        parts[slice(*rows), 80:130] = part
    parts[110:, 100:110] = 0
    parts[80:120, 85:95] = 6
    depth = np.where(parts > 0, np.where(parts == 6, 0.35, 0.5), 0).astype(np.float32)
    return depth, parts


@law
@given(seeds, st.sampled_from([add_blanket, add_board]))
def test_only_what_is_behind_a_thing_changes(chance, cover):
    depth, parts = standing()
    x, y = cover(depth, parts, np.random.default_rng(chance))
    same = (x == depth) & (y == parts)
    hidden, beside = ~same & (depth > 0), ~same & (depth == 0)
    assert (x.dtype, y.dtype) == (np.float32, np.uint8)
    assert (y[~same] == BACKGROUND).all()
    assert (x[hidden] < depth[hidden] + ROUGH).all()
    assert (x[beside] > 0).all()
    assert x[x > 0].min() >= LEAST_VALUE


def test_a_blanket_lies_across_the_legs_and_between_them():
    depth, parts = standing()
    hidden = [blanket_band(parts, np.random.default_rng(k)) & (parts > 0) for k in range(50)]
    assert not any(one[:55].any() for one in hidden)
    assert 10 < sum(one[130:150, 80:100].all() and not one[204:].all() for one in hidden) < 50
    drapes = [add_blanket(depth, parts, np.random.default_rng(k))[0] for k in range(50)]
    assert 5 < sum((one[130:140, 100:110] > 0).all() for one in drapes) < 40


def test_a_blanket_stands_a_few_centimetres_before_what_carries_it():
    """Here trunk and legs are at one depth, so all folds and the span between them lie just before it."""
    depth, parts = standing()
    ahead = []
    for chance in range(60):
        x, y = add_blanket(depth, parts, np.random.default_rng(chance))
        ahead.append(0.5 - x[(y == BACKGROUND) & (x > 0)])
    middle = [np.median(one) for one in ahead if one.size]
    assert 20 < len(middle) < 50
    assert THICK[0] - 0.005 < min(middle)
    assert max(middle) < THICK[1] + 0.005


def test_an_arm_before_a_blanket_stays():
    depth, parts = standing()
    parts[120:160, 85:95] = 6
    depth[120:160, 85:95] = 0.2
    for chance in range(30):
        _, y = add_blanket(depth, parts, np.random.default_rng(chance))
        np.testing.assert_array_equal(y[parts == 6], 6)


@pytest.mark.parametrize("part", [1, 2])
def test_who_shows_no_legs_gets_no_blanket(part):
    depth, parts = standing()
    parts[parts > 0] = part
    x, y = add_blanket(depth, parts, np.random.default_rng(0))
    np.testing.assert_array_equal(x, depth)
    np.testing.assert_array_equal(y, parts)


@pytest.mark.parametrize(("deviation", "share"), [(0.0, 0.0), (0.001, 0.1), (0.002, 0.03)])
def test_noise_and_lost_pixels_are_the_persons(deviation, share):
    depth, _ = standing()
    rng = np.random.default_rng(0)
    depth = np.where(depth > 0, 0.5 + deviation * rng.standard_normal(depth.shape), 0).astype(np.float32)
    depth[rng.random(depth.shape) < share] = 0
    noise, lost = sensor_noise(depth, rng)
    assert noise.std() == pytest.approx(deviation, rel=0.25, abs=1e-6)
    assert lost.mean() == pytest.approx(share, abs=0.015)
    assert np.abs(noise).max() <= ROUGH
