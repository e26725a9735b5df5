"""Bad input is refused in one line with exit 1, or named in the results; nothing is left half-written."""

import json
import os
import pickle
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from conftest import assert_refused, record, tree
from mcap.writer import Writer
from mcap_protobuf.schema import register_schema

from annotate.labelset.label_set import MANIFEST, LabelSet
from annotate.parts import BODY_PARTS, UNDEFINED
from annotate.suit.palette import DEFAULT_SUIT, suit_to_toml
from eval.network.onnx_network import SHIPPED_WEIGHTS
from sensors.session.messages import DEPTH, image_message
from sensors.session.reader import Session
from synth.rig.simulate import suit_path, truth_path


@pytest.fixture
def folder(tmp_path) -> Path:
    """Return a folder of two depth images, with intrinsics of another size."""
    path = tmp_path / "mine"
    path.mkdir()
    for i in range(2):
        cv2.imwrite(str(path / f"{i}.png"), np.full((24, 32), 900 + i, np.uint16))
    numbers = {"fx": 300, "fy": 300, "cx": 320, "cy": 240, "width": 640, "height": 480}
    (path / "intrinsics.json").write_text(json.dumps(numbers))
    return path


@pytest.fixture
def labels(tmp_path, rig_labels) -> Path:
    """Return a copy of ``rig_labels`` that may be damaged."""
    return Path(shutil.copytree(rig_labels.path, tmp_path / "labels"))


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "is empty"),
        (bytes(range(256)) * 40, "not an MCAP file"),
        (b"frame,depth\n1,2\n", "not an MCAP file"),
        (b"\x89MCAP0\r\n", "cut off in front of its first depth image"),
    ],
)
@pytest.mark.parametrize("verb", ["info", "validate", "label", "predict", "import"])
def test_a_file_of_another_kind_is_refused(annotate_cloud, tmp_path, verb, content, says):
    path, out = tmp_path / "x.mcap", tmp_path / "out.mcap"
    path.write_bytes(content)
    to = {"label": ("--out", out), "predict": ("--out", out), "import": (out,)}.get(verb, ())
    assert_refused(annotate_cloud(verb, path, *to), path, says)
    assert tree(tmp_path) == {"x.mcap": tree(tmp_path)["x.mcap"]}


def test_a_truncated_session_opens_says_so_and_is_labelled(annotate_cloud, tmp_path, rig_session, rig_labels):
    path = tmp_path / "cut.mcap"
    path.write_bytes(rig_session.read_bytes()[: int(rig_session.stat().st_size * 0.8)])
    info = annotate_cloud("info", path, "--json").result
    assert info["truncated"]
    assert 1 <= info["frames"] < 3
    checked = annotate_cloud("validate", path, "--json")
    assert (checked.code, checked.result["ok"]) == (1, False)
    assert "truncated" in checked.result["problems"][0]
    done = annotate_cloud("label", path, "--suit", suit_path(rig_session), "--out", tmp_path / "l", "--json")
    assert (done.code, done.result["frames"]) == (0, info["frames"])
    assert "truncated" in done.err
    for frame in LabelSet.open(tmp_path / "l"):
        np.testing.assert_array_equal(frame.parts, rig_labels.read(frame.frame_id).parts)


def test_a_session_without_calibration_is_refused(annotate_cloud, tmp_path):
    path = tmp_path / "x.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        message = image_message(np.full((24, 32), 1000, np.uint16), "depth", 0)
        channel = writer.register_channel(DEPTH, "protobuf", register_schema(writer, type(message)))
        writer.add_message(channel, 0, message.SerializeToString(), 0)
        writer.finish()
    for verb, to in (
        ("info", ()),
        ("label", ("--out", tmp_path / "l")),
        ("predict", ("--out", tmp_path / "p")),
    ):
        assert_refused(annotate_cloud(verb, path, *to), "camera_info", "--intrinsics")
    assert set(tree(tmp_path)) == {"x.mcap"}


def test_without_colour_parts_are_undefined_and_without_temperature_depth_finds_the_person(
    annotate_cloud, tmp_path, rig_session, rig_labels
):
    def label(**missing):
        out = tmp_path / "-".join(missing)
        path = out.with_suffix(".mcap")
        record(path, Session(rig_session), lambda f: replace(f, **missing))
        done = annotate_cloud("label", path, "--suit", suit_path(rig_session), "--out", out)
        assert done.code == 0
        return done.err, LabelSet.open(out)

    said, frames = label(color_encoded=None)
    assert "no colour images" in said
    for frame, colored in zip(frames, rig_labels, strict=True):
        assert set(np.unique(frame.parts)) == {0, UNDEFINED}
        both = (frame.parts > 0) & (colored.parts > 0)
        assert both.sum() > 0.8 * ((frame.parts > 0) | (colored.parts > 0)).sum()
        assert any("no colour" in note for note in frame.notes["notes"])
    said, frames = label(thermal_c=None)
    assert "no thermal images" in said
    assert {frame.notes["extraction"] for frame in frames} == {"depth"}


def test_depth_without_any_reading_shows_no_person(annotate_cloud, tmp_path, rig_session):
    path = record(
        tmp_path / "x.mcap", Session(rig_session), lambda f: replace(f, depth_mm=np.zeros_like(f.depth_mm))
    )
    for verb, more in (("label", ("--suit", suit_path(rig_session))), ("predict", ())):
        out = tmp_path / verb
        assert annotate_cloud(verb, path, "--out", out, *more).code == 0
        for frame in LabelSet.open(out):
            assert not frame.parts.any()
            assert any("no person" in note for note in frame.notes["notes"])
    checked = annotate_cloud("validate", path, "--json")
    assert checked.code == 1
    assert len(checked.result["problems"]) == 3
    assert "no depth reading" in checked.result["problems"][0]


def test_colour_of_another_size_than_its_calibration_is_refused(annotate_cloud, tmp_path, rig_session):
    small = bytes(cv2.imencode(".jpg", np.zeros((54, 96, 3), np.uint8))[1])
    path = record(tmp_path / "x.mcap", Session(rig_session), lambda f: replace(f, color_encoded=small))
    checked = annotate_cloud("validate", path, "--json")
    assert (checked.code, len(checked.result["problems"])) == (1, 3)
    out = tmp_path / "l"
    done = annotate_cloud("label", path, "--suit", suit_path(rig_session), "--out", out)
    assert_refused(done, "96x54", "1920x1080", remarks=1)
    assert not out.exists()


def test_intrinsics_of_another_size_are_refused(annotate_cloud, tmp_path, folder):
    before, out, labels = tree(tmp_path), tmp_path / "out.mcap", ("--out", tmp_path / "out")
    to = {"label": labels, "predict": labels, "import": (out,), "validate": ()}
    for verb, more in to.items():
        done = annotate_cloud(verb, folder, *more)
        said = done.out if verb == "validate" else done.err
        assert done.code == 1 and "32x24" in said and "640x480" in said
    after = tree(tmp_path)
    assert {name: after[name] for name in before} == before
    assert not [name for name in after if name.endswith(".partial")] and not out.is_file()


def test_colour_without_calibration_is_left_out_with_a_remark(annotate_cloud, tmp_path, folder):
    numbers = {"fx": 30, "fy": 30, "cx": 16, "cy": 12, "width": 32, "height": 24}
    (folder / "intrinsics.json").write_text(json.dumps(numbers))
    (folder / "color").mkdir()
    for i in range(2):
        cv2.imwrite(str(folder / "color" / f"{i}.jpg"), np.zeros((48, 64, 3), np.uint8))
    done = annotate_cloud("label", folder, "--out", tmp_path / "l")
    assert done.code == 0
    assert "colour images are 64x48, depth is 32x24: not used; register them to depth" in done.err
    assert any("not calibrated" in note for note in LabelSet.open(tmp_path / "l").notes("000000")["notes"])


PALETTE = suit_to_toml(DEFAULT_SUIT)
TORSO = next(line for line in PALETTE.splitlines() if line.startswith("torso"))


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "no [colors]"),
        ("colors = 3", "no [colors]"),
        (PALETTE.replace(TORSO + "\n", ""), "no colour for torso"),
        (PALETTE.replace(TORSO, "torso = []"), "no colour for torso"),
        (PALETTE + TORSO, "cannot be read"),
        (PALETTE.replace("torso", "belly"), "'belly' is not a part"),
        (PALETTE + 'background = "#000000"', "'background' is not a part"),
        (PALETTE.replace(TORSO, 'torso = "yellow"'), "give '#rrggbb'"),
        (PALETTE.replace(TORSO, "torso = 7"), "give '#rrggbb'"),
        (PALETTE.replace(TORSO, f"torso = {['#e6c814'] * 300}"), "colours; give at most"),
        ("x = " + "[" * 20_000, "cannot be read"),
        ("a = [\n", "cannot be read"),
        ("# \x00", "cannot be read"),
        ("x" * 400_000, "larger than"),
        (b"\xff\xfe\x00", "cannot be read"),
        (None, "cannot be read"),
    ],
)
def test_a_wrong_suit_is_refused(annotate_cloud, tmp_path, rig_session, text, says):
    suit, out = tmp_path / "suit.toml", tmp_path / "l"
    if text is not None:
        suit.write_bytes(text if isinstance(text, bytes) else text.encode())
    assert_refused(annotate_cloud("label", rig_session, "--suit", suit, "--out", out), suit.stem, says)
    assert not out.exists()


def test_a_suit_of_two_equal_colours_is_diagnosed(annotate_cloud, tmp_path, rig_session):
    suit, out = tmp_path / "suit.toml", tmp_path / "l"
    suit.write_text(PALETTE.replace(TORSO, 'torso = "#dc1e28"'))
    done = annotate_cloud("label", rig_session, "--suit", suit, "--out", out)
    assert done.code == 0 and len(LabelSet.open(out)) == 3
    assert "torso and left_upper_arm" in done.err and "choose another hue" in done.err


@pytest.mark.parametrize("suffix", ["depth.png", "parts.png", "confidence.png", "json"])
def test_a_corrupt_frame_is_named(annotate_cloud, labels, rig_session, suffix):
    file = labels / "frames" / f"000001.{suffix}"
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    before, truth = tree(labels), truth_path(rig_session)
    for command in (("diff", labels, truth), ("diff", truth, labels), ("evaluate", labels, truth)):
        assert_refused(annotate_cloud(*command), file.name)
    checked = annotate_cloud("validate", labels, "--json")
    assert checked.code == 1
    (problem,) = checked.result["problems"]
    assert file.name in problem
    assert tree(labels) == before


def test_a_label_set_that_lacks_a_frame_is_named(annotate_cloud, labels, rig_session):
    (labels / "frames" / "000001.json").unlink()
    assert_refused(annotate_cloud("diff", labels, truth_path(rig_session)), "lacks 1 of the 3", "000001")


def network(n_classes: int, kind: str = "FLOAT", size: int = 212) -> bytes:
    """Return a one-layer network over a crop, with any number of classes."""
    onnx = pytest.importorskip("onnx")
    element = getattr(onnx.TensorProto, kind)
    weight = onnx.helper.make_tensor("w", element, (n_classes, 1, 1, 1), [1.0] * n_classes)
    graph = onnx.helper.make_graph(
        [onnx.helper.make_node("Conv", ["depth", "w"], ["probability"])],
        "g",
        [onnx.helper.make_tensor_value_info("depth", element, ("batch", 1, size, size))],
        [onnx.helper.make_tensor_value_info("probability", element, ("batch", n_classes, size, size))],
        [weight],
    )
    opset = onnx.helper.make_opsetid("", 17)
    return bytes(onnx.helper.make_model(graph, opset_imports=[opset], ir_version=8).SerializeToString())


class Exploit:
    """Runs when unpickled."""

    def __reduce__(self):
        return os.mkdir, ("unpickled",)


WEIGHTS: dict[str, tuple[Callable[[], bytes], str]] = {
    "pickle": (lambda: pickle.dumps(Exploit()), "not a network"),
    "empty": (lambda: b"", "are empty"),
    "truncated": (lambda: SHIPPED_WEIGHTS.read_bytes()[:100_000], "not a network"),
    "another class count": (lambda: network(len(BODY_PARTS)), "12 classes"),
    "another size": (lambda: network(12, size=100), "not a network"),
    "another number type": (lambda: network(12, "DOUBLE"), "not a network"),
}


@pytest.mark.parametrize("kind", list(WEIGHTS))
def test_wrong_weights_are_refused_and_never_run(annotate_cloud, tmp_path, monkeypatch, rig_session, kind):
    monkeypatch.chdir(tmp_path)
    make, says = WEIGHTS[kind]
    weights = tmp_path / "w.onnx"
    weights.write_bytes(make())
    done = annotate_cloud("predict", rig_session, "--weights", weights, "--out", tmp_path / "p")
    assert_refused(done, weights, says)
    assert set(tree(tmp_path)) == {"w.onnx"}


def test_text_of_a_file_does_not_steer_the_terminal(annotate_cloud, labels):
    manifest = labels / MANIFEST
    info = json.loads(manifest.read_text())
    manifest.write_text(json.dumps({**info, "source": "a\x1b[2J\x07\u202eb"}))
    shown = annotate_cloud("info", labels)
    assert shown.code == 0 and "a\\x1b[2J\\x07\\u202eb" in shown.out
    assert all(line.isprintable() for line in shown.out.split("\n"))
