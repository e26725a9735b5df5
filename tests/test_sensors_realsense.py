"""RealSense: the driver through the SDK's own software device, and recordings that the SDK makes."""

from contextlib import closing
from dataclasses import replace

import cv2
import numpy as np
import pytest

from sensors.calibration_files.lens_models import realsense_intrinsics
from sensors.drivers import realsense
from sensors.drivers.realsense import PRESETS, QUEUE, USB_IDS, RealSense, Settings, realsense_serials
from sensors.errors import CalibrationError, CloudError, DeviceAccessError, DeviceError, DeviceLostError
from sensors.importers.bags.realsense import RealSenseRecording
from sensors.importers.open_source import open_source
from sensors.recording import open_device as open_device_module
from sensors.recording.open_device import find_devices, open_device
from sensors.rig.camera import Intrinsics, project
from sensors.virtual.frame_loop import FrameLoop
from sensors.virtual.realsense import COLOR_LATER_MS, FIRST_MS, VirtualRealSense
from sensors.virtual.schedule import Faults
from tests.helpers.swinging_ball import small_ball

rs = pytest.importorskip("pyrealsense2", reason="no pyrealsense2: pip install 'annotate-cloud[realsense]'")


@pytest.fixture
def twin():
    """A twin that shows only what ``show`` feeds."""
    made = still()
    yield made
    made.unplug()


def still(unit_mm=1.0, frames=small_ball):
    return VirtualRealSense(FrameLoop(frames()), Faults(drop=1.0), unit_mm)


def driver(twin, **settings):
    return RealSense(settings=Settings(twin.size, twin.color_size, **settings), context=twin)


def read_all(device):
    """Every reading that has come."""
    readings = []
    while (reading := device.read(0.05)) is not None:
        readings.append(reading)
    return readings


# --- the driver --------------------------------------------------------------------------------------


def test_a_thousand_frames_at_30_a_second_none_lost_and_stamps_kept(twin):
    """By the camera's clock, 33 s of depth, infrared and colour, through the SDK; the clock wraps around."""
    readings = []
    with closing(driver(twin)) as device:
        device.start()
        for number in range(1000):
            twin.show(number)
            readings += [device.read(5), device.read(5)]
    depth, color = ([r for r in readings if r.stream == stream] for stream in ("depth", "color"))
    assert len(depth) == len(color) == 1000 and not any(r.dropped for r in readings)
    wanted_ns = np.rint(1e3 * (FIRST_MS + np.arange(1000) / 30 * 1000)) * 1000
    np.testing.assert_allclose([r.stamp_ns for r in depth], wanted_ns, atol=1000)
    np.testing.assert_allclose([r.stamp_ns for r in color], wanted_ns + 1e6 * COLOR_LATER_MS, atol=1000)
    ball = small_ball()
    for number, reading in enumerate(depth):
        seen = ball[number % len(ball)]
        np.testing.assert_array_equal(reading.value.depth_mm, seen.depth_mm)
        np.testing.assert_array_equal(reading.value.infrared, seen.infrared >> 8)


def test_what_is_lost_is_counted_to_the_frame(twin):
    gone = {3, 4, 8}
    with closing(driver(twin)) as device:
        device.start()
        readings = []
        for number in sorted(set(range(10)) - gone):
            twin.show(number)
            readings += [device.read(5), device.read(5)]
    for stream in device.rates_hz:
        assert [r.dropped for r in readings if r.stream == stream] == [0, 0, 0, 2, 0, 0, 1]


def test_a_slow_reader_loses_old_frames_and_is_told(twin):
    with closing(driver(twin)) as device:
        device.start()
        for number in range(QUEUE):
            twin.show(number)
        readings = read_all(device)
    depth = [r for r in readings if r.stream == "depth"]
    # Losses before the first reading are unknown.
    assert 5 < len(depth) <= QUEUE // 3 + 1 and not any(r.dropped for r in depth[1:])


def test_depth_without_its_infrared_comes_all_the_same(twin, monkeypatch):
    """Half of an exposure may be lost; the other half waits no longer than until the next one comes."""
    with closing(driver(twin)) as device:
        device.start()
        with monkeypatch.context() as patch:
            patch.setattr(twin._scene, "infrared", lambda seconds: None)
            twin.show(0)
        twin.show(1)
        depth = [r.value for r in read_all(device) if r.stream == "depth"]
    assert [value.infrared is None for value in depth] == [True, False]


def test_a_camera_without_infrared_streams():
    bare = still(frames=lambda: [replace(frame, infrared=None) for frame in small_ball()])
    with closing(driver(bare)) as device:
        device.start()
        bare.show(0)
        assert [r.stream for r in read_all(device)] == ["depth", "color"]
    bare.unplug()


def test_the_depth_unit_is_asked_of_the_camera():
    """A D405 counts tenths of a millimetre."""
    fine = still(0.1)
    with closing(driver(fine)) as device:
        device.start()
        fine.show(0)
        depth = next(r.value.depth_mm for r in read_all(device) if r.stream == "depth")
    fine.unplug()
    assert device._unit_mm == 0.1
    np.testing.assert_array_equal(depth, small_ball()[0].depth_mm)


def test_colour_and_calibration(twin):
    with closing(driver(twin)) as device:
        assert device.calibration is None
        device.start()
        twin.show(0)
        color = next(r.value.encoded for r in read_all(device) if r.stream == "color")
        rig = device.calibration
    seen, got = (
        cv2.imdecode(np.frombuffer(image, np.uint8), cv2.IMREAD_COLOR).astype(int)
        for image in (small_ball()[0].color_encoded, color)
    )
    assert np.abs(seen - got).mean() < 3
    assert (rig.depth.width, rig.depth.height) == twin.size and not any(rig.depth.distortion)
    assert (rig.color.width, rig.color.height) == twin.color_size and any(rig.color.distortion)
    np.testing.assert_allclose(rig.color_from_depth.translation_m, (-0.059, 0, 0))


def test_settings_reach_the_camera_by_name(twin):
    with closing(driver(twin, preset=PRESETS["high-accuracy"], exposure_us=4000, laser_mw=90)):
        options = rs.option.visual_preset, rs.option.exposure, rs.option.laser_power
        assert [twin._stereo.get_option(option) for option in options] == [3, 4000, 90]
    for name, number in PRESETS.items():
        assert int(getattr(rs.rs400_visual_preset, name.replace("-", "_"))) == number


@pytest.mark.parametrize(
    ("settings", "match"),
    [
        ({"laser_mw": 91}, "refused laser 91; give 0 to 360 in steps of 30"),
        ({"size": (848, 480)}, "no depth images of 848x480 at 30 a second; choose 64x53$"),
        ({"color_size": (848, 480)}, "no colour images of 848x480 at 30 a second; choose 240x134"),
        ({"rate_hz": 6}, "at 6 a second; choose another rate"),
    ],
)
def test_what_the_camera_has_not_is_refused_with_what_it_has(twin, settings, match):
    wanted = replace(Settings(twin.size, twin.color_size), **settings)
    with pytest.raises(DeviceError, match=match):
        RealSense(settings=wanted, context=twin)
    # Nothing is left open.
    driver(twin).close()


def test_a_slow_socket_is_named(twin):
    twin.device.register_info(rs.camera_info.usb_type_descriptor, "2.1")
    with pytest.raises(DeviceError, match="or use a USB 3 port and cable: it is on USB 2"):
        RealSense(settings=Settings((848, 480)), context=twin)


def test_an_unplugged_camera_is_lost_at_once(twin):
    with closing(driver(twin)) as device:
        device.start()
        twin.show(0)
        read_all(device)
        twin.unplug()
        with pytest.raises(DeviceLostError, match="no longer connected; plug it in again"):
            device.read(5)
    with pytest.raises(DeviceError, match="no RealSense is plugged in"):
        driver(twin)


def test_cameras_are_listed_and_opened_by_serial_number(monkeypatch, twin):
    monkeypatch.setattr(rs, "context", lambda: twin)
    assert realsense_serials() == ["virtual"]
    assert "realsense:virtual" in [found.address for found in find_devices()]
    assert open_device_module.SIZES["848x480"] == Settings().size
    monkeypatch.setitem(open_device_module.SIZES, "848x480", twin.size)
    monkeypatch.setitem(open_device_module.SIZES, "1280x720", twin.color_size)
    with closing(open_device("realsense:?preset=hand&exposure=100&laser=0")) as device:
        assert device.address == "realsense:virtual" and twin._stereo.get_option(rs.option.laser_power) == 0


def test_without_a_udev_rule_and_without_the_library(monkeypatch, tmp_path):
    empty = type("Empty", (), {"query_devices": lambda self: []})
    monkeypatch.setattr(rs, "context", empty)

    def refuse(ids):
        assert ids == USB_IDS
        raise DeviceAccessError("belongs to root; install the device's udev rule")

    monkeypatch.setattr(realsense, "check_usb", refuse)
    with pytest.raises(DeviceAccessError, match="udev rule"):
        RealSense()
    monkeypatch.setattr(realsense, "find_spec", lambda name: None)
    assert realsense_serials() == []
    with pytest.raises(DeviceError, match=r"not installed; pip install 'annotate-cloud\[realsense\]'"):
        open_device("virtual:realsense", small_ball())


@pytest.mark.parametrize("model", ["brown_conrady", "inverse_brown_conrady", "modified_brown_conrady"])
def test_lenses_project_as_the_sdk_does(model):
    """A D455's colour camera; see ``COLOR_LENS``."""
    lens = rs.intrinsics()
    lens.width, lens.height, lens.ppx, lens.ppy, lens.fx, lens.fy = 1280, 800, 640, 400, 630, 630
    lens.coeffs, lens.model = [-0.0557, 0.0603, -0.00098, -0.00085, -0.0161], getattr(rs.distortion, model)
    camera = realsense_intrinsics(Intrinsics(1280, 800, 630, 630, 640, 400), lens.model.name, lens.coeffs)
    x, y = np.meshgrid(np.linspace(-0.95, 0.95, 20), np.linspace(-0.6, 0.6, 20))
    points = np.stack([x, y, np.ones_like(x)], axis=-1).reshape(-1, 3)
    wanted = [rs.rs2_project_point_to_pixel(lens, point.tolist()) for point in points]
    np.testing.assert_allclose(project(camera, points), wanted, atol=0.02)


def test_a_fisheye_is_refused():
    pinhole = Intrinsics(64, 48, 50, 50, 32, 24)
    with pytest.raises(CalibrationError, match="'ftheta', which is not supported; use a RealSense D400"):
        realsense_intrinsics(pinhole, "ftheta", [0.1, 0, 0, 0, 0])


# --- recordings --------------------------------------------------------------------------------------

files = pytest.importorskip("tests.helpers.realsense_files", reason="needs rosbags (extra exchange)")
NUMBERS = (0, 1, 2, 4)


@pytest.fixture(scope="module")
def db3(tmp_path_factory):
    """Four frames recorded by the SDK, half a millimetre a unit; the one before the last was lost."""
    twin = still(0.5)
    path = files.write_db3(tmp_path_factory.mktemp("rs") / "take.db3", twin, NUMBERS)
    twin.unplug()
    return path


def test_what_the_sdk_records_is_read(db3):
    source, ball = open_source(db3), small_ball()
    assert isinstance(source, RealSenseRecording) and len(source) == 4
    assert "1 depth images were lost while it was recorded" in source.notes
    assert any(note.startswith("depth: 0.5 mm a step (declared)") for note in source.notes)
    for number, frame in zip(NUMBERS, source, strict=True):
        assert abs(frame.stamp_ns - 1e6 * (FIRST_MS + number / 0.03)) <= 1000
        np.testing.assert_array_equal(frame.depth_mm, ball[number].depth_mm)
        np.testing.assert_array_equal(frame.infrared, ball[number].infrared >> 8)
        color = cv2.imdecode(np.frombuffer(ball[number].color_encoded, np.uint8), cv2.IMREAD_COLOR)
        assert np.abs(frame.decode_color()[..., ::-1].astype(int) - color).mean() < 3


def test_a_recording_has_the_calibration_of_the_camera(db3, twin):
    with closing(driver(twin)) as device:
        device.start()
        rig, recorded = device.calibration, open_source(db3).calibration
    np.testing.assert_allclose(recorded.color.distortion, rig.color.distortion, atol=1e-6)
    np.testing.assert_allclose(recorded.depth.matrix, rig.depth.matrix, rtol=1e-6)
    np.testing.assert_allclose(recorded.color_from_depth.translation_m, (-0.059, 0, 0), atol=1e-6)


def test_one_command_makes_a_session_of_it(db3, annotate_cloud, tmp_path):
    done = annotate_cloud("import", db3, tmp_path / "take.mcap")
    assert done.code == 0, done.err
    frames = list(open_source(tmp_path / "take.mcap"))
    assert len(frames) == 4 and frames[0].infrared is not None and frames[0].color_encoded


def old_frames():
    rng, shape = np.random.default_rng(0), (48, 64)
    return [
        (
            number,
            1000 + 33.25 * number,
            rng.integers(0, 9000, shape, np.uint16),
            rng.integers(0, 256, shape, np.uint8),
            rng.integers(0, 256, (*shape, 2), np.uint8),
        )
        for number in (1, 2, 4)
    ]


@pytest.fixture
def old_bag(tmp_path):
    lens = Intrinsics(64, 48, 50, 51, 31.5, 23.5)
    bent = replace(lens, k1=-0.0557, k2=0.0603)
    turned = (0.0, 0.0, 0.0998334, 0.9950042)
    lenses = (lens, "Brown Conrady"), (bent, "Inverse Brown Conrady")
    return files.write_old_bag(tmp_path / "old.bag", old_frames(), lenses, 0.0005, turned)


def assert_old_frames(source):
    assert isinstance(source, RealSenseRecording) and len(source) == 3
    for (_, stamp_ms, depth, infrared, yuyv), frame in zip(old_frames(), source, strict=True):
        assert frame.stamp_ns == round(1e6 * stamp_ms)
        np.testing.assert_array_equal(frame.depth_mm, np.rint(depth / 2))
        np.testing.assert_array_equal(frame.infrared, infrared)
        np.testing.assert_array_equal(
            frame.decode_color()[..., ::-1], cv2.cvtColor(yuyv, cv2.COLOR_YUV2BGR_YUY2)
        )
    assert source.calibration.depth == Intrinsics(64, 48, 50, 51, 31.5, 23.5)
    np.testing.assert_allclose(source.calibration.color.distortion, (-0.0557, 0.0603, 0, 0, 0), atol=1e-6)
    pose = source.calibration.color_from_depth
    np.testing.assert_allclose(pose.translation_m, (-0.059, 0.001, 0), atol=1e-6)
    np.testing.assert_allclose(np.arctan2(pose.rotation[1, 0], pose.rotation[0, 0]), 0.2, atol=1e-5)


def test_a_bag_of_an_older_sdk_is_read(old_bag):
    assert_old_frames(open_source(old_bag))


def test_the_sdk_reads_the_same_from_that_bag(old_bag, tmp_path):
    """So that the bag is one: the SDK converts it to a .db3, whose images are not packed."""
    rs.context().convert_bag_to_db3(str(old_bag), str(tmp_path / "new.db3"))
    assert_old_frames(open_source(tmp_path / "new.db3"))


@pytest.mark.parametrize("kind", ["db3", "old_bag"])
def test_a_damaged_recording_is_an_error_or_frames(request, kind, tmp_path):
    good, rng = request.getfixturevalue(kind).read_bytes(), np.random.default_rng(0)
    path = tmp_path / "damaged"
    for number in range(40):
        content = bytearray(good if number % 4 else good[: len(good) * number // 40])
        for at in rng.integers(0, max(1, len(content)), 4 if content else 0):
            content[at] ^= 1 << rng.integers(8)
        path.write_bytes(content)
        try:
            for frame in open_source(path):
                frame.decode_color()
        except CloudError as error:
            assert "\n" not in str(error)
