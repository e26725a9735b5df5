"""Malformed notes of frames, results and markers: one line or unknown values, never a traceback."""

import json
import subprocess
import sys

import numpy as np
import pytest
from conftest import assert_refused

from annotate.correction.correction import Correction
from annotate.correction.review_queue import confidence_of, has_unsure_island
from annotate.exchange.keypoints import keypoints_of
from annotate.label_recording import Run
from annotate.labelset.label_set import LabelSet
from cli.verbs.labels.labelling import LabelChoices
from sensors.errors import ExistsError, FormatError
from synth.images.distributions import figures_of_labels
from tests.helpers.witnessed_sets import CAMERA, COLOUR, frame, written

JOINTS = [
    *([["a"] * 3] * 20, [[1, 2], [3]], {"head": 1}, [[10**400] * 3] * 20, [[1e308] * 3] * 20, None, 5),
    *([[None] * 3] * 20, [[0.0, 0.0, 0.0]] * 20),
]


@pytest.mark.parametrize("image", ["depth", "parts", "confidence", "persons"])
def test_a_cut_off_image_is_refused_in_one_line_by_the_script(tmp_path, image):
    """OpenCV writes warnings to stderr beside Python, so another process runs the command."""
    labels = LabelSet.open(written(tmp_path / "labels", COLOUR, 1))
    file = labels.path / "frames" / f"000000.{image}.png"
    file.write_bytes(file.read_bytes()[:40])
    words = ("export", str(labels.path), str(tmp_path / "out"), "--format", "coco")
    done = subprocess.run(
        [sys.executable, "-m", "cli.main", *words], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.startswith("annotate-cloud: ") and done.stderr.count("\n") == 1


@pytest.mark.parametrize(("field", "remedy"), [("subject", "a text"), ("notes", "an object")])
def test_a_field_of_the_wrong_type_is_named(tmp_path, field, remedy):
    labels = LabelSet.open(written(tmp_path / "labels", COLOUR, 1))
    file = labels.path / "frames" / "000000.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | {field: 5}))
    with pytest.raises(FormatError, match=f"frame 000000: {field} is 5; give {remedy}"):
        labels.read("000000")


def test_joints_that_no_number_holds_are_refused_by_exports_and_statistics():
    known = frame(0)
    known.notes["bearing"]["joints_px"] = known.notes["joints_mm"] = [[10**400] * 3] * 15
    with pytest.raises(FormatError, match="joints_px is malformed"):
        keypoints_of(known)
    with pytest.raises(FormatError, match="joints_mm is malformed"):
        figures_of_labels(known)


NOTES = [5, "x", None, [[]], [{}], {"a": 1}]


def noted(path, **notes):
    """Write three frames' labels, and replace notes of each."""
    labels = LabelSet.open(written(path, COLOUR))
    for file in (labels.path / "frames").glob("*.json"):
        fields = json.loads(file.read_text())
        fields["notes"] |= notes
        file.write_text(json.dumps(fields))
    return labels


@pytest.mark.parametrize("joints", JOINTS)
def test_malformed_true_joints_are_unknown_to_a_training_and_refused_by_scores(tmp_path, joints):
    pytest.importorskip("torch")
    from eval.fine_tuning.adaptation.labelled_people import targets_of
    from eval.scores.joint_errors import all_joints_mm
    from eval.training.body_targets import body_targets

    known = frame(0)
    known.notes["joints_mm"] = joints
    labels = LabelSet.open(written(tmp_path / "labels", COLOUR, 1))
    with np.errstate(all="raise"):
        for row in (
            body_targets(labels, known),
            targets_of(labels, known, 1, (CAMERA, known.on_body)),
        ):
            assert not np.isinf(row).any()
    if joints != JOINTS[-1]:
        with pytest.raises(FormatError, match="joints_mm is malformed"):
            all_joints_mm(known)


@pytest.mark.parametrize("notes", NOTES)
def test_malformed_remarks_of_a_frame_count_as_none(tmp_path, notes):
    labels = noted(tmp_path / "labels", notes=notes, confidence=notes)
    run = Run(labels, ())
    assert run.remarks() == {}
    assert run.review_order() == labels.frame_ids
    with Correction.open(labels.path, read_only=True) as correction:
        assert not has_unsure_island(correction, "000000")
        confidence_of(correction, "000000")


@pytest.mark.parametrize("number", [10**400, float("nan"), -5, True])
def test_a_confidence_that_is_no_share_is_unknown(tmp_path, number):
    labels = noted(tmp_path / "labels", confidence=number)
    with Correction.open(labels.path, read_only=True) as correction:
        assert confidence_of(correction, "000000") is None


MARKERS = [b"\xff", b"[" * 100_000, b'{"rec', b"", b"[]"]


@pytest.mark.parametrize("marker", MARKERS)
def test_a_damaged_marker_of_try_is_refused(annotate_cloud, rig_session, monkeypatch, tmp_path, marker):
    monkeypatch.setattr(LabelChoices, "work", lambda choices: None)
    (tmp_path / "try.json").write_bytes(marker)
    refused = annotate_cloud("try", rig_session, "--out", tmp_path)
    assert_refused(refused, tmp_path / "try.json", "restore it from a copy")
    assert (tmp_path / "try.json").read_bytes() == marker


GAIN = {"before": 0.5, "after": 0.6, "low": 0.0, "high": 0.1, "sure": 0.9, "share": 1.0}
RESULT = {
    **{"weights": None, "frames": 3, "spans": 3, "held_out": "spans", "parts": GAIN, "joints": None},
    **{"synthetic": [[0.8, 0.7], [0.8, 0.7]], "share": 1.0, "predicted": None, "refined": True},
}


def test_the_result_of_an_adaptation_is_read(tmp_path):
    pytest.importorskip("torch")
    from eval.fine_tuning.adaptation.adapt import RECORD, WEIGHTS, Adapted

    (tmp_path / RECORD).write_text(json.dumps(RESULT | {"joints": GAIN}))
    assert Adapted.read(tmp_path).gain.joints.high == 0.1
    (tmp_path / RECORD).write_text(json.dumps(RESULT | {"weights": WEIGHTS}))
    with pytest.raises(FormatError, match=r"weights.onnx is missing; remove .*adapted.json to compare again"):
        Adapted.read(tmp_path)
    (tmp_path / WEIGHTS).touch()
    assert Adapted.read(tmp_path).weights == tmp_path / WEIGHTS


@pytest.mark.parametrize(
    "change",
    [
        *({"parts": None}, {"parts": GAIN | {"sure": float("nan")}}, {"parts": GAIN | {"before": "a"}}),
        *({"synthetic": [[1, 2, 3], [1, 2, 3]]}, {"synthetic": 5}, {"frames": 1e400}, {"share": []}),
        *({"weights": 5}, {"weights": "../weights.onnx"}, {"weights": ["weights.onnx"]}),
        *({"refined": "no"}, {"refined": None}, {"predicted": 5}),
    ],
)
def test_a_damaged_result_of_an_adaptation_is_refused(tmp_path, change):
    pytest.importorskip("torch")
    from eval.fine_tuning.adaptation.adapt import RECORD, Adapted

    for text in (json.dumps(RESULT | change).encode(), *MARKERS):
        (tmp_path / RECORD).write_bytes(text)
        with pytest.raises(FormatError, match=r"adapted.json holds no result; remove the file"):
            Adapted.read(tmp_path)


def test_a_damaged_order_of_an_adaptation_is_refused(tmp_path):
    pytest.importorskip("torch")
    from eval.fine_tuning.adaptation.adapt import ORDER, finished

    (tmp_path / ORDER).write_bytes(b"\xff")
    with pytest.raises(ExistsError, match="holds another adaptation"):
        finished(tmp_path, "{}")
