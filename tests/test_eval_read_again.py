"""Refined labels are the same on every way to them, and no worse than the network's."""

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
from sensors.rig.frame import FrameSource, RigFrame
from sensors.session.reader import Session
from synth.rig.simulate import truth_path


class Cold(FrameSource):
    """Frame source that drops the temperatures of a recording."""

    def __init__(self, source: FrameSource) -> None:
        self._source, self.calibration, self.name = source, source.calibration, source.name
        self.times_ns, self.subject = source.times_ns, source.subject

    def _frame(self, index: int) -> RigFrame:
        return replace(self._source.frame(index), thermal_c=None)


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
def network() -> SuitNetwork:
    return SuitNetwork(SHIPPED_REFINEMENT_NETWORK)


def predict(source, out, **options) -> LabelSet:
    return predict_source(source, OnnxNetwork(), out, lambda n: None, PredictOptions(**options)).labels


@pytest.fixture(scope="module")
def first(tmp_path_factory, rig_session) -> LabelSet:
    """A recording by the network alone."""
    return predict(Session(rig_session), tmp_path_factory.mktemp("first") / "p")


@pytest.fixture(scope="module")
def refined(tmp_path_factory, rig_session, network) -> LabelSet:
    return predict(Session(rig_session), tmp_path_factory.mktemp("refined") / "p", refiners=[network])


def test_recordings_and_label_sets_are_refined_as_their_frames_are(tmp_path, first, refined, network):
    for one, two in zip(first, refined, strict=True):
        own = refine(camera_in(first, one), one, network)
        np.testing.assert_array_equal(two.parts, own.parts)
        assert two.notes["bearing"] == one.notes["bearing"] == own.notes["bearing"]
        assert two.notes["confidence"] == own.notes["confidence"]
        assert (two.confidence != one.confidence).any()
    assert refined.info["steps"]["predict"]["readers"] == [network.sha256]
    alone, options = predict_frames(first, OnnxNetwork(), tmp_path / "one", lambda n: None).labels, [network]
    found = predict_frames(
        first, OnnxNetwork(), tmp_path / "two", lambda n: None, PredictOptions(refiners=options)
    ).labels
    for one, two in zip(alone, found, strict=True):
        np.testing.assert_array_equal(two.parts, refine(camera_in(alone, one), one, network).parts)


def test_the_room_refiner_needs_a_room(tmp_path, rig_session, first, refined, network):
    session = Session(rig_session)
    cut_out = CutOut(session, [person_of(frame.parts) for frame in first])
    alone = predict(cut_out, tmp_path / "alone")
    for name, source, expected in (("room", session, refined), ("cut out", cut_out, alone)):
        found = predict(source, tmp_path / name, room_refiner=network)
        for one, two in zip(found, expected, strict=True):
            np.testing.assert_array_equal(one.parts, two.parts)


def test_refined_labels_are_no_worse(tmp_path, rig_session, first, refined, network):
    """With temperatures and without: a better outline in both, and better parts over both."""
    truth, cold = LabelSet.open(truth_path(rig_session)), Cold(Session(rig_session))
    found = [first, refined, predict(cold, tmp_path / "c"), predict(cold, tmp_path / "r", refiners=[network])]
    warm, warm_refined, bare, bare_refined = (compare_sets(labels, truth).scores for labels in found)
    assert warm_refined["person_iou"] > warm["person_iou"] and bare_refined["person_iou"] > bare["person_iou"]
    recall = [scores["mean_recall"] for scores in (warm_refined, bare_refined, warm, bare)]
    assert sum(recall[:2]) > sum(recall[2:])


def test_an_empty_frame_stays_and_colour_is_unused(first, network):
    frame = next(iter(first))
    empty = replace(frame, parts=np.zeros_like(frame.parts))
    assert refine(first.intrinsics, empty, network) is empty
    _, view = depth_view(frame, first.intrinsics)
    dark = [CHANNELS.index(name) for name in ("shade", "red", "green", "room", *LIKELIHOODS)]
    assert not view.planes[dark].any() and len(view.colors) == 0
