"""Existing files are never lost, and no half file is left: foreign folders, full disks, permissions."""

import ctypes
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest
from conftest import assert_refused, largest_file, record, tree

import synth.rig.truth
from annotate.labelset.label_set import LabelSet
from annotate.suit.palette import DEFAULT_SUIT, suit_to_toml
from sensors.session.reader import Session
from synth.rig.simulate import suit_path

PALETTE = suit_to_toml(DEFAULT_SUIT)
TORSO = next(line for line in PALETTE.splitlines() if line.startswith("torso"))


@pytest.fixture
def labels(tmp_path, rig_labels) -> Path:
    """Return a copy of ``rig_labels`` that may be damaged."""
    return Path(shutil.copytree(rig_labels.path, tmp_path / "labels"))


@pytest.mark.parametrize("taken", ["s.mcap", "s.suit.toml", "s.truth", "s.truth/mine.txt"])
def test_simulate_overwrites_nothing_unasked_and_no_folder_of_others(annotate_cloud, tmp_path, taken):
    (tmp_path / taken).parent.mkdir(exist_ok=True)
    if taken.endswith("truth"):
        (tmp_path / taken).mkdir()
    else:
        (tmp_path / taken).write_text("mine")
    before = tree(tmp_path)
    command = ("simulate", tmp_path / "s.mcap", "--frames", 1)
    assert_refused(annotate_cloud(*command), taken.partition("/")[0], "--overwrite")
    assert tree(tmp_path) == before
    if taken == "s.truth/mine.txt":
        assert_refused(annotate_cloud(*command, "--overwrite"), "s.truth", "remove it yourself")
        assert tree(tmp_path) == before


@pytest.mark.parametrize("case", ["own input", "input inside", "corrections", "missing data"])
def test_overwrite_never_removes_inputs_corrections_or_the_output_of_a_refused_run(
    annotate_cloud, tmp_path, labels, rig_session, case
):
    if case == "corrections":
        (labels / "journal.jsonl").write_text("")
    source = {"own input": labels, "input inside": labels / rig_session.name}.get(case, rig_session)
    if case == "input inside":
        shutil.copy(rig_session, labels)
    if case == "missing data":
        (labels / "plan.json").write_text("{}")
        command, says = ("train", tmp_path / "typo"), "does not exist; check its name"
    else:
        command, says = ("predict", source), "corrections" if case == "corrections" else "holds the input"
    before = tree(labels)
    assert_refused(annotate_cloud(*command, "--out", labels, "--overwrite"), says)
    assert tree(labels) == before


def test_labels_without_parts_train_nothing(annotate_cloud, tmp_path, rig_session):
    pytest.importorskip("torch")
    assert annotate_cloud("label", rig_session, "--out", tmp_path / "l").code == 0
    done = annotate_cloud("train", tmp_path / "l", "--out", tmp_path / "t", "--json")
    assert_refused(done, "no labelled part")
    assert not (tmp_path / "t").exists()


def test_another_suit_or_window_or_recording_does_not_resume(annotate_cloud, tmp_path, labels, rig_session):
    before = tree(labels)
    suit = tmp_path / "suit.toml"
    suit.write_text(PALETTE.replace(TORSO, 'torso = "#dcc81e"'))
    same = ("--suit", suit_path(rig_session))
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
        assert_refused(done, labels, "another", "--overwrite")
        assert tree(labels) == before
    assert annotate_cloud("label", rig_session, "--suit", suit, "--out", labels, "--overwrite").code == 0
    assert tree(labels) != before


@pytest.mark.parametrize("in_compiled", [0, 1, 2], ids="in {0} compiled functions".format)
def test_an_interrupted_simulation_leaves_nothing(
    annotate_cloud, tmp_path, shot_before, monkeypatch, in_compiled
):
    """Numba turns an interrupt in compiled code into SystemError, once for each call."""
    truths = synth.rig.truth.truth_labels

    def raised(depth: int) -> None:
        if not depth:
            raise KeyboardInterrupt
        try:
            raised(depth - 1)
        except BaseException as error:
            raise SystemError("returned a result with an exception set") from error

    def interrupted(frame, *truth):
        if frame.index == 1:
            raised(in_compiled)
        return truths(frame, *truth)

    monkeypatch.setattr(synth.rig.truth, "truth_labels", interrupted)
    done = annotate_cloud("simulate", tmp_path / "s.mcap", "--frames", 2)
    assert (done.code, done.out) == (130, "")
    assert done.err.splitlines()[-1].startswith("annotate-cloud: interrupted")
    assert not list(tmp_path.iterdir())


DISK_BYTES = 512 * 1024


@pytest.fixture
def tiny_disk(tmp_path) -> Iterator[Path]:
    """Yield a file system of DISK_BYTES; skip where the user may not mount one."""
    path = tmp_path / "disk"
    path.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", f"size={DISK_BYTES}", "tmpfs", path], capture_output=True, check=False
    )
    if mounted.returncode:
        pytest.skip(f"no tmpfs to fill: {mounted.stderr.decode().strip()}")
    yield path
    subprocess.run(["umount", path], check=True)


def test_a_full_disk_keeps_the_frames_that_are_done(annotate_cloud, tiny_disk, rig_session, rig_labels):
    out, filler = tiny_disk / "l", tiny_disk / "other"
    frame_bytes = sum(p.stat().st_size for p in (rig_labels.path / "frames").glob("000000.*"))
    filler.write_bytes(bytes(DISK_BYTES - int(1.5 * frame_bytes) - 16_384))
    command = ("label", rig_session, "--suit", suit_path(rig_session), "--out", out)
    assert_refused(annotate_cloud(*command), "No space left", "free some space")
    assert not [name for name in tree(out) if name.endswith(".partial")]
    assert LabelSet.open(out).frame_ids == ["000000"]
    filler.unlink()
    assert annotate_cloud(*command).code == 0
    assert tree(out) == tree(rig_labels.path)


def remarks(done) -> int:
    """Return the number of lines before a refusal."""
    return sum(done.err.count(text) for text in ("no suit", "evaluate: ", "export: "))


FORMATS = ("pairs", "mmseg", "coco", "cvat", "pcd", "ply", "semantic-kitti", "parquet")
WRITERS = ("simulate", "import", "label", "predict", "evaluate", "report", *FORMATS)


def writing(verb: str, out: Path, session: Path, labels: Path) -> tuple[object, ...]:
    """Return a command that writes ``out``. verb: or a format of export."""
    return {
        "simulate": ("simulate", out, "--frames", 1),
        "import": ("import", session, out.with_suffix(".mcap")),
        "label": ("label", session, "--out", out),
        "predict": ("predict", labels, "--out", out),
        "evaluate": ("evaluate", labels, labels, "--out", out),
        "report": ("report", out.parent.parent / "result.npz", "--out", out),
    }.get(verb, ("export", labels, out, "--format", verb))


@pytest.mark.parametrize("verb", WRITERS)
def test_a_write_that_fails_leaves_no_half_file(
    annotate_cloud, tmp_path, rig_session, rig_labels, shot_before, verb
):
    if verb == "parquet":
        pytest.importorskip("pyarrow", reason="the extra 'exchange' is not installed")
    if verb == "report":
        result = tmp_path / "result.npz"
        assert annotate_cloud("evaluate", rig_labels.path, rig_labels.path, "--out", result).code == 0
    folder = tmp_path / "out"
    folder.mkdir()
    with largest_file({"report": 100_000}.get(verb, 1000 if verb in FORMATS else 3000)):
        done = annotate_cloud(*writing(verb, folder / "x", rig_session, rig_labels.path))
    assert_refused(done, remarks=remarks(done))
    left = [name for name in tree(folder) if "labelset" not in name]
    assert not [name for name in left if name.endswith(".partial")] and not (folder / "x").is_file()
    assert not left or verb in ("label", "predict", "report")
    assert verb == "report" or not [name for name in left if name.endswith(".json")]


class _Caps(ctypes.Structure):
    _fields_ = [(name, ctypes.c_uint32) for name in ("effective", "permitted", "inheritable")]


@contextmanager
def ordinary_user() -> Iterator[None]:
    """Give up root's right to read and write everywhere, but remain the owner of files."""
    libc = ctypes.CDLL(None, use_errno=True)
    header = (ctypes.c_uint32 * 2)(0x20080522, 0)  # linux/capability.h: version 3, this thread
    had, left = (_Caps * 2)(), (_Caps * 2)()
    assert libc.capget(header, had) == 0 and libc.capget(header, left) == 0
    left[0].effective &= ~(1 << 1 | 1 << 2)  # CAP_DAC_OVERRIDE, CAP_DAC_READ_SEARCH
    assert libc.capset(header, left) == 0
    try:
        yield
    finally:
        assert libc.capset(header, had) == 0


@pytest.mark.parametrize("verb", [verb for verb in WRITERS if verb not in FORMATS[1:]])
def test_a_read_only_folder_is_named(annotate_cloud, rig_session, rig_labels, verb):
    with tempfile.TemporaryDirectory() as name:
        folder, locked = Path(name), Path(name) / "locked"
        labels = Path(shutil.copytree(rig_labels.path, folder / "labels"))
        locked.mkdir()
        assert annotate_cloud("evaluate", labels, labels, "--out", folder / "result.npz").code == 0
        for path in (folder, locked):
            path.chmod(0o555)
        with ordinary_user():
            done = annotate_cloud(*writing(verb, locked / "x", rig_session, labels))
        assert_refused(done, "Permission denied", locked, "check the permissions", remarks=remarks(done))
        assert not list(locked.iterdir())
        folder.chmod(0o755)
