"""Recordings that real signals end in real processes: whole, or nothing at all; never refused afterwards."""

import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

import sensors.interrupt
from sensors.interrupt import ENDING, SAME_S, ended_by_signals, interrupted_by_signals
from sensors.session.reader import Session
from sensors.session.recording_file import recording_at

SCRIPT = """
import os, signal, sys, threading, time

# As in a terminal: nohup and a shell's background ignore them.
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)

import numpy as np
import cli.live_view, cli.main, cli.rig_devices
from annotate.live.live_frame import Labelling
from sensors.device.protocol import DepthImage, DeviceReading
from sensors.errors import CloudError
from sensors.calibration_files.kinect2_factory import KINECT2_DEPTH
from sensors.rig.rig_calibration import RigCalibration

class Camera:
    address, serial, calibration, rates_hz = "a:1", "1", RigCalibration(KINECT2_DEPTH), {"depth": 300.0}
    image = 1000 + np.random.default_rng(0).integers(0, 40, (424, 512), np.uint16)

    def start(self):
        self.ended = threading.Event()

    def read(self, timeout_s):
        if self.ended.wait(1 / 300):
            return None
        now_ns = time.monotonic_ns()
        return DeviceReading(now_ns, now_ns, DepthImage(self.image))

    def close(self):
        self.ended.set()

def fail(*_):
    raise CloudError("the view is empty")

cli.rig_devices.open_device = lambda address, shown: Camera()
cli.live_view.labelling_by = lambda suit, weights: Labelling(fail, fail)
print("ready", flush=True)
for line in sys.stdin:
    verb, path = line.split()
    child = os.fork()
    if child:
        print(child, flush=True)
        print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
        continue
    for stream in (1, 2):
        os.dup2(os.open(f"{path}.said{stream}", os.O_CREAT | os.O_WRONLY), stream)
    options = {"record": ["record", path], "live": ["live", "--no-window", "--record", path]}[verb]
    sys.argv = ["annotate-cloud", *options, "--device", "kinect2:"]
    code = 99
    try:
        cli.main.main()
        code = 0
    except SystemExit as end:
        code = end.code or 0
    finally:
        os._exit(code)
"""
"""For each verb and path given: the real command in a process of its own, whose number and exit code are
printed. Its camera always has an image that is to be written, so any moment is in the middle of a write."""


@pytest.fixture(scope="module")
def commands():
    """SCRIPT."""
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    command, here = [sys.executable, "-c", SCRIPT], Path(__file__).parents[1]
    with subprocess.Popen(command, **pipes, text=True, cwd=here) as process:
        assert process.stdout.readline() == "ready\n"
        yield process
        process.stdin.close()


def ended(commands, verb: str, path: Path, numbers: list[int], after_s: float) -> int:
    """The exit code of a command that signals ended so long after its file had appeared; 0 is a pause."""
    commands.stdin.write(f"{verb} {path}\n")
    commands.stdin.flush()
    child, partial = int(commands.stdout.readline()), path.with_name(path.name + ".partial")
    while not partial.exists():
        time.sleep(0.001)
    time.sleep(after_s)
    for number in numbers:
        with suppress(ProcessLookupError):
            os.kill(child, number)
        time.sleep(0.002 if number else 2 * SAME_S)
    return int(commands.stdout.readline())


@pytest.mark.parametrize("verb", ["record", "live"])
@pytest.mark.parametrize("number", ENDING)
def test_a_recording_that_a_signal_ends_is_whole(commands, tmp_path, verb, number):
    rng = np.random.default_rng(number)
    for take in range(2 if verb == "record" else 1):
        path = tmp_path / f"{take}.mcap"
        code = ended(commands, verb, path, [number], rng.uniform(0.15, 0.3))
        session = Session(path)
        assert code == 0 and len(session) and not session.truncated
        assert not path.with_name(path.name + ".partial").exists()


def test_a_recording_that_was_ended_before_its_first_image_leaves_nothing_that_cannot_be_read(
    commands, tmp_path
):
    for take in range(3):
        path = tmp_path / f"{take}.mcap"
        code = ended(commands, "record", path, [signal.SIGINT], 0.0)
        if path.exists():
            assert code == 0 and len(Session(path))
        else:
            assert code == 3 and "nothing was recorded" in path.with_name(f"{take}.mcap.said2").read_text()
            assert not path.with_name(f"{take}.mcap.partial").exists()


@pytest.mark.parametrize("verb", ["record", "live"])
def test_signals_that_come_at_once_are_one(commands, tmp_path, verb):
    """As a terminal that is closed sends them, or a program that hands Ctrl-C on to what it started."""
    for take, numbers in enumerate(([signal.SIGINT] * 2, [signal.SIGHUP, signal.SIGTERM, signal.SIGHUP])):
        path = tmp_path / f"{take}.mcap"
        assert ended(commands, verb, path, numbers, 0.2) == 0
        assert not Session(path).truncated


def test_a_second_ctrl_c_may_abort_and_still_leaves_a_recording_that_opens(commands, tmp_path):
    for take in range(2):
        path = tmp_path / f"{take}.mcap"
        ended(commands, "record", path, [signal.SIGINT, 0, signal.SIGINT], 0.2)
        assert len(Session(recording_at(path)))


def test_the_first_signal_sets_a_flag_and_a_second_one_later_interrupts(monkeypatch):
    before = [signal.getsignal(number) for number in ENDING]
    with ended_by_signals() as ending:
        assert not ending.asked
        signal.raise_signal(signal.SIGTERM)
        assert ending.asked and ending()
        signal.raise_signal(signal.SIGHUP)
        monkeypatch.setattr(sensors.interrupt, "SAME_S", 0.0)
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
    with interrupted_by_signals(), pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGTERM)
    assert [signal.getsignal(number) for number in ENDING] == before


def test_a_hangup_that_is_ignored_stays_ignored():
    """As ``nohup`` has it."""
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with ended_by_signals() as ending:
            signal.raise_signal(signal.SIGHUP)
            assert not ending.asked
    finally:
        signal.signal(signal.SIGHUP, before)


INTERRUPTED = """
import os, signal, sys, threading, time
signal.signal(signal.SIGINT, signal.default_int_handler)
kind, folder = sys.argv[1:]
sys.path.insert(0, folder)
sys.argv = ["annotate-cloud", "info", "absent.mcap"]
import cli, cli.main

def interrupt(*_):
    os.kill(os.getpid(), signal.SIGINT)
    time.sleep(0.02)

class Callback:
    def __del__(self):
        interrupt()

def app():
    if kind == "error":
        try:
            interrupt()
        except KeyboardInterrupt:
            raise cli.main.CloudError("an extra is not installed") from None
    if kind == "callback":
        Callback()
    if kind == "import":
        import interrupted_module
    if kind == "twice":
        try:
            interrupt()
        finally:
            interrupt()
    if kind == "plain":
        interrupt()
    time.sleep(10)

cli.main.app = app
cli.command()
"""


@pytest.mark.parametrize("kind", ["plain", "error", "callback", "import", "twice"])
def test_ctrl_c_at_any_moment_of_a_command_is_one_line(tmp_path, kind):
    module = (
        "import os, signal\nos.kill(os.getpid(), signal.SIGINT)\nopen(__file__ + '.whole', 'w').close()\n"
    )
    (tmp_path / "interrupted_module.py").write_text(module)
    command = [sys.executable, "-c", INTERRUPTED, kind, str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    assert (done.returncode, done.stdout) == (130, ""), done.stderr
    assert done.stderr == "annotate-cloud: interrupted; the same command begins anew\n"
    assert (tmp_path / "interrupted_module.py.whole").exists() == (kind == "import")


STARTED = """
import os, signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)

class Finder:
    def find_spec(self, name, *rest):
        if name == "cli.main":
            os.kill(os.getpid(), signal.SIGINT)

sys.meta_path.insert(0, Finder())
from cli import command
command()
"""


def test_ctrl_c_during_the_first_imports_is_one_line():
    done = subprocess.run(
        [sys.executable, "-c", STARTED, "info", "absent.mcap"], capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 130
    assert done.stderr == "annotate-cloud: interrupted; the same command begins anew\n"
