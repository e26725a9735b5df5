"""The network's square: cutting and pasting are inverse, it holds the whole person, depth stays in range."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from annotate.crop import LEAST_VALUE, SIZE, Crop, crop_around, network_crop, normalize, window_of
from sensors.errors import CloudError
from sensors.rig.camera import Intrinsics, project, rays

law = settings(deadline=None, max_examples=60)

H, W = 90, 110
sides = st.integers(8, 80)
corners = st.tuples(st.integers(-20, 40), st.integers(-20, 40))


def image(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).integers(1, 60_000, (H, W), np.uint16)


def inside(crop: Crop) -> np.ndarray:
    v, u = np.mgrid[:H, :W]
    rows, columns = v - crop.top, u - crop.left
    return (rows >= 0) & (rows < crop.side) & (columns >= 0) & (columns < crop.side)


@law
@given(corners, sides, st.integers(0, 200), st.integers(0, 99))
def test_what_is_cut_out_larger_pastes_back_to_the_pixel(corner, side, more, seed):
    crop, whole = Crop(*corner, side), image(seed)
    back = crop.paste(crop.cut(whole, 0, side + more), whole.shape, 0)
    np.testing.assert_array_equal(back, np.where(inside(crop), whole, 0))


@law
@given(corners, st.integers(20, 89), st.integers(0, 99))
def test_what_is_cut_out_smaller_comes_back_shrunk_the_same(corner, side, seed):
    crop, whole = Crop(*corner, side), image(seed)
    small = crop.cut(whole, 0, 16)
    back = crop.paste(small, whole.shape, 0)
    np.testing.assert_array_equal(crop.cut(back, 0, 16), small)


@law
@given(st.integers(0, 30), st.integers(0, 12), st.integers(0, 99))
def test_a_window_is_the_least_that_holds_all_pixels_and_its_margin(pixels, margin, seed):
    rng = np.random.default_rng(seed)
    mask = np.zeros((20, 30), np.bool_)
    mask[rng.integers(5, 12, pixels), rng.integers(8, 15, pixels)] = True
    window = window_of(mask, margin)
    assert mask[window].sum() == mask.sum()
    if not mask.any():
        assert not mask[window].size
        return
    v, u = np.nonzero(mask)
    assert window[0] == slice(max(0, v.min() - margin), v.max() + 1 + margin)
    assert window[1] == slice(max(0, u.min() - margin), u.max() + 1 + margin)


@law
@given(corners, sides, st.integers(1, 200), st.integers(0, 99))
def test_a_cut_is_nearest_neighbour(corner, side, size, seed):
    """Against its definition: output pixel i looks at the input pixel under its centre."""
    crop, whole = Crop(*corner, side), image(seed)
    at = [int((i + 0.5) * side / size) for i in range(size)]
    cut = crop.cut(whole, 7, size)
    for i, j in np.random.default_rng(seed).integers(0, size, (20, 2)):
        v, u = corner[0] + at[i], corner[1] + at[j]
        expected = whole[v, u] if 0 <= v < H and 0 <= u < W else 7
        # Where the centre falls on the border of two pixels either is the nearest.
        if (2 * i + 1) * side % (2 * size) and (2 * j + 1) * side % (2 * size):
            assert cut[i, j] == expected


@law
@given(st.integers(0, H - 1), st.integers(0, W - 1), st.integers(1, H), st.integers(1, W))
def test_the_square_holds_the_whole_person_and_its_middle(top, left, height, width):
    mask = np.zeros((H, W), bool)
    mask[top : top + height, left : left + width] = True
    crop = crop_around(mask)
    assert not (mask & ~inside(crop)).any()
    rows, columns = np.nonzero(mask)
    assert abs(rows.mean() - (crop.top + (crop.side - 1) / 2)) <= 1
    assert abs(columns.mean() - (crop.left + (crop.side - 1) / 2)) <= 1
    assert crop.side <= max(8, 1.1 * max(mask.any(axis=1).sum(), mask.any(axis=0).sum()) + 1)


@law
@given(st.integers(0, 99), st.integers(-2000, 2000))
def test_depth_is_in_range_and_nothing_is_zero_but_nothing(seed, nearer):
    rng = np.random.default_rng(seed)
    depth = rng.integers(2500, 3300, (20, 20), np.uint16)
    depth[rng.random((20, 20)) < 0.2] = 0
    mask = rng.random((20, 20)) < 0.5
    x = normalize(depth, mask)
    person = mask & (depth > 0)
    assert x.dtype == np.float32
    assert not x[~person].any()
    assert (x[person] >= np.float32(LEAST_VALUE)).all()
    assert (x <= 1).all()
    assert abs(float(np.median(x[person])) - 0.5) < 1e-3
    # The whole person nearer or further looks the same.
    moved = np.where(depth > 0, depth.astype(int) + nearer, 0).astype(np.uint16)
    np.testing.assert_allclose(normalize(moved, mask), x, atol=1e-6)
    assert not normalize(moved, np.zeros_like(mask)).any()


@law
@given(corners, sides, st.integers(8, 200))
def test_a_crops_camera_sees_each_pixel_where_the_whole_camera_does(corner, side, size):
    """Project the crop's rays with the whole camera: they fall on the input pixel that ``cut`` looks at."""
    whole, crop = Intrinsics(W, H, 100.0, 105.0, 52.3, 46.1), Crop(*corner, side)
    pixels = project(whole, rays(crop.camera(whole, size)))
    at = np.floor((np.arange(size) + 0.5) * side / size)
    u, v = np.meshgrid(corner[1] + at, corner[0] + at)
    assert np.abs(pixels - np.stack([u, v], axis=-1)).max() <= 0.5 + 1e-9


def test_an_image_of_the_networks_size_is_a_crop_already():
    mask = np.zeros((SIZE, SIZE), bool)
    mask[40:90, 60:80] = True
    assert network_crop(mask) == Crop(0, 0, SIZE)
    assert network_crop(mask[:-1]) == crop_around(mask[:-1])
    with pytest.raises(CloudError, match="no person"):
        network_crop(np.zeros((SIZE, SIZE), bool))


def test_paste_carries_channels_and_fills():
    crop = Crop(10, 20, 30)
    pasted = crop.paste(np.ones((SIZE, SIZE, 3), np.float32), (H, W), 0.5)
    assert pasted.shape == (H, W, 3)
    assert set(np.unique(pasted[inside(crop)])) == {1}
    assert set(np.unique(pasted[~inside(crop)])) == {0.5}
