"""Bad input gets one clear line and exit 1; nothing is lost, nothing is left half-written."""

import os
import pickle
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from mcap.writer import Writer
from mcap_protobuf.schema import register_schema

import synth.simulate
from annotate.parts import BODY_PARTS, UNDEFINED
from annotate.store import LabelSet
from annotate.suit import DEFAULT_SUIT, suit_to_toml
from conftest import Ended, tree
from eval.predict import SHIPPED_WEIGHTS
from sensors.frame import RigFrame
from sensors.messages import DEPTH, depth_message
from sensors.replay import Session
from sensors.session import SessionWriter

MAIN = [sys.executable, "-c", "from cli.main import main; main()"]


def assert_refused(done: Ended, *says: object, remarks: int = 0) -> None:
    """One line on stderr after ``remarks`` others, which holds what it must say; exit 1."""
    assert (done.code, done.out) == (1, ""), done
    lines = done.err.splitlines()
    assert len(lines) == 1 + remarks, done.err
    assert lines[-1].startswith("annotate-cloud: ")
    for said in says:
        assert str(said) in lines[-1]


def suit_of(session: Path) -> Path:
    return session.with_name(session.name + ".suit.toml")


def truth_of(session: Path) -> Path:
    return session.with_name(session.name + ".truth")


def record(path: Path, source: Session, change: Callable[[RigFrame], RigFrame]) -> Path:
    """A recording with every frame changed."""
    with SessionWriter(path, source.calibration, source.name) as writer:
        for frame in source:
            writer.write(change(frame))
    return path


@pytest.fixture
def folder(tmp_path) -> Path:
    """A user's folder of two depth images, intrinsics of another size."""
    path = tmp_path / "mine"
    path.mkdir()
    for i in range(2):
        cv2.imwrite(str(path / f"{i}.png"), np.full((24, 32), 900 + i, np.uint16))
    (path / "intrinsics.json").write_text(
        '{"fx": 300, "fy": 300, "cx": 320, "cy": 240, "width": 640, "height": 480}'
    )
    return path


@pytest.fixture
def labels(tmp_path, rig_labels) -> Path:
    """A copy of ``rig_labels`` that may be spoilt."""
    return Path(shutil.copytree(rig_labels.path, tmp_path / "labels"))


# Recordings


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "is empty"),
        (bytes(range(256)) * 40, "no MCAP file"),
        (b"frame,depth\n1,2\n", "no MCAP file"),
        (b"\x89MCAP0\r\n", "no depth images"),
    ],
)
@pytest.mark.parametrize("verb", ["info", "validate", "label", "predict", "import"])
def test_what_is_no_session_is_refused(annotate_cloud, tmp_path, verb, content, says):
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
    done = annotate_cloud("label", path, "--suit", suit_of(rig_session), "--out", tmp_path / "l", "--json")
    assert (done.code, done.result["frames"]) == (0, info["frames"])
    assert "truncated" in done.err
    for frame in LabelSet.open(tmp_path / "l"):
        np.testing.assert_array_equal(frame.parts, rig_labels.read(frame.frame_id).parts)


def test_a_session_without_calibration_is_refused(annotate_cloud, tmp_path):
    path = tmp_path / "x.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        message = depth_message(np.full((24, 32), 1000, np.uint16), 0)
        channel = writer.register_channel(DEPTH, "protobuf", register_schema(writer, type(message)))
        writer.add_message(channel, 0, message.SerializeToString(), 0)
        writer.finish()
    for verb, to in (
        ("info", ()),
        ("label", ("--out", tmp_path / "l")),
        ("predict", ("--out", tmp_path / "p")),
    ):
        assert_refused(annotate_cloud(verb, path, *to), "calibration")
    assert set(tree(tmp_path)) == {"x.mcap"}


def test_without_colour_parts_are_undefined_and_it_says_why(
    annotate_cloud, tmp_path, rig_session, rig_labels
):
    path = record(tmp_path / "x.mcap", Session(rig_session), lambda f: replace(f, color_encoded=None))
    done = annotate_cloud("label", path, "--suit", suit_of(rig_session), "--out", tmp_path / "l", "--json")
    assert done.code == 0
    assert "no colour images" in done.err
    for frame, colored in zip(LabelSet.open(tmp_path / "l"), rig_labels, strict=True):
        assert set(np.unique(frame.parts)) == {0, UNDEFINED}
        np.testing.assert_array_equal(frame.parts > 0, colored.parts > 0)
        assert any("no colour" in note for note in frame.notes["notes"])


def test_without_temperature_the_person_is_found_by_depth(annotate_cloud, tmp_path, rig_session):
    path = record(tmp_path / "x.mcap", Session(rig_session), lambda f: replace(f, thermal_c=None))
    done = annotate_cloud("label", path, "--suit", suit_of(rig_session), "--out", tmp_path / "l", "--json")
    assert done.code == 0
    assert "no thermal images" in done.err
    assert {frame.notes["extraction"] for frame in LabelSet.open(tmp_path / "l")} == {"depth"}


def test_depth_without_any_reading_shows_no_person(annotate_cloud, tmp_path, rig_session):
    path = record(
        tmp_path / "x.mcap", Session(rig_session), lambda f: replace(f, depth_mm=np.zeros_like(f.depth_mm))
    )
    for verb, more in (("label", ("--suit", suit_of(rig_session))), ("predict", ())):
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
    done = annotate_cloud("label", path, "--suit", suit_of(rig_session), "--out", out)
    assert_refused(done, "96x54", "1920x1080", remarks=1)
    assert not out.exists()


@pytest.mark.parametrize("verb", ["label", "predict", "import", "validate"])
def test_intrinsics_of_another_size_are_refused(annotate_cloud, tmp_path, folder, verb):
    before, out = tree(tmp_path), tmp_path / "out.mcap"
    to = {"label": ("--out", out), "predict": ("--out", out), "import": (out,), "validate": ()}[verb]
    done = annotate_cloud(verb, folder, *to)
    assert done.code == 1
    said = done.out if verb == "validate" else done.err
    assert "32x24" in said
    assert "640x480" in said
    assert "Traceback" not in done.err
    after = tree(tmp_path)
    assert {name: after[name] for name in before} == before
    assert not [name for name in after if name.endswith(".partial")]
    assert not (tmp_path / "out.mcap").is_file()


def test_colour_without_calibration_is_left_out_and_said(annotate_cloud, tmp_path, folder):
    (folder / "intrinsics.json").write_text(
        '{"fx": 30, "fy": 30, "cx": 16, "cy": 12, "width": 32, "height": 24}'
    )
    (folder / "color").mkdir()
    for i in range(2):
        cv2.imwrite(str(folder / "color" / f"{i}.jpg"), np.zeros((24, 32, 3), np.uint8))
    done = annotate_cloud("label", folder, "--out", tmp_path / "l")
    assert done.code == 0
    assert "no calibration of the colour camera" in done.err
    assert any("not calibrated" in note for note in LabelSet.open(tmp_path / "l").notes("000000")["notes"])


# Suits

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
        (PALETTE.replace(TORSO, 'torso = "#dc1e28"'), "the same colour but for brightness"),
        (PALETTE.replace("torso", "belly"), "'belly' is no part"),
        (PALETTE + 'background = "#000000"', "'background' is no part"),
        (PALETTE.replace(TORSO, 'torso = "yellow"'), "give '#rrggbb'"),
        (PALETTE.replace(TORSO, "torso = 7"), "give '#rrggbb'"),
        (PALETTE.replace(TORSO, f"torso = {['#e6c814'] * 300}"), "colours; give at most"),
        ("x = " + "[" * 20_000, "cannot be read"),
        ("a = [\n", "cannot be read"),
        ("# \x00", "cannot be read"),
        ("x" * 200_000, "larger than"),
    ],
)
def test_a_wrong_suit_is_refused(annotate_cloud, tmp_path, rig_session, text, says):
    suit, out = tmp_path / "suit.toml", tmp_path / "l"
    suit.write_text(text)
    assert_refused(annotate_cloud("label", rig_session, "--suit", suit, "--out", out), suit.stem, says)
    assert not out.exists()


def test_a_suit_that_is_no_text_is_refused(annotate_cloud, tmp_path, rig_session):
    (tmp_path / "suit.toml").write_bytes(b"\xff\xfe\x00")
    for suit in (tmp_path / "suit.toml", tmp_path, tmp_path / "absent"):
        done = annotate_cloud("label", rig_session, "--suit", suit, "--out", tmp_path / "l")
        assert_refused(done, suit, "cannot be read")
    assert set(tree(tmp_path)) == {"suit.toml"}


# Nothing is overwritten


def outputs(session: Path, labels: Path) -> dict[str, tuple[object, ...]]:
    """Every verb that writes a folder, but for its output."""
    return {
        "label": ("label", session, "--out"),
        "predict": ("predict", session, "--out"),
        "demo": ("demo", "--frames", 1, "--out"),
        "train": ("train", labels, "--epochs", 1, "--out"),
        "synth generate": ("synth", "generate", "--preset", "sitting-test", "--count", 1, "--out"),
    }


@pytest.mark.parametrize("overwrite", [(), ("--overwrite",)])
@pytest.mark.parametrize("verb", list(outputs(Path(), Path())))
def test_a_folder_that_no_command_made_is_never_touched(
    annotate_cloud, tmp_path, rig_session, rig_labels, verb, overwrite
):
    out = tmp_path / "holiday"
    (out / "frames").mkdir(parents=True)
    (out / "frames" / "beach.jpg").write_bytes(b"irreplaceable")
    before = tree(tmp_path)
    done = annotate_cloud(*outputs(rig_session, rig_labels.path)[verb], out, *overwrite)
    assert_refused(done, out, remarks=done.err.count("no --suit"))
    assert tree(tmp_path) == before


@pytest.mark.parametrize("taken", ["s.mcap", "s.mcap.suit.toml", "s.mcap.truth", "s.mcap.truth/mine.txt"])
def test_simulate_overwrites_nothing_unasked_and_no_folder_of_others(annotate_cloud, tmp_path, taken):
    (tmp_path / taken).parent.mkdir(exist_ok=True)
    if taken.endswith("truth"):
        (tmp_path / taken).mkdir()
    else:
        (tmp_path / taken).write_text("mine")
    before = tree(tmp_path)
    command = ("simulate", tmp_path / "s.mcap", "--frames", 1)
    assert_refused(annotate_cloud(*command), "s.mcap", "--overwrite")
    assert tree(tmp_path) == before
    if "truth" in taken:
        assert_refused(annotate_cloud(*command, "--overwrite"), "s.mcap.truth", "remove it yourself")
        assert tree(tmp_path) == before


def test_files_are_not_overwritten_unasked(annotate_cloud, tmp_path, rig_session, rig_labels):
    taken = tmp_path / "taken.mcap"
    taken.write_text("mine")
    truth = truth_of(rig_session)
    assert_refused(annotate_cloud("import", rig_session, taken), taken, "--overwrite")
    assert_refused(annotate_cloud("evaluate", rig_labels.path, truth, "--out", taken), taken, "--overwrite")
    assert annotate_cloud("evaluate", rig_labels.path, truth, "--out", tmp_path / "r.json").code == 0
    assert_refused(annotate_cloud("report", tmp_path / "r.json", "--out", taken), taken, "--overwrite")
    assert taken.read_text() == "mine"


@pytest.mark.parametrize("inside", [False, True])
def test_overwrite_never_removes_its_own_input(annotate_cloud, labels, rig_session, inside):
    source = labels
    if inside:
        source = Path(shutil.copy(rig_session, labels))
    before = tree(labels)
    assert_refused(
        annotate_cloud("predict", source, "--out", labels, "--overwrite"), "holds the input", labels
    )
    assert tree(labels) == before


def test_bad_data_leaves_the_training_that_it_was_to_replace(annotate_cloud, tmp_path):
    pytest.importorskip("torch")
    (tmp_path / "t").mkdir()
    (tmp_path / "t" / "schedule.json").write_text("{}")
    before = tree(tmp_path)
    done = annotate_cloud("train", tmp_path / "typo", "--out", tmp_path / "t", "--overwrite")
    assert_refused(done, "typo", "no label set")
    assert tree(tmp_path) == before


def test_labels_without_parts_train_nothing(annotate_cloud, tmp_path, rig_session):
    pytest.importorskip("torch")
    assert annotate_cloud("label", rig_session, "--out", tmp_path / "l").code == 0
    done = annotate_cloud("train", tmp_path / "l", "--out", tmp_path / "t", "--json")
    assert_refused(done, "no labelled part")
    assert not (tmp_path / "t").exists()


# Resuming


def test_another_suit_or_window_or_recording_does_not_resume(annotate_cloud, tmp_path, labels, rig_session):
    before = tree(labels)
    suit = tmp_path / "suit.toml"
    suit.write_text(PALETTE.replace(TORSO, 'torso = "#dcc81e"'))
    same = ("--suit", suit_of(rig_session))
    other = record(
        tmp_path / "x.mcap", Session(rig_session), lambda f: replace(f, depth_mm=f.depth_mm[:, ::-1].copy())
    )
    for recording, arguments in (
        (rig_session, ()),
        (rig_session, ("--suit", suit)),
        (rig_session, (*same, "--window", 24, 35)),
        (other, same),
    ):
        done = annotate_cloud("label", recording, *arguments, "--out", labels)
        assert_refused(done, labels, "another", "--overwrite", remarks=0 if arguments else 1)
        assert tree(labels) == before
    assert annotate_cloud("label", rig_session, "--suit", suit, "--out", labels, "--overwrite").code == 0
    assert tree(labels) != before


def test_ctrl_c_then_the_same_command_gives_the_same_labels(tmp_path, rig_session, rig_labels):
    out = tmp_path / "l"
    command = [*MAIN, "label", rig_session, "--suit", suit_of(rig_session), "--out", out, "--json"]
    running = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    until = time.monotonic() + 60
    while running.poll() is None and not (out / "frames" / "000000.json").exists():
        assert time.monotonic() < until, "no frame within a minute"
        time.sleep(0.002)
    running.send_signal(signal.SIGINT)
    said, remarks = running.communicate(timeout=60)
    assert (running.returncode, said) == (130, "")
    assert remarks.splitlines()[-1].startswith("annotate-cloud: interrupted")
    assert "Traceback" not in remarks
    begun = LabelSet.open(out)
    assert 1 <= len(begun) < 3
    assert all(frame.parts.any() for frame in begun)
    assert not [name for name in tree(out) if name.endswith(".partial")]
    again = subprocess.run(command, capture_output=True, text=True, check=False)
    assert again.returncode == 0, again.stderr
    assert tree(out) == tree(rig_labels.path)


def test_an_interrupted_simulation_leaves_nothing(annotate_cloud, tmp_path, monkeypatch):
    truths = synth.simulate.truth_labels

    def interrupted(frame, truth):
        if frame.index == 1:
            raise KeyboardInterrupt
        return truths(frame, truth)

    monkeypatch.setattr(synth.simulate, "truth_labels", interrupted)
    done = annotate_cloud("simulate", tmp_path / "s.mcap", "--frames", 2)
    assert (done.code, done.out) == (130, "")
    assert done.err.splitlines()[-1].startswith("annotate-cloud: interrupted")
    assert not list(tmp_path.iterdir())


# Disks

DISK_BYTES = 512 * 1024


@pytest.fixture
def tiny_disk(tmp_path) -> Iterator[Path]:
    """A file system of DISK_BYTES; skips where the user may not mount one."""
    path = tmp_path / "disk"
    path.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", f"size={DISK_BYTES}", "tmpfs", path], capture_output=True, check=False
    )
    if mounted.returncode:
        pytest.skip(f"no tmpfs to fill: {mounted.stderr.decode().strip()}")
    yield path
    subprocess.run(["umount", path], check=True)


@contextmanager
def largest_file(size: int) -> Iterator[None]:
    """Files may not grow beyond ``size`` bytes: a disk that fills up, without a disk."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_a_full_disk_leaves_no_simulation(annotate_cloud, tiny_disk):
    done = annotate_cloud("simulate", tiny_disk / "s.mcap", "--frames", 2)
    assert_refused(done, "No space left", "free some space")
    assert not list(tiny_disk.iterdir())


def test_a_full_disk_leaves_no_import(annotate_cloud, tiny_disk, rig_session):
    filler = tiny_disk / "other"
    filler.write_bytes(bytes(DISK_BYTES - rig_session.stat().st_size // 2))
    assert_refused(annotate_cloud("import", rig_session, tiny_disk / "s.mcap"), "No space left")
    assert list(tiny_disk.iterdir()) == [filler]


def test_a_full_disk_keeps_the_frames_that_are_done(annotate_cloud, tiny_disk, rig_session, rig_labels):
    out, filler = tiny_disk / "l", tiny_disk / "other"
    frame_bytes = sum(p.stat().st_size for p in (rig_labels.path / "frames").glob("000000.*"))
    filler.write_bytes(bytes(DISK_BYTES - int(1.5 * frame_bytes) - 16_384))
    command = ("label", rig_session, "--suit", suit_of(rig_session), "--out", out)
    assert_refused(annotate_cloud(*command), "No space left", "free some space")
    assert not [name for name in tree(out) if name.endswith(".partial")]
    assert LabelSet.open(out).frame_ids == ["000000"]
    filler.unlink()
    assert annotate_cloud(*command).code == 0
    assert tree(out) == tree(rig_labels.path)


@pytest.mark.parametrize("verb", ["simulate", "import", "label", "predict", "evaluate"])
def test_a_write_that_fails_leaves_no_half_file(annotate_cloud, tmp_path, rig_session, rig_labels, verb):
    command = {
        "simulate": ("simulate", tmp_path / "out", "--frames", 1),
        "import": ("import", rig_session, tmp_path / "out"),
        "label": ("label", rig_session, "--out", tmp_path / "out"),
        "predict": ("predict", rig_session, "--out", tmp_path / "out"),
        "evaluate": ("evaluate", rig_labels.path, rig_labels.path, "--out", tmp_path / "out"),
    }[verb]
    with largest_file(3_000):
        done = annotate_cloud(*command)
    assert_refused(done, "File too large", remarks=done.err.count("no --suit"))
    left = tree(tmp_path)
    assert not [name for name in left if name.endswith((".partial", ".json")) and "labelset" not in name]
    if verb in ("simulate", "import", "evaluate"):
        assert not left


@contextmanager
def ordinary_user() -> Iterator[None]:
    """Give up root's right to write everywhere for a while."""
    root = os.geteuid() == 0
    if root:
        os.seteuid(65534)
    try:
        yield
    finally:
        if root:
            os.seteuid(0)


@pytest.mark.parametrize("verb", ["simulate", "import", "label", "evaluate", "report"])
def test_a_read_only_folder_is_named(annotate_cloud, rig_session, rig_labels, verb):
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        shutil.copy(rig_session, folder / "session.mcap")
        shutil.copytree(rig_labels.path, folder / "labels")
        locked, source, labels = folder / "locked", folder / "session.mcap", folder / "labels"
        locked.mkdir()
        result = folder / "result.json"
        assert annotate_cloud("evaluate", labels, labels, "--out", result).code == 0
        for path in (folder, locked):
            path.chmod(0o555)
        command = {
            "simulate": ("simulate", locked / "s.mcap", "--frames", 1),
            "import": ("import", source, locked / "s.mcap"),
            "label": ("label", source, "--out", locked / "l"),
            "evaluate": ("evaluate", labels, labels, "--out", locked / "r.json"),
            "report": ("report", result, "--out", locked / "r.html"),
        }[verb]
        with ordinary_user():
            done = annotate_cloud(*command)
        assert_refused(
            done, "Permission denied", locked, "check the permissions", remarks=done.err.count("no --suit")
        )
        assert not list(locked.iterdir())
        folder.chmod(0o755)


# Label sets and weights


@pytest.mark.parametrize("suffix", ["depth.png", "parts.png", "confidence.png", "json"])
def test_a_corrupt_frame_is_named(annotate_cloud, labels, rig_session, suffix):
    file = labels / "frames" / f"000001.{suffix}"
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    before, truth = tree(labels), truth_of(rig_session)
    for command in (("diff", labels, truth), ("diff", truth, labels), ("evaluate", labels, truth)):
        assert_refused(annotate_cloud(*command), file.name)
    checked = annotate_cloud("validate", labels, "--json")
    assert checked.code == 1
    (problem,) = checked.result["problems"]
    assert file.name in problem
    assert tree(labels) == before


def test_a_label_set_that_lacks_a_frame_is_named(annotate_cloud, labels, rig_session):
    (labels / "frames" / "000001.json").unlink()
    assert_refused(annotate_cloud("diff", labels, truth_of(rig_session)), "lacks 1 of the 3", "000001")


def network(n_classes: int, kind: str = "FLOAT", size: int = 212) -> bytes:
    """A one-layer network over a crop, with any number of classes."""
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
    "pickle": (lambda: pickle.dumps(Exploit()), "no network"),
    "empty": (lambda: b"", "empty"),
    "truncated": (lambda: SHIPPED_WEIGHTS.read_bytes()[:100_000], "no network"),
    "another class count": (lambda: network(len(BODY_PARTS)), "12 classes"),
    "another size": (lambda: network(12, size=100), "no network"),
    "another number type": (lambda: network(12, "DOUBLE"), "no network"),
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


def test_absent_inputs_are_named(annotate_cloud, tmp_path):
    absent, out = tmp_path / "absent", tmp_path / "out"
    for command in (
        ("info", absent),
        ("validate", absent),
        ("import", absent, out),
        ("label", absent, "--out", out),
        ("predict", absent, "--out", out),
        ("predict", absent, "--out", out, "--weights", absent),
        ("diff", absent, absent),
        ("evaluate", absent, absent),
        ("report", absent, "--out", out),
        ("simulate", out, "--scene", "beach"),
        ("simulate", out, "--difficulty", "impossible"),
        ("simulate", out, "--frames", 2, "--subjects", 3),
    ):
        assert_refused(annotate_cloud(*command))
        with suppress(FileNotFoundError):
            pytest.fail(f"{command} left {list(out.iterdir())}")
    assert not list(tmp_path.iterdir())
