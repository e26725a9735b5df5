"""Foreign files: pipes, devices, impossible numbers, folders; each is refused at once, by its name."""

import json
import os
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from conftest import assert_refused, tree

from cli.console import block, finish, table


@pytest.mark.parametrize("verb", ["info", "validate", "repair", "label --out {out}", "predict --out {out}"])
@pytest.mark.parametrize("kind", ["pipe", "device"])
def test_pipes_and_devices_are_refused_at_once(annotate_cloud, tmp_path, verb, kind):
    path = tmp_path / "x.mcap"
    if kind == "pipe":
        os.mkfifo(path)
    else:
        path.symlink_to("/dev/zero")
    name, *words = verb.format(out=tmp_path / "out").split()
    assert_refused(annotate_cloud(name, path, *words), f"{path} is a pipe or a device")


@pytest.mark.parametrize(
    "command",
    [
        "models colour --from x.whl",
        "models colour --from pose_detection.tflite",
        "label {session} --by x.onnx --out out",
        "compare x.npz x.npz",
        "report x.npz --out out",
        "solve x.npz --out out",
        "train {labels} --out out --init x.safetensors",
    ],
)
@pytest.mark.parametrize("kind", ["pipe", "device"])
def test_pipes_and_devices_in_place_of_files_are_refused(
    annotate_cloud, rig_session, rig_labels, tmp_path, monkeypatch, command, kind
):
    monkeypatch.chdir(tmp_path)
    words = command.format(session=rig_session, labels=rig_labels.path).split()
    name = next(word for word in words if word.startswith(("x.", "pose_")))
    if kind == "pipe":
        os.mkfifo(name)
    else:
        Path(name).symlink_to("/dev/zero")
    assert_refused(annotate_cloud(*words), f"{name} is not a file")
    assert [path.name for path in tmp_path.iterdir()] == [name]


@pytest.mark.parametrize("command", ["learn {labels}", "convert {labels} --scheme six", "label {session}"])
def test_a_link_in_a_circle_is_refused(annotate_cloud, rig_session, rig_labels, tmp_path, command):
    (loop := tmp_path / "loop").symlink_to(tmp_path / "loop")
    words = command.format(labels=rig_labels.path, session=rig_session).split()
    refused = annotate_cloud(*words, "--out", loop)
    assert_refused(refused, loop, "check the path", remarks=len(refused.err.splitlines()) - 1)
    assert loop.is_symlink() and len(list(tmp_path.iterdir())) == 1


@pytest.mark.parametrize("target", ["out.mcap", "nowhere/out.mcap"])
def test_a_link_to_nothing_is_not_replaced_unasked(annotate_cloud, rig_session, tmp_path, target):
    out = tmp_path / "out.mcap"
    out.symlink_to(tmp_path / target)
    refused = annotate_cloud("strip", rig_session, out, "--colour")
    assert_refused(refused, f"{out} already exists; choose another name")
    assert out.is_symlink() and len(list(tmp_path.iterdir())) == 1
    assert annotate_cloud("strip", rig_session, out, "--colour", "--overwrite").code == 0
    assert out.is_file() and not out.is_symlink()


@pytest.mark.parametrize(
    ("name", "value"), [("fx", "NaN"), ("fx", "1e999"), ("width", "-5"), ("cy", "-Infinity")]
)
def test_impossible_numbers_are_refused_with_their_file(annotate_cloud, tmp_path, name, value):
    (tmp_path / "depth").mkdir()
    cv2.imwrite(str(tmp_path / "depth" / "0.png"), np.full((424, 512), 2000, np.uint16))
    numbers = {"width": 512, "height": 424, "fx": 365.0, "fy": 365.0, "cx": 254.0, "cy": 211.0, name: "?"}
    file = tmp_path / "intrinsics.json"
    file.write_text(json.dumps(numbers).replace('"?"', value))
    assert_refused(annotate_cloud("import", tmp_path, tmp_path / "x.mcap"), file)


@pytest.mark.parametrize(
    "command", ["export {labels} {inside} --format coco", "convert {labels} --scheme six --out {inside}"]
)
def test_nothing_is_written_into_the_labels_that_are_read(annotate_cloud, rig_labels, command):
    """``learn`` refuses such a folder too."""
    before = tree(rig_labels.path)
    inside = rig_labels.path / "frames" / "more"
    done = annotate_cloud(*(word.format(labels=rig_labels.path, inside=inside) for word in command.split()))
    assert_refused(done, f"{inside} is inside the input")
    assert tree(rig_labels.path) == before


OWN = {
    "label set": "a label set",
    "dataset": "a dataset",
    "w.onnx": "a network",
    "model": "the folder of a network",
    "w.safetensors": "the weights of a network",
    "six.toml": "a scheme",
    "suit.toml": "the palette of a suit",
    "rig": "the folder of a rig",
    "rig.toml": "a rig file",
    "results.npz": "the results of 'evaluate'",
    "report.html": "a page",
    "rep": "the folder of a report",
    "s.mcap": "a recording",
}
"""Files and folders of this program, and their names in a refusal."""
TAKERS = {
    "label {} --out out": ("not a recording", {"s.mcap"}),
    "try {} --out out": ("not a recording", {"s.mcap"}),
    "import {} out.mcap": ("not a recording", {"s.mcap"}),
    "validate {}": ("not a recording", {"s.mcap", "label set", "dataset"}),
    "info {}": ("not a recording", {"s.mcap", "label set", "dataset"}),
    "strip {} out.mcap --colour": ("give a session", {"s.mcap"}),
    "repair {}": ("give a", {"s.mcap"}),
    "live {} --no-window": ("not a recording", {"s.mcap"}),
    "fix {}": ("not a label set", {"label set"}),
    "learn {} --out out": ("not a label set", {"label set"}),
    "adapt {} --out out": ("not a label set", {"label set"}),
    "convert {} --scheme six --out out": ("not a label set", {"label set", "dataset"}),
    "export {} out --format coco": ("not a label set", {"label set"}),
    "evaluate {} labels": ("not a label set", {"label set", "dataset"}),
}
"""Verbs, the end of their refusal, and the kinds that they take."""


@pytest.fixture(scope="module")
def own_files(rig_session, rig_labels, tmp_path_factory) -> Path:
    """Return a folder with one of each kind of ``OWN``; contents that no verb reads are missing."""
    folder = tmp_path_factory.mktemp("own")
    shutil.copy(rig_session, folder / "s.mcap")
    shutil.copytree(rig_labels.path, folder / "label set")
    for name in ("dataset/dataset.json", "model/weights.onnx", "rep/report.html", "w.onnx", "w.safetensors"):
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text("{}")
    (folder / "report.html").write_text("<!doctype html>")
    (folder / "six.toml").write_text("name = 'six'\n[[parts]]\nname = 'head'\n")
    (folder / "suit.toml").write_text("name = 'mine'\n[colors]\nhead = ['#ffffff']\n")
    (folder / "rig.toml").write_text("name = 'mine'\ndevices = ['kinect2:']\n")
    shutil.copytree(folder, folder / "rig", ignore=lambda _, names: set(names) - {"rig.toml"})
    np.savez(folder / "results.npz", counts=np.zeros(3), texts=np.zeros(3))
    return folder


@pytest.mark.parametrize("command", TAKERS)
def test_a_file_of_this_program_in_place_of_another_is_named(annotate_cloud, own_files, monkeypatch, command):
    monkeypatch.chdir(own_files)
    before = tree(own_files)
    end, taken = TAKERS[command]
    for name in sorted(OWN.keys() - taken):
        done = annotate_cloud(*(name if word == "{}" else word for word in command.split()))
        assert_refused(done, name, OWN[name], end)
    assert tree(own_files) == before


def test_a_deeply_nested_toml_file_is_of_an_unknown_kind(annotate_cloud, tmp_path):
    (tmp_path / "deep.toml").write_text("a=" + "[" * 5000)
    assert_refused(annotate_cloud("info", tmp_path / "deep.toml"), "is of an unknown kind")


def test_axes_of_a_recording_without_points_are_refused(annotate_cloud, rig_session, tmp_path):
    refused = annotate_cloud("import", rig_session, tmp_path / "x.mcap", "--axes", "up")
    assert_refused(refused, "is not a cloud of points; leave the axes out (--axes)")


def test_a_folder_in_place_of_a_file_is_named(annotate_cloud, rig_session, rig_labels, tmp_path):
    strip = annotate_cloud("strip", rig_labels.path, tmp_path / "x.mcap", "--colour")
    assert_refused(strip, "is a label set; give a session's file")
    strip = annotate_cloud("strip", tmp_path, tmp_path / "x.mcap", "--colour")
    assert_refused(strip, "is a folder; give a session's file")
    (tmp_path / "out.mcap").mkdir()
    assert_refused(annotate_cloud("simulate", tmp_path / "out.mcap"), "is a folder; give the name of a file")


@pytest.mark.parametrize("name", ["two\nlines", "up\x1b[2A"])
def test_a_name_breaks_no_line(annotate_cloud, rig_session, rig_labels, tmp_path, name):
    folder = tmp_path / name
    folder.mkdir()
    session, labels = folder / f"{name}.mcap", folder / name
    shutil.copy(rig_session, session)
    shutil.copytree(rig_labels.path, labels)
    commands = [
        ("strip", session, folder / f"{name} stripped.mcap", "--colour"),
        ("validate", session),
        ("convert", labels, "--scheme", "six", "--out", folder / "six"),
        ("validate", labels),
        ("validate", folder / "none"),
    ]
    for command in commands:
        done = annotate_cloud(*command)
        shown = done.out or done.err
        assert shown.endswith("\n") and shown[:-1].isprintable(), done
    (folder / "broken.mcap").write_bytes(b"")
    problems = annotate_cloud("validate", folder).out.splitlines()
    assert len(problems) == 1 and problems[0].startswith("broken.mcap: "), problems


def test_each_text_of_a_result_is_one_line(capsys):
    drawn = table(("file",), [("a\nb",), ("c",)])
    finish({}, False, "d\ne", drawn, block(drawn, "f\rg"), "", "h")
    rows = drawn.splitlines()
    assert capsys.readouterr().out.splitlines() == ["d e", *rows, *rows, "", "f g", "", "h"]


IN_PLACE_OF_FILES = """
intrinsics.json info AT
intrinsics.json info AT/depth.npy
calibration.json predict AT --out AT/out
labelset.json info AT
labelset.json diff AT AT
dataset.json validate AT
dataset.json diff AT AT
joints.jsonl benchmark joints AT --out AT/out
pose_detection.tflite models colour --from AT
annotate-cloud.json import AT AT/out
intrinsics.json import AT AT/out
"""
"""Names of expected files, and commands that read them."""


@pytest.mark.parametrize("line", IN_PLACE_OF_FILES.strip().splitlines())
def test_a_folder_with_the_name_of_an_expected_file_is_named(annotate_cloud, rig_labels, tmp_path, line):
    name, *words = line.split()
    if words[0] == "import":
        assert annotate_cloud("export", rig_labels.path, tmp_path, "--format", "pairs").code == 0
        for file in ("annotate-cloud.json", "intrinsics.json"):
            (tmp_path / file).unlink(missing_ok=True)
    else:
        (tmp_path / "depth").mkdir()
        cv2.imwrite(str(tmp_path / "depth" / "0.png"), np.full((424, 512), 2000, np.uint16))
        np.save(tmp_path / "depth.npy", np.full((1, 424, 512), 2000, np.uint16))
    if name != "intrinsics.json":
        numbers = {"width": 512, "height": 424, "fx": 365.0, "fy": 365.0, "cx": 254.0, "cy": 211.0}
        (tmp_path / "intrinsics.json").write_text(json.dumps(numbers))
    (tmp_path / name).mkdir()
    before = tree(tmp_path)
    done = annotate_cloud(*(word.replace("AT", str(tmp_path)) for word in words))
    assert_refused(done, f"{tmp_path / name} is a folder", remarks=done.err.count("import: "))
    assert tree(tmp_path) == before
