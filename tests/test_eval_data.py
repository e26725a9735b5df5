"""Training tensors: mirrored bodies swap sides, no part is invented where depth is gone."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import eval.data as data
from annotate.crop import NEAREST, SIZE
from annotate.labels import FrameLabels
from annotate.parts import BACKGROUND, LEFT_RIGHT, N_CLASSES, UNDEFINED, swap_left_right
from annotate.store import LabelSet
from eval.data import Crops, augment, batches, load_crops, to_crop
from sensors.camera import Intrinsics
from sensors.errors import CloudError

law = settings(deadline=None, max_examples=40)
seeds = st.integers(0, 9999)


class Scripted:
    """A generator that mirrors or not as told and changes nothing else."""

    def __init__(self, mirrored: bool) -> None:
        self._mirrored = mirrored

    def random(self, shape=None, dtype=None):
        if shape is not None:
            return np.ones(shape, dtype)
        answer = 0.0 if self._mirrored else 1.0
        self._mirrored = False
        return answer if answer == 0.0 else 1.0

    def uniform(self, low, high, size=None):
        middle = 1.0 if low > 0.5 else (low + high) / 2
        return np.full(size, middle) if size else middle

    def normal(self, mean, deviation):
        return mean


def body(seed: int = 0, size: int = SIZE) -> tuple[np.ndarray, np.ndarray]:
    """A crop in blocks: depth in (0, 1], parts where there is depth and nowhere else."""
    rng = np.random.default_rng(seed)
    blocks = rng.integers(0, N_CLASSES, (-(-size // 20), -(-size // 20))).astype(np.uint8)
    parts = np.kron(blocks, np.ones((20, 20), np.uint8))[:size, :size]
    parts[rng.random(parts.shape) < 0.02] = BACKGROUND
    depth = np.where(parts > 0, rng.uniform(NEAREST, 1, parts.shape), 0).astype(np.float32)
    return depth, parts


def crops(n: int) -> Crops:
    pairs = [body(i) for i in range(n)]
    return Crops(
        np.stack([np.rint(x * 65535).astype(np.uint16) for x, _ in pairs]), np.stack([y for _, y in pairs])
    )


@law
@given(seeds, seeds)
def test_no_part_is_invented_where_depth_is_gone(seed, chance):
    depth, parts = body(seed)
    x, y = augment(depth, parts, np.random.default_rng(chance))
    assert (x.dtype, y.dtype, x.shape, y.shape) == (np.float32, np.uint8, depth.shape, parts.shape)
    assert set(np.unique(y[x == 0])) <= {BACKGROUND, UNDEFINED}
    # And none is lost where depth is left.
    assert ((y[x > 0] >= 1) & (y[x > 0] < N_CLASSES)).all()
    assert x.min() >= 0
    assert x.max() <= 1


@law
@given(seeds, seeds)
def test_augmenting_is_the_seeds_and_leaves_its_input(seed, chance):
    depth, parts = body(seed)
    kept = depth.copy(), parts.copy()
    a, b = (augment(depth, parts, np.random.default_rng(chance)) for _ in range(2))
    np.testing.assert_array_equal(a[0], b[0])
    np.testing.assert_array_equal(a[1], b[1])
    np.testing.assert_array_equal(depth, kept[0])
    np.testing.assert_array_equal(parts, kept[1])


@law
@given(seeds)
def test_a_mirrored_body_has_its_sides_swapped(seed):
    """Label image of a mirror image = mirrored label image, left and right exchanged."""
    depth, parts = body(seed)
    x, y = augment(depth, parts, Scripted(mirrored=True))
    np.testing.assert_allclose(x, depth[:, ::-1], atol=1e-6)
    np.testing.assert_array_equal(y, swap_left_right(parts[:, ::-1]))
    for left, right in LEFT_RIGHT:
        np.testing.assert_array_equal(y == left, (parts == right)[:, ::-1])
    x, y = augment(depth, parts, Scripted(mirrored=False))
    np.testing.assert_allclose(x, depth, atol=1e-6)
    np.testing.assert_array_equal(y, parts)


def test_an_epoch_sees_every_crop_once_in_the_seeds_order():
    some = crops(7)
    seen = [x for x, _ in batches(some, 3, np.random.default_rng(1), augmented=False)]
    assert [len(x) for x in seen] == [3, 3]
    again = [x for x, _ in batches(some, 3, np.random.default_rng(1), augmented=False)]
    np.testing.assert_array_equal(np.concatenate(seen), np.concatenate(again))
    every = some.depth.astype(np.float32) / 65535
    origin = [[i for i in range(7) if np.array_equal(x[0], every[i])] for x in np.concatenate(seen)]
    assert sorted(i for (i,) in origin) == sorted({i for (i,) in origin})


def test_fewer_crops_than_a_batch_are_one_batch():
    (batch,) = batches(crops(2), 16, np.random.default_rng(0))
    assert batch[0].shape == (2, 1, SIZE, SIZE)
    assert batch[1].shape == (2, SIZE, SIZE)


def test_a_frame_becomes_the_square_round_its_person():
    parts = np.zeros((424, 512), np.uint8)
    parts[100:300, 200:260] = 2
    parts[100:300, 260:320] = 7
    depth = np.full(parts.shape, 2000, np.uint16)
    x, y = to_crop(FrameLabels("f", depth, parts))
    assert x.shape == y.shape == (SIZE, SIZE)
    assert set(np.unique(y)) == {0, 2, 7}
    np.testing.assert_array_equal(x > 0, y > 0)
    assert np.abs(x[x > 0] - 0.5).max() < 1e-6


def test_label_sets_are_read_and_frames_that_teach_nothing_left_out(tmp_path, rig_session):
    truth = rig_session.with_suffix(".truth")
    loaded = load_crops([truth])
    assert len(loaded) == 3
    assert len(load_crops([truth, truth])) == 6
    assert len(loaded.first(2)) == 2
    for frame, depth, parts in zip(LabelSet.open(truth), loaded.depth, loaded.parts, strict=True):
        x, y = to_crop(frame)
        np.testing.assert_allclose(depth / 65535, x, atol=1e-5)
        np.testing.assert_array_equal(parts, y)

    camera = Intrinsics(8, 6, 9.0, 9.0, 3.5, 2.5)
    empty = LabelSet.create(tmp_path / "empty", camera, {})
    with pytest.raises(CloudError, match="no labelled part"):
        load_crops([empty.path])
    for name, part in (("a", BACKGROUND), ("b", UNDEFINED)):
        empty.write(FrameLabels(name, np.full((6, 8), 900, np.uint16), np.full((6, 8), part, np.uint8)))
    with pytest.raises(CloudError, match="no labelled part"):
        load_crops([empty.path])
    assert len(load_crops([truth, empty.path])) == 3


def test_what_is_neither_label_set_nor_dataset_is_refused(tmp_path):
    for path in (tmp_path, tmp_path / "absent"):
        with pytest.raises(CloudError, match="label set"):
            data.open_frames(path)
