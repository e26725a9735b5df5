"""Killed, full disk, clocks that jump, two at once, a worker lost: finished work stays, the rest resumes."""

import errno
import multiprocessing.synchronize
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import assert_refused, largest_file, tree
from test_cli_nothing_lost import ordinary_user

import sensors.recording.device_readers
from annotate.correction.correction import Correction
from annotate.correction.edit import IDLE_S, ActiveTime, steady_time
from annotate.exchange.formats import FORMATS
from annotate.frame_labels import FrameLabels
from annotate.label_recording import SuitLabeller, label_source
from annotate.labelset.atomic_folder import appearing, claimed_to_replace, moved_aside
from annotate.labelset.claim import CLAIM, Claim, ClaimedError
from annotate.labelset.journal import JOURNAL
from annotate.labelset.label_set import MANIFEST, LabelSet, validate
from annotate.suit.palette import DEFAULT_SUIT
from sensors.calibration_files.kinect2_factory import KINECT2_DEPTH
from sensors.errors import CloudError, ExistsError
from sensors.files.atomic import sweep, temporary_of
from sensors.recording.live_rig import LiveRig
from sensors.recording.open_device import open_device
from sensors.rig.camera import Intrinsics
from sensors.rig.rig_calibration import RigCalibration
from sensors.session.reader import Session
from synth.images.generate import Order, generate
from synth.images.presets import PRESETS
from synth.images.workers import Workers, processes
from synth.rig.simulate import suit_path
from tests.helpers.swinging_ball import swinging_ball

ORDER = Order(PRESETS["sitting-test"], 12, 3, shard_frames=4)


def made(out: Path) -> None:
    """The dataset of ORDER, made or gone on with."""
    with ThreadPoolExecutor(1) as pool:
        generate(ORDER, out, Workers(pool, 1), lambda n: None)


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> dict[str, str]:
    """Labels of ORDER from an uninterrupted run."""
    out = tmp_path_factory.mktemp("whole") / "d"
    made(out)
    return tree(out)


def partial_of(folder: Path) -> list[str]:
    return [name for name in tree(folder) if name.endswith(".partial")]


# Killed and interrupted: each verb ends at the worst moment, with a file written and not yet named

KILLED = """
import os, signal, sys
from pathlib import Path
from cli.main import main
from test_faults import made

def ends(by, event, number, run):
    child = os.fork()
    if child:
        return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    if by == signal.SIGINT:
        for stream in (1, 2):
            os.dup2(os.open(f"{folder}/said.{stream}", os.O_CREAT | os.O_WRONLY), stream)
    left = number
    def look(name, arguments):
        nonlocal left
        if name == event and folder in str(arguments):
            left -= 1
            if not left:
                os.kill(os.getpid(), by)
    sys.addaudithook(look)
    try:
        run()
    except SystemExit as end:
        sys.stdout.flush(), sys.stderr.flush()
        os._exit(end.code)
    finally:
        os._exit(99)

def command(*arguments):
    sys.argv = ["annotate-cloud", *arguments]
    main()

def label(name):
    command("label", session, "--suit", suit, "--out", f"{folder}/{name}", "--json")

folder, session, suit, labels = sys.argv[1:]
for by, event, number, run in (
    (signal.SIGINT, "os.rename", 9, lambda: label("interrupted")),
    (signal.SIGKILL, "os.rename", 9, lambda: label("labels")),
    (signal.SIGKILL, "os.rename", 9, lambda: command("predict", labels, "--out", f"{folder}/predicted")),
    (signal.SIGKILL, "open", 5, lambda: command("export", labels, f"{folder}/pairs", "--format", "pairs")),
    (signal.SIGKILL, "os.rename", 3, lambda: made(Path(f"{folder}/dataset"))),
    (signal.SIGKILL, "os.rename", 1, lambda: command("simulate", f"{folder}/s.mcap", "--frames", "1")),
):
    print(ends(by, event, number, run), flush=True)
"""


@pytest.fixture(scope="module")
def killed(tmp_path_factory, rig_session, rig_labels) -> Path:
    """Leftovers of verbs killed with -9, and of an interrupted one."""
    folder = tmp_path_factory.mktemp("killed")
    command = [sys.executable, "-c", KILLED, folder, rig_session, suit_path(rig_session), rig_labels.path]
    here = Path(__file__).parent
    environment = {**os.environ, "PYTHONPATH": f"{here.parent}:{here}"}
    # A shell lets what it starts in the background ignore Ctrl-C, and all its children.
    heeding = partial(signal.signal, signal.SIGINT, signal.SIG_DFL)
    done = subprocess.run(
        command, capture_output=True, text=True, env=environment, check=True, timeout=300, preexec_fn=heeding
    )
    assert done.stdout.split() == ["130", *["-9"] * 5], done
    assert partial_of(folder), "killed while it wrote"
    return folder


def test_ctrl_c_is_said_and_the_same_command_gives_the_same_labels(
    annotate_cloud, killed, rig_session, rig_labels
):
    out = killed / "interrupted"
    assert (killed / "said.1").read_text() == ""
    remarks = (killed / "said.2").read_text()
    assert remarks.splitlines()[-1].startswith("annotate-cloud: interrupted")
    assert "Traceback" not in remarks
    begun = LabelSet.open(out)
    assert 1 <= len(begun) < len(rig_labels) and not validate(begun)
    assert all(frame.parts.any() for frame in begun)
    assert not partial_of(out)
    assert annotate_cloud("label", rig_session, "--suit", suit_path(rig_session), "--out", out).code == 0
    assert tree(out) == tree(rig_labels.path)


def test_a_killed_label_goes_on_to_the_same_bytes(annotate_cloud, killed, rig_session, rig_labels):
    out = killed / "labels"
    begun = LabelSet.open(out)
    assert begun.frame_ids == ["000000"] and not validate(begun)
    assert partial_of(out)
    assert annotate_cloud("label", rig_session, "--suit", suit_path(rig_session), "--out", out).code == 0
    assert tree(out) == tree(rig_labels.path)


def test_a_killed_predict_goes_on_to_the_same_bytes(annotate_cloud, killed, tmp_path, rig_labels):
    out = killed / "predicted"
    assert not [problem for problem in validate(LabelSet.open(out)) if "holds no frames" not in problem]
    assert annotate_cloud("predict", rig_labels.path, "--out", out).code == 0
    assert annotate_cloud("predict", rig_labels.path, "--out", tmp_path / "whole").code == 0
    assert tree(out) == tree(tmp_path / "whole")


def test_a_killed_export_leaves_nothing_of_that_name(annotate_cloud, killed, tmp_path, rig_labels):
    assert not (killed / "pairs").exists()
    assert list(killed.glob(".pairs.*.partial"))
    for out in (killed / "pairs", tmp_path / "whole"):
        assert annotate_cloud("export", rig_labels.path, out, "--format", "pairs").code == 0
    assert not list(killed.glob(".pairs.*.partial"))
    assert tree(killed / "pairs") == tree(tmp_path / "whole")


@pytest.mark.parametrize("removed", ["marker", "frames"])
def test_a_result_that_replaces_another_is_never_half_of_one(tmp_path, monkeypatch, removed):
    """Killed while it removes the old one; what comes next finds a whole result, and replaces it."""
    out = tmp_path / "out"

    def write(text: str) -> None:
        with appearing(out, "marker", overwrite=True) as folder:
            for name in ("marker", "frames"):
                (folder / name).write_text(text)

    def killed(path: Path, **_) -> None:
        if path.exists():
            (path / removed).unlink()
            raise KeyboardInterrupt

    write("old")
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(shutil, "rmtree", killed)
        write("new")
    assert len({(out / name).read_text() for name in ("marker", "frames")}) == 1
    write("newer")
    assert (out / "marker").read_text() == "newer"
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_nobody_corrects_a_set_that_is_being_replaced(tmp_path):
    out = tmp_path / "labels"

    def written(folder: Path) -> None:
        labels = LabelSet.create(folder, Intrinsics(8, 8, 8.0, 8.0, 4.0, 4.0), {"source": "x"})
        depth_mm = np.full((8, 8), 1000, np.uint16)
        labels.write(FrameLabels("000000", depth_mm, np.ones((8, 8), np.uint8)))

    written(out)
    with appearing(out, MANIFEST, overwrite=True) as folder:
        written(folder)
        with pytest.raises(ClaimedError):
            Correction.open(out, "ann")
    with Correction.open(out, "ann") as correction:
        with pytest.raises(ClaimedError), claimed_to_replace(out, MANIFEST):
            pass
        correction.edit("000000").paint(np.arange(8), 2)
    with pytest.raises(ExistsError, match="corrections"), appearing(out, MANIFEST, overwrite=True):
        pass
    assert (out / JOURNAL).is_file()


def test_a_result_that_cannot_take_its_place_restores_the_old_one(tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    (out / "marker").write_text("old")
    with pytest.raises(OSError, match="full"), moved_aside(out):
        raise OSError("the disk is full")
    assert (out / "marker").read_text() == "old"
    assert list(tmp_path.iterdir()) == [out]


def test_a_claim_that_is_given_back_leaves_the_next_ones(tmp_path):
    """The folder was replaced meanwhile, and the new one is claimed."""
    out = tmp_path / "out"
    out.mkdir()
    first = Claim.take(out, "ann")
    out.replace(tmp_path / "aside")
    out.mkdir()
    with Claim.take(out, "ben"):
        first.release()
        with pytest.raises(ClaimedError, match="ben"):
            Claim.take(out, "cid")


def test_a_killed_generate_goes_on_to_the_same_bytes(killed, whole):
    out = killed / "dataset"
    assert partial_of(out)
    assert {name: hash_ for name, hash_ in tree(out).items() if name in whole}.items() <= whole.items()
    made(out)
    assert tree(out) == whole


def test_a_killed_simulate_is_told_and_made_anew(annotate_cloud, killed, shot_before):
    command = ("simulate", killed / "s.mcap", "--frames", 1)
    assert not (killed / "s.mcap").exists()
    assert_refused(annotate_cloud(*command), "--overwrite")
    assert annotate_cloud(*command, "--overwrite").code == 0
    assert not list(killed.glob("s.*partial"))


def test_the_living_keep_what_they_are_making(tmp_path):
    mine, parent_s = temporary_of(tmp_path / "x"), tmp_path / f".x.0a1b2c3d.{os.getppid()}.partial"
    # The last one's process is dead, and had the number that this one has now.
    dead = [tmp_path / f".x.{ending}.partial" for ending in (2**22 + 1, f"0a1b2c3d.{os.getpid()}")]
    for path in (mine, parent_s, *dead):
        path.mkdir()
    sweep(tmp_path)
    assert sorted(tmp_path.iterdir()) == sorted([mine, parent_s])


# Full disk


def test_a_full_disk_leaves_whole_shards_and_generate_goes_on(tmp_path, whole):
    out = tmp_path / "d"
    with largest_file(5_000), pytest.raises(OSError, match="File too large"):
        made(out)
    assert list(tree(out)) == ["order.json"]
    made(out)
    assert tree(out) == whole


def test_a_read_only_place_is_left_as_it_is():
    with tempfile.TemporaryDirectory() as name:
        Path(name).chmod(0o555)
        with ordinary_user(), pytest.raises(PermissionError):
            made(Path(name) / "d")
        assert not list(Path(name).iterdir())


def test_a_full_disk_is_one_line_of_train_and_it_goes_on(tmp_path):
    tiny = pytest.importorskip("tests.helpers.tiny_training", reason="training needs torch")
    from eval.training.processes import ProcessGroup
    from eval.training.train import Data, Watch, train

    def trained(out: Path) -> None:
        with ProcessGroup.join() as group:
            train(Data(tiny.CROPS), out, tiny.PLAN, group, Watch(checkpoint_s=0.0))

    with largest_file(4_000), pytest.raises(CloudError, match=r"cannot be written .*free some space"):
        trained(tmp_path / "t")
    assert not [name for name in tree(tmp_path) if "checkpoint" in name or "partial" in name]
    trained(tmp_path / "t")
    assert (tmp_path / "t" / "history.json").is_file()
    with Claim.take(tmp_path / "t", "ann"), pytest.raises(ClaimedError, match="written by ann"):
        trained(tmp_path / "t")


@pytest.mark.parametrize("format_", FORMATS)
def test_a_full_disk_leaves_no_export(annotate_cloud, tmp_path, rig_labels, format_):
    if format_ == "parquet":
        pytest.importorskip("pyarrow", reason="the extra 'exchange' is not installed")
    with largest_file(1_000):
        done = annotate_cloud("export", rig_labels.path, tmp_path / "x", "--format", format_)
    assert_refused(done, remarks=done.err.count("export: "))
    assert not list(tmp_path.iterdir())


def test_a_full_disk_leaves_no_report(annotate_cloud, tmp_path, rig_labels):
    result = tmp_path / "r.npz"
    assert annotate_cloud("evaluate", rig_labels.path, rig_labels.path, "--out", result).code == 0
    with largest_file(100_000):
        assert_refused(annotate_cloud("report", result, "--out", tmp_path / "page.html"), "File too large")
    assert not (tmp_path / "page.html").exists() and not partial_of(tmp_path)


# Clocks


def test_a_clock_that_is_set_costs_nobody_any_time(monkeypatch):
    spent = ActiveTime()
    spent.mark("looking")
    real = time.time
    monkeypatch.setattr(time, "time", lambda: real() + 60)
    time.sleep(0.01)
    spent.mark("looking")
    monkeypatch.setattr(time, "time", lambda: real() - 3600)
    time.sleep(0.01)
    spent.mark("looking")
    assert 0.02 <= spent.take()["looking"] < 30
    assert abs(steady_time() - real()) < 60
    assert IDLE_S > 60, "a jump of a minute would have counted"


def test_a_clock_that_is_set_while_recording_moves_no_event(tmp_path, monkeypatch):
    jumped = SimpleNamespace(monotonic=time.monotonic, monotonic_ns=time.monotonic_ns, time_ns=time.time_ns)
    monkeypatch.setattr(sensors.recording.device_readers, "time", jumped)
    devices = [
        open_device(a, swinging_ball())
        for a in ("virtual:kinect2", "virtual:optris?mode=128hz&unplug_after=0.3")
    ]
    for device in devices:
        device.start()
    with closing(LiveRig("rig", devices, RigCalibration(KINECT2_DEPTH), {}, open_device)) as rig:
        rig.record(tmp_path / "s.mcap")
        jumped.time_ns = lambda: time.time_ns() - 86_400 * 10**9
        rig.start()
        time.sleep(1.0)
    session = Session(tmp_path / "s.mcap")
    stamps = [frame.stamp_ns for frame in session]
    assert [stamp for stamp, text in session.events if "optris" in text]
    assert all(stamps[0] - 5e9 < stamp < stamps[-1] + 5e9 for stamp, _ in session.events)


# Two at once


def test_two_labels_of_one_set_take_turns(annotate_cloud, tmp_path, rig_session, rig_labels):
    out, seen = tmp_path / "l", []

    def meanwhile(n: int) -> None:
        for overwrite in ([], ["--overwrite"]):
            second = annotate_cloud(
                "label", rig_session, "--suit", suit_path(rig_session), "--out", out, *overwrite
            )
            assert_refused(second, f"{out} is being written by", f"process {os.getpid()}")
        with pytest.raises(ClaimedError, match="being written"):
            Correction.open(out)
        seen.append(len(Correction.open(out, read_only=True).labels))

    label_source(Session(rig_session), SuitLabeller(DEFAULT_SUIT), out, meanwhile)
    assert len(seen) == 3
    assert all(on_disk >= told for told, on_disk in enumerate(seen, 1))
    assert tree(out) == tree(rig_labels.path)


def test_nothing_is_written_to_a_set_that_is_being_corrected(
    annotate_cloud, tmp_path, rig_session, rig_labels
):
    labels = Path(shutil.copytree(rig_labels.path, tmp_path / "labels"))
    with Correction.open(labels, "ann"):
        before = tree(labels)
        for command in (
            ("label", rig_session, "--suit", suit_path(rig_session), "--out", labels),
            ("predict", rig_session, "--overwrite", "--out", labels),
            ("import", tmp_path / "pairs", labels, "--overwrite"),
        ):
            if command[0] == "import":
                assert annotate_cloud("export", labels, tmp_path / "pairs", "--format", "pairs").code == 0
            assert_refused(annotate_cloud(*command), f"{labels} is being written by ann@")
        assert tree(labels) == before


def test_a_claim_of_the_dead_hinders_nobody(annotate_cloud, tmp_path, rig_session, rig_labels):
    labels = Path(shutil.copytree(rig_labels.path, tmp_path / "labels"))
    (labels / CLAIM).write_text('{"who": "ann"}')
    command = ("label", rig_session, "--suit", suit_path(rig_session), "--out", labels)
    assert annotate_cloud(*command).code == 0
    assert tree(labels) == tree(rig_labels.path)


def test_two_generates_of_one_dataset_take_turns(tmp_path, whole):
    out, refused = tmp_path / "d", []

    def meanwhile(n: int) -> None:
        with pytest.raises(ClaimedError) as error:
            made(out)
        refused.append(error)

    with ThreadPoolExecutor(1) as pool:
        generate(ORDER, out, Workers(pool, 1), meanwhile)
    assert refused and tree(out) == whole


# A worker lost


def test_a_lost_worker_costs_nothing_that_is_done(tmp_path, whole):
    out = tmp_path / "d"
    with pytest.raises(CloudError, match=r"was killed.*same command"), processes(1) as workers:

        def lose(n: int) -> None:
            if n:
                for process in workers.executor._processes.values():
                    process.kill()

        generate(ORDER, out, workers, lose)
    done = tree(out)
    assert "shard-000000.tar" in done and done.items() <= whole.items()
    made(out)
    assert tree(out) == whole


def test_a_lost_worker_of_a_training_is_one_line(tmp_path):
    tiny = pytest.importorskip("tests.helpers.tiny_training", reason="training needs torch")
    losing = tiny.begin_and_lose(tmp_path / "t", tmp_path / "said")
    losing.join(120)
    said = (tmp_path / "said").read_text()
    assert "was killed" in said and "fewer --workers" in said and "\n" not in said


def test_workers_without_shared_memory_are_one_line(tmp_path, monkeypatch):
    """A container without /dev/shm: the system's own call for a semaphore fails."""

    def refused(*_):
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT))

    monkeypatch.setattr(multiprocessing.synchronize._multiprocessing, "SemLock", refused)
    with pytest.raises(CloudError, match=r"No such file .*mount /dev/shm"), processes(1):
        pass
    pytest.importorskip("torch", reason="training needs torch")
    from eval.training.augment import Augmentation
    from eval.training.loader import BatchOrder, Images, batches
    from tests.helpers.tiny_training import CROPS

    with pytest.raises(CloudError, match="mount /dev/shm"):
        next(batches(Images(CROPS, Augmentation(), 0), BatchOrder(len(CROPS), 2, 1, 0), 0, workers=1))


HOLD = """
import os, time
from synth.images.workers import processes
if __name__ == "__main__":
    with processes(1) as workers:
        print(workers.executor.submit(os.getpid).result(), flush=True)
        time.sleep(600)
"""


def test_workers_do_not_outlive_a_killed_parent(tmp_path):
    (tmp_path / "hold.py").write_text(HOLD)
    parent = subprocess.Popen([sys.executable, tmp_path / "hold.py"], stdout=subprocess.PIPE)
    with parent:
        assert parent.stdout is not None
        worker = int(parent.stdout.readline())
        parent.send_signal(signal.SIGKILL)
    deadline = time.monotonic() + 600
    while Path("/proc", str(worker)).exists():
        assert time.monotonic() < deadline, "the worker lives on"
        time.sleep(0.05)


def test_a_claim_is_given_back_when_a_run_fails(tmp_path, rig_session):
    out = tmp_path / "l"

    def fails(n: int) -> None:
        raise OSError(28, "No space left on device")

    with pytest.raises(OSError, match="No space"):
        label_source(Session(rig_session), SuitLabeller(DEFAULT_SUIT), out, fails)
    Claim.take(out, "bob").release()
