"""Training crops from shards and label sets."""

import zlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

import eval.training.crops as data
from annotate.crop import SIZE
from annotate.frame_labels import FrameLabels
from annotate.labelset.label_set import LabelSet
from annotate.labelset.labelled_frames import camera_of, pinhole_of
from annotate.parts import BACKGROUND, UNDEFINED
from eval.training.body_targets import no_targets
from eval.training.calibration.calibration_split import calibration_split
from eval.training.crops import DEPTH_STEPS, Crops, load_crops, to_crop
from sensors.calibration_files.kinect2_factory import KINECT2_PINHOLE
from sensors.errors import CloudError
from sensors.rig.camera import Intrinsics
from tests.helpers.shards import write_dataset


def of(depth, parts):
    return Crops.of((*both, no_targets()) for both in zip(depth, parts, strict=True))


def test_chosen_and_spread_crops_are_the_requested_ones():
    crops = of(
        np.arange(10, dtype=np.uint16).reshape(10, 1, 1), np.arange(10, dtype=np.uint8).reshape(10, 1, 1)
    )
    some = crops.chosen(np.array([7, 2, 2]))
    assert [int(some.depth(i)[0, 0]) for i in range(3)] == [7, 2, 2]
    assert [int(some.parts(i)[0, 0]) for i in range(3)] == [7, 2, 2]
    assert len({crops.crc32, some.crc32, crops.chosen(np.array([7, 2])).crc32}) == 3
    assert [int(crops.spread(4).depth(i)[0, 0]) for i in range(4)] == [0, 3, 6, 9]
    assert [len(crops.spread(n)) for n in (1, 99)] == [1, 10]


def people(n: int, images: int) -> Crops:
    """``images`` crops of each of ``n`` people, in turn; a crop's depth is its number."""
    depth = np.arange(n * images, dtype=np.uint16).reshape(-1, 1, 1)
    examples = ((d, np.ones((1, 1), np.uint8), no_targets()) for d in depth)
    return Crops.of(examples, [frozenset({f"p{i % n}"}) for i in range(n * images)])


@pytest.mark.parametrize(("n", "images", "held"), [(40, 2, 4), (10, 3, 3), (9, 20, 9), (1, 99, 0)])
def test_what_calibrates_is_not_trained_on(n, images, held):
    crops = people(n, images)
    split = calibration_split(crops)
    trained = {int(split.trained.depth(i)[0, 0]) for i in range(len(split.trained))}
    own = split.calibrated
    calibrated = set() if own is None else {int(own.depth(i)[0, 0]) for i in range(len(own))}
    assert len(calibrated) == held
    assert trained | calibrated == set(range(len(crops))) and not trained & calibrated
    if split.bodies:
        assert not split.trained.showing(split.bodies).any()
        assert own is not None and set().union(*own.bodies) == set(split.bodies)
    again = calibration_split(crops)
    assert again.trained.crc32 == split.trained.crc32 and again.bodies == split.bodies


def test_a_blend_of_two_bodies_belongs_to_both():
    pairs = [frozenset({f"p{i}", f"p{j}"}) for i in range(12) for j in range(i)]
    depth = np.arange(len(pairs), dtype=np.uint16).reshape(-1, 1, 1)
    crops = Crops.of(((d, np.ones((1, 1), np.uint8), no_targets()) for d in depth), pairs)
    split = calibration_split(crops)
    assert len(split.bodies) == 1 and split.calibrated is not None
    assert len(split.calibrated) == 11 and all(split.bodies[0] in own for own in split.calibrated.bodies)
    assert not split.trained.showing(split.bodies).any()
    everywhere = Crops.of(
        ((d, np.ones((1, 1), np.uint8), no_targets()) for d in depth), [frozenset("abcdefghijk")] * len(depth)
    )
    assert calibration_split(everywhere).calibrated is None


@settings(deadline=None, max_examples=30)
@given(st.data())
def test_what_was_packed_comes_back(data):
    shape = data.draw(hnp.array_shapes(min_dims=3, max_dims=3, max_side=9))
    depth, parts = (data.draw(hnp.arrays(kind, shape)) for kind in (np.uint16, np.uint8))
    crops, size = of(depth, parts), data.draw(st.integers(1, 10))
    told = [np.concatenate(images) for images in zip(*crops.batches(size), strict=True)]
    np.testing.assert_array_equal(told[0], depth.astype(np.float32) / DEPTH_STEPS)
    np.testing.assert_array_equal(told[1], parts)
    for i in range(len(crops)):
        np.testing.assert_array_equal(crops.depth(i), depth[i])
        np.testing.assert_array_equal(crops.parts(i), parts[i])
    told = b"".join(d.tobytes() + p.tobytes() for d, p in zip(depth, parts, strict=True))
    assert crops.crc32 == zlib.crc32(crops.wholes.tobytes(), zlib.crc32(told))


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
    for i, frame in enumerate(LabelSet.open(truth)):
        x, y = to_crop(frame)
        np.testing.assert_allclose(loaded.image(i)[0], x, atol=1e-5)
        np.testing.assert_array_equal(loaded.parts(i), y)

    camera = Intrinsics(8, 6, 9.0, 9.0, 3.5, 2.5)
    empty = LabelSet.create(tmp_path / "empty", camera, {})
    with pytest.raises(CloudError, match="no labelled part"):
        load_crops([empty.path])
    for name, part in (("a", BACKGROUND), ("b", UNDEFINED)):
        empty.write(FrameLabels(name, np.full((6, 8), 900, np.uint16), np.full((6, 8), part, np.uint8)))
    with pytest.raises(CloudError, match="no labelled part"):
        load_crops([empty.path])
    assert len(load_crops([truth, empty.path])) == 3


def test_subjects_are_held_out_and_measured_on(rig_session):
    truth = rig_session.with_suffix(".truth")
    subjects = [frame.subject for frame in LabelSet.open(truth)]
    one = subjects[0]
    held = load_crops([truth], only=frozenset({one}))
    rest = load_crops([truth], without=frozenset({one}))
    assert len(held) == subjects.count(one)
    assert len(rest) == len(subjects) - len(held) > 0
    with pytest.raises(CloudError, match="no labelled part of absent"):
        load_crops([truth], only=frozenset({"absent"}))


def test_shards_are_read_and_what_is_wrong_with_them_is_said(tmp_path):
    parts = np.zeros((SIZE, SIZE), np.uint8)
    parts[50:150, 50:150] = 3
    depth = np.where(parts > 0, np.uint16(1500), np.uint16(0))
    frames = [FrameLabels(f"{i}", depth, parts) for i in range(3)]
    write_dataset(tmp_path / "a", frames)
    assert len(load_crops([tmp_path / "a"])) == 3
    write_dataset(tmp_path / "b", frames, images=10**14)
    assert len(load_crops([tmp_path / "b"])) == 3
    (tmp_path / "a" / "shard-000000.tar").unlink()
    with pytest.raises(CloudError, match=r"lacks shard 'shard-000000\.tar'"):
        load_crops([tmp_path / "a"])


def test_crops_lie_in_a_file_and_a_full_disk_is_one_line(tmp_path, rig_session, monkeypatch):
    truth = rig_session.with_suffix(".truth")
    crops = load_crops([truth])
    assert isinstance(crops.packed.base, np.memmap) and crops.packed.size < 0.3 * 135_000 * len(crops)

    def full():
        return Path("/dev/full").open("w+b", buffering=0)

    monkeypatch.setattr(data, "TemporaryFile", full)
    with pytest.raises(CloudError, match=r"No space left.*TMPDIR"):
        load_crops([truth])


def test_a_crop_in_a_label_set_is_seen_by_the_camera_it_was_cut_from(tmp_path):
    """A prediction of a dataset is a label set whose own camera stands for none of its crops."""
    blank = np.zeros((SIZE, SIZE), np.uint8)
    frame = FrameLabels("a", blank.astype(np.uint16), blank, notes={"crop": [10, 20, 106]})
    predicted = LabelSet.create(tmp_path / "set", Intrinsics(SIZE, SIZE, 9.0, 9.0, 1.0, 1.0), {})
    assert camera_of(predicted, frame) == KINECT2_PINHOLE
    assert pinhole_of(frame, KINECT2_PINHOLE).fx == pytest.approx(2 * KINECT2_PINHOLE.fx)
    whole = FrameLabels("b", frame.depth_mm, frame.parts)
    assert camera_of(predicted, whole) == predicted.intrinsics == pinhole_of(whole, predicted.intrinsics)
