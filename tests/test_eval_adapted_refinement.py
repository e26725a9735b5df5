"""Refinement of an adapted network: measured by the adaptation, stated in the file, obeyed by predict."""

import json
import shutil
from dataclasses import asdict

import numpy as np
import pytest

pytest.importorskip("torch")
import onnx

from annotate.array_types import Float64
from annotate.labelset.label_set import LabelSet
from annotate.onnx_session import SCHEME
from annotate.parts import PAPER, UNDEFINED
from annotate.scheme.scheme_file import load_scheme
from eval.fine_tuning.adaptation.adaptation_gain import SHARES, AdaptationGain, adaptation_gain
from eval.fine_tuning.adaptation.adaptation_split import AdaptationSplit
from eval.fine_tuning.adaptation.labelled_people import image_of, people_in, taught_frames
from eval.fine_tuning.adaptation.predicted_parts import predicted_parts
from eval.fine_tuning.adaptation.scores_on_crops import CropScores
from eval.network.onnx_export import leave_unrefined, name_scheme
from eval.network.onnx_network import SHIPPED_WEIGHTS, OnnxNetwork
from eval.network.refine import shipped_refinement_network
from eval.prediction.predictor import Predictor
from eval.scores.confusion import confusion_matrix, recall
from eval.training.body_targets import no_targets
from eval.training.crops import Crops
from sensors.session.reader import Session
from synth.rig.simulate import truth_path
from tests.helpers.witnessed_sets import COLOUR, written

SPANS = 3


def scores(*right: float) -> CropScores:
    """Scores of one crop a span: that share of the torso's thousand pixels is right; all joints are near."""
    confusion = np.zeros((len(right), 12, 12), np.int64)
    confusion[:, 2, 2] = np.round(1000 * np.array(right))
    confusion[:, 2, 3] = 1000 - confusion[:, 2, 2]
    return CropScores(confusion, np.full((len(right), 2), 1000))


def gain_of(unrefined: list[Float64], refined: list[Float64], alone: float = 0.1) -> AdaptationGain:
    """Gain where the network alone gains ``alone``, and ``predict`` has these recalls: of the start, then of
    each share.
    """
    index = np.arange(SPANS)
    crops = Crops.of([(np.zeros((2, 2), np.uint16), np.zeros((2, 2), np.uint8), no_targets())])
    split = AdaptationSplit(crops, index, index, index, index, index, "spans")
    before, kept = np.array([0.6, 0.7, 0.8]), scores(0.9)
    found = [(scores(*before), kept), *[(scores(*before + alone), kept)] * len(SHARES)]
    return adaptation_gain(found, split, np.array([unrefined, refined]))


def shares(first: Float64, then: Float64) -> list[Float64]:
    return [first, *[then] * len(SHARES)]


SPREAD = np.array([-0.001, 0, 0.001])


def test_predict_refines_an_adapted_network_only_where_that_is_better():
    start = np.array([0.8, 0.8, 0.8])
    better, best = start + 0.05 + SPREAD, start + 0.09 + SPREAD
    for refined, (without, after) in {False: (best, better), True: (better, best)}.items():
        found = gain_of(shares(start - 0.05, without), shares(start, after))
        assert found.refined is refined and found.is_certain
        assert found.predicted.before == pytest.approx(0.8), "predict refines the first network"
        assert found.predicted.after == pytest.approx(0.89)
        assert ("no longer refined" in found.text) is not refined
        assert AdaptationGain.of_fields(json.loads(json.dumps(asdict(found)))) == found


def test_a_network_that_is_better_alone_and_worse_by_predict_is_refused():
    start = np.array([0.8, 0.8, 0.8])
    worse = start - 0.05 + SPREAD
    found = gain_of(shares(start - 0.1, worse), shares(start, worse), alone=0.3)
    assert found.parts.is_certain and not found.is_harmless and not found.is_certain


def test_a_network_whose_labels_cannot_be_refined_is_judged_alone():
    nothing = np.full(SPANS, np.nan)
    found = gain_of(shares(nothing, nothing), shares(nothing, nothing))
    assert found.is_certain and found.predicted is None and "predict" not in found.text


@pytest.fixture(scope="module")
def unrefined(tmp_path_factory):
    """The shipped network in a file that states that refinement makes its labels worse."""
    path = tmp_path_factory.mktemp("weights") / "w.onnx"
    shutil.copy(SHIPPED_WEIGHTS, path)
    leave_unrefined(path)
    return path


def test_a_file_keeps_its_scheme_beside_the_statement(tmp_path, unrefined):
    assert OnnxNetwork(unrefined).unrefined and not OnnxNetwork().unrefined
    assert OnnxNetwork(unrefined).own == OnnxNetwork().own
    path = tmp_path / "w.onnx"
    shutil.copy(unrefined, path)
    name_scheme(path, load_scheme("hands-and-feet"))
    entries = {entry.key: entry.value for entry in onnx.load(path).metadata_props}
    assert len(entries) == 2 and json.loads(entries[SCHEME])["name"] == "hands-and-feet"


def test_predict_obeys_the_file_and_an_option_overrides_it(tmp_path, rig_session, unrefined, annotate_cloud):
    def parts(name: str, *options: object) -> list[object]:
        done = annotate_cloud("predict", rig_session, "--out", tmp_path / name, *options)
        assert done.code == 0 and ("better without" in done.err) is (name == "stated")
        return [frame.parts for frame in LabelSet.open(tmp_path / name)]

    stated = parts("stated", "--weights", unrefined)
    refined, alone = parts("refined"), parts("alone", "--no-again")
    overridden = parts("overridden", "--weights", unrefined, "--again")
    np.testing.assert_array_equal(stated, alone)
    np.testing.assert_array_equal(overridden, refined)
    assert (np.array(alone) != np.array(refined)).any()


def test_a_predictor_in_memory_obeys_the_file_too(rig_session, unrefined):
    session = Session(rig_session)
    camera, depth_mm = session.calibration.depth.undistorted(), session.frame(0).depth_mm
    found = Predictor(camera, weights=unrefined).predict(depth_mm)
    refined = Predictor(camera).predict(depth_mm)
    assert (found.labels != refined.labels).any()
    np.testing.assert_array_equal(found.depth_mm, refined.depth_mm)


def test_parts_by_predict_are_those_of_the_network_and_of_the_refinement(rig_session):
    """Refined as ``Networks`` does; what predict deletes or adds outside the outline counts too."""
    taught, network = taught_frames(truth_path(rig_session)), OnnxNetwork()
    (person,) = people_in(taught, 0, next(iter(taught.places)))
    image = image_of(taught, person)
    done: list[int] = []
    matrices = predicted_parts([network, network], [image], PAPER, done.append)
    assert matrices.shape == (2, 2, 1, 12, 12) and done == [2]
    expected = network.in_scheme(PAPER).segment(image.depth_mm, image.mask)
    np.testing.assert_array_equal(matrices[0, 1, 0], confusion_matrix(image.parts, expected.parts, PAPER))
    np.testing.assert_array_equal(matrices[1, 0], matrices[1, 1])
    outside = (image.parts != UNDEFINED) & ~image.mask
    assert (matrices.sum(axis=(2, 3, 4)) == (image.parts != UNDEFINED).sum()).all() and outside.any()
    assert (recall(matrices[1, 0, 0]) != recall(matrices[0, 0, 0])).any()
    assert shipped_refinement_network().own == PAPER


def test_the_image_of_a_person_hides_other_people(tmp_path):
    taught = taught_frames(written(tmp_path / "labels", COLOUR))
    (person,) = people_in(taught, 0, "000000")
    image = image_of(taught, person)
    assert (image.parts[6:40, 50:60] == UNDEFINED).all() and (image.parts[:, :10] == 0).all()
    np.testing.assert_array_equal(image.mask[6:40, 16:32].any(), True)
    assert not image.mask[:, 40:].any() and image.depth_mm[20, 20] == 1500
    assert (image.parts[6:14, 20:28] == 1).any()
    other = image_of(taught, person._replace(number=2))
    assert (other.parts[6:14, 20:28] == UNDEFINED).all()
