"""Labels read again by a reader that learns by depth: the same in every way there is, and no worse."""

from dataclasses import replace

import numpy as np
import pytest

from annotate.crop import person_of
from annotate.labelset.label_set import LabelSet
from annotate.segmentation.input_channels import CHANNELS, LIKELIHOODS
from annotate.segmentation.suit_network import SuitNetwork
from eval.compare.compare import compare_sets
from eval.network.onnx_network import OnnxNetwork
from eval.network.predict import PredictOptions, predict_frames
from eval.network.predict_source import predict_source
from eval.network.refine import SHIPPED_REFINEMENT_NETWORK, camera_in, depth_view, refine
from sensors.session.reader import Session
from synth.rig.simulate import truth_path
from tools.measure.refinement import Cold


class CutOut(Cold):
    """A recording of which persons (h, w) alone are left; its depth camera has no lens distortion."""

    def __init__(self, source, persons):
        super().__init__(source)
        self._persons = persons
        self.calibration = replace(source.calibration, depth=source.calibration.depth.undistorted())

    def _frame(self, index):
        frame = super()._frame(index)
        depth_mm = np.where(self._persons[index], frame.depth_mm, 0).astype(np.uint16)
        return replace(frame, depth_mm=depth_mm)


@pytest.fixture(scope="module")
def learnt() -> SuitNetwork:
    return SuitNetwork(SHIPPED_REFINEMENT_NETWORK)


@pytest.fixture(scope="module")
def first(tmp_path_factory, rig_session) -> LabelSet:
    """A recording by the network alone."""
    out = tmp_path_factory.mktemp("first") / "p"
    return predict_source(Session(rig_session), OnnxNetwork(), out, lambda n: None).labels


@pytest.fixture(scope="module")
def again(tmp_path_factory, rig_session, learnt) -> LabelSet:
    """The same recording, read again."""
    out = tmp_path_factory.mktemp("again") / "p"
    return predict_source(
        Session(rig_session), OnnxNetwork(), out, lambda n: None, PredictOptions(refiners=[learnt])
    ).labels


def test_a_recording_is_read_again_as_its_labels_are(first, again, learnt):
    for one, two in zip(first, again, strict=True):
        read = refine(camera_in(first, one), one, learnt)
        np.testing.assert_array_equal(two.parts, read.parts)
        assert two.notes["bearing"] == one.notes["bearing"] == read.notes["bearing"]
        assert two.notes["confidence"] == read.notes["confidence"]
        assert (two.confidence != one.confidence).any()
    assert again.info["steps"]["predict"]["readers"] == [learnt.sha256]


def test_it_reads_again_where_a_frame_shows_the_room(tmp_path, rig_session, first, again, learnt):
    session, network = Session(rig_session), OnnxNetwork()

    def found(name: str, source) -> LabelSet:
        return predict_source(
            source, network, tmp_path / name, lambda n: None, PredictOptions(room_refiner=learnt)
        ).labels

    for one, two in zip(found("room", session), again, strict=True):
        np.testing.assert_array_equal(one.parts, two.parts)
    cut_out = CutOut(session, [person_of(frame.parts) for frame in first])
    alone = predict_source(cut_out, network, tmp_path / "alone", lambda n: None).labels
    for one, two in zip(found("cut out", cut_out), alone, strict=True):
        np.testing.assert_array_equal(one.parts, two.parts)


def test_a_label_set_is_read_again_as_a_recording_is(tmp_path, first, learnt):
    network = OnnxNetwork()
    one = predict_frames(first, network, tmp_path / "one", lambda n: None).labels
    two = predict_frames(
        first, network, tmp_path / "two", lambda n: None, PredictOptions(refiners=[learnt])
    ).labels
    for own, read in zip(one, two, strict=True):
        np.testing.assert_array_equal(read.parts, refine(camera_in(one, own), own, learnt).parts)


def test_it_is_no_worse_than_the_network_alone(tmp_path, rig_session, first, again, learnt):
    """With temperatures and without: a better outline in both, and better parts over both."""
    truth, cold, network = LabelSet.open(truth_path(rig_session)), Cold(Session(rig_session)), OnnxNetwork()
    found = [first, again]
    for name, readers in (("cold", ()), ("cold again", (learnt,))):
        run = predict_source(cold, network, tmp_path / name, lambda n: None, PredictOptions(refiners=readers))
        found.append(run.labels)
    warm, warm_again, bare, bare_again = (compare_sets(labels, truth).scores for labels in found)
    assert warm_again["person_iou"] > warm["person_iou"] and bare_again["person_iou"] > bare["person_iou"]
    recall = [scores["mean_recall"] for scores in (warm_again, bare_again, warm, bare)]
    assert sum(recall[:2]) > sum(recall[2:])


def test_nobody_stays_nobody_and_no_colour_is_seen(first, learnt):
    frame = next(iter(first))
    nobody = replace(frame, parts=np.zeros_like(frame.parts))
    assert refine(first.intrinsics, nobody, learnt) is nobody
    _, view = depth_view(frame, first.intrinsics)
    dark = [CHANNELS.index(name) for name in ("shade", "red", "green", "room", *LIKELIHOODS)]
    assert not view.planes[dark].any() and len(view.colors) == 0
