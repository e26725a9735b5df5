"""A running rig is recorded from key to key, through unplugged devices and a full disk."""

import errno
import gc
import itertools
import json
import shutil
import threading
import time
from collections.abc import Callable
from datetime import datetime
from types import SimpleNamespace

import numpy as np
import pytest

import sensors.recording.device_readers
import sensors.recording.live_rig
import sensors.recording.recorder
from annotate.label_recording import run
from annotate.labelset.nameless import person_code
from annotate.live.rig_warnings import rig_warnings
from sensors.device.protocol import DepthImage, DeviceReading, Spot
from sensors.errors import (
    CloudError,
    DeviceError,
    DeviceFaultError,
    DeviceLostError,
    DeviceNotFoundError,
    ExistsError,
)
from sensors.recording.device_readers import Intake
from sensors.recording.live_rig import LiveRig
from sensors.recording.playback import Playback
from sensors.rig.camera import Intrinsics
from sensors.rig.rig_calibration import RigCalibration
from sensors.session.reader import Session
from tests.helpers.labellers import CloudLabeller, no_person
from tests.helpers.slow_disk import on_disk_of

CAMERA = Intrinsics(8, 6, 10.0, 10.0, 3.5, 2.5)
PERIOD_S = 0.005
KINECT = Intrinsics(512, 424, 365.0, 365.0, 255.5, 211.5)


class Camera:
    """A depth camera of 200 small images a second that say their number, unplugged after so many."""

    address, serial, calibration = "kinect2:1", "1", None

    def __init__(self, images: float = float("inf"), numbers=None) -> None:
        self.rates_hz = {"depth": 1 / PERIOD_S}
        self._left, self._numbers = images, numbers or itertools.count(1)
        self._ended = threading.Event()

    def start(self) -> None:
        pass

    def read(self, timeout_s: float) -> DeviceReading | None:
        if self._ended.wait(PERIOD_S) or self._left <= 0:
            raise DeviceLostError(f"{self.address} was unplugged")
        self._left -= 1
        image = np.full(CAMERA.shape, next(self._numbers), np.uint16)
        now_ns = time.monotonic_ns()
        return DeviceReading(now_ns, now_ns, DepthImage(image))

    def close(self) -> None:
        self._ended.set()


class Pyrometer(Camera):
    """A pyrometer that never fails."""

    address = "pyrometer:1"

    def __init__(self) -> None:
        super().__init__()
        self.rates_hz = {"pyrometer": 1 / PERIOD_S}

    def read(self, timeout_s: float) -> DeviceReading | None:
        reading = super().read(timeout_s)
        return DeviceReading(reading.stamp_ns, reading.arrival_ns, Spot(33.0, 30.0, 30.0))


def never(address: str):
    raise DeviceNotFoundError(f"{address} is not there")


def wait_for(what: Callable[[], bool]) -> None:
    """Wait until something is so; a test that has waited long enough fails."""
    end_s = time.monotonic() + 30
    while not what():
        assert time.monotonic() < end_s
        time.sleep(0.002)


@pytest.fixture
def rig_of(monkeypatch):
    """Makes rigs that run, and ends them."""
    monkeypatch.setattr(sensors.recording.device_readers, "REOPEN_S", 0.01)
    made = []

    def make(*devices, reopen=never) -> LiveRig:
        made.append(LiveRig("ward", devices, RigCalibration(CAMERA), {}, reopen))
        made[-1].start()
        return made[-1]

    yield make
    for rig in made:
        rig.close()


def numbers_in(path) -> list[int]:
    return [int(frame.depth_mm[0, 0]) for frame in Session(path)]


def test_recordings_from_key_to_key_have_no_gap_and_the_name_of_the_person(rig_of, tmp_path, annotate_cloud):
    rig, before = rig_of(Camera(), Pyrometer()), datetime.now().astimezone().replace(microsecond=0)
    for name in ("a.mcap", "b.mcap"):
        rig.record(tmp_path / name, subject="anna")
        begun, measured = rig.frames.count, rig.health().streams["pyrometer"].count
        wait_for(lambda begun=begun: rig.frames.count > begun + 20)
        wait_for(lambda measured=measured: rig.health().streams["pyrometer"].count > measured + 2)
        rig.mark("sits down")
        assert rig.end_recording() == tmp_path / name
    assert rig.end_recording() is None
    for name in ("a.mcap", "b.mcap"):
        session, numbers = Session(tmp_path / name), numbers_in(tmp_path / name)
        assert len(numbers) >= 20 and numbers == list(range(numbers[0], numbers[0] + len(numbers)))
        assert not session.truncated and session.metadata["subject"] == "anna"
        assert [text for _, text in session.events] == ["sits down"]
        assert np.isfinite(session.reference_c).any()
    info = json.loads(annotate_cloud("info", tmp_path / "a.mcap", "--json").out)
    assert info["subject"] == "anna" and "anna" in annotate_cloud("info", tmp_path / "a.mcap").out
    assert before <= datetime.fromisoformat(info["started"]) <= datetime.now().astimezone()
    made = run(Session(tmp_path / "a.mcap"), {}, tmp_path / "l", CloudLabeller(no_person), lambda n: None)
    assert len(made.labels) and {frame.subject for frame in made.labels} == {person_code("anna")}


def test_the_collector_passes_over_what_was_there_while_devices_are_read(rig_of, tmp_path):
    rig = rig_of(Camera())
    wait_for(lambda: rig.frames.count > 0)
    before = gc.get_freeze_count()
    loaded = [[] for _ in range(1000)]
    rig.record(tmp_path / "a.mcap")
    assert gc.get_freeze_count() >= before + len(loaded) > 10_000
    rig.close()
    assert gc.get_freeze_count() == 0


def test_nothing_is_recorded_twice_at_once_or_over_something(rig_of, tmp_path):
    rig = rig_of(Camera())
    (tmp_path / "old.mcap").write_text("old")
    with pytest.raises(ExistsError, match="old"):
        rig.record(tmp_path / "old.mcap")
    assert rig.health().recording is None
    rig.record(tmp_path / "a.mcap")
    with pytest.raises(CloudError, match="being recorded"):
        rig.record(tmp_path / "b.mcap")
    assert rig.health().recording == tmp_path / "a.mcap" and not (tmp_path / "b.mcap").exists()


def test_an_unplugged_camera_is_missed_and_recorded_again_when_it_is_back(rig_of, tmp_path):
    numbers, back = itertools.count(1), threading.Event()

    def reopen(address: str) -> Camera:
        return Camera(numbers=numbers) if back.is_set() else never(address)

    rig = rig_of(Camera(30, numbers), reopen=reopen)
    rig.record(tmp_path / "a.mcap")
    wait_for(lambda: bool(rig.health().away))
    (warning,) = rig_warnings(rig.health())
    assert warning.kind == "away" and "plug it in again" in warning.text
    back.set()
    wait_for(lambda: rig.frames.count > 40)
    assert not rig.health().away
    rig.close()
    session, recorded = Session(tmp_path / "a.mcap"), numbers_in(tmp_path / "a.mcap")
    assert recorded == list(range(recorded[0], recorded[0] + len(recorded))) and recorded[-1] > 35
    texts = [text for _, text in session.events]
    assert texts == ["kinect2:1 was unplugged", "kinect2:1 is back"]
    stamps = [frame.stamp_ns for frame in session]
    assert stamps == sorted(stamps)


def test_a_full_disk_ends_the_recording_keeps_what_came_and_the_rig_runs_on(rig_of, tmp_path, monkeypatch):
    rig, write = rig_of(Camera()), sensors.recording.recorder.write_item
    written = itertools.count()

    def full(writer, item, infrared) -> None:
        if next(written) >= 10:
            raise OSError(errno.ENOSPC, "No space left on device")
        write(writer, item, infrared)

    monkeypatch.setattr(sensors.recording.recorder, "write_item", full)
    rig.record(tmp_path / "a.mcap")
    wait_for(lambda: bool(rig.health().trouble))
    (warning,) = rig_warnings(rig.health())
    assert "No space left" in warning.text and "a.mcap.partial" in warning.text
    assert rig.health().recording is None
    seen = rig.frames.count
    wait_for(lambda: rig.frames.count > seen + 3)
    assert len(numbers_in(tmp_path / "a.mcap.partial")) == 10 == rig.last_take.frames


class Kinect(Camera):
    """A camera of 434 kB an image that no disk compresses."""

    def __init__(self, rate_hz: float) -> None:
        super().__init__()
        self.rates_hz, self._period_s = {"depth": rate_hz}, 1 / rate_hz
        self._noise = np.random.default_rng(0).integers(1, 1 << 15, KINECT.shape, np.uint16)

    def read(self, timeout_s: float) -> DeviceReading | None:
        if self._ended.wait(self._period_s):
            return None
        image, now_ns = self._noise.copy(), time.monotonic_ns()
        image[0, 0] = next(self._numbers)
        return DeviceReading(now_ns, now_ns, DepthImage(image))


@pytest.mark.parametrize(("rate_hz", "too_slow"), [(30, False), (200, True)])
def test_a_disk_of_20_mb_a_second_loses_nothing_or_it_is_said(
    rig_of, tmp_path, monkeypatch, rate_hz, too_slow
):
    """13 MB a second fit, 87 do not."""
    if too_slow:
        monkeypatch.setattr(sensors.recording.device_readers, "BACKLOG", 8)
        monkeypatch.setattr(sensors.recording.device_readers, "BACKLOG_S", 0.0)
    monkeypatch.setattr(sensors.recording.recorder, "SessionWriter", on_disk_of(20e6))
    monkeypatch.setattr(shutil, "disk_usage", lambda folder: SimpleNamespace(free=10**13))
    rig = LiveRig("ward", [Kinect(rate_hz)], RigCalibration(KINECT), {}, never)
    rig.start()
    try:
        rig.record(tmp_path / "a.mcap")
        wait_for(lambda: rig.frames.count > 12)
        if too_slow:
            wait_for(lambda: any(c.kind == "drops" for c in rig_warnings(rig.health())))
        said = [warning.text for warning in rig_warnings(rig.health())]
    finally:
        rig.close()
    numbers, dropped = numbers_in(tmp_path / "a.mcap"), rig.health().dropped
    missing = numbers[-1] - numbers[0] + 1 - len(numbers)
    assert len(numbers) > 8 and (missing > 0) == too_slow and missing <= dropped
    assert too_slow == bool(dropped)
    assert [text for text in said if "the disk is too slow" in text] == said and too_slow == bool(said)


def test_a_nearly_full_disk_ends_the_recording_in_time(rig_of, tmp_path, monkeypatch):
    monkeypatch.setattr(sensors.recording.live_rig, "DISK_S", 0.05)
    rig = rig_of(Camera())
    rig.record(tmp_path / "a.mcap")
    begun = rig.frames.count
    wait_for(lambda: rig.frames.count > begun + 5)
    monkeypatch.setattr(sensors.recording.recorder, "RESERVE_BYTES", 1 << 62)
    wait_for(lambda: bool(rig.health().trouble))
    rig.close()
    assert not Session(tmp_path / "a.mcap").truncated


def test_a_recording_that_cannot_be_finished_is_trouble(rig_of, tmp_path, monkeypatch):
    rig = rig_of(Camera())
    rig.record(tmp_path / "a.mcap")
    wait_for(lambda: rig.frames.count > 3)

    def full(number: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("sensors.session.writer.os.fsync", full)
    with pytest.raises(OSError, match="No space"):
        rig.end_recording()
    assert "a.mcap.partial" in rig.health().trouble and rig.health().recording is None


def test_what_a_device_sends_wrong_is_said_with_its_remedy(rig_of):
    camera = Camera()
    rig = rig_of(camera)
    wait_for(lambda: rig.frames.count > 3)
    assert not rig.health().faults

    def faulty(timeout_s: float) -> None:
        camera._ended.wait(PERIOD_S)
        raise DeviceFaultError("its gain control is on; switch it off")

    camera.read = faulty
    wait_for(lambda: bool(rig.health().faults))
    said = {warning.kind: warning.text for warning in rig_warnings(rig.health())}
    assert said["fault"] == "its gain control is on; switch it off"


def test_a_rig_that_was_never_started_gives_its_devices_back():
    camera = Camera()
    LiveRig("ward", [camera], RigCalibration(CAMERA), {}, never).close()
    assert camera._ended.is_set()


def test_a_camera_comes_back_whatever_its_library_raises_meanwhile(rig_of):
    attempts = itertools.count()

    def reopen(address: str) -> Camera:
        if next(attempts) < 2:
            raise RuntimeError("failed to set power state")
        return Camera()

    gone = Camera(3)
    gone.close = lambda: reopen("")
    rig = rig_of(gone, reopen=reopen)
    wait_for(lambda: rig.frames.count > 3)


def test_a_loss_comes_through_a_full_queue(monkeypatch):
    monkeypatch.setattr(sensors.recording.device_readers, "READ_S", 0.01)
    monkeypatch.setattr(sensors.recording.device_readers, "BACKLOG", 2)
    camera = Camera(5)
    camera.rates_hz = {"depth": 1.0}
    with Intake([camera], never) as intake:
        # The queue is full when the camera is lost, and for some time after.
        camera._ended.wait(0.3)
        wait_for(lambda: bool(intake.drain()) and camera.address in intake.away)
        assert not intake.drain()


def test_a_camera_in_another_mode_ends_the_rig_at_once_and_leaves_nothing(rig_of, tmp_path):
    """The file would be unreadable, so this is not the fault of one image."""
    rig = LiveRig("ward", [Camera()], RigCalibration(Intrinsics(9, 6, 10.0, 10.0, 3.5, 2.5)), {}, never)
    rig.record(tmp_path / "a.mcap")
    rig.start()
    wait_for(lambda: rig.frames.ended)
    rig.close()
    assert isinstance(rig.error, CloudError) and "8x6 instead of 9x6" in str(rig.error)
    assert rig.health().recording is None and not list(tmp_path.iterdir())
    with pytest.raises(CloudError, match="ward has stopped"):
        rig.record(tmp_path / "b.mcap")
    assert not list(tmp_path.iterdir())


def test_a_rig_needs_each_stream_once_and_depth_and_a_playback_is_not_recorded(rig_session, tmp_path):
    for devices, match in (([Pyrometer()], "depth"), ([Camera(), Camera()], "both give depth")):
        with pytest.raises(DeviceError, match=match):
            LiveRig("ward", devices, RigCalibration(CAMERA), {}, never)
    with pytest.raises(CloudError, match="played back"):
        Playback(Session(rig_session)).record(tmp_path / "a.mcap")
