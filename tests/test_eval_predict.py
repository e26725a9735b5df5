"""Prediction labels the person alone, at any place and distance; runs resume to the same bytes."""

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from conftest import assert_refused, tree

from annotate.crop import SIZE, crop_around, network_crop
from annotate.frame_labels import FrameLabels
from annotate.labelset import dataset
from annotate.labelset.dataset import Dataset
from annotate.labelset.images import encode_png
from annotate.labelset.label_set import LabelSet, validate
from annotate.parts import BACKGROUND, N_CLASSES, PAPER, PART_ID, swap_left_right
from eval.compare.compare import compare_sets
from eval.network.body_state import BodyState
from eval.network.onnx_network import OnnxNetwork
from eval.network.predict import PredictOptions, predict_frames
from eval.network.predict_source import predict_source
from eval.scores.joints import TWIN
from eval.training.crops import to_crop
from sensors.errors import CloudError, ExistsError, FormatError
from sensors.importers.open_source import open_source
from sensors.session.reader import Session
from tests.helpers.shards import write_dataset

ALL = PredictOptions(probabilities=True)


def silent(n: int) -> None:
    assert n == 1


@pytest.fixture(scope="module")
def network() -> OnnxNetwork:
    return OnnxNetwork().in_scheme(PAPER)


@pytest.fixture(scope="module")
def truth(rig_session) -> LabelSet:
    return LabelSet.open(rig_session.with_suffix(".truth"))


@pytest.fixture(scope="module")
def predicted(tmp_path_factory, rig_session, network) -> LabelSet:
    """Labels of the clean rig's recording by the shipped network."""
    out = tmp_path_factory.mktemp("predict") / "p"
    return predict_source(Session(rig_session), network, out, silent).labels


def test_probabilities_do_not_depend_on_the_batch(network):
    x = np.random.default_rng(0).random((3, SIZE, SIZE), np.float32)
    p = network.probabilities(x)
    assert (p.shape, p.dtype) == ((3, N_CLASSES, SIZE, SIZE), np.float32)
    np.testing.assert_allclose(p.sum(axis=1), 1, atol=1e-4)
    assert p.min() >= 0
    np.testing.assert_allclose(network.probabilities(x[1:2])[0], p[1], atol=1e-4)


def test_every_pixel_of_the_person_gets_a_part_and_the_room_changes_nothing(network, truth):
    for frame in truth:
        person = frame.parts > 0
        result = network.segment(frame.depth_mm, person)
        on = person & (frame.depth_mm > 0)
        assert ((result.parts[on] >= 1) & (result.parts[on] < N_CLASSES)).all()
        assert (result.parts[~on] == BACKGROUND).all() and (result.confidence[~on] == 0).all()
        assert 0 <= result.confidence.min() <= result.confidence.max() <= 1
        alone = network.segment(np.where(person, frame.depth_mm, 0).astype(np.uint16), person)
        np.testing.assert_array_equal(result.parts, alone.parts)
        np.testing.assert_array_equal(result.confidence, alone.confidence)


def test_a_flipped_image_gets_flipped_labels(network, truth):
    """Both are computed from the same two images; sums of regions round in another order."""
    frame = truth.read("000000")
    crop = network_crop(frame.parts > 0)
    depth, person = crop.cut(frame.depth_mm, 0), crop.cut(frame.parts > 0, False)
    found, other = (
        network.segment(*images) for images in ((depth, person), (depth[:, ::-1], person[:, ::-1]))
    )
    np.testing.assert_array_equal(swap_left_right(other.parts)[:, ::-1], found.parts)
    np.testing.assert_allclose(other.confidence[:, ::-1], found.confidence, atol=1e-6)
    state, flipped = (BodyState.from_note(result.bearing) for result in (found, other))
    assert flipped.facing_deg == pytest.approx(-state.facing_deg)
    np.testing.assert_allclose(flipped.joints_px[TWIN, 0], SIZE - 1 - state.joints_px[:, 0], atol=0.11)
    once = OnnxNetwork(flip=False).in_scheme(PAPER).segment(depth, person)
    assert (once.parts != found.parts).any()


def test_place_and_distance_of_the_person_change_nothing(network, truth):
    frame = truth.read("000000")
    depth_mm, person = frame.depth_mm, frame.parts > 0
    rows, columns = np.nonzero(person)
    shift = 3 - int(rows.min()), 2 - int(columns.min())
    moved = network.segment(np.roll(depth_mm, shift, (0, 1)), np.roll(person, shift, (0, 1)))
    straight = network.segment(depth_mm, person)
    np.testing.assert_array_equal(moved.parts, np.roll(straight.parts, shift, (0, 1)))
    further = network.segment(np.where(depth_mm > 0, depth_mm + 400, 0).astype(np.uint16), person)
    assert (straight.parts != further.parts).sum() <= 0.001 * (straight.parts > 0).sum()


def test_an_empty_mask_gets_no_parts_and_one_pixel_gets_one(network):
    depth = np.full((424, 512), 2000, np.uint16)
    for depth_mm, person in ((depth, np.zeros(depth.shape, bool)), (depth * 0, np.ones(depth.shape, bool))):
        result = network.segment(depth_mm, person)
        assert not result.parts.any() and "no person" in result.notes[0]
    for at in ((0, 0), (423, 511), (200, 300)):
        person = np.zeros(depth.shape, bool)
        person[at] = True
        np.testing.assert_array_equal(network.segment(depth, person).parts > 0, person)


def test_a_rim_that_a_small_crop_drops_gets_the_part_beside_it():
    """The network gives background off the person; a pixel of the person never takes that for a head."""

    class Forearms(OnnxNetwork):
        def outputs(self, crops):
            planes = np.zeros((len(crops), N_CLASSES, SIZE, SIZE), np.float32)
            planes[:, PART_ID["left_forearm"]] = 0.9 * (crops > 0)
            planes[:, BACKGROUND] = 1 - 0.9 * (crops > 0)
            return [planes]

    person = np.random.default_rng(0).random((424, 512)) < 0.5
    result = Forearms().segment(np.full(person.shape, 1500, np.uint16), person)
    np.testing.assert_array_equal(result.parts, np.where(person, PART_ID["left_forearm"], 0))
    np.testing.assert_allclose(result.confidence, np.where(person, 0.9, 0), atol=1e-6)


# Runs over recordings, label sets and datasets


def test_a_recordings_run_resumes_to_the_same_bytes(tmp_path, rig_session, predicted, truth, network):
    assert predicted.info["steps"]["predict"]["weights"] == network.sha256
    assert {predicted.notes(i)["extraction"] for i in predicted.frame_ids} == {"thermal"}
    assert all(predicted.probabilities(i) is None for i in predicted.frame_ids)
    # Needs the trained weights; untrained ones fail here.
    assert float(compare_sets(predicted, truth).scores["mean_recall"]) >= 0.6

    class Interrupted(OnnxNetwork):
        def segment(self, depth_mm, person, camera=None, *, probabilities=False):
            if np.array_equal(depth_mm, second.depth_mm):
                raise KeyboardInterrupt
            return super().segment(depth_mm, person, camera, probabilities=probabilities)

    second, out = predicted.read("000001"), tmp_path / "p"
    with pytest.raises(KeyboardInterrupt):
        predict_source(Session(rig_session), Interrupted(), out, silent)
    assert len(LabelSet.open(out)) == 1
    predict_source(Session(rig_session), network, out, silent)
    assert tree(out) == tree(predicted.path)


def crop_frame(truth: LabelSet, frame_id: str, name: str) -> FrameLabels:
    """A frame as in a dataset: the person's crop."""
    frame = truth.read(frame_id)
    crop = crop_around(frame.parts > 0)
    depth, parts = crop.cut(frame.depth_mm, 0), crop.cut(frame.parts, 0)
    notes = {"crop": [crop.top, crop.left, crop.side]}
    return FrameLabels(name, depth, parts, subject=f"subject {frame_id}", status="truth", notes=notes)


@pytest.fixture(scope="module")
def crops(tmp_path_factory, truth) -> Dataset:
    """Six crops: two of each of the rig's frames."""
    frames = [crop_frame(truth, i, f"{n}{i}") for n in range(2) for i in truth.frame_ids]
    return write_dataset(tmp_path_factory.mktemp("dataset") / "d", frames)


def test_a_dataset_is_labelled_as_its_frames_are(tmp_path, crops, network):
    """Its frames are crops already, as in training."""
    done, again = [], []
    run = predict_frames(crops, network, tmp_path / "p", done.append)
    predict_frames(crops, network, tmp_path / "p", again.append)
    assert sum(done) == sum(again) == 6
    assert run.labels.frame_ids == sorted(frame.frame_id for frame in crops)
    for frame in crops:
        predicted = run.labels.read(frame.frame_id)
        depth, _ = to_crop(frame)
        body = network.probabilities(depth[None])[0, 1:]
        there = (frame.parts > 0) & (frame.depth_mm > 0)
        np.testing.assert_array_equal(predicted.parts, np.where(there, body.argmax(axis=0) + 1, 0))
        np.testing.assert_array_equal(predicted.depth_mm, frame.depth_mm)
        assert (predicted.subject, predicted.notes["crop"]) == (frame.subject, frame.notes["crop"])
        assert predicted.status == "auto"


def test_batches_and_interruptions_change_no_byte(tmp_path, crops, network):
    class Interrupted(OnnxNetwork):
        calls = 0

        def segment_all(self, images, cameras, *, probabilities=False):
            self.calls += 1
            if self.calls > 2:
                raise KeyboardInterrupt
            return super().segment_all(images, cameras, probabilities=probabilities)

    for batch in (1, 4, 7):
        predict_frames(crops, network, tmp_path / str(batch), silent, PredictOptions(True, batch=batch))
    out = tmp_path / "p"
    with pytest.raises(KeyboardInterrupt):
        predict_frames(crops, Interrupted(), out, silent, PredictOptions(True, batch=2))
    assert 0 < len(LabelSet.open(out)) < 6
    predict_frames(crops, network, out, silent, ALL)
    assert tree(tmp_path / "1") == tree(tmp_path / "4") == tree(tmp_path / "7") == tree(out)


def test_another_source_or_setting_is_not_mixed_in(tmp_path, crops, truth, network):
    out, whole = tmp_path / "p", tmp_path / "w"
    predict_frames(crops, network, out, silent)
    predict_frames(truth, network, whole, silent)
    before = tree(tmp_path)
    other = write_dataset(tmp_path / "d", [crop_frame(truth, "000000", "00")])
    recording = LabelSet.create(tmp_path / "other", truth.intrinsics, truth.info)
    frame = truth.read("000000")
    recording.write(FrameLabels("000000", frame.depth_mm[::-1].copy(), frame.parts[::-1].copy()))
    for source, folder, options, why in (
        (other, out, PredictOptions(), "another source"),
        (crops, out, ALL, "other settings"),
        (recording, whole, PredictOptions(), "another recording"),
    ):
        with pytest.raises(ExistsError, match=why):
            predict_frames(source, network, folder, silent, options)
    assert before.items() <= tree(tmp_path).items()
    none = LabelSet.create(tmp_path / "none", truth.intrinsics, {})
    with pytest.raises(CloudError, match="holds no frames"):
        predict_frames(none, network, tmp_path / "q", silent)
    assert not (tmp_path / "q").exists()
    with pytest.raises(CloudError, match="leave out one of the two"):
        PredictOptions(probabilities=True, everybody=True)


def test_a_shard_that_breaks_off_keeps_the_frames_before(tmp_path, crops, network):
    path = Path(shutil.copytree(crops.path, tmp_path / "d"))
    shard = path / "shard-000000.tar"
    shard.write_bytes(shard.read_bytes()[: shard.stat().st_size * 2 // 3])
    with pytest.raises(FormatError, match="shard"):
        predict_frames(Dataset.open(path), network, tmp_path / "p", silent, PredictOptions(batch=2))
    kept = LabelSet.open(tmp_path / "p")
    assert 0 < len(kept) < 6
    assert validate(kept) == []


# Stored probabilities


def test_probabilities_come_back_and_give_the_labels(tmp_path, truth, rig_session, network):
    run = predict_frames(truth, network, tmp_path / "p", silent, ALL)
    for frame in run.labels:
        stored = run.labels.probabilities(frame.frame_id)
        exact = network.segment(frame.depth_mm, frame.parts > 0, probabilities=True).probabilities
        assert stored.crop == exact.crop
        np.testing.assert_allclose(stored.planes, exact.planes, atol=0.03)
        np.testing.assert_allclose(stored.planes.sum(axis=0), 1, atol=1e-5)
        image = stored.crop.paste(stored.planes.transpose(1, 2, 0), frame.parts.shape, 0)
        person = frame.parts > 0
        scores = np.sort(image[..., 1:][person], axis=-1)
        # Rounding keeps the order: only a tie between the first two may be another label.
        untied = scores[:, -1] > scores[:, -2]
        agree = image[..., 1:].argmax(axis=-1)[person] + 1 == frame.parts[person]
        assert agree[untied].all() and untied.mean() > 0.98
    labels = predict_source(Session(rig_session), network, tmp_path / "q", silent, ALL).labels
    assert all(labels.probabilities(i) is not None for i in labels.frame_ids)
    labels.write(labels.read("000000"))
    assert labels.probabilities("000000") is None


def no_sum() -> bytes:
    return cv2.imencode(".png", np.full((N_CLASSES * SIZE, SIZE), 9, np.uint8))[1].tobytes()


def test_damaged_probabilities_are_named(tmp_path, truth, network):
    labels = predict_frames(truth, network, tmp_path / "p", silent, ALL).labels
    file = labels.path / "frames" / "000000.probability.png"
    data, bomb = file.read_bytes(), bytearray(no_sum())
    bomb[16:24] = (2**31 - 1).to_bytes(4, "big") * 2  # claims more than memory holds
    for spoilt, why in (
        (data[: len(data) // 2], "cannot be decoded|cut off|add up"),
        (b"\x80\x04K\x01." * 10, "not a PNG"),
        (cv2.imencode(".png", np.zeros((SIZE, SIZE), np.uint8))[1].tobytes(), "212x2544"),
        (no_sum(), "add up to one"),
        (bytes(bomb), "give at most"),
    ):
        file.write_bytes(spoilt)
        with pytest.raises(FormatError, match=why) as error:
            labels.probabilities("000000")
        assert str(file) in str(error.value)
        assert [str(error.value)] == validate(labels)


# As a command


def test_predict_takes_a_dataset_and_a_folder_of_depth_images(annotate_cloud, tmp_path, crops, truth):
    done = annotate_cloud("predict", crops.path, "--out", tmp_path / "a", "--probabilities", "--json")
    assert (done.code, done.result["frames"]) == (0, 6)
    assert LabelSet.open(tmp_path / "a").probabilities("0000000") is not None
    folder = tmp_path / "folder"
    folder.mkdir()
    (folder / "0.png").write_bytes(encode_png(truth.read("000000").depth_mm))
    camera = truth.intrinsics
    numbers = {name: getattr(camera, name) for name in ("width", "height", "fx", "fy", "cx", "cy")}
    (folder / "intrinsics.json").write_text(json.dumps(numbers))
    done = annotate_cloud("predict", folder, "--out", tmp_path / "b", "--json")
    assert (done.code, done.result["frames"]) == (0, 1)
    assert "no thermal images" in done.err
    assert LabelSet.open(tmp_path / "b").notes("000000")["extraction"] == "depth"


def test_an_unusable_source_is_refused(annotate_cloud, tmp_path, crops):
    out, empty = ("--out", tmp_path / "p"), tmp_path / "empty"
    empty.mkdir()
    assert_refused(annotate_cloud("predict", empty, *out), "holds no depth images", empty)
    broken = Path(shutil.copytree(crops.path, tmp_path / "d"))
    (broken / "shard-000000.tar").unlink()
    assert_refused(annotate_cloud("predict", broken, *out), "lacks shard")
    weights = ("--weights", broken / dataset.MANIFEST)
    assert_refused(annotate_cloud("predict", crops.path, *out, *weights), "weights")
    assert not (tmp_path / "p").exists()


@pytest.mark.parametrize("scan", ["20190823_020756", "20190823_030127"])
def test_a_real_standing_person_has_parts_from_head_to_feet(shared_data, tmp_path, network, scan):
    """The two scans are from in front and from behind."""
    source = open_source(shared_data / "kinect2_standing" / f"{scan}.pcd")
    labels = predict_source(source, network, tmp_path / "p", silent).labels
    frame = labels.read("000000")
    assert (frame.parts > 0).sum() > 0.9 * (frame.depth_mm > 0).sum()
    rows = [
        np.median(np.nonzero(np.isin(frame.parts, [PART_ID[name] for name in names]))[0])
        for names in (["head"], ["torso"], ["left_lower_leg", "right_lower_leg"])
    ]
    assert rows == sorted(rows)
