"""The verb try: an RGB-D recording labelled by colour and by depth, compared, and continued."""

import json
import shlex
import shutil

import numpy as np
import pytest
from conftest import assert_refused, tree

import annotate.witness.blazepose
from annotate.labelset.label_set import LabelSet
from annotate.witness.model_files import SHA256, models_folder
from sensors.session.reader import Session
from tests.helpers.page_material import write_image_folder
from tests.helpers.pose_network import pose_onnx
from tools.fit.witness_errors import WitnessErrors
from tools.measure.by_colour import simulated

SETS = ("by-depth", "by-colour")


@pytest.fixture
def witness(rig_session, monkeypatch):
    """A simulated colour network in place of MediaPipe's."""
    network = simulated(rig_session, WitnessErrors(0, 0, 0, 0, 0), 1, 0)
    monkeypatch.setattr(annotate.witness.blazepose, "BlazePose", lambda: network)


def test_a_session_is_tried_in_place_and_continued(annotate_cloud, rig_session, witness, tmp_path):
    out = tmp_path / "tried of 'me'"
    done = annotate_cloud("try", rig_session, "--out", out, "--json")
    assert done.code == 0, done.err
    assert done.result["frames"] == 3
    (pair,) = done.result["pairs"]
    assert (pair["a"], pair["b"], pair["frames"]) == (*SETS, 3)
    assert pair["mean_recall"] > 0.8
    assert sorted(path.name for path in out.iterdir()) == ["by-colour", "by-depth", "report.html", "try.json"]
    window, adapt = (shlex.split(command) for command in done.result["commands"].values())
    assert adapt[:3] == ["annotate-cloud", "adapt", str(out / "by-colour")]
    assert window[:3] == ["annotate-cloud", "fix", str(out / "by-colour")]
    assert window[-1] == str(rig_session)
    kept = tree(out)
    for path in (out / "by-depth" / "frames").glob("000002*"):
        path.unlink()
    again = annotate_cloud("try", rig_session, "--out", out)
    assert again.code == 0
    assert "report.html is of an earlier run and stays" in again.err
    assert "by-depth against by-colour" in again.out
    assert tree(out) == kept
    other = shutil.copy(rig_session, tmp_path / "other.mcap")
    assert_refused(annotate_cloud("try", other, "--out", out), "is of another recording")
    assert tree(out) == kept


def test_wrong_recordings_are_refused_before_anything_is_written(
    annotate_cloud, rig_session, tmp_path, monkeypatch
):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    out, folder = tmp_path / "out", tmp_path / "folder"
    refused = annotate_cloud("try", rig_session, "--out", out)
    assert_refused(refused, "run annotate-cloud models colour")
    write_image_folder(folder, Session(rig_session))
    shutil.rmtree(folder / "color")
    assert_refused(annotate_cloud("try", folder, "--out", out), "register colour to depth")
    assert annotate_cloud("strip", rig_session, tmp_path / "grey.mcap", "--colour").code == 0
    grey = annotate_cloud("try", tmp_path / "grey.mcap", "--out", out)
    assert_refused(grey, "the recording has no colour images; give one with colour")
    (tmp_path / "pose.onnx").write_bytes(pose_onnx("heat maps"))
    for more in ((), ("--suit", rig_session.with_suffix(".suit.toml"))):
        options = ("--by", tmp_path / "pose.onnx", "--out", out, *more)
        grey = annotate_cloud("label", tmp_path / "grey.mcap", *options)
        assert_refused(grey, "the recording has no colour images; give one with colour", remarks=1)
    (tmp_path / "many").mkdir()
    shutil.copy(rig_session, tmp_path / "many")
    several = annotate_cloud("try", tmp_path / "many", "--out", out)
    assert_refused(several, "is a folder of 1 sessions", tmp_path / "many" / rig_session.name)
    assert not out.exists()


def test_a_folder_of_another_origin_stays(annotate_cloud, rig_session, witness, tmp_path):
    (tmp_path / "mine").touch()
    assert_refused(annotate_cloud("try", rig_session, "--out", tmp_path), "already exists")
    assert [path.name for path in tmp_path.iterdir()] == ["mine"]


def test_a_recording_that_cannot_be_imported_leaves_nothing(annotate_cloud, rig_session, witness, tmp_path):
    """The same command with another recording then starts in the same place."""
    folder, out = tmp_path / "folder", tmp_path / "out"
    write_image_folder(folder, Session(rig_session))
    damaged = folder / "depth" / "000001.png"
    damaged.write_bytes(damaged.read_bytes()[:50])
    assert_refused(annotate_cloud("try", folder, "--out", out), damaged)
    assert not out.exists()


def test_refusals_name_no_option_that_try_lacks(annotate_cloud, rig_session, witness, tmp_path):
    (tmp_path / "try.json").write_text(json.dumps({"recording": str(rig_session.resolve())}))
    (tmp_path / "by-colour").touch()
    refused = annotate_cloud("try", rig_session, "--out", tmp_path)
    assert_refused(refused, "by-colour already exists; choose another folder")
    assert "--overwrite" not in refused.err


@pytest.mark.parametrize(("name", "recall"), [("sofa", 0.5), ("upper_body", 0.5)])
def test_real_recordings_are_tried(annotate_cloud, shared_data, tmp_path, name, recall):
    if not all((models_folder() / model).is_file() for model in SHA256):
        pytest.skip("no colour models: annotate-cloud models colour")
    whole, some, out = shared_data / "rgbd" / name, tmp_path / name, tmp_path / "out"
    for kind in ("depth", "color"):
        (some / kind).mkdir(parents=True)
        for path in sorted((whole / kind).iterdir())[:2]:
            shutil.copy(path, some / kind)
    shutil.copy(whole / "intrinsics.json", some)
    done = annotate_cloud("try", some, "--out", out, "--json")
    assert done.code == 0, done.err
    assert "colour assumed to be aligned" in done.err
    assert done.result["pairs"][0]["mean_recall"] > recall
    page = (out / "report.html").read_text()
    assert page.count('alt="Camera"') == 2
    people = json.loads((whole / "people.json").read_text())
    judge = np.array(next(iter(people.values()))[0])
    labels = LabelSet.open(out / "by-colour")
    camera, (first, *_) = labels.intrinsics, labels.frame_ids
    x, y, z = labels.notes(first)["bearing"]["witness"]["joints_mm"]["left_shoulder"]
    found = np.array([x / z * camera.fx + camera.cx, y / z * camera.fy + camera.cy])
    assert np.abs(found - judge[11, :2]).max() < 10
