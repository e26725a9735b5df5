"""Kinect v2: left stays left, undistortion to the last bit, the shim, the driver, which device is meant."""

import shutil
import subprocess
from contextlib import closing
from ctypes import CDLL, c_void_p
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from annotate.cloud.fuse import Fuser, undistortion_index
from annotate.label_recording import SuitLabeller, label_source
from annotate.labelset.label_set import LabelSet
from annotate.parts import UNDEFINED, swap_left_right
from annotate.suit.palette import DEFAULT_SUIT
from eval.network.body_state import BodyState
from eval.network.onnx_network import OnnxNetwork
from eval.network.predict_source import predict_source
from eval.scores.joints import IN_SKELETON, TWIN
from sensors.calibration_files.calibration_yaml import read_yaml
from sensors.calibration_files.kinect2_factory import KINECT2_COLOR, KINECT2_DEPTH
from sensors.drivers import kinect2_build
from sensors.drivers.kinect2 import COLOR, DEPTH, INFRARED, Kinect2, load_shim, uint16_from_float
from sensors.drivers.kinect2_build import built_shim
from sensors.errors import DeviceBusyError, DeviceError, DeviceNotFoundError
from sensors.recording.rig_templates import REFERENCE, TEMPLATES
from sensors.rig.camera import Intrinsics, project, undistort
from sensors.rig.frame import RigFrame
from sensors.rig.wrapping_counter import WrappingCounter
from sensors.session.reader import Session
from sensors.session.writer import SessionWriter
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


def decoded(encoded):
    return cv2.imdecode(np.frombuffer(encoded, np.uint8), cv2.IMREAD_COLOR).astype(int)


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
        # The library's first column is the camera's right: the driver's last one.
        for image in [r.value.depth_mm for r in depth] + [r.value.infrared for r in depth]:
            assert (image[:, -1] > 0).all() and not image[:, :-1].any()
        ticks = np.diff([r.stamp_ns for r in depth]) / 125_000
        np.testing.assert_array_equal(ticks, 267 * np.diff(numbers))
    Kinect2(shim=compiled).close()


def test_factory_parameters_are_read_in_libfreenect2s_order(compiled):
    with closing(Kinect2("012345678947", compiled)) as device:
        device.start()
        camera = device.calibration.depth
        # The library's are of mirrored images, and so are its cx and p2.
        assert (camera.fx, camera.fy, camera.cx, camera.cy) == (365, 366, 511 - 254, 211)
        np.testing.assert_allclose(camera.distortion, (0.1, 0.2, 0.4, -0.5, 0.3), rtol=1e-6)


def test_the_twin_has_real_parameters_and_shows_its_scene():
    scene = FrameLoop(swinging_ball())
    twin = VirtualKinect2(scene)
    with closing(Kinect2(shim=twin.shim)) as device:
        device.start()
        assert device.calibration.depth.fx == pytest.approx(KINECT2_DEPTH.fx)
        first = {(r := device.read(1)).stream: r.value for _ in range(2)}
    np.testing.assert_array_equal(first["depth"].depth_mm, scene.depth(0))
    np.testing.assert_array_equal(first["depth"].infrared, scene.infrared(0))
    np.testing.assert_allclose(decoded(first["color"].encoded), decoded(scene.color(0)), atol=25)


class Library(VirtualKinect2):
    """A libfreenect2 that delivers these images, as they are: depth (424, 512), colour (1080, 1920, 3)."""

    def __init__(self, depth_mm, color_bgr):
        super().__init__(FrameLoop(swinging_ball()))
        self._images = {
            DEPTH: depth_mm.astype(np.float32).tobytes(),
            INFRARED: np.ones(depth_mm.shape, np.float32).tobytes(),
            COLOR: cv2.imencode(".jpg", color_bgr, [cv2.IMWRITE_JPEG_QUALITY, 95])[1].tobytes(),
        }

    def _image(self, kind, number):
        return self._images[kind]


def read_from(twin):
    """A depth and a colour image of a twin, by stream, and the camera's factory calibration."""
    with closing(Kinect2(shim=twin.shim)) as device:
        device.start()
        return {(r := device.read(1)).stream: r.value for _ in range(2)}, device.calibration


def color_of_depth(u, v, z_mm):
    """Pixels (u, v) of colour by ``Registration::apply`` of libfreenect2; both images are mirrored."""
    c, x, y = KINECT2_COLOR, (u - KINECT2_DEPTH.cx) * 0.01, (v - KINECT2_DEPTH.cy) * 0.01
    terms = (x**3, y**3, x**2 * y, y**2 * x, x**2, y**2, x * y, x, y, 1)
    wx, wy = (sum(a * b for a, b in zip(side, terms, strict=True)) for side in (c.mx, c.my))
    right = wx / (c.f * 0.002199) - c.shift_m / c.shift_d + c.shift_m / z_mm
    return right * c.f + c.cx, wy / 0.002199 + c.cy


@pytest.mark.parametrize("left", [60, 180, 330])
def test_what_libfreenect2_delivers_has_its_colour_by_iais_calibration(left):
    """A near plate on a far wall, red in colour where libfreenect2's own registration maps it."""
    depth = np.full((424, 512), 2500.0)
    rows, columns = slice(150, 280), slice(left, left + 110)
    depth[rows, columns] = 1000
    color = np.full((1080, 1920, 3), (200, 80, 60), np.uint8)
    ends = (np.float64([at.start, at.stop]) for at in (columns, rows))
    u, v = color_of_depth(*ends, np.full(2, 1000.0))
    color[round(v[0]) : round(v[1]), round(u[0]) : round(u[1])] = (40, 40, 220)
    images, calibration = read_from(Library(depth, color))
    rig = replace(TEMPLATES[REFERENCE].calibration, depth=calibration.depth)
    cloud = Fuser(rig).fuse_frame(RigFrame(0, 0, images["depth"].depth_mm, images["color"].encoded))
    near = cloud.valid & (cloud.points_m[..., 2] < 1.5) & cloud.color_valid
    # Mirrored left of the middle is the camera's right.
    assert np.sign(cloud.points_m[near][:, 0].mean()) == np.sign(254 - (left + 55))
    red = cloud.color_rgb[..., 0] > 130
    # Two units differ by 25 pixels of colour at most, which is a fifteenth of the plate.
    assert red[near].mean() > 0.9
    assert (red & cloud.color_valid & ~near).sum() < 0.1 * near.sum()


@pytest.mark.parametrize("unit", UNITS)
def test_calibrations_of_real_units_project_with_the_sign_of_iais_sources(shared_data, tmp_path, unit):
    """iai flips images before it calibrates: its pose is libfreenect2's registration, mirrored."""
    for file in (shared_data / "kinect2_calibration").glob(f"iai_{unit}_*.yaml"):
        (tmp_path / file.name).write_bytes(file.read_bytes())
    rig = read_yaml(tmp_path)
    u, v = map(np.ravel, np.meshgrid(np.linspace(40, 470, 9), np.linspace(90, 330, 7)))
    by_meter = {}
    for z in (0.8, 3.0):
        library = color_of_depth(511 - u, v, 1000 * z)[0]
        lens = rig.depth
        xy = undistort(lens, np.c_[(u - lens.cx) / lens.fx, (v - lens.cy) / lens.fy])
        pixels = project(rig.color, rig.color_from_depth.apply(np.c_[xy, np.ones(len(u))] * z))[:, 0]
        by_meter[z] = 1919 - library, pixels
    near, far = by_meter[0.8], by_meter[3.0]
    # Nearer is farther left, by f * 52 mm * (1 / 0.8 - 1 / 3).
    np.testing.assert_allclose(near[0] - far[0], -1081.37 * 0.052 * (1 / 0.8 - 1 / 3), atol=0.01)
    np.testing.assert_allclose(near[1] - far[1], near[0] - far[0], atol=2.5)


def test_left_stays_left_from_the_library_to_the_labels(rig_session, tmp_path):
    """People of the virtual rig through a libfreenect2 that mirrors them: parts, joints, points are right."""
    session, truth = Session(rig_session), LabelSet.open(rig_session.with_suffix(".truth"))
    with SessionWriter(tmp_path / "k.mcap", session.calibration, "kinect") as writer:
        for frame in session:
            color = cv2.imdecode(np.frombuffer(frame.color_encoded, np.uint8), cv2.IMREAD_COLOR)
            images, factory = read_from(Library(frame.depth_mm[:, ::-1], color[:, ::-1]))
            shown = replace(frame, depth_mm=images["depth"].depth_mm, color_encoded=images["color"].encoded)
            writer.write(shown)
    assert factory.depth.cx == pytest.approx(511 - (511 - session.calibration.depth.cx), abs=1e-4)
    recorded = Session(tmp_path / "k.mcap")
    labels = label_source(recorded, SuitLabeller(DEFAULT_SUIT), tmp_path / "l", lambda n: None).labels
    network = predict_source(recorded, OnnxNetwork(), tmp_path / "p", lambda n: None).labels
    for found, least in ((labels, 0.85), (network, 0.6)):
        for frame in found:
            true = truth.read(frame.frame_id).parts
            sided = (true != swap_left_right(true)) & (frame.parts != UNDEFINED)
            right, swapped = (frame.parts[sided] == t[sided] for t in (true, swap_left_right(true)))
            assert right.mean() > least and swapped.mean() < 0.1
    for frame in network:
        joints = BodyState.from_note(frame.notes["bearing"]).joints_mm(network.intrinsics)
        true = np.array(truth.read(frame.frame_id).notes["joints_mm"])[IN_SKELETON]
        off, if_swapped = (np.linalg.norm(joints - t, axis=1).mean() for t in (true, true[TWIN]))
        assert off < 0.6 * if_swapped
    points, own = (Fuser(one.calibration).fuse(one.frame(0).depth_mm).points_m for one in (recorded, session))
    np.testing.assert_array_equal(points, own)


@pytest.mark.parametrize(
    ("serials", "wanted", "match"),
    [
        ((), "", "no Kinect v2 is plugged in"),
        (("A", "B"), "", r"there are 2 Kinect v2 devices \(A, B\); name one"),
        (("A", "B"), "C", r"no Kinect v2 has serial 'C'; give one that is plugged in: A, B"),
        (("A", "A"), "", "two Kinect v2 devices have serial 'A'; unplug one"),
        (("A", "B", "A"), "A", "two Kinect v2 devices have serial 'A'; unplug one"),
    ],
)
def test_which_device_is_meant(serials, wanted, match):
    with pytest.raises(DeviceError, match=match):
        Kinect2(wanted, VirtualKinect2(FrameLoop(swinging_ball()), serials=serials).shim)


def test_without_the_library_one_line_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setenv("PKG_CONFIG_LIBDIR", str(tmp_path))
    with pytest.raises(DeviceNotFoundError, match="not found; build libfreenect2 in five lines"):
        load_shim()
    (tmp_path / "no.so").write_bytes(b"no library")
    with pytest.raises(DeviceNotFoundError, match="cannot be loaded"):
        load_shim(tmp_path / "no.so")
    freenect2_in(tmp_path, monkeypatch)
    monkeypatch.setattr(kinect2_build, "FLAGS", ("-std=c++17", "-include", "no_such_header"))
    with pytest.raises(DeviceNotFoundError, match=r"cannot be compiled with libfreenect2 \(.*no_such_header"):
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
