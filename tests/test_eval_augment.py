"""Augmented images stay true: mirrored bodies swap sides, parts are never invented, switches work."""

from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from annotate.crop import LEAST_VALUE, SIZE
from annotate.parts import BACKGROUND, LEFT_RIGHT, N_CLASSES, UNDEFINED, swap_left_right
from eval.training.augment import MIN_LEFT, MIN_UNCOVERED, Augmentation, _incomplete, augment
from eval.training.body_targets import FACING, JOINTS, POSTURE, no_targets, swap_sides
from eval.training.occluders import ROUGH

law = settings(deadline=None, max_examples=30)
seeds = st.integers(0, 9999)
UNKNOWN = no_targets()
NOTHING = Augmentation(**{field.name: False for field in fields(Augmentation)})


def body(seed: int = 0, size: int = SIZE) -> tuple[np.ndarray, np.ndarray]:
    """A crop of coloured blocks in a disc that fills it up to the margin; depth where there are parts."""
    rng = np.random.default_rng(seed)
    blocks = rng.integers(1, N_CLASSES, (-(-size // 20), -(-size // 20))).astype(np.uint8)
    parts = np.kron(blocks, np.ones((20, 20), np.uint8))[:size, :size]
    v, u = np.ogrid[:size, :size]
    parts[np.hypot(v - (size - 1) / 2, u - (size - 1) / 2) > size / 2 / 1.08] = BACKGROUND
    depth = np.where(parts > 0, rng.uniform(0.3, 0.7, parts.shape), 0).astype(np.float32)
    return depth, parts


@law
@given(seeds, seeds)
def test_no_part_is_invented_where_depth_is_gone(seed, chance):
    depth, parts = body(seed)
    parts[100:110] = np.where(parts[100:110] > 0, UNDEFINED, 0)
    x, y, _ = augment((depth, parts, UNKNOWN), Augmentation(), np.random.default_rng(chance))
    assert (x.dtype, y.dtype, x.shape, y.shape) == (np.float32, np.uint8, depth.shape, parts.shape)
    assert (y[x == 0] == BACKGROUND).all()
    assert set(np.unique(y)) <= set(range(N_CLASSES)) | {UNDEFINED}
    assert x[x > 0].min() >= np.float32(LEAST_VALUE)
    assert x.max() <= 1


@law
@given(seeds, seeds)
def test_only_things_and_extras_are_background_with_depth(seed, chance):
    how = replace(Augmentation(), occluders=False, extras=False)
    x, y, _ = augment((*body(seed), UNKNOWN), how, np.random.default_rng(chance))
    np.testing.assert_array_equal(y > 0, x > 0)


def test_things_before_a_person_hide_it_and_are_background():
    """Here the blocks carry parts at random, so blankets find their legs."""
    depth, parts = body()
    hidden = 0
    for chance in range(40):
        d, p = _incomplete(depth, parts, replace(NOTHING, occluders=True), np.random.default_rng(chance))
        thing = (d > 0) & (p == BACKGROUND)
        np.testing.assert_array_equal(d[p > 0], depth[p > 0])
        np.testing.assert_array_equal(p[p > 0], parts[p > 0])
        assert (d[thing & (parts > 0)] < depth[thing & (parts > 0)] + ROUGH).all()
        hidden += int((thing & (parts > 0)).any())
    assert 10 <= hidden <= 30


def test_extras_lie_beside_the_person_and_take_nothing():
    depth, parts = body()
    added = 0
    for chance in range(20):
        how = replace(NOTHING, extras=True)
        x, y, _ = augment((depth, parts, UNKNOWN), how, np.random.default_rng(chance))
        added += int(((x > 0) & (y == BACKGROUND)).any())
    assert 1 <= added <= 15


@law
@given(seeds, seeds)
def test_augmenting_is_the_seeds_and_leaves_its_input(seed, chance):
    depth, parts = body(seed)
    kept = depth.copy(), parts.copy()
    a, b = (augment((depth, parts, UNKNOWN), Augmentation(), np.random.default_rng(chance)) for _ in range(2))
    np.testing.assert_array_equal(a[0], b[0])
    np.testing.assert_array_equal(a[1], b[1])
    np.testing.assert_array_equal(depth, kept[0])
    np.testing.assert_array_equal(parts, kept[1])


@law
@given(seeds)
def test_without_any_change_a_crop_keeps_all_but_its_mean_depth(seed):
    """To within a pixel of the box, which is fitted anew."""
    depth, parts = body(seed)
    x, y, _ = augment((depth, parts, UNKNOWN), NOTHING, np.random.default_rng(0))
    np.testing.assert_array_equal(y, parts)
    np.testing.assert_allclose(
        x[x > 0], (depth - np.median(depth[depth > 0]) + 0.5)[depth > 0].clip(LEAST_VALUE, 1), atol=1e-6
    )


def test_a_mirrored_body_has_its_sides_swapped():
    """Label image of a mirror image = mirrored label image, left and right exchanged; about every second."""
    depth, parts = body()
    mirrored = 0
    for chance in range(20):
        x, y, _ = augment(
            (depth, parts, UNKNOWN), replace(NOTHING, mirror=True), np.random.default_rng(chance)
        )
        if np.array_equal(y, parts):
            continue
        mirrored += 1
        np.testing.assert_array_equal(y, swap_left_right(parts[:, ::-1]))
        np.testing.assert_array_equal(x > 0, depth[:, ::-1] > 0)
        for left, right in LEFT_RIGHT:
            np.testing.assert_array_equal(y == left, (parts == right)[:, ::-1])
    assert 4 <= mirrored <= 16


def test_what_is_cut_away_leaves_enough_and_the_rest_is_refitted():
    depth, parts = body()
    shares = []
    for chance in range(40):
        x, y, _ = augment((depth, parts, UNKNOWN), replace(NOTHING, cuts=True), np.random.default_rng(chance))
        rows = np.flatnonzero((x > 0).any(axis=1))
        columns = np.flatnonzero((x > 0).any(axis=0))
        # The longer side fills the crop again, up to the margin.
        assert max(np.ptp(rows), np.ptp(columns)) + 1 == pytest.approx(SIZE / 1.08, abs=3)
        magnified = (max(np.ptp(rows), np.ptp(columns)) + 1) ** 2
        shares.append(np.count_nonzero(y) / magnified)
    assert min(shares) < 0.95 * np.pi / 4
    assert min(shares) >= MIN_LEFT * np.pi / 4 * 0.9


def test_joints_stay_on_their_pixels_and_facing_turns_with_the_mirror():
    """One patch of a part marks a joint; wherever the image goes, the joint goes with it."""
    depth, parts = body()
    parts[parts > 0] = 2
    parts[60:69, 120:129] = 3
    row = no_targets()
    row[FACING], row[POSTURE] = (0.6, 0.8), 1
    row[JOINTS] = np.tile([124.5 / SIZE, 64.5 / SIZE, depth[64, 124]], len(row[JOINTS]) // 3)
    for chance in range(12):
        how = replace(NOTHING, mirror=True, turn=True, place=True)
        x, y, known = augment((depth, parts, row), how, np.random.default_rng(chance))
        patch = np.isin(y, (3, 4))
        v, u = np.argwhere(patch).mean(axis=0) + 0.5
        joint = known[JOINTS][:3]
        np.testing.assert_allclose(joint[:2] * SIZE, (u, v), atol=1.5)
        assert x[int(v), int(u)] == pytest.approx(joint[2], abs=0.25)
        assert known[FACING].tolist() == pytest.approx([0.6, -0.8 if (y == 4).any() else 0.8])
        assert known[POSTURE] == 1
    np.testing.assert_array_equal(swap_sides(swap_sides(row)), row)


@pytest.mark.parametrize("what", ["noise", "holes", "turn", "place", "borders"])
def test_each_way_does_something_and_can_be_left_out(what):
    depth, parts = body()
    plain = augment((depth, parts, UNKNOWN), NOTHING, np.random.default_rng(0))
    changed = [
        not np.array_equal(
            augment((depth, parts, UNKNOWN), replace(NOTHING, **{what: True}), rng)[0], plain[0]
        )
        for rng in map(np.random.default_rng, range(12))
    ]
    assert any(changed)


@law
@given(seeds)
def test_a_single_pixel_survives_and_an_empty_crop_stays_empty(chance):
    rng, nothing = np.random.default_rng(chance), np.zeros((20, 20), np.float32)
    x, y, _ = augment((nothing, nothing.astype(np.uint8), UNKNOWN), Augmentation(), rng)
    assert not x.any() and not y.any()
    depth, parts = np.zeros((20, 20), np.float32), np.zeros((20, 20), np.uint8)
    depth[3, 16], parts[3, 16] = 0.5, 3
    x, y, _ = augment((depth, parts, UNKNOWN), Augmentation(), np.random.default_rng(chance))
    assert set(np.unique(y)) <= {BACKGROUND, 3, 4}
    assert np.isfinite(x).all()


@law
@given(seeds)
def test_a_trunk_and_a_foot_of_one_pixel_each_are_never_all_gone(chance):
    depth, parts = np.zeros((20, 20), np.float32), np.zeros((20, 20), np.uint8)
    depth[3, 16], parts[3, 16] = 0.5, 2
    depth[9, 12], parts[9, 12] = 0.4, 10
    x, y = _incomplete(depth, parts, Augmentation(), np.random.default_rng(chance))
    assert (x > 0).any()
    assert (y > 0).any()


@pytest.mark.parametrize(("legs", "least"), [(False, MIN_LEFT), (True, MIN_UNCOVERED)])
def test_enough_of_a_person_is_left(legs, least):
    depth, parts = body()
    if not legs:
        parts[parts > 9] = 1
    whole, chances = np.count_nonzero(parts), map(np.random.default_rng, range(150))
    left = [np.count_nonzero(_incomplete(depth, parts, Augmentation(), rng)[1]) for rng in chances]
    assert least * whole <= min(left) < 0.75 * whole
