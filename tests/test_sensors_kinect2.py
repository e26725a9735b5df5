"""Kinect v2: undistortion to the last bit, the compiled shim, its driver, and which device is meant."""

import shutil
import subprocess
from contextlib import closing
from ctypes import CDLL, c_void_p
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from annotate.cloud.fuse import undistortion_index
from sensors.drivers import kinect2_build
from sensors.drivers.kinect2 import DEPTH, Kinect2, load_shim, uint16_from_float
from sensors.drivers.kinect2_build import built_shim
from sensors.errors import DeviceBusyError, DeviceError, DeviceNotFoundError
from sensors.rig.camera import Intrinsics
from sensors.rig.kinect2_factory import KINECT2_COLOR, KINECT2_DEPTH
from sensors.rig.wrapping_counter import WrappingCounter
from sensors.virtual.frame_loop import FrameLoop
from sensors.virtual.kinect2 import VirtualKinect2
from tests.helpers.swinging_ball import swinging_ball
from tests.helpers.undistortion_twin import undistort_scalar

ROOT = Path(__file__).resolve().parents[1]
FAKE = ROOT / "tests" / "fake_freenect2"
UNITS = ("196605135147", "299150235147")
FRAMES = 100


def infrared_camera(folder, unit):
    """Infrared camera of a real unit as iai_kinect2 calibrated it."""
    file = cv2.FileStorage(str(folder / f"iai_{unit}_calib_ir.yaml"), cv2.FILE_STORAGE_READ)
    k, d = file.getNode("cameraMatrix").mat(), file.getNode("distortionCoefficients").mat().ravel()
    file.release()
    return Intrinsics(512, 424, k[0, 0], k[1, 1], k[0, 2], k[1, 2], *d[:5])


def random_depth(rng):
    """Slanted planes with steps, noise of a millimetre, and a tenth of the pixels without a reading."""
    v, u = np.mgrid[:424, :512].astype(np.float32)
    plane = rng.uniform(800, 4000) + rng.uniform(-1, 1) * u + rng.uniform(-1, 1) * v
    for _ in range(4):
        left, top = rng.integers(0, 400), rng.integers(0, 320)
        plane[top : top + 90, left : left + 110] = rng.uniform(500, 3000)
    noisy = plane + rng.normal(0, 1, plane.shape).astype(np.float32)
    return np.where(rng.random(plane.shape) < 0.1, 0, noisy.clip(0, 8000)).astype(np.float32)


def undistorted(camera, depth_mm):
    index = undistortion_index(camera)
    return np.where(index >= 0, depth_mm.ravel()[index], np.float32(0))


@pytest.mark.parametrize("unit", UNITS)
def test_undistortion_of_a_hundred_frames_equals_the_scalar_twin_bit_for_bit(shared_data, unit):
    camera = infrared_camera(shared_data / "kinect2_calibration", unit)
    rng = np.random.default_rng(int(unit))
    for _ in range(FRAMES):
        depth = random_depth(rng)
        assert np.array_equal(undistorted(camera, depth), undistort_scalar(camera, depth))


@pytest.mark.parametrize("unit", UNITS)
def test_undistortion_equals_the_installed_library(shared_data, tmp_path, unit):
    if subprocess.run(["pkg-config", "--exists", "freenect2"], check=False).returncode:
        pytest.skip("libfreenect2 is not installed")
    flags = subprocess.run(
        ["pkg-config", "--cflags", "--libs", "freenect2"], check=True, capture_output=True, text=True
    ).stdout.split()
    out = tmp_path / "registration.so"
    source = str(FAKE / "registration.cpp")
    subprocess.run(["g++", "-shared", "-fPIC", source, "-o", str(out), *flags], check=True)
    camera, color = infrared_camera(shared_data / "kinect2_calibration", unit), KINECT2_COLOR
    lens = (camera.fx, camera.fy, camera.cx, camera.cy, camera.k1, camera.k2, camera.k3, camera.p1, camera.p2)
    factory = (color.f, color.f, color.cx, color.cy, color.shift_d, color.shift_m, *color.mx, *color.my)
    infrared, colors = np.float32(lens), np.float32(factory)
    rng = np.random.default_rng(1)
    bgrx = rng.integers(1, 256, (1080, 1920, 4), np.uint8)
    theirs, registered = np.empty((424, 512), np.float32), np.empty((424, 512, 4), np.uint8)
    for _ in range(FRAMES):
        depth = random_depth(rng)
        arrays = (infrared, colors, depth, bgrx, theirs, registered)
        CDLL(str(out)).register_frame(*(array.ctypes.data_as(c_void_p) for array in arrays))
        np.testing.assert_array_equal(undistorted(camera, depth), theirs)


def freenect2_in(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A libfreenect2 with its interface and one device, where pkg-config finds it; a cache of its own."""
    text = f"Name: freenect2\nDescription: fake\nVersion: 0.2.0\nCflags: -I{FAKE} -Werror\nLibs:\n"
    (folder / "freenect2.pc").write_text(text)
    monkeypatch.setenv("PKG_CONFIG_PATH", str(folder))
    monkeypatch.setenv("XDG_CACHE_HOME", str(folder))


@pytest.fixture(scope="module")
def compiled(tmp_path_factory):
    """The product's shim, compiled at first use."""
    if shutil.which("g++") is None:
        pytest.skip("no g++ to compile the shim")
    with pytest.MonkeyPatch.context() as monkeypatch:
        freenect2_in(tmp_path_factory.mktemp("shim"), monkeypatch)
        built = built_shim()
        stamp = built.stat().st_mtime_ns
        assert built_shim() == built and built.stat().st_mtime_ns == stamp
        return load_shim(built)


def test_the_compiled_shim_streams_native_jpeg_and_millimetres(compiled):
    with closing(Kinect2(shim=compiled)) as device:
        assert device.serial == "012345678947" and device.calibration is None
        with pytest.raises(DeviceBusyError, match="cannot be opened; close the program"):
            Kinect2(shim=compiled)
        device.start()
        readings = [device.read(1) for _ in range(16)]
        depth = [r for r in readings if r.stream == "depth"]
        color = [r for r in readings if r.stream == "color"]
        # Frame 5 was lost, frame 7 broken; both streams say so, and the clock wrapped around meanwhile.
        numbers, dropped = [1, 2, 3, 4, 6, 8, 9, 10], [0, 0, 0, 0, 1, 1, 0, 0]
        assert [r.dropped for r in depth] == dropped and [r.dropped for r in color] == dropped
        assert [r.value.encoded for r in color] == [bytes([0xFF, 0xD8, 0xFF, n]) for n in numbers]
        assert [int(r.value.depth_mm.max()) for r in depth] == numbers
        assert [int(r.value.infrared.max()) for r in depth] == numbers
        assert [r.value.depth_mm.shape for r in depth] == [(424, 512)] * 8
        ticks = np.diff([r.stamp_ns for r in depth]) / 125_000
        np.testing.assert_array_equal(ticks, 267 * np.diff(numbers))
    Kinect2(shim=compiled).close()


def test_factory_parameters_are_read_in_libfreenect2s_order(compiled):
    with closing(Kinect2("012345678947", compiled)) as device:
        device.start()
        camera = device.calibration.depth
        assert (camera.fx, camera.fy, camera.cx, camera.cy) == (365, 366, 254, 211)
        np.testing.assert_allclose(camera.distortion, (0.1, 0.2, 0.4, 0.5, 0.3), rtol=1e-6)


def test_the_twin_has_real_parameters_and_shows_its_scene():
    scene = FrameLoop(swinging_ball())
    twin = VirtualKinect2(scene)
    with closing(Kinect2(shim=twin.shim)) as device:
        device.start()
        assert device.calibration.depth.fx == pytest.approx(KINECT2_DEPTH.fx)
        first = {(r := device.read(1)).stream: r.value for _ in range(2)}
    np.testing.assert_array_equal(first["depth"].depth_mm, scene.depth(0))
    np.testing.assert_array_equal(first["depth"].infrared, scene.infrared(0))
    assert first["color"].encoded == scene.color(0)


@pytest.mark.parametrize(
    ("serials", "wanted", "match"),
    [
        ((), "", "no Kinect v2 is plugged in"),
        (("A", "B"), "", r"there are 2 Kinect v2 devices \(A, B\); name one"),
        (("A", "B"), "C", r"no Kinect v2 has serial 'C'; plugged in: A, B"),
        (("A", "A"), "", "two Kinect v2 devices have serial 'A'; unplug one"),
        (("A", "B", "A"), "A", "two Kinect v2 devices have serial 'A'; unplug one"),
    ],
)
def test_which_device_is_meant(serials, wanted, match):
    with pytest.raises(DeviceError, match=match):
        Kinect2(wanted, VirtualKinect2(FrameLoop(swinging_ball()), serials=serials).shim)


def test_without_the_library_one_line_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setenv("PKG_CONFIG_LIBDIR", str(tmp_path))
    with pytest.raises(DeviceNotFoundError, match="libfreenect2 was not found; build it in five lines"):
        load_shim()
    (tmp_path / "no.so").write_bytes(b"no library")
    with pytest.raises(DeviceNotFoundError, match="cannot be loaded"):
        load_shim(tmp_path / "no.so")
    freenect2_in(tmp_path, monkeypatch)
    monkeypatch.setattr(kinect2_build, "FLAGS", ("-std=c++17", "-include", "no_such_header"))
    with pytest.raises(DeviceNotFoundError, match=r"cannot be compiled against \(.*no_such_header"):
        load_shim()
    monkeypatch.setattr(kinect2_build, "which", lambda name: "" if name == "pkg-config" else None)
    with pytest.raises(DeviceNotFoundError, match=r"needs a C\+\+ compiler"):
        load_shim()


def test_float_images_become_whole_numbers():
    depth = np.float32([[0.4, 499.6, 70000], [np.nan, np.inf, -5]])
    np.testing.assert_array_equal(uint16_from_float(depth), [[0, 500, 65535], [0, 0, 0]])


@given(st.lists(st.integers(-(2**20), 2**31 - 1), max_size=30), st.integers(0, 2**32 - 1))
def test_a_wrapping_clock_is_counted_on(steps, start):
    counter, true = WrappingCounter(), start
    assert counter.unwrap(start) == start
    for step in steps:
        true += step
        assert counter.unwrap(true % 2**32) == true


def test_gaps_in_running_numbers_are_counted_and_late_frames_left_out():
    twin = VirtualKinect2(FrameLoop(swinging_ball()))
    with closing(Kinect2(shim=twin.shim)) as device:
        device.start()
        twin._ready += [(DEPTH, 2**32 - 3 + step) for step in (0, 1, 5, 4, 5, 6, 9)]
        readings = [device.read(1) for _ in range(5)]
    assert [r.dropped for r in readings] == [0, 0, 3, 0, 2]
