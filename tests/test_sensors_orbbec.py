"""Orbbec: the driver by pyorbbecsdk's names and on the SDK's playback, and recordings of the SDK."""

import struct
import sys
from contextlib import closing, suppress
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from sensors.calibration_files.lens_models import intrinsics_from_rational
from sensors.drivers.orbbec import Orbbec, depth_of, load_sdk
from sensors.errors import (
    CalibrationError,
    DeviceFaultError,
    DeviceLostError,
    DeviceNotFoundError,
    FormatError,
)
from sensors.importers.bags import orbbec
from sensors.importers.bags.orbbec import OrbbecRecording
from sensors.importers.open_source import open_source
from sensors.importers.options import ImportOptions
from sensors.recording.open_device import find_devices, open_device
from sensors.rig.camera import Intrinsics, project
from sensors.session.reader import Session
from tests.helpers import orbbec_files
from tests.helpers.orbbec_files import SHIFT_MM, jpeg_of, write_orbbec_bag

DEPTH_LENS = Intrinsics(64, 58, 50.4, 50.4, 32.0, 33.0, 0.1)
COLOR_LENS = Intrinsics(96, 54, 55.0, 55.0, 48.0, 27.0, 0.08)


def frames(count=5):
    rng = np.random.default_rng(0)
    return [
        (n, 1_000_000 + 33_333 * n, *rng.integers(0, 4000, (2, *DEPTH_LENS.shape), np.uint16),
         jpeg_of(COLOR_LENS, 40 + n))
        for n in range(count)
    ]  # fmt: skip


def bag(folder, recorded=None):
    return write_orbbec_bag(folder / "bolt.bag", DEPTH_LENS, COLOR_LENS, recorded or frames())


def test_a_recording_becomes_a_session_by_one_command_to_the_bit(tmp_path, annotate_cloud):
    recorded, out = frames(), tmp_path / "bolt.mcap"
    done = annotate_cloud("import", bag(tmp_path, recorded), out)
    assert done.code == 0, done.err
    session = Session(out)
    assert len(session) == len(recorded)
    for frame, (_, stamp_us, depth, infrared, jpeg) in zip(session, recorded, strict=True):
        np.testing.assert_array_equal(frame.depth_mm, depth)
        np.testing.assert_array_equal(frame.infrared, infrared)
        assert frame.color_encoded == jpeg
        assert frame.stamp_ns == 1000 * stamp_us
    found = session.calibration
    assert found.depth.fx == pytest.approx(50.4) and found.color.cx == 48.0
    assert found.depth.k1 == pytest.approx(0.1, abs=1e-3)
    np.testing.assert_allclose(found.color_from_depth.translation_m, np.array(SHIFT_MM) / 1000, rtol=1e-6)


def test_lost_images_are_counted_and_the_order_is_that_of_time(tmp_path):
    recorded = frames(6)
    source = open_source(bag(tmp_path, [recorded[n] for n in (4, 0, 1, 5)]))
    assert isinstance(source, OrbbecRecording)
    assert "2 depth images were lost while it was recorded" in source.notes
    assert [frame.stamp_ns for frame in source] == [1000 * recorded[n][1] for n in (0, 1, 4, 5)]


@pytest.mark.parametrize(("unit", "note"), [(0.5, False), (2.2e-44, True)])
def test_the_unit_of_depth_counts_where_there_is_one(tmp_path, monkeypatch, unit, note):
    """Some versions of the SDK write another thing in its place."""
    message = orbbec_files.image_message
    plain = struct.pack("<f", 1.0)

    def with_unit(number, stamp_us, pixels, encoding, shape):
        data = message(number, stamp_us, pixels, encoding, shape)
        at = len(data) - struct.calcsize("<fQQQQII")
        assert data[at : at + 4] == plain
        return data[:at] + struct.pack("<f", unit) + data[at + 4 :]

    monkeypatch.setattr(orbbec_files, "image_message", with_unit)
    (number, stamp_us, depth, *rest) = frames(1)[0]
    source = open_source(bag(tmp_path, [(number, stamp_us, depth // 2 * 2, *rest)]))
    expected = depth // 2 * 2 if note else depth // 2
    np.testing.assert_array_equal(next(iter(source)).depth_mm, expected)
    assert ("no depth unit in the recording" in source.notes) == note


def test_without_a_pose_colour_is_kept_but_not_fused(tmp_path, monkeypatch):
    """The SDK writes zeros for an unknown pose."""
    profile = orbbec_files.profile_message

    def without_pose(stream, *rest):
        data = profile(stream, *rest)
        start = 16 + 2
        return data[:start] + bytes(48) + data[start + 48 :]

    monkeypatch.setattr(orbbec_files, "profile_message", without_pose)
    source = open_source(bag(tmp_path))
    assert source.calibration.color is None
    assert next(iter(source)).color_encoded is not None
    assert "no calibration of the colour camera: its images cannot be fused" in source.notes


def test_what_lacks_a_lens_or_depth_is_refused_in_one_line(tmp_path, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(orbbec, "_profile", lambda data: ())
        with pytest.raises(CalibrationError, match="no intrinsics of the depth camera"):
            open_source(bag(tmp_path))
        (tmp_path / "bolt.bag").unlink()
    monkeypatch.setattr(orbbec_files, "DEPTH", 7)
    with pytest.raises(FormatError, match="has no depth images"):
        open_source(bag(tmp_path))


def test_a_cut_message_is_damage(tmp_path, monkeypatch):
    message = orbbec_files.image_message
    monkeypatch.setattr(orbbec_files, "image_message", lambda *a: message(*a)[:200])
    with pytest.raises(FormatError, match="cannot be read"):
        open_source(bag(tmp_path))


def test_declared_intrinsics_of_any_dialect_replace_the_recording_s(tmp_path):
    """A matrix without a size is of the recording's images, and the notes name its file as their origin."""
    file = tmp_path / "K.txt"
    np.savetxt(file, Intrinsics(64, 58, 60, 61, 30, 29).matrix)
    path = bag(tmp_path)
    source = open_source(path, ImportOptions(intrinsics=file))
    assert source.calibration.depth == Intrinsics(64, 58, 60, 61, 30, 29)
    assert source.calibration.color == open_source(path).calibration.color
    assert [note for note in source.notes if "intrinsics" in note] == [
        "depth intrinsics from K.txt, as declared"
    ]


# --- the driver ------------------------------------------------------------------------------------


def methods(**values):
    """An object whose methods return these values."""
    return SimpleNamespace(**{name: (lambda *_, v=value: v) for name, value in values.items()})


class FakeOrbbec:
    """pyorbbecsdk's own names (its stub file), with one camera of two framesets."""

    class OBError(Exception):
        pass

    OBSensorType = SimpleNamespace(COLOR_SENSOR=2, DEPTH_SENSOR=3, IR_SENSOR=1, LEFT_IR_SENSOR=9)
    OBFrameType = SimpleNamespace(IR_FRAME=1, LEFT_IR_FRAME=9)
    OBFormat = SimpleNamespace(MJPG=5)
    OBPropertyID = SimpleNamespace(
        **{f"OB_PROP_{n}_{c}_BOOL": (n, c) for n in ("DEPTH", "COLOR", "IR") for c in ("MIRROR", "FLIP")}
    )
    OBPermissionType = SimpleNamespace(PERMISSION_WRITE=2)
    __spec__ = ModuleSpec("pyorbbecsdk", None)
    stamped = True

    class Device:
        """A camera whose viewer has left the depth image mirrored; infrared has no such setting."""

        def __init__(self):
            self.on = {("DEPTH", "MIRROR"): True, ("DEPTH", "FLIP"): True, ("COLOR", "MIRROR"): False}

        def is_property_supported(self, setting, permission):
            assert permission == 2
            return setting in self.on

        def set_bool_property(self, setting, value):
            self.on[setting] = value

    class Config:
        def enable_stream(self, profile):
            assert profile.name in ("color 1920x1080", "depth")

    class Context:
        def __init__(self, config: str):
            assert "<EnumerateNetDevice>false<" in Path(config).read_text()

        def query_devices(self):
            names = ("get_device_serial_number_by_index", "get_device_by_serial_number")
            return methods(get_count=1, **dict.fromkeys(names, "CP1"))

    class Pipeline:
        def __init__(self, device):
            self.left, self.device = 2, FakeOrbbec.Device()

        def get_device(self):
            return self.device

        def get_stream_profile_list(self, sensor):
            return SimpleNamespace(
                get_video_stream_profile=lambda width, height, form, hz: SimpleNamespace(
                    name=f"color {width}x{height}", get_fps=lambda: hz
                ),
                get_default_video_stream_profile=lambda: SimpleNamespace(name="depth", get_fps=lambda: 15),
            )

        def start(self, config):
            pass

        def stop(self):
            pass

        def get_camera_param(self):
            lens = SimpleNamespace(fx=500.0, fy=500.0, cx=320.0, cy=288.0, width=640, height=576)
            none = SimpleNamespace(**dict.fromkeys(("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"), 0.0))
            pose = SimpleNamespace(rot=np.eye(3), transform=np.array([-32.0, 0, 0]))
            lenses = dict.fromkeys(("depth_intrinsic", "rgb_intrinsic"), lens)
            lenses |= dict.fromkeys(("depth_distortion", "rgb_distortion"), none)
            return SimpleNamespace(**lenses, transform=pose)

        def wait_for_frames(self, timeout_ms):
            self.left -= 1
            if self.left < 0:
                return None
            turns = [self.device.on["DEPTH", change] for change in ("FLIP", "MIRROR")]
            image = np.flip(np.arange(6, dtype="<u2").reshape(2, 3), np.flatnonzero(turns))
            frame = methods(
                get_height=2,
                get_width=3,
                get_data=np.ascontiguousarray(image).view(np.uint8),
                get_depth_scale=0.5,
                get_timestamp_us=(10**6 - 66_667 * self.left) * FakeOrbbec.stamped,
            )
            return methods(get_depth_frame=frame, get_color_frame=None, get_frame=None)


@pytest.mark.parametrize("stamped", [True, False])
def test_a_camera_by_pyorbbecsdks_names(monkeypatch, stamped):
    """A camera without a clock is stamped by arrival (orbbec/OrbbecSDK issue 91)."""
    monkeypatch.setitem(sys.modules, "pyorbbecsdk", FakeOrbbec)
    monkeypatch.setattr(FakeOrbbec, "stamped", stamped)
    assert [found.address for found in find_devices() if found.kind == "orbbec"] == ["orbbec:CP1"]
    with closing(open_device("orbbec:CP1")) as device:
        device.start()
        np.testing.assert_allclose(device.calibration.color_from_depth.translation_m, (-0.032, 0, 0))
        first, second = device.read(0.5), device.read(0.5)
        np.testing.assert_array_equal(first.value.depth_mm, [[0, 0, 1], [2, 2, 2]])
        assert device.rates_hz == {"depth": 15.0, "color": 30.0}
        assert device.read(0.0) is None
    apart_ns = second.stamp_ns - first.stamp_ns
    if stamped:
        assert apart_ns == 66_667_000 and second.dropped == 0
    else:
        assert 0 < apart_ns < 10**9 and abs(second.arrival_ns - second.stamp_ns) < 10**9


def test_a_truncated_depth_frame_is_a_fault():
    frame = methods(get_height=2, get_width=3, get_data=np.zeros(10, np.uint8), get_depth_scale=1.0)
    with pytest.raises(DeviceFaultError, match="image has 5 pixels, not 3x2; wait for the next"):
        depth_of(frame)


def test_a_rational_lens_becomes_the_polynomial_one():
    """The depth camera of an Azure Kinect, within a twentieth of a pixel over the whole image."""
    coefficients = np.array([0.7, 0.3, 1e-4, -5e-5, 0.015, 1.03, 0.46, 0.08])
    matrix = np.array([[504.0, 0, 320], [0, 504.0, 330], [0, 0, 1]])
    camera = intrinsics_from_rational((640, 576), matrix, coefficients)
    v, u = np.mgrid[-0.6:0.6:25j, -0.6:0.6:25j]
    points = np.stack([u, v, np.ones_like(u)], axis=-1).reshape(-1, 3)
    expected = cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix, coefficients)[0].reshape(-1, 2)
    inside = ((expected >= 0) & (expected < (640, 576))).all(axis=-1)
    assert inside.mean() > 0.5
    np.testing.assert_allclose(project(camera, points)[inside], expected[inside], atol=0.05)


def played_by_orbbec(sdk, path, count):
    """Readings of ``count`` depth and of ``count`` colour images, or of those before the SDK fell silent."""
    with closing(Orbbec(pipeline=sdk.Pipeline(sdk.PlaybackDevice(str(path))))) as device:
        device.start()
        assert device.address == "orbbec:CL8TEST"
        assert (device.calibration.depth.fx, device.calibration.color.cx) == (504.0, 960.0)
        np.testing.assert_allclose(device.calibration.color_from_depth.translation_m, (-0.032, -0.002, 0.004))
        readings = []
        with suppress(DeviceLostError):
            while len(readings) < 2 * count:
                if (reading := device.read(5.0)) is not None:
                    readings.append(reading)
    return readings


def test_the_driver_reads_what_orbbecs_sdk_plays(tmp_path):
    """A Femto Bolt's recording, written as the SDK writes it: all comes, bit for bit, and losses are counted.

    On a busy machine the SDK drops other images each time it plays, and then waits for ever. It is played
    until all have come. Its streams start one after the other, so the first infrared image may be missing.
    """
    try:
        sdk = load_sdk()
    except DeviceNotFoundError as error:
        pytest.skip(str(error))
    depth_lens = Intrinsics(640, 576, 504.0, 504.0, 320.0, 330.0, 0.1)
    color_lens = Intrinsics(1920, 1080, 1100.0, 1100.0, 960.0, 540.0, 0.08)
    rng, frames = np.random.default_rng(0), []
    for number in range(6):
        depth, infrared = rng.integers(0, 4000, (2, 576, 640), np.uint16)
        stamp_us = 1_000_000 + 33_333 * number
        frames.append((number, stamp_us, depth, infrared, jpeg_of(color_lens, 40 + number)))
    path = write_orbbec_bag(tmp_path / "bolt.bag", depth_lens, color_lens, frames)
    numbers = {1000 * stamp_us: number for number, stamp_us, *_ in frames}
    missing = {(kind, number) for kind in ("depth", "color", "infrared") for number in range(6)}
    missing.remove(("infrared", 0))
    for _ in range(12):
        before: dict[str, int] = {}
        for reading in played_by_orbbec(sdk, path, len(frames)):
            number, stream = numbers[reading.stamp_ns], reading.value.stream
            assert reading.dropped == number - before.get(stream, number - 1) - 1
            before[stream] = number
            missing.discard((stream, number))
            _, _, depth, infrared, jpeg = frames[number]
            if stream == "color":
                assert reading.value.encoded[: len(jpeg)] == jpeg
                continue
            np.testing.assert_array_equal(reading.value.depth_mm, depth)
            if reading.value.infrared is not None:
                np.testing.assert_array_equal(reading.value.infrared, infrared)
                missing.discard(("infrared", number))
        if not missing:
            break
    assert not missing
