"""Lost workers and clocks that jump: results stay, and errors are one line."""

import errno
import multiprocessing.synchronize
import os
import signal
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace

import pytest
from conftest import tree
from test_faults import ORDER, made

import sensors.recording.device_readers
from annotate.correction.edit import IDLE_S, ActiveTime, steady_time
from sensors.calibration_files.kinect2_factory import KINECT2_DEPTH
from sensors.errors import CloudError
from sensors.recording.live_rig import LiveRig
from sensors.recording.open_device import open_device
from sensors.rig.rig_calibration import RigCalibration
from sensors.session.reader import Session
from synth.images.generate import generate
from synth.images.workers import processes
from tests.helpers.swinging_ball import swinging_ball


def test_a_clock_that_is_set_changes_no_active_time(monkeypatch):
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
        deadline_s = time.monotonic() + 30
        while (
            not any("connected" in str(event) for _, event in [*rig.events]) and time.monotonic() < deadline_s
        ):
            time.sleep(0.1)
        time.sleep(0.3)
    session = Session(tmp_path / "s.mcap")
    stamps = [frame.stamp_ns for frame in session]
    assert [stamp for stamp, text in session.events if "connected" in text]
    assert all(stamps[0] - 5e9 < stamp < stamps[-1] + 5e9 for stamp, _ in session.events)


def test_a_lost_worker_costs_no_finished_shard(tmp_path):
    out, whole = tmp_path / "d", tmp_path / "whole"
    made(whole)
    with pytest.raises(CloudError, match=r"was killed.*same command"), processes(1) as workers:

        def lose(n: int) -> None:
            if n:
                for process in workers.executor._processes.values():
                    process.kill()

        generate(ORDER, out, workers, lose)
    done = tree(out)
    assert "shard-000000.tar" in done and done.items() <= tree(whole).items()
    made(out)
    assert tree(out) == tree(whole)


def test_a_lost_worker_of_a_training_is_one_line(tmp_path):
    tiny = pytest.importorskip("tests.helpers.tiny_training", reason="training needs torch")
    losing = tiny.begin_and_lose(tmp_path / "t", tmp_path / "said")
    losing.join(120)
    said = (tmp_path / "said").read_text()
    assert "was killed" in said and "fewer workers" in said and "\n" not in said


def test_workers_without_shared_memory_are_one_line(tmp_path, monkeypatch):
    """As in a container without /dev/shm, where the call for a semaphore fails."""

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


def test_ctrl_c_of_a_terminal_does_not_reach_a_worker():
    """A terminal sends it to all processes; the parent ends its workers."""
    with processes(1) as workers:
        masked = workers.executor.submit(signal.pthread_sigmask, signal.SIG_BLOCK, ()).result()
    assert signal.SIGINT in masked
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, ())
