"""Predictions in a scheme: labels, refinement, sides and support; refusals are one line."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("torch")

from annotate.frame_labels import FrameLabels
from annotate.labelset.convert import in_scheme
from annotate.labelset.label_set import LabelSet
from annotate.labelset.scheme_note import scheme_note
from annotate.parts import PAPER
from annotate.person.extract import PersonMask
from annotate.person.planes import Plane
from annotate.scheme.merging import conversion_table
from annotate.scheme.scheme import Part, scheme_of
from annotate.scheme.scheme_file import load_scheme
from annotate.segmentation.segmented_person import Segmentation
from annotate.segmentation.suit_network import SuitNetwork
from eval.fine_tuning.by_depth import DepthFineTuner
from eval.fine_tuning.training_split import CorrectedFrame
from eval.network.finer_parts import in_finer_scheme
from eval.network.onnx_network import OnnxNetwork
from eval.network.predict import PredictOptions, fits, predict_frames
from eval.network.predict_source import _without_things, predict_source
from eval.network.refine import refine, shipped_refinement_network
from eval.network.side_smoothing import sided_by_parts
from eval.network.support import CARRIED, support_of
from eval.training.segmentation.network import FULL_REFINEMENT_NETWORK
from sensors.errors import FormatError
from sensors.rig.camera import Intrinsics
from sensors.session.reader import Session
from tests.helpers.schemes import WARD, frame_in
from tests.test_eval_bearing import body_state
from tests.test_eval_network_file import onnx_network

ATLAS, SIX, HANDS = load_scheme("atlas"), load_scheme("six"), load_scheme("hands-and-feet")
CAMERA = Intrinsics(128, 96, 110.0, 110.0, 63.5, 47.5)


@pytest.fixture(scope="module")
def person(tmp_path_factory) -> LabelSet:
    """A label set with one frame: a column in front of a wall."""
    labels = LabelSet.create(tmp_path_factory.mktemp("one") / "set", CAMERA, {"source": "made"})
    rows, columns = np.mgrid[:96, :128]
    on = (abs(columns - 64) < 14) & (rows > 10)
    depth = np.where(on, 2000 + abs(columns - 64), 3000).astype(np.uint16)
    parts = np.where(on, np.where(rows < 25, 1, 2), 0).astype(np.uint8)
    labels.write(FrameLabels("000000", depth, parts))
    return labels


def predicted(labels, out, **options):
    run = predict_frames(labels, OnnxNetwork(), out, lambda n: None, PredictOptions(**options))
    return run.labels


def test_labels_in_a_coarser_scheme_are_those_of_the_summed_probabilities(tmp_path, person):
    labels = predicted(person, tmp_path / "six", scheme=SIX)
    frame = person.read("000000")
    expected = OnnxNetwork().in_scheme(SIX).segment(frame.depth_mm, frame.on_person)
    assert LabelSet.open(labels.path).scheme == SIX
    np.testing.assert_array_equal(labels.read("000000").parts, expected.parts)


def test_a_refinement_takes_the_first_labels_in_its_scheme_and_gives_the_wanted_one(tmp_path, person):
    refiner = shipped_refinement_network()
    labels = predicted(person, tmp_path / "again", scheme=SIX, refiners=[refiner])
    first = predicted(person, tmp_path / "first").read("000000")
    expected = refine(CAMERA, first, refiner.in_scheme(SIX))
    found = labels.read("000000")
    assert found.scheme == labels.scheme == SIX
    np.testing.assert_array_equal(found.parts, expected.parts)


def test_a_scheme_that_the_networks_cannot_give_is_refused_in_one_line(tmp_path, person, annotate_cloud):
    network, room = OnnxNetwork(onnx_network(tmp_path / "n.onnx", 12)), shipped_refinement_network()
    assert fits(PredictOptions(room_refiner=room), network)
    assert not fits(PredictOptions(room_refiner=room, scheme=HANDS), network)
    with pytest.raises(FormatError, match="several parts of scheme 'hands-and-feet'"):
        PredictOptions(scheme=HANDS).chained(network)
    wanted = ("--scheme", "hands-and-feet", "--out", tmp_path / "p")
    done = annotate_cloud("predict", person.path, "--weights", tmp_path / "n.onnx", *wanted)
    assert done.code == 1 and len(done.err.strip().splitlines()) == 1
    assert "'hands-and-feet'" in done.err and not (tmp_path / "p").exists()


def test_a_scheme_that_splits_the_papers_parts_is_given_by_the_regions(tmp_path, person, annotate_cloud):
    wanted = ("--scheme", "hands-and-feet", "--out", tmp_path / "p")
    assert annotate_cloud("predict", person.path, *wanted).code == 0
    frame = LabelSet.open(tmp_path / "p").read("000000")
    network = OnnxNetwork()
    expected = network.in_scheme(HANDS).segment(frame.depth_mm, frame.on_person)
    np.testing.assert_array_equal(frame.parts, expected.parts)


def test_refined_labels_in_a_finer_scheme_keep_the_refined_parts_and_the_first_regions():
    first = frame_in(ATLAS, 3, (48, 64))
    to_paper, to_hands = conversion_table(ATLAS, PAPER), conversion_table(HANDS, PAPER)
    same = in_finer_scheme(in_scheme(first, PAPER, to_paper), first, HANDS)
    np.testing.assert_array_equal(same.parts, conversion_table(ATLAS, HANDS)[first.parts])
    moved = replace(first, parts=np.roll(to_paper[first.parts], 5, 1), scheme=PAPER)
    finer = in_finer_scheme(moved, first, HANDS)
    np.testing.assert_array_equal(to_hands[finer.parts], moved.parts)
    missing = replace(first, parts=np.zeros_like(first.parts))
    np.testing.assert_array_equal(to_hands[in_finer_scheme(moved, missing, HANDS).parts], moved.parts)


def test_recordings_are_refined_in_a_finer_scheme(tmp_path, rig_session):
    """Joined to `paper`, the labels equal labels in `paper`; some pixels are hands."""
    room, opened = shipped_refinement_network(), Session(rig_session)
    coarse, fine = (
        predict_source(
            opened,
            OnnxNetwork(),
            tmp_path / name,
            lambda n: None,
            PredictOptions(room_refiner=room, scheme=scheme),
        ).labels
        for name, scheme in (("paper", PAPER), ("hands", HANDS))
    )
    hands = [part.id for part in HANDS.parts if "hand" in part.name]
    for frame_id in fine.frame_ids:
        found, expected = fine.read(frame_id).parts, coarse.read(frame_id).parts
        same = conversion_table(HANDS, PAPER)[found] == expected
        assert same[expected > 0].mean() > 0.98 and ((found > 0) == (expected > 0)).mean() > 0.999
    assert np.isin(found, hands).any()


@pytest.mark.parametrize("coarse", [PAPER, SIX], ids=lambda scheme: scheme.name)
def test_support_and_sides_are_the_same_in_a_finer_scheme(coarse):
    rng, table = np.random.default_rng(0), conversion_table(ATLAS, coarse)
    floor = Plane(np.array([0.0, -1.0, 0.0]), -1.2, 4.0)
    points = rng.uniform((-1, -1, 2), (1, 1.2, 3), (48, 64, 3)).astype(np.float32)
    for seed in range(8):
        frame = frame_in(ATLAS, seed, (48, 64))
        other = in_scheme(frame, coarse, table)
        state = body_state()
        joints = sided_by_parts(state, frame).joints_px
        if coarse == PAPER:
            np.testing.assert_array_equal(joints, sided_by_parts(state, other).joints_px)
        else:
            np.testing.assert_array_equal(sided_by_parts(state, other).joints_px, state.joints_px)
        for posture in ("standing", *CARRIED):
            on = np.isin(frame.parts, [*range(1, 7), *range(17, 25), 0])
            parts, fewer = (np.where(on, one.parts, 0).astype(np.uint8) for one in (frame, other))
            found = support_of(posture, parts, points, floor, ATLAS)
            assert found == support_of(posture, fewer, points, floor, coarse) != "" or coarse == SIX


def test_things_are_labelled_and_are_not_the_person():
    frame = frame_in(WARD)
    person = PersonMask(frame.parts > 0, "depth", (frame.parts > 0).astype(np.uint8))
    found = Segmentation(frame.parts, np.ones(frame.parts.shape, np.float32), scheme=WARD)
    _, kept = _without_things(found, person)
    np.testing.assert_array_equal(kept.mask, frame.on_person)
    np.testing.assert_array_equal(kept.persons > 0, frame.on_person)


def test_a_thing_that_a_user_drew_is_a_class_of_the_fine_tuned_network(tmp_path, person):
    scheme = scheme_of("chair", [*PAPER.parts, Part(40, "wheelchair", "Wheelchair", (9, 200, 9))])
    frame = in_scheme(person.read("000000"), scheme, conversion_table(PAPER, scheme))
    parts = frame.parts.copy()
    parts[60:, 30:48] = 40
    labels = LabelSet.create(tmp_path / "set", CAMERA, {"source": "made"} | scheme_note(scheme))
    labels.write(frame)
    tuner = DepthFineTuner(labels, None)
    corrected = CorrectedFrame(frame, replace(frame, parts=parts), 0)
    (example,) = tuner.examples([corrected], None)
    assert {12, 1, 2, 0} <= set(np.unique(example.target).tolist()) <= {12, 1, 2, 0, 255}
    tuner.save(tuner.start_network, 1.0, tmp_path / "w.onnx")
    network = SuitNetwork(tmp_path / "w.onnx")
    assert network.own == scheme
    ((found,),) = tuner.parts([corrected], [tmp_path / "w.onnx"])
    before = refine(CAMERA, person.read("000000"), SuitNetwork(FULL_REFINEMENT_NETWORK))
    same = found == in_scheme(before, scheme, conversion_table(PAPER, scheme)).parts
    assert scheme.unknown_ids(found).size == 0 and same[frame.parts > 0].mean() > 0.98
    options = PredictOptions(refiners=[network])
    assert options.chained(OnnxNetwork()).scheme == scheme
