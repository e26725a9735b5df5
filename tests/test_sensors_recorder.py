"""Recording: virtual devices end up in a session that pairs, whole or killed; what cannot be is refused."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing
from pathlib import Path
from types import SimpleNamespace
from typing import ClassVar

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

import sensors.recording.device_readers
import sensors.recording.recorder
from cli.rig_devices import opened_rig
from sensors.calibration_files.kinect2_factory import KINECT2_DEPTH
from sensors.device.protocol import DepthImage, Device, DeviceReading
from sensors.drivers.kinect2 import Kinect2
from sensors.errors import CalibrationError, DeviceError
from sensors.recording.device_readers import BACKLOG
from sensors.recording.live_rig import LiveRig
from sensors.recording.open_device import open_device
from sensors.recording.recorder import clock_metadata
from sensors.recording.rig_file import RecordingRig, load_rig
from sensors.rig.rig_calibration import RigCalibration, save_calibration
from sensors.session.reader import Session
from sensors.session.writer import SessionWriter
from sensors.virtual.frame_loop import FrameLoop
from sensors.virtual.kinect2 import VirtualKinect2
from tests.conftest import assert_refused
from tests.helpers.swinging_ball import swinging_ball

KINECT, FIR, SPOT = "virtual:kinect2", "virtual:optris-direct", "virtual:pyrometer?family=ct"
RIG = RigCalibration(KINECT2_DEPTH)


def started(*addresses: str) -> list[Device]:
    devices = [open_device(address, swinging_ball()) for address in addresses]
    for device in devices:
        device.start()
    return devices


def recorded(path: Path, seconds: float, *addresses: str) -> LiveRig:
    """A rig that has recorded for so long, or until the recording ended by itself."""
    with closing(rig_of(*addresses)) as rig:
        rig.record(path)
        rig.start()
        end = time.monotonic() + seconds
        while time.monotonic() < end and rig.health().recording:
            time.sleep(0.01)
    return rig


def rig_of(*addresses: str) -> LiveRig:
    return LiveRig("rig", started(*addresses), RIG, {}, lambda address: started(address)[0])


def test_devices_with_skewed_clocks_and_drops_make_a_session_that_pairs(tmp_path):
    path = tmp_path / "session.mcap"
    rig = recorded(path, 2.0, f"{KINECT}?skew_ppm=50&drop=0.2", f"{FIR}?skew_ppm=-50", SPOT)
    session, depth = Session(path), rig.health().streams["depth"]
    assert len(session) == depth.count > 10 and depth.dropped > 0
    assert any("dropped" in text for text in rig.last_take.events)
    assert not session.truncated
    frames = list(session)
    assert np.mean([frame.color_encoded is not None for frame in frames]) > 0.9
    assert np.mean([frame.thermal_c is not None for frame in frames]) > 0.9
    assert np.isfinite(session.reference_c).mean() > 0.5
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        topics = {channel.topic for _, channel, _, _ in reader.iter_decoded_messages()}
    assert {"/depth/image", "/color/image", "/thermal/image", "/pyrometer"} <= topics


@pytest.mark.parametrize("address", ["virtual:lepton", "virtual:y16?scale=0.01&offset=-273.15"])
def test_a_thermal_camera_of_nine_images_a_second_makes_a_session(tmp_path, address):
    """Every image belongs to the depth image that is nearest, as far as there is one."""
    path = tmp_path / "session.mcap"
    streams = recorded(path, 1.2, KINECT, address).health().streams
    session = Session(path)
    warm = [frame.thermal_c for frame in session if frame.thermal_c is not None]
    assert 0 < len(warm) <= streams["thermal"].count
    assert all(20 < np.median(celsius) < 34 for celsius in warm)


def test_what_was_unplugged_is_opened_again_and_recorded(tmp_path, monkeypatch):
    """Both cameras vanish after a while, again and again; each time their clocks begin anew."""
    monkeypatch.setattr(sensors.recording.device_readers, "REOPEN_S", 0.2)
    path = tmp_path / "session.mcap"
    rig = recorded(path, 5.0, f"{KINECT}?unplug_after=0.8", f"{FIR}?unplug_after=1.1")
    session, back = Session(path), [text for text in rig.last_take.events if text.endswith("is back")]
    assert any("kinect2" in text for text in back) and any("optris" in text for text in back)
    assert len(session) == rig.health().streams["depth"].count > 10
    assert np.mean([frame.color_encoded is not None for frame in session]) > 0.9


SCRIPT = """
import os, sys, time
from pathlib import Path
import sensors.recording.recorder
from sensors.recording.live_rig import LiveRig
from sensors.recording.open_device import open_device
from sensors.calibration_files.kinect2_factory import KINECT2_DEPTH
from sensors.rig.rig_calibration import RigCalibration
from sensors.session.writer import SessionWriter
from tests.helpers.swinging_ball import swinging_ball

class Telling(SessionWriter):
    def write_depth(self, *image):
        super().write_depth(*image)
        print(image[-1], flush=True)

sensors.recording.recorder.SessionWriter = Telling

def record(path):
    devices = [open_device(address, swinging_ball()) for address in sys.argv[1:]]
    for device in devices:
        device.start()
    rig = LiveRig("rig", devices, RigCalibration(KINECT2_DEPTH), {}, lambda address: None)
    rig.record(Path(path))
    rig.start()
    time.sleep(600)

for path in sys.stdin:
    child = os.fork()
    if not child:
        print(os.getpid(), flush=True)
        record(path.strip())
    os.waitpid(child, 0)
    print("ended", flush=True)
"""
# Records to each given path without end, in a process of its own. Prints the process id, then the arrival of
# each written depth image, and the end of the process.


@pytest.fixture(scope="module")
def recording() -> Iterator[subprocess.Popen[str]]:
    """SCRIPT."""
    command, here = [sys.executable, "-c", SCRIPT, KINECT, FIR], Path(__file__).parents[1]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen(command, **pipes, text=True, cwd=here) as process:
        yield process
        process.stdin.close()


@pytest.mark.parametrize("images", [1, 12, 33])
def test_kill_9_loses_at_most_a_tenth_of_a_second(tmp_path, recording, images):
    path = tmp_path / "session.mcap"
    recording.stdin.write(f"{path}\n")
    recording.stdin.flush()
    number = int(recording.stdout.readline())
    told = [recording.stdout.readline() for _ in range(images)]
    os.kill(number, signal.SIGKILL)
    told += iter(recording.stdout.readline, "ended\n")
    session = Session(path.with_name(path.name + ".partial"))
    assert session.truncated
    # What was written has left the process; what it had not written yet is younger than an image.
    assert len(told) >= images
    assert int(session._places["/depth/image"]["arrival_ns"][-1]) >= int(told[-1])
    assert "truncated" in " ".join(session.notes)


class _Ahead:
    """A depth camera that has always one more image than was taken: faster than any disk."""

    address = "ahead:"
    rates_hz: ClassVar = {"depth": 30.0}

    def __init__(self) -> None:
        self.asked, self.closed = 0, False
        self.changed = threading.Condition()

    def read(self, timeout_s: float) -> DeviceReading:
        with self.changed:
            self.asked += 1
            self.changed.notify_all()
            stamp_ns = self.asked * 33_333_333
        return DeviceReading(stamp_ns, stamp_ns, DepthImage(np.full((424, 512), 1000, np.uint16)))

    def close(self) -> None:
        self.closed = True


def test_a_recording_that_is_slower_than_its_devices_still_ends(tmp_path, monkeypatch):
    camera, written = _Ahead(), 0

    class Slow(SessionWriter):
        def write_depth(self, *image) -> None:
            nonlocal written
            written += 1
            with camera.changed:
                # The image after this one is in the queue once the camera has been read twice more.
                camera.changed.wait_for(lambda: camera.closed or camera.asked > written + 1)

    monkeypatch.setattr(sensors.recording.recorder, "SessionWriter", Slow)
    rig = LiveRig("rig", [camera], RIG, {}, lambda address: camera)
    rig.record(tmp_path / "a.mcap")
    rig.start()
    while not written:
        time.sleep(0.01)
    before = written
    rig.end_recording()
    assert written - before <= 2 * BACKLOG
    rig.close()


def test_a_recording_without_devices_or_depth_is_refused_before_it_begins(
    annotate_cloud, tmp_path, monkeypatch
):
    monkeypatch.setattr("cli.rig_devices.Shown", lambda plate: SimpleNamespace(calibration=RIG))
    for options, match in (
        ((), "--rig"),
        (("--device", "webcam:0"), "webcam"),
        (("--device", SPOT, "--seconds", 0.5), "name a depth camera"),
    ):
        assert_refused(annotate_cloud("record", tmp_path / "a.mcap", *options), match)
    assert not list(tmp_path.iterdir())


def test_a_rig_file_is_read_up_to_the_bound(tmp_path, monkeypatch):
    path, text = tmp_path / "rig.toml", RIG_FILE + '[latency_ms]\n"virtual:kinect2" = 25\n'
    save_calibration(tmp_path / "rig.json", RIG)
    path.write_text(text)
    monkeypatch.setattr("sensors.recording.rig_file.MAX_BYTES", path.stat().st_size)
    assert load_rig(path) == RecordingRig("ward", (KINECT,), RIG, {KINECT: 25})
    path.write_text(text + " ")
    with pytest.raises(DeviceError, match="larger than"):
        load_rig(path)


RIG_FILE = 'name = "ward"\ncalibration = "rig.json"\ndevices = ["virtual:kinect2"]\n'


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ('colour = "kinect2"', "unknown key 'colour'"),
        ("devices = 3", "list of addresses"),
        ("devices = []", "names no devices"),
        ('devices = ["a:b", "a:b"]', "twice"),
        ('devices = ["a:b"]\n[latency_ms]\n"c" = 1', "not one of its devices"),
        ('devices = ["a:b"]\n[latency_ms]\n"a:b" = -1', "0 to 1000"),
        ("devices = [", "TOML"),
        ("devices." + "a." * 99 + "a = 1", "list of addresses"),
        (RIG_FILE, "rig.json"),
    ],
)
def test_a_wrong_rig_file_says_what_is_wrong(tmp_path, text, says):
    (tmp_path / "rig.toml").write_text(text)
    with pytest.raises((DeviceError, CalibrationError), match=says) as error:
        load_rig(tmp_path / "rig.toml")
    assert "\n" not in str(error.value).strip()


def test_a_device_is_opened_again_as_it_was_asked_for_and_has_its_latency(tmp_path, monkeypatch):
    """Its own address has its serial number and no options."""
    asked = []

    def opened(address, shown):
        asked.append(address)
        return Kinect2(shim=VirtualKinect2(FrameLoop(swinging_ball())).shim)

    monkeypatch.setattr("cli.rig_devices.open_device", opened)
    save_calibration(tmp_path / "rig.json", RIG)
    text = RIG_FILE.replace(KINECT, "kinect2:?turn=0") + '[latency_ms]\n"kinect2:?turn=0" = 25\n'
    (tmp_path / "rig.toml").write_text(text)
    with ExitStack() as stack:
        wanted, devices, _, again = opened_rig(tmp_path / "rig.toml", None, stack)
        assert clock_metadata(devices, wanted.latency_ms)["latency /depth/image"] == "25"
        again(devices[0].address).close()
    assert asked == ["kinect2:?turn=0"] * 2


def test_without_a_rig_file_the_depth_camera_s_own_calibration_is_recorded(
    annotate_cloud, tmp_path, monkeypatch
):
    """Only a camera that has started knows it."""
    twin = VirtualKinect2(FrameLoop(swinging_ball()))
    monkeypatch.setattr("cli.rig_devices.open_device", lambda address, shown: Kinect2(shim=twin.shim))
    done = annotate_cloud("record", tmp_path / "a.mcap", "--device", "kinect2:", "--seconds", 0.5, "--json")
    assert done.code == 0 and "calibrate" in done.err
    assert Session(tmp_path / "a.mcap").calibration.depth.fx == pytest.approx(KINECT2_DEPTH.fx)
