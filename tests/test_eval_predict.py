"""The network at work: it labels the person and nothing else, wherever and however far away they are."""

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
from annotate.parts import BACKGROUND, N_CLASSES, PART_ID, swap_left_right
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


def silent(n: int) -> None:
    assert n == 1


@pytest.fixture(scope="module")
def network() -> OnnxNetwork:
    return OnnxNetwork()


@pytest.fixture(scope="module")
def truth(rig_session) -> LabelSet:
    return LabelSet.open(rig_session.with_suffix(".truth"))


@pytest.fixture(scope="module")
def predicted(tmp_path_factory, rig_session, network) -> LabelSet:
    """What the shipped network makes of the clean rig's recording."""
    out = tmp_path_factory.mktemp("predict") / "p"
    return predict_source(Session(rig_session), network, out, silent).labels


def test_probabilities_are_probabilities(network):
    x = np.random.default_rng(0).random((3, SIZE, SIZE), np.float32)
    p = network.probabilities(x)
    assert (p.shape, p.dtype) == ((3, N_CLASSES, SIZE, SIZE), np.float32)
    np.testing.assert_allclose(p.sum(axis=1), 1, atol=1e-4)
    assert p.min() >= 0
    for i in range(3):
        np.testing.assert_allclose(network.probabilities(x[i : i + 1])[0], p[i], atol=1e-4)


def test_every_pixel_of_the_person_gets_a_part_and_no_other(network, truth):
    for frame in truth:
        person = frame.parts > 0
        result = network.segment(frame.depth_mm, person)
        on = person & (frame.depth_mm > 0)
        assert (result.parts.dtype, result.confidence.dtype) == (np.uint8, np.float32)
        assert ((result.parts[on] >= 1) & (result.parts[on] < N_CLASSES)).all()
        assert (result.parts[~on] == BACKGROUND).all()
        assert (result.confidence[~on] == 0).all()
        assert (result.confidence >= 0).all()
        assert (result.confidence <= 1).all()


def test_a_mirror_image_gets_mirrored_labels(network, truth):
    """To the bit: both are asked for the same two images."""
    frame = truth.read("000000")
    crop = network_crop(frame.parts > 0)
    depth, person = crop.cut(frame.depth_mm, 0), crop.cut(frame.parts > 0, False)
    found, other = (
        network.segment(*images) for images in ((depth, person), (depth[:, ::-1], person[:, ::-1]))
    )
    np.testing.assert_array_equal(swap_left_right(other.parts)[:, ::-1], found.parts)
    np.testing.assert_array_equal(other.confidence[:, ::-1], found.confidence)
    bearing, mirrored = (BodyState.from_note(result.bearing) for result in (found, other))
    assert mirrored.facing_deg == pytest.approx(-bearing.facing_deg)
    np.testing.assert_allclose(mirrored.joints_px[TWIN, 0], SIZE - 1 - bearing.joints_px[:, 0], atol=0.11)
    once = OnnxNetwork(flip=False).segment(depth, person)
    assert (once.parts != found.parts).any()


def test_the_room_behind_changes_nothing(network, truth):
    frame = truth.read("000000")
    person = frame.parts > 0
    alone = np.where(person, frame.depth_mm, 0).astype(np.uint16)
    a, b = (network.segment(depth, person) for depth in (frame.depth_mm, alone))
    np.testing.assert_array_equal(a.parts, b.parts)
    np.testing.assert_array_equal(a.confidence, b.confidence)


def test_where_the_person_sits_in_the_image_changes_nothing(network, truth):
    frame = truth.read("000000")
    person = frame.parts > 0
    rows, columns = np.nonzero(person)
    dv, du = 3 - rows.min(), -(2 - columns.min())
    shift = (int(dv), -int(du))
    moved = network.segment(np.roll(frame.depth_mm, shift, (0, 1)), np.roll(person, shift, (0, 1)))
    straight = network.segment(frame.depth_mm, person)
    np.testing.assert_array_equal(moved.parts, np.roll(straight.parts, shift, (0, 1)))


def test_how_far_the_person_sits_changes_nothing(network, truth):
    frame = truth.read("000001")
    further = np.where(frame.depth_mm > 0, frame.depth_mm + 400, 0).astype(np.uint16)
    a, b = (network.segment(depth, frame.parts > 0).parts for depth in (frame.depth_mm, further))
    assert (a != b).sum() <= 0.001 * (a > 0).sum()


def test_nobody_is_labelled_nothing(network):
    depth = np.full((424, 512), 2000, np.uint16)
    for depth_mm, person in ((depth, np.zeros(depth.shape, bool)), (depth * 0, np.ones(depth.shape, bool))):
        result = network.segment(depth_mm, person)
        assert not result.parts.any()
        assert "no person" in result.notes[0]


@pytest.mark.parametrize("at", [(0, 0), (423, 511), (200, 300)])
def test_a_person_of_one_pixel_is_labelled(network, at):
    person = np.zeros((424, 512), bool)
    person[at] = True
    parts = network.segment(np.full(person.shape, 2000, np.uint16), person).parts
    np.testing.assert_array_equal(parts > 0, person)


def test_a_run_keeps_the_extraction_and_goes_on_to_the_same_bytes(tmp_path, rig_session, predicted, network):
    assert predicted.info["steps"]["predict"]["weights"] == network.sha256
    assert {predicted.notes(i)["extraction"] for i in predicted.frame_ids} == {"thermal"}

    class Interrupted(OnnxNetwork):
        def segment(self, depth_mm, person, *, probabilities=False):
            if np.array_equal(depth_mm, second.depth_mm):
                raise KeyboardInterrupt
            return super().segment(depth_mm, person, probabilities=probabilities)

    second = predicted.read("000001")
    out = tmp_path / "p"
    with pytest.raises(KeyboardInterrupt):
        predict_source(Session(rig_session), Interrupted(), out, silent)
    assert len(LabelSet.open(out)) == 1
    predict_source(Session(rig_session), network, out, silent)
    assert tree(out) == tree(predicted.path)


def test_labels_of_another_recording_are_not_mixed_in(tmp_path, truth, network):
    out = tmp_path / "p"
    predict_frames(truth, network, out, silent)
    before = tree(out)
    other = LabelSet.create(tmp_path / "other", truth.intrinsics, truth.info)
    frame = truth.read("000000")
    other.write(type(frame)("000000", frame.depth_mm[::-1].copy(), frame.parts[::-1].copy()))
    with pytest.raises(ExistsError, match="another recording"):
        predict_frames(other, network, out, silent)
    assert tree(out) == before


def test_subjects_are_carried_along(tmp_path, truth, network):
    run = predict_frames(truth, network, tmp_path / "p", silent)
    assert [f.subject for f in run.labels] == [f.subject for f in truth]
    assert {f.status for f in run.labels} == {"auto"}


def test_the_shipped_network_knows_the_parts(truth, predicted):
    """Needs the trained weights; a placeholder fails here."""
    assert float(compare_sets(predicted, truth).scores["mean_recall"]) >= 0.6


def test_rims_that_a_small_crop_drops_get_the_part_beside_them():
    """A network gives background where it sees nothing; a pixel of the person never takes that for a head."""

    class Forearms(OnnxNetwork):
        def outputs(self, crops):
            planes = np.zeros((len(crops), N_CLASSES, SIZE, SIZE), np.float32)
            planes[:, PART_ID["left_forearm"]], planes[:, BACKGROUND] = (
                0.9 * (crops > 0),
                1 - 0.9 * (crops > 0),
            )
            return [planes]

    person = np.random.default_rng(0).random((424, 512)) < 0.5
    result = Forearms().segment(np.full(person.shape, 1500, np.uint16), person)
    np.testing.assert_array_equal(result.parts, np.where(person, PART_ID["left_forearm"], 0))
    np.testing.assert_allclose(result.confidence, np.where(person, 0.9, 0), atol=1e-6)


# Label sets and datasets


def crop_frame(truth: LabelSet, frame_id: str, name: str) -> FrameLabels:
    """A frame as a dataset holds it: the person's crop."""
    frame = truth.read(frame_id)
    crop = crop_around(frame.parts > 0)
    return FrameLabels(
        name,
        crop.cut(frame.depth_mm, 0),
        crop.cut(frame.parts, 0),
        subject=f"subject {frame_id}",
        status="truth",
        notes={"crop": [crop.top, crop.left, crop.side]},
    )


@pytest.fixture(scope="module")
def crops(tmp_path_factory, truth) -> Dataset:
    """Six crops: two of each of the rig's frames."""
    frames = [crop_frame(truth, i, f"{n}{i}") for n in range(2) for i in truth.frame_ids]
    return write_dataset(tmp_path_factory.mktemp("dataset") / "d", frames)


def test_a_dataset_is_labelled_as_its_frames_are(tmp_path, crops, truth, network):
    """Its frames are crops already: what training saw is what the network gets."""
    run = predict_frames(crops, network, tmp_path / "p", silent)
    assert run.labels.frame_ids == sorted(frame.frame_id for frame in crops)
    for frame in crops:
        predicted = run.labels.read(frame.frame_id)
        depth, _ = to_crop(frame)
        body = network.probabilities(depth[None])[0, 1:]
        there = (frame.parts > 0) & (frame.depth_mm > 0)
        np.testing.assert_array_equal(predicted.parts, np.where(there, body.argmax(axis=0) + 1, 0))
        np.testing.assert_array_equal(predicted.depth_mm, frame.depth_mm)
        assert (predicted.subject, predicted.notes["crop"]) == (frame.subject, frame.notes["crop"])


def test_the_number_of_frames_at_once_changes_no_byte(tmp_path, crops, network):
    for batch in (1, 4, 7):
        predict_frames(crops, network, tmp_path / str(batch), silent, PredictOptions(True, batch=batch))
    assert tree(tmp_path / "1") == tree(tmp_path / "4") == tree(tmp_path / "7")


def test_an_interrupted_dataset_goes_on_to_the_same_bytes(tmp_path, crops, network):
    whole = predict_frames(crops, network, tmp_path / "whole", silent, PredictOptions(True))

    class Interrupted(OnnxNetwork):
        calls = 0

        def segment_all(self, images, *, probabilities=False):
            self.calls += 1
            if self.calls > 2:
                raise KeyboardInterrupt
            return super().segment_all(images, probabilities=probabilities)

    out = tmp_path / "p"
    with pytest.raises(KeyboardInterrupt):
        predict_frames(crops, Interrupted(), out, silent, PredictOptions(True, batch=2))
    assert 0 < len(LabelSet.open(out)) < 6
    assert len(predict_frames(crops, network, out, silent, PredictOptions(True)).labels) == 6
    assert tree(out) == tree(whole.labels.path)


def test_progress_counts_every_frame_once(tmp_path, crops, network):
    done = []
    predict_frames(crops, network, tmp_path / "p", done.append)
    again = []
    predict_frames(crops, network, tmp_path / "p", again.append)
    assert sum(done) == sum(again) == 6


def test_a_dataset_of_other_images_is_not_mixed_in(tmp_path, crops, truth, network):
    out = tmp_path / "p"
    predict_frames(crops, network, out, silent)
    before = tree(out)
    other = write_dataset(tmp_path / "d", [crop_frame(truth, "000000", "00")])
    with pytest.raises(ExistsError, match="another source"):
        predict_frames(other, network, out, silent)
    with pytest.raises(ExistsError, match="other settings"):
        predict_frames(crops, network, out, silent, PredictOptions(True))
    assert tree(out) == before


def test_one_frame_is_enough_and_none_is_said(tmp_path, truth, network):
    one = write_dataset(tmp_path / "one", [crop_frame(truth, "000000", "0")])
    assert len(predict_frames(one, network, tmp_path / "p", silent).labels) == 1
    none = LabelSet.create(tmp_path / "none", truth.intrinsics, {})
    with pytest.raises(CloudError, match="holds no frames"):
        predict_frames(none, network, tmp_path / "q", silent)
    assert not (tmp_path / "q").exists()


def test_a_shard_that_breaks_off_keeps_what_was_done(tmp_path, crops, network):
    path = Path(shutil.copytree(crops.path, tmp_path / "d"))
    shard = path / "shard-000000.tar"
    shard.write_bytes(shard.read_bytes()[: shard.stat().st_size * 2 // 3])
    with pytest.raises(FormatError, match="shard"):
        predict_frames(Dataset.open(path), network, tmp_path / "p", silent, PredictOptions(batch=2))
    kept = LabelSet.open(tmp_path / "p")
    assert 0 < len(kept) < 6
    assert validate(kept) == []


# Probabilities


def test_probabilities_come_back_and_give_the_labels(tmp_path, truth, network):
    run = predict_frames(truth, network, tmp_path / "p", silent, PredictOptions(True))
    for frame in run.labels:
        stored = run.labels.probabilities(frame.frame_id)
        assert stored is not None
        exact = network.segment(frame.depth_mm, frame.parts > 0, probabilities=True).probabilities
        assert stored.crop == exact.crop
        np.testing.assert_allclose(stored.planes, exact.planes, atol=0.03)
        np.testing.assert_allclose(stored.planes.sum(axis=0), 1, atol=1e-5)
        image = stored.crop.paste(stored.planes.transpose(1, 2, 0), frame.parts.shape, 0)
        assert image.shape == (*frame.parts.shape, N_CLASSES)
        person = frame.parts > 0
        scores = np.sort(image[..., 1:][person], axis=-1)
        # Rounding keeps the order: only a tie between the first two may be another label.
        untied = scores[:, -1] > scores[:, -2]
        agree = image[..., 1:].argmax(axis=-1)[person] + 1 == frame.parts[person]
        assert agree[untied].all() and untied.mean() > 0.98


def test_without_being_asked_none_are_kept(predicted):
    assert all(predicted.probabilities(i) is None for i in predicted.frame_ids)


def test_a_session_keeps_them_too(tmp_path, rig_session, network):
    run = predict_source(Session(rig_session), network, tmp_path / "p", silent, PredictOptions(True))
    assert all(run.labels.probabilities(i) is not None for i in run.labels.frame_ids)
    labels = run.labels
    labels.write(labels.read("000000"))
    assert labels.probabilities("000000") is None


def wrong_size() -> bytes:
    return cv2.imencode(".png", np.zeros((SIZE, SIZE), np.uint8))[1].tobytes()


def no_sum() -> bytes:
    return cv2.imencode(".png", np.full((N_CLASSES * SIZE, SIZE), 9, np.uint8))[1].tobytes()


def bomb() -> bytes:
    """A header that claims more than memory holds."""
    data = bytearray(no_sum())
    data[16:24] = (2**31 - 1).to_bytes(4, "big") * 2
    return bytes(data)


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (lambda data: data[: len(data) // 2], "nothing readable|cut off|add up"),
        (lambda data: b"\x80\x04K\x01." * 10, "not a PNG"),
        (lambda data: wrong_size(), "2544 x 212"),
        (lambda data: no_sum(), "add up to one"),
        (lambda data: bomb(), "claims"),
    ],
)
def test_spoilt_probabilities_are_named(tmp_path, truth, network, spoil, says):
    labels = predict_frames(truth, network, tmp_path / "p", silent, PredictOptions(True)).labels
    file = labels.path / "frames" / "000000.probability.png"
    file.write_bytes(spoil(file.read_bytes()))
    with pytest.raises(FormatError, match=says) as error:
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
    labels = LabelSet.open(tmp_path / "b")
    assert labels.notes("000000")["extraction"] == "depth"


def test_a_source_that_holds_nothing_to_label_is_refused(annotate_cloud, tmp_path, crops):
    out = ("--out", tmp_path / "p")
    empty = tmp_path / "empty"
    empty.mkdir()
    assert_refused(annotate_cloud("predict", empty, *out), "holds no depth images", empty)
    broken = Path(shutil.copytree(crops.path, tmp_path / "d"))
    (broken / "shard-000000.tar").unlink()
    assert_refused(annotate_cloud("predict", broken, *out), "lacks shard")
    assert_refused(
        annotate_cloud("predict", crops.path, *out, "--weights", broken / dataset.MANIFEST), "weights"
    )
    assert not (tmp_path / "p").exists()


@pytest.mark.parametrize("scan", ["20190823_020756", "20190823_030127"])
def test_a_real_standing_person_comes_out_upright(shared_data, tmp_path, network, scan):
    """Parts from head to feet downwards; the two scans are seen from in front and behind."""
    source = open_source(shared_data / "kinect2_standing" / f"{scan}.pcd")
    labels = predict_source(source, network, tmp_path / "p", silent).labels
    frame = labels.read("000000")
    assert (frame.parts > 0).sum() > 0.9 * (frame.depth_mm > 0).sum()
    rows = [
        np.median(np.nonzero(np.isin(frame.parts, [PART_ID[name] for name in names]))[0])
        for names in (["head"], ["torso"], ["left_lower_leg", "right_lower_leg"])
    ]
    assert rows == sorted(rows)
