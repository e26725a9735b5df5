"""Faults while recording: one bad image is left out, a wrong mode is refused, a device comes back."""

import itertools
import json
import threading
import time
from collections.abc import Callable, Iterator

import cv2
import numpy as np
import pytest

import sensors.recording.device_readers
from sensors.device.protocol import ColorImage, DepthImage, DeviceReading, Flag, ThermalImage
from sensors.errors import DeviceLostError, DeviceNotFoundError
from sensors.recording.stream_health import in_words
from sensors.rig.camera import Intrinsics
from sensors.rig.rig_calibration import Pose, RigCalibration
from sensors.session.reader import Session
from tests.conftest import assert_refused

DEPTH, COLOR, WARM = Intrinsics(8, 6, 10, 10, 3.5, 2.5), Intrinsics(16, 12, 20, 20, 8, 6), (4, 5)
THERMAL = Intrinsics(WARM[1], WARM[0], 5, 5, 2, 1.5)
RIG = RigCalibration(DEPTH, COLOR, Pose.identity(), THERMAL, Pose.identity())
PERIOD_S = 0.003
PICTURE = cv2.imencode(".jpg", np.full((*COLOR.shape, 3), 90, np.uint8))[1].tobytes()
SMALL = cv2.imencode(".jpg", np.full((8, 8, 3), 90, np.uint8))[1].tobytes()
GOOD = {
    "depth": DepthImage(np.full(DEPTH.shape, 1000, np.uint16)),
    "color": ColorImage(PICTURE),
    "thermal": ThermalImage(np.full(WARM, 30, np.float32), Flag.OPEN),
}
BAD = {
    "an empty colour image": ColorImage(b""),
    "a garbled colour image": ColorImage(bytes(range(256))),
    "a colour image without its header": ColorImage(PICTURE[40:]),
    "a colour image that is cut off": ColorImage(PICTURE[:-40]),
    "a colour image of another size": ColorImage(SMALL),
    "an empty depth image": DepthImage(np.zeros((0, 0), np.uint16)),
    "a depth image of another size": DepthImage(np.full((6, 7), 900, np.uint16)),
    "a depth image of one row": DepthImage(np.full(48, 900, np.uint16)),
    "infrared of another size": DepthImage(np.full(DEPTH.shape, 900, np.uint16), np.ones((3, 4), np.uint16)),
    "a thermal image of another size": ThermalImage(np.full((5, 5), 20, np.float32), Flag.OPEN),
    "a thermal image of another size, all NaN": ThermalImage(np.full((9, 9), np.nan, np.float32), Flag.OPEN),
    "an empty thermal image": ThermalImage(np.zeros((0, 5), np.float32), Flag.OPEN),
}


class Camera:
    """All three cameras in one, in turn; ``values``: images, None = the camera is gone."""

    address, serial, calibration = "cameras:1", "1", RIG

    def __init__(self, values: Iterator | None = None) -> None:
        self.rates_hz = dict.fromkeys(GOOD, 1 / PERIOD_S / 3)
        self._values, self._ended = values or itertools.cycle(GOOD.values()), threading.Event()

    def start(self) -> None:
        pass

    def read(self, timeout_s: float) -> DeviceReading:
        value = next(self._values)
        if value is None or self._ended.wait(PERIOD_S):
            raise DeviceLostError(f"{self.address} was unplugged")
        now_ns = time.monotonic_ns()
        return DeviceReading(now_ns, now_ns, value)

    def close(self) -> None:
        self._ended.set()


@pytest.fixture
def recorded(annotate_cloud, tmp_path, monkeypatch):
    """Runs the real ``record`` with cameras that are opened one after another."""

    def run(open_one: Callable[[], Camera], *options: object):
        monkeypatch.setattr("cli.rig_devices.open_device", lambda address, shown: open_one())
        monkeypatch.setattr(sensors.recording.device_readers, "REOPEN_S", 0.05)
        return annotate_cloud("record", tmp_path / "a.mcap", "--device", "kinect2:", "--json", *options)

    return run


@pytest.mark.parametrize("bad", BAD.values(), ids=BAD.keys())
def test_one_bad_image_is_left_out_noted_and_counted(recorded, tmp_path, bad):
    good = itertools.cycle(GOOD.values())
    done = recorded(
        lambda: Camera(itertools.chain(itertools.islice(good, 30), [bad], good)), "--seconds", 0.6
    )
    assert done.code == 0, done.err
    told, session = json.loads(done.out), Session(tmp_path / "a.mcap")
    assert told["streams"][bad.stream]["left_out"] == 1 and told["dropped"] == 0
    assert {name for name, stream in told["streams"].items() if stream["left_out"]} == {bad.stream}
    (note,) = (text for _, text in session.events if "left out" in text)
    assert note in told["events"] and note.startswith({"color": "colour"}.get(bad.stream, bad.stream))
    assert len(session) == told["frames"] > 10
    frames = list(session)
    assert all((frame.depth_mm == 1000).all() for frame in frames)
    assert all(frame.color_encoded in (PICTURE, None) for frame in frames)


@pytest.mark.parametrize("bad", BAD.values(), ids=BAD.keys())
def test_a_camera_that_sends_nothing_else_is_refused_at_once_and_nothing_is_left(recorded, tmp_path, bad):
    values = GOOD | {bad.stream: bad}
    done = recorded(lambda: Camera(itertools.cycle(values.values())), "--seconds", 60)
    assert_refused(done, "images are unusable, the last one is", remarks=1)
    assert not list(tmp_path.iterdir())


def test_a_camera_that_turns_bad_later_is_told_and_the_others_go_on(recorded, tmp_path):
    good, broken = itertools.cycle(GOOD.values()), GOOD | {"color": ColorImage(b"")}
    values = itertools.chain(itertools.islice(good, 30), itertools.cycle(broken.values()))
    done = recorded(lambda: Camera(values), "--seconds", 3.5)
    told = json.loads(done.out)
    assert done.code == 0 and told["streams"]["color"]["count"] == 10 < told["streams"]["color"]["left_out"]
    assert told["frames"] > 40
    assert "colour: no image for" in done.err and "left out" in done.err


def test_a_depth_camera_that_stays_away_is_told(recorded, tmp_path):
    cameras = iter([Camera(itertools.chain(itertools.islice(itertools.cycle(GOOD.values()), 60), [None]))])

    def opened() -> Camera:
        if camera := next(cameras, None):
            return camera
        raise DeviceNotFoundError("it is not there")

    done = recorded(opened, "--seconds", 3.5)
    told = json.loads(done.out)
    assert done.code == 3 and told["ended"] == "lost" and told["frames"] == 20
    assert "cameras:1 is gone: plug it in again" in done.err
    assert len(Session(tmp_path / "a.mcap")) == 20


def test_a_library_that_raises_anything_is_a_device_that_is_lost(recorded, tmp_path):
    def failing() -> Iterator:
        yield from itertools.islice(itertools.cycle(GOOD.values()), 30)
        raise ValueError("cannot reshape array of size 7")

    cameras = iter([Camera(failing()), Camera()])
    done = recorded(lambda: next(cameras), "--seconds", 1.2)
    told = json.loads(done.out)
    assert done.code == 0 and told["frames"] > 30
    assert any("cannot reshape" in text for text in told["events"])


def test_a_thermal_image_without_temperatures_is_described_without_a_warning(recwarn):
    assert in_words(ThermalImage(np.full(WARM, np.nan, np.float32), Flag.OPEN)) == "no temperatures"
    assert not recwarn


def test_a_file_that_came_to_the_recording_s_name_stays_and_is_named(recorded, tmp_path):
    def squatting() -> Iterator:
        yield from itertools.islice(itertools.cycle(GOOD.values()), 30)
        (tmp_path / "a.mcap").write_bytes(b"precious")
        yield from itertools.cycle(GOOD.values())

    done = recorded(lambda: Camera(squatting()), "--seconds", 0.5)
    told, partial = json.loads(done.out), tmp_path / "a.mcap.partial"
    assert done.code == 3 and done.err.splitlines()[-1].endswith("rename it")
    assert (tmp_path / "a.mcap").read_bytes() == b"precious"
    session = Session(partial)
    assert not session.truncated and len(session) == told["frames"] > 10


@pytest.mark.parametrize("moved", [True, False], ids=["moved", "removed"])
def test_a_recording_whose_file_is_moved_or_removed_ends_within_seconds(recorded, tmp_path, moved):
    def meddling() -> Iterator:
        yield from itertools.islice(itertools.cycle(GOOD.values()), 30)
        partial = tmp_path / "a.mcap.partial"
        partial.rename(tmp_path / "b.mcap") if moved else partial.unlink()
        yield from itertools.cycle(GOOD.values())

    done = recorded(lambda: Camera(meddling()), "--seconds", 60)
    told = json.loads(done.out)
    assert done.code == 3 and told["ended"] == "disk" and told["seconds"] < 30
    assert "was moved or removed while it was written" in done.err.splitlines()[-1]
    assert {path.name for path in tmp_path.iterdir()} == ({"b.mcap"} if moved else set())
    if moved:
        assert len(Session(tmp_path / "b.mcap")) == told["frames"]
