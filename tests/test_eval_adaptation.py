"""Adaptation to labelled recordings: taught labels, held-out people, and refused networks."""

import json
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

pytest.importorskip("torch")

import torch

from annotate.labelset.label_set import LabelSet
from annotate.parts import PAPER, UNDEFINED
from cli.main import app
from eval.architecture.compact import CompactConfig, CompactUNet
from eval.architecture.networks import build
from eval.fine_tuning.adaptation import adapt as adaptation
from eval.fine_tuning.adaptation import adaptation_gain
from eval.fine_tuning.adaptation.adapt import RECORD, adapt
from eval.fine_tuning.adaptation.adaptation_gain import SHARES
from eval.fine_tuning.adaptation.adaptation_split import AdaptationSplit, HeldOut, split_of
from eval.fine_tuning.adaptation.distillation import distance
from eval.fine_tuning.adaptation.labelled_people import (
    LabelledPerson,
    check_sets,
    people_in,
    taught_frames,
)
from eval.fine_tuning.adaptation.scores_on_crops import CropScores, near_joints
from eval.fine_tuning.weights_between import between
from eval.network.onnx_export import export_network
from eval.network.onnx_network import OnnxNetwork
from eval.network.weights_file import save_weights
from eval.scores.joints import JOINT, N_JOINTS
from eval.training.body_targets import FACING, JOINTS, no_targets
from eval.training.crops import Crops
from eval.training.plan import ModernRecipe, Plan
from sensors.errors import CloudError, ExistsError
from synth.data_files import TRAINING
from synth.images import workers
from synth.images.presets import preset_named
from synth.images.workers import Workers
from tests.helpers.witnessed_sets import BY_NETWORK, BY_SUIT, CAMERA, COLOUR, judged, written


@contextmanager
def silent(what, total):
    yield lambda n: None


def test_rejected_frames_and_automatic_frames_of_predict_are_not_taught(tmp_path):
    suit, network = written(tmp_path / "suit", BY_SUIT), written(tmp_path / "network", BY_NETWORK)
    judged(suit, "000001", "reject")
    assert taught_frames(suit).places == {"000000": 0, "000002": 2 / 3}
    with pytest.raises(CloudError, match="0 of 3 frames to adapt with; accept"):
        taught_frames(network)
    judged(network, "000001", "accept")
    assert list(taught_frames(network).places) == ["000001"]
    with pytest.raises(CloudError, match="reserved for measuring"):
        taught_frames(written(tmp_path / "judges", BY_SUIT | {"cast": "judge"}))


def test_a_pixel_is_taught_with_the_probability_of_its_confidence_unless_accepted(tmp_path):
    path = written(tmp_path / "labels", COLOUR)
    judged(path, "000001", "accept")
    taught = taught_frames(path)
    (unsure,), (sure,) = (list(people_in(taught, 0, i)) for i in ("000000", "000001"))
    body = unsure.depth > 0
    share = (unsure.parts[body] == UNDEFINED).mean()
    assert 0.2 < share < 0.3 and set(np.unique(unsure.parts)) == {0, 1, 2, UNDEFINED}
    assert set(np.unique(sure.parts)) == {0, 1, 2}
    (again,) = people_in(taught, 0, "000000")
    np.testing.assert_array_equal(again.parts, unsure.parts)


def test_a_person_is_cropped_alone_with_joints_by_colour_only(tmp_path):
    """The undefined neighbour is not in the crop; joints lie where the image has them."""
    (person,) = people_in(taught_frames(written(tmp_path / "labels", COLOUR)), 0, "000000")
    rows, columns = np.nonzero(person.depth)
    assert abs(np.ptp(rows) / np.ptp(columns) - 34 / 16) < 0.1
    joints = person.row[JOINTS].reshape(N_JOINTS, 3)
    (shoulder_u, shoulder_v), hip = (joints[JOINT[f"left_{name}"], :2] * 212 for name in ("shoulder", "hip"))
    assert person.parts[int(shoulder_v), int(shoulder_u)] in (2, UNDEFINED) and hip[1] > shoulder_v
    np.testing.assert_allclose(person.row[FACING], (1, 0), atol=1e-5)
    (by_suit,) = people_in(taught_frames(written(tmp_path / "suit", BY_SUIT)), 0, "000000")
    assert np.isnan(by_suit.row).all()


def test_of_a_witness_s_joints_only_shown_places_are_taught(tmp_path):
    """Hidden joints, a head that depth moved, and middles of landmarks stay unknown, and so do depths."""
    (person,) = people_in(taught_frames(written(tmp_path / "labels", COLOUR)), 0, "000000")
    joints = person.row[JOINTS].reshape(N_JOINTS, 3)
    unknown = {name for name, i in JOINT.items() if np.isnan(joints[i, :2]).any()}
    assert unknown == {"head", "neck", "pelvis", "left_wrist"} and np.isnan(joints[:, 2]).all()


def person(bodies: str = "p", recording: int = 0, place: float = 0.0) -> LabelledPerson:
    nothing = np.zeros((2, 2), np.uint16)
    return LabelledPerson(
        nothing, nothing.astype(np.uint8), no_targets(), frozenset({bodies}), recording, place
    )


def test_people_are_held_out_or_recordings_or_spans():
    many = [person(f"p{n % 8}", n % 2, n / 16) for n in range(16)]
    held = HeldOut.of(many)
    assert held.kind == "people" and np.flatnonzero(held.mask).tolist() == [2, 6, 10, 14]
    held = HeldOut.of([person("p", n % 4, n / 16) for n in range(16)])
    assert held.kind == "recordings" and np.flatnonzero(held.mask).tolist() == [2, 6, 10, 14]
    held = HeldOut.of([person(place=n / 24) for n in range(24)])
    assert held.kind == "spans" and np.flatnonzero(held.mask).tolist() == [4, 5, 12, 13, 20, 21]
    assert held.span_of.tolist() == [0, 0, 1, 1, 2, 2]
    with pytest.raises(CloudError, match="label at least 12 frames"):
        HeldOut.of([person(place=n / 24) for n in range(4)])


def test_taught_and_held_out_share_nobody():
    images = np.zeros((24 + 40, 2, 2), np.uint16)
    crops = Crops.of((one, one.astype(np.uint8), no_targets()) for one in images)
    held = HeldOut.of([person(place=n / 24) for n in range(24)])
    split = split_of(held, [n % 5 == 0 for n in range(40)], crops)
    every = np.concatenate([split.taught, split.held, split.rehearsed, split.checked])
    np.testing.assert_array_equal(np.sort(every), np.arange(64))
    np.testing.assert_array_equal(split.held, np.flatnonzero(held.mask))
    np.testing.assert_array_equal(split.checked, 24 + np.arange(0, 40, 5))
    np.testing.assert_array_equal(split.trained, np.concatenate([split.taught, split.rehearsed]))


def test_a_joint_is_near_within_a_tenth_of_the_trunk():
    """By hand: the trunk is 0.4 of the crop's side; one joint is outside, and one is unknown."""
    truth = np.full((N_JOINTS, 3), 0.5)
    truth[[JOINT["left_shoulder"], JOINT["right_shoulder"]], 1] = 0.1
    truth[JOINT["head"], 0], truth[JOINT["neck"], 0] = 1.2, np.nan
    found = truth + np.array([0.039, 0, 9])
    assert near_joints(found, truth).tolist() == [13, 13]
    found[JOINT["left_knee"], 0] += 0.002
    assert near_joints(found, truth).tolist() == [12, 13]
    assert near_joints(np.full((N_JOINTS, 3), np.nan), truth).tolist() == [0, 13]
    truth[JOINT["left_hip"]] = np.nan
    assert near_joints(found, truth).tolist() == [0, 0]


def scores(*right: float, joints: float = 0.5) -> CropScores:
    """Scores of one crop a span: that share of the torso's thousand pixels is right."""
    confusion = np.zeros((len(right), 12, 12), np.int64)
    confusion[:, 2, 2] = np.round(1000 * np.array(right))
    confusion[:, 2, 3] = 1000 - confusion[:, 2, 2]
    return CropScores(confusion, np.full((len(right), 2), (round(1000 * joints), 1000)))


def split(spans: int) -> AdaptationSplit:
    index = np.arange(spans)
    crops = Crops.of([(np.zeros((2, 2), np.uint16), np.zeros((2, 2), np.uint8), no_targets())])
    return AdaptationSplit(crops, index, index, index, index, index, "spans")


def gain_of(*networks: tuple[CropScores, CropScores]) -> adaptation_gain.AdaptationGain:
    """Gain of scores on held-out and on synthetic people: of the start, then one for each share."""
    return adaptation_gain.adaptation_gain(networks, split(3))


def test_a_gain_that_forgets_is_refused_and_a_share_that_keeps_is_preferred():
    before, most, half, least = (
        scores(0.6, 0.7, 0.8),
        scores(0.8, 0.92, 0.99),
        scores(0.7, 0.81, 0.9),
        scores(0.65, 0.76, 0.85),
    )
    kept, forgot = scores(0.9), scores(0.89)
    found = gain_of((before, kept), (most, kept), (half, kept), (least, kept))
    assert found.is_certain and found.share == SHARES[0]
    assert found.parts.after - found.parts.before == pytest.approx(0.61 / 3)
    found = gain_of((before, kept), (most, forgot), (half, kept), (least, kept))
    assert found.is_certain and found.share == SHARES[1]
    found = gain_of((before, kept), (most, forgot), (half, forgot), (least, kept))
    assert found.is_certain and found.share == SHARES[2]
    found = gain_of((before, kept), (most, forgot), (half, forgot), (least, forgot))
    assert not found.is_certain and not found.is_harmless and "90.0% before, 89.0% after" in found.text


def test_a_gain_within_chance_and_a_certain_loss_of_joints_are_refused():
    kept, before = scores(0.9), scores(0.6, 0.7, 0.8)
    chance = scores(0.7, 0.65, 0.8)
    found = gain_of((before, kept), *[(chance, kept)] * len(SHARES))
    assert not found.is_certain and found.is_harmless and "sure of a gain" in found.text
    better = scores(0.7, 0.8, 0.9, joints=0.4)
    found = gain_of((before, kept), *[(better, kept)] * len(SHARES))
    assert not found.is_certain and not found.is_harmless


def test_held_out_spans_without_sure_labels_are_refused():
    found = scores(0.6, 0.7, 0.8)
    found.confusion[1:] = 0
    with pytest.raises(CloudError, match="fewer than two held-out spans have parts"):
        gain_of(*[(found, scores(0.9))] * (1 + len(SHARES)))


def test_a_gain_is_read_from_its_record():
    kept = scores(0.9)
    found = gain_of(*[(scores(0.6, 0.7, 0.8), kept)] * (1 + len(SHARES)))
    for gain in (found, replace(found, joints=None)):
        assert type(gain).of_fields(json.loads(json.dumps(asdict(gain)))) == gain
    with pytest.raises(KeyError):
        type(found).of_fields({"frames": 3})


def test_a_network_between_two_has_their_mean():
    first, last = torch.nn.Linear(2, 2), torch.nn.Linear(2, 2)
    middle = between(first, last, 0.25)
    expected = 0.75 * first.weight + 0.25 * last.weight
    np.testing.assert_allclose(middle.weight.detach(), expected.detach(), atol=1e-6)


def test_label_sets_of_two_schemes_and_one_set_twice_are_refused(tmp_path):
    taught = taught_frames(written(tmp_path / "labels", COLOUR))
    other = LabelSet(tmp_path / "other", CAMERA, {})
    other.scheme = replace(PAPER, name="other")
    with pytest.raises(CloudError, match="convert the labels"):
        check_sets([taught, taught._replace(labels=other)])
    (tmp_path / "link").symlink_to(taught.labels.path.resolve())
    with pytest.raises(CloudError, match="link is given twice; give each label set once"):
        check_sets([taught, taught._replace(labels=LabelSet(tmp_path / "link", CAMERA, {}))])


@contextmanager
def here(count):
    """Make the images in this process."""
    with ThreadPoolExecutor(count) as pool:
        yield Workers(pool, count)


@pytest.fixture
def small(monkeypatch, tmp_path) -> Path:
    """A small network in place of the shipped one, and few images and steps."""
    config = CompactConfig((4, 6, 6), 1)
    torch.manual_seed(1)
    model, shipped = CompactUNet(config), tmp_path / "shipped.onnx"
    save_weights(shipped.with_suffix(".safetensors"), model, config)
    export_network(model, shipped)
    monkeypatch.setattr(adaptation, "SHIPPED_WEIGHTS", shipped)
    people = replace(preset_named("people", TRAINING), each=2, views=1)
    monkeypatch.setattr(adaptation, "preset_named", lambda name, cast: people)
    monkeypatch.setattr(adaptation, "IMAGES", 5)
    recipe = ModernRecipe(4, 1e-2, averaged=0.9, coarse=0.0)
    monkeypatch.setattr(adaptation, "planned", lambda config, minutes: Plan(config, recipe, epochs=5))
    for module in (adaptation, adaptation_gain):
        monkeypatch.setattr(module, "SHARES", (1.0,))
    monkeypatch.setattr(workers, "processes", here)
    torch.set_num_threads(1)
    return shipped


def test_adapting_improves_held_out_spans_and_repeats_itself(small, tmp_path, monkeypatch):
    """Without a network that forgets nothing, none is written. An interrupted comparison is made again by the
    finished training, a finished one is not made again.
    """
    taught, out = taught_frames(written(tmp_path / "labels", COLOUR, 12)), tmp_path / "adapted"
    monkeypatch.setattr(adaptation_gain, "MOST_LOST", -1.0)
    assert adapt([taught], out, 1.0, silent).weights is None and not (out / "weights.onnx").exists()
    (checkpoint,) = (out / "training").glob("*.safetensors")
    trained = checkpoint.read_bytes()
    monkeypatch.setattr(adaptation_gain, "MOST_LOST", 1.0)
    assert adapt([taught], out, 1.0, silent).weights is None
    (out / RECORD).unlink()
    steps = list[list[object]]()

    @contextmanager
    def noted(what, total):
        steps.append([what, total, 0])
        yield lambda n: steps[-1].__setitem__(2, steps[-1][2] + n)

    done = adapt([taught], out, 1.0, noted)
    assert all(total == finished for _, total, finished in steps), steps
    exported = "export, networks"
    assert [step[0] for step in steps].count(exported) == 2 and steps[-2][0] == "calibrate, images"
    assert checkpoint.read_bytes() == trained
    assert done.weights == out / "weights.onnx" and done.gain.frames == done.gain.spans == 3
    assert done.gain.parts.low > 0.2
    assert OnnxNetwork(done.weights).own == PAPER
    monkeypatch.setattr(adaptation, "found_people", None)
    assert adapt([taught], out, 1.0, silent) == done
    with pytest.raises(ExistsError, match="another adaptation"):
        adapt([taught], out, 2.0, silent)
    judged(taught.labels.path, "000001", "accept")
    with pytest.raises(ExistsError, match="another adaptation"):
        adapt([taught], out, 1.0, silent)


def test_too_few_frames_leave_nothing_behind(small, tmp_path):
    taught, out = taught_frames(written(tmp_path / "labels", COLOUR)), tmp_path / "adapted"
    with pytest.raises(CloudError, match="label at least 12 frames"):
        adapt([taught], out, 1.0, silent)
    assert not out.exists()


def test_a_folder_inside_a_label_set_is_refused(tmp_path):
    path = written(tmp_path / "labels", COLOUR)
    done = CliRunner().invoke(app, ["adapt", str(path), "--out", str(path / "adapted")])
    assert isinstance(done.exception, ExistsError)
    assert "is inside the input" in str(done.exception) and not (path / "adapted").exists()


def test_outputs_are_apart_by_what_differs():
    """A network is 0 apart from itself; each of its outputs alone adds to the distance."""
    torch.manual_seed(0)
    network = build(CompactConfig((4, 6, 6), 1), PAPER).eval()
    depth = torch.rand(2, 1, 212, 212)
    depth[:, :, :20] = 0
    with torch.no_grad():
        known = network(depth)
    assert float(distance(known, known, depth, ModernRecipe())) == pytest.approx(0, abs=1e-6)
    for name in ("scores", "facing", "posture", "joint_sd", "joint_state", "joint_maps"):
        other = known._replace(**{name: getattr(known, name) * 1.5})
        assert float(distance(other, known, depth, ModernRecipe())) > 1e-5, name
    unseen = known.scores.clone()
    unseen[:, 1, :20] += 9
    apart = distance(known._replace(scores=unseen), known, depth, ModernRecipe())
    assert float(apart) == pytest.approx(0, abs=1e-6)
