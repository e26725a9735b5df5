"""Public module: its surface, results equal to the commands', a fast import, and its page."""

import inspect
import json
import re
import shutil
import subprocess
import sys
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest
from conftest import tree

import annotate_cloud
from annotate.labelset.label_set import LabelSet, as_read
from annotate.scheme.scheme_file import load_scheme
from annotate.suit.palette import suit_to_toml
from eval.network.onnx_network import OnnxNetwork
from sensors.errors import CalibrationError, FormatError
from sensors.session.reader import Session
from synth.appearance.random_suit import random_suit
from synth.rig.simulate import suit_path
from tests.helpers.page_material import write_image_folder

ROOT = Path(__file__).parent.parent
SIGNATURES = {
    "predict": "(depth_mm: 'NDArray[Any]', camera: 'Camera', *, scheme: 'Scheme | str | Path | None' = None, "
    "everybody: bool = False) -> 'Prediction'",
    "predict_source": "(source: 'FrameSource | str | Path', out: str | pathlib.Path, *, "
    "scheme: 'Scheme | str | Path | None' = None, everybody: bool = False, "
    "weights: str | pathlib.Path | None = None) -> 'Run'",
    "label": "(source: 'FrameSource | str | Path', suit: 'Suit | str | Path | None', "
    "out: str | pathlib.Path) -> 'Run'",
    "open_source": "(path: str | pathlib.Path, options: 'ImportOptions | None' = None) -> 'FrameSource'",
}
PARAMETERS = {
    "Camera": "width height fx fy cx cy k1 k2 p1 p2 k3",
    "Dataset": "path scheme",
    "ImportOptions": "intrinsics depth_unit_mm turn_deg mirror subject rate_hz topics axes",
    "Person": "joints_mm posture posture_sure facing_deg facing_sure support joint_sd_mm joint_visibility",
    "Prediction": "labels confidence persons people scheme depth_mm camera notes frame",
    "Predictor": "camera scheme everybody weights",
    "Run": "labels failed",
    "load_scheme": "name_or_path",
}
MEMBERS = {
    "FrameSource": "name calibration times_ns notes path subject events frame",
    "LabelSet": "open create frame_ids read write",
    "Prediction": "joints_mm posture facing_deg",
    "Predictor": "predict",
    "Scheme": "name parts twins neighbours part_id palette_rgb swap_left_right",
    "Suit": "name colors_rgb parts",
}
OTHERS = {"CloudError", "__version__"}

WITHOUT_EXTRAS = """
import json, sys, time
begun = time.process_time()
import annotate_cloud
seconds = time.process_time() - begun
heavy = sorted({"numpy", "torch", "cv2", "numba", "onnxruntime", "typer"} & set(sys.modules))
sys.modules["torch"] = None
listed = "Dataset" in dir(annotate_cloud)
try:
    annotate_cloud.Dataset
except annotate_cloud.CloudError as error:
    said = str(error)
print(json.dumps([seconds, heavy, listed, said, annotate_cloud.load_scheme("six").name]))
"""


def test_the_surface_stays():
    named = {*SIGNATURES, *PARAMETERS, *MEMBERS, *OTHERS}
    assert set(annotate_cloud.__all__) == named
    assert named <= {*dir(annotate_cloud)}
    for name, text in SIGNATURES.items():
        assert str(inspect.signature(getattr(annotate_cloud, name))) == text
    for name, text in PARAMETERS.items():
        assert list(inspect.signature(getattr(annotate_cloud, name)).parameters) == text.split()
    for name, text in MEMBERS.items():
        thing = getattr(annotate_cloud, name)
        known = {*dir(thing), *thing.__annotations__, *inspect.signature(thing).parameters}
        assert set(text.split()) <= known, name
    assert list(inspect.signature(annotate_cloud.Predictor.predict).parameters) == [
        "self",
        "depth_mm",
        "before",
    ]
    assert annotate_cloud.__version__ == version("annotate-cloud")
    with pytest.raises(AttributeError, match="no attribute 'Labels'"):
        _ = annotate_cloud.Labels


def test_the_import_is_light_and_a_missing_extra_is_named():
    done = subprocess.run([sys.executable, "-c", WITHOUT_EXTRAS], capture_output=True, text=True, check=True)
    seconds, heavy, listed, said, name = json.loads(done.stdout)
    assert seconds < 0.2 and not heavy
    assert (said, name) == ("torch is not installed; pip install 'annotate-cloud[train]'", "six")
    assert not listed


@pytest.fixture
def command(request):
    """Return the fixture ``annotate_cloud``, whose name the module has here."""
    return request.getfixturevalue("annotate_cloud")


@pytest.fixture(scope="module")
def depth_folder(tmp_path_factory, rig_session) -> Path:
    """Return a folder of depth images alone."""
    folder = tmp_path_factory.mktemp("python") / "depth-folder"
    write_image_folder(folder, Session(rig_session))
    for name in ("color", "thermal"):
        shutil.rmtree(folder / name)
    return folder


@pytest.mark.parametrize("everybody", [False, True])
def test_predictions_are_the_commands(depth_folder, tmp_path, command, everybody):
    options = ["--everybody", "--scheme", "six"] if everybody else []
    out, joints = tmp_path / "out", tmp_path / "out.jsonl"
    assert command("predict", depth_folder, "--out", out, "--joints", joints, *options).code == 0
    theirs, scheme = LabelSet.open(out), "six" if everybody else None
    rows = [json.loads(line) for line in joints.read_text().splitlines()]
    source = annotate_cloud.open_source(str(depth_folder))
    camera = source.calibration.depth
    predictor = annotate_cloud.Predictor(camera, scheme=scheme, everybody=everybody)
    before, found, people = None, 0, 0
    for image, frame in zip(source, theirs, strict=True):
        before = predictor.predict(image.depth_mm, before)
        assert np.array_equal(before.labels, frame.parts)
        assert np.array_equal(before.persons, frame.persons)
        assert np.array_equal(as_read(before.frame).confidence, frame.confidence)
        assert list(before.notes) == frame.notes["notes"]
        found += before.labels.any()
        for number, person in before.people.items():
            row = rows[people]
            assert (row["frame"], row["person"]) == (frame.frame_id, number)
            assert {name: xyz.tolist() for name, xyz in person.joints_mm.items()} == row["joints_mm"]
            others = asdict(person)
            del others["joints_mm"]
            assert others == {name: row.get(name, {}) for name in others}
            people += 1
    assert found and people == len(rows)
    first = annotate_cloud.predict(source.frame(0).depth_mm, camera, scheme=scheme, everybody=everybody)
    assert first.scheme == theirs.scheme == predictor.scheme
    assert np.array_equal(first.labels, theirs.read("000000").parts)


@pytest.mark.parametrize("scheme", ["paper", "hands-and-feet"])
def test_recordings_are_labelled_as_by_the_commands(rig_session, tmp_path, command, scheme):
    suit = suit_path(rig_session)
    if scheme != "paper":
        suit = tmp_path / "suit.toml"
        suit.write_text(suit_to_toml(random_suit(4, scheme=load_scheme(scheme))))
    for verb, options in (("predict", []), ("label", ["--suit", suit])):
        done = command(verb, rig_session, "--out", tmp_path / verb, *options)
        assert done.code == 0
    runs = {
        "predict": annotate_cloud.predict_source(str(rig_session), tmp_path / "own-predict"),
        "label": annotate_cloud.label(
            annotate_cloud.open_source(rig_session), str(suit), tmp_path / "own-label"
        ),
    }
    for verb, run in runs.items():
        assert not run.failed and len(run.labels) == 3
        assert tree(tmp_path / verb) == tree(tmp_path / f"own-{verb}")
    labels = annotate_cloud.LabelSet.open(str(tmp_path / "own-label"))
    assert labels.frame_ids == run.labels.frame_ids and labels.scheme.name == scheme


def test_units_types_and_schemes_of_images(rig_session):
    source = annotate_cloud.open_source(rig_session)
    camera, depth_mm = source.calibration.depth, source.frame(0).depth_mm
    found = annotate_cloud.predict(depth_mm, camera)
    holes = np.where(depth_mm > 0, depth_mm.astype(np.float32), np.float32(np.nan))
    for same in (holes, depth_mm.astype(">i4"), depth_mm[:, ::-1][:, ::-1]):
        assert np.array_equal(annotate_cloud.predict(same, camera).labels, found.labels)
    assert found.depth_mm.shape == found.labels.shape == camera.shape
    assert found.joints_mm.keys() == found.people[1].joints_mm.keys() and found.posture in "standing sitting"
    six = annotate_cloud.load_scheme("six")
    coarse = annotate_cloud.predict(depth_mm, camera, scheme=six)
    assert coarse.scheme == six and six.n_classes == 1 + coarse.labels.max()
    nothing = annotate_cloud.predict(np.zeros_like(depth_mm), camera)
    assert not nothing.people and not nothing.labels.any() and nothing.notes
    assert (nothing.joints_mm, nothing.posture) == ({}, "") and np.isnan(nothing.facing_deg)
    for wrong, error, said in (
        (depth_mm / 1000, FormatError, "give millimetres, not metres"),
        (depth_mm[:10], CalibrationError, "512x10"),
        (np.zeros((4, 4, 3)), FormatError, "give numbers of shape"),
        (depth_mm > 0, FormatError, "bool"),
    ):
        with pytest.raises(error, match=said):
            annotate_cloud.predict(wrong, camera)
    fine = annotate_cloud.predict(depth_mm, camera, scheme="smpl-24")
    assert np.array_equal(fine.labels > 0, fine.persons == 1) and len(np.unique(fine.labels)) > 12
    assert fine.people[1].joint_sd_mm.keys() == fine.joints_mm.keys()


@pytest.mark.filterwarnings("ignore:You are using the legacy TorchScript-based ONNX export")
@pytest.mark.filterwarnings("ignore:The feature will be removed")
def test_the_blocks_of_the_page_run(tmp_path, rig_session, monkeypatch, capsys):
    text = (ROOT / "docs" / "python.md").read_text()
    table = " ".join(re.findall(r"^\| (`.*?) \|", text, re.M))
    assert set(re.findall(r"`(\w+)`", table)) | {"__version__"} == set(annotate_cloud.__all__)
    assert len(text.replace("|", " ").split()) <= 350
    session = Session(rig_session)
    write_image_folder(tmp_path / "my-folder", session)
    np.save(tmp_path / "depth.npy", session.frame(0).depth_mm)
    monkeypatch.chdir(tmp_path)
    namespace: dict[str, object] = {}
    blocks = re.findall(r"^```python\n(.*?)^```", text, re.M | re.S)
    assert len(blocks) >= 3
    for block in blocks:
        exec(compile(block, "docs/python.md", "exec"), namespace)
    said = capsys.readouterr().out
    assert "person 1: sitting" in said or "person 1: standing" in said
    assert "000002" in said and "not labelled: ()" in said
    six = load_scheme("six")
    assert OnnxNetwork(tmp_path / "mine.onnx", scheme=six).own == six
