"""What is there is never lost: folders of others, unfinished runs, full disks, folders without permission."""

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

import synth.rig.simulate
from annotate.labelset.label_set import LabelSet
from annotate.suit.palette import DEFAULT_SUIT, suit_to_toml
from sensors.session.reader import Session
from synth.rig.simulate import suit_path, truth_path

PALETTE = suit_to_toml(DEFAULT_SUIT)
TORSO = next(line for line in PALETTE.splitlines() if line.startswith("torso"))


@pytest.fixture
def labels(tmp_path, rig_labels) -> Path:
    """A copy of ``rig_labels`` that may be spoilt."""
    return Path(shutil.copytree(rig_labels.path, tmp_path / "labels"))


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
    assert_refused(done, out, remarks=done.err.count("no --suit") + done.err.count("evaluate: "))
    assert tree(tmp_path) == before


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


def test_files_are_not_overwritten_unasked(annotate_cloud, tmp_path, rig_session, rig_labels):
    taken = tmp_path / "taken.mcap"
    taken.write_text("mine")
    truth = truth_path(rig_session)
    assert_refused(annotate_cloud("import", rig_session, taken), taken, "--overwrite")
    assert_refused(annotate_cloud("evaluate", rig_labels.path, truth, "--out", taken), taken, "--overwrite")
    assert annotate_cloud("evaluate", rig_labels.path, truth, "--out", tmp_path / "r.npz").code == 0
    assert_refused(annotate_cloud("report", tmp_path / "r.npz", "--out", taken), taken, "--overwrite")
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
    (tmp_path / "t" / "plan.json").write_text("{}")
    before = tree(tmp_path)
    done = annotate_cloud("train", tmp_path / "typo", "--out", tmp_path / "t", "--overwrite")
    assert_refused(done, "typo", "does not exist; check its name")
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


def test_corrections_are_never_overwritten(annotate_cloud, tmp_path, rig_session, rig_labels):
    labels = tmp_path / "labels"
    shutil.copytree(rig_labels.path, labels)
    (labels / "journal.jsonl").write_text("")
    before = tree(labels)
    done = annotate_cloud("label", rig_session, "--out", labels, "--overwrite")
    assert_refused(done, labels, "corrections")
    assert tree(labels) == before


@pytest.mark.parametrize("in_compiled", [0, 1, 2], ids="in {0} compiled functions".format)
def test_an_interrupted_simulation_leaves_nothing(
    annotate_cloud, tmp_path, shot_before, monkeypatch, in_compiled
):
    """An interrupt within code that Numba calls comes out as SystemError, once for each call."""
    truths = synth.rig.simulate.truth_labels

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

    monkeypatch.setattr(synth.rig.simulate, "truth_labels", interrupted)
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


def test_a_full_disk_leaves_no_simulation(annotate_cloud, tiny_disk, shot_before):
    filler = tiny_disk / "other"
    filler.write_bytes(bytes(DISK_BYTES // 2))
    done = annotate_cloud("simulate", tiny_disk / "s.mcap", "--frames", 2)
    assert_refused(done, "No space left", "free some space")
    assert list(tiny_disk.iterdir()) == [filler]


def test_a_full_disk_leaves_no_import(annotate_cloud, tiny_disk, rig_session):
    filler = tiny_disk / "other"
    filler.write_bytes(bytes(DISK_BYTES - rig_session.stat().st_size // 2))
    assert_refused(annotate_cloud("import", rig_session, tiny_disk / "s.mcap"), "No space left")
    assert list(tiny_disk.iterdir()) == [filler]


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


@pytest.mark.parametrize("verb", ["simulate", "import", "label", "predict", "evaluate"])
def test_a_write_that_fails_leaves_no_half_file(
    annotate_cloud, tmp_path, rig_session, rig_labels, shot_before, verb
):
    command = {
        "simulate": ("simulate", tmp_path / "out", "--frames", 1),
        "import": ("import", rig_session, tmp_path / "out.mcap"),
        "label": ("label", rig_session, "--out", tmp_path / "out"),
        "predict": ("predict", rig_session, "--out", tmp_path / "out"),
        "evaluate": ("evaluate", rig_labels.path, rig_labels.path, "--out", tmp_path / "out"),
    }[verb]
    with largest_file(3_000):
        done = annotate_cloud(*command)
    assert_refused(done, "File too large", remarks=done.err.count("no --suit") + done.err.count("evaluate: "))
    left = tree(tmp_path)
    assert not [name for name in left if name.endswith((".partial", ".json")) and "labelset" not in name]
    if verb in ("simulate", "import", "evaluate"):
        assert not left


class _Caps(ctypes.Structure):
    _fields_ = [(name, ctypes.c_uint32) for name in ("effective", "permitted", "inheritable")]


@contextmanager
def ordinary_user() -> Iterator[None]:
    """Give up root's right to read and write everywhere for a while, but stay who owns the files."""
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


@pytest.mark.parametrize("verb", ["simulate", "import", "label", "predict", "evaluate", "report", "export"])
def test_a_read_only_folder_is_named(annotate_cloud, rig_session, rig_labels, verb):
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        shutil.copy(rig_session, folder / "session.mcap")
        shutil.copytree(rig_labels.path, folder / "labels")
        locked, source, labels = folder / "locked", folder / "session.mcap", folder / "labels"
        locked.mkdir()
        result = folder / "result.npz"
        assert annotate_cloud("evaluate", labels, labels, "--out", result).code == 0
        for path in (folder, locked):
            path.chmod(0o555)
        command = {
            "simulate": ("simulate", locked / "s.mcap", "--frames", 1),
            "import": ("import", source, locked / "s.mcap"),
            "label": ("label", source, "--out", locked / "l"),
            "evaluate": ("evaluate", labels, labels, "--out", locked / "r.npz"),
            "predict": ("predict", labels, "--out", locked / "p"),
            "export": ("export", labels, locked / "x", "--format", "pairs"),
            "report": ("report", result, "--out", locked / "r.html"),
        }[verb]
        with ordinary_user():
            done = annotate_cloud(*command)
        assert_refused(
            done,
            "Permission denied",
            locked,
            "check the permissions",
            remarks=done.err.count("no --suit") + done.err.count("evaluate: "),
        )
        assert not list(locked.iterdir())
        folder.chmod(0o755)
