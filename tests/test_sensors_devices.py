"""One contract for every device that can be opened here, addresses, and what goes wrong on opening."""

import errno
import os
import sys
import threading
from collections.abc import Callable
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from importlib.machinery import ModuleSpec
from importlib.util import find_spec
from itertools import count, pairwise
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sensors.calibration_files.lens_models import intrinsics_from_rational
from sensors.device import node
from sensors.device.address import Address
from sensors.device.node import check_node, node_error
from sensors.device.protocol import ColorImage, DepthImage, Device, Spot, ThermalCounts, ThermalImage
from sensors.device.streaming_camera import StreamingCamera
from sensors.drivers import azure_kinect, kinect2, pyrometer, serial_line
from sensors.drivers.azure_kinect import AzureKinect, azure_devices
from sensors.drivers.k4a import Capture, Playback, StampedDepth, load_k4a
from sensors.drivers.kinect2 import Kinect2
from sensors.drivers.lepton import Lepton
from sensors.drivers.optris import LAYOUTS, Optris
from sensors.drivers.optris_direct import OptrisDirect
from sensors.drivers.orbbec import Orbbec, depth_of, load_sdk, orbbec_serials
from sensors.drivers.pyrometer import Pyrometer, PyrometerOptions
from sensors.drivers.pyrometer_protocol import CS, CT
from sensors.drivers.realsense import RealSense, Settings, realsense_serials
from sensors.drivers.y16 import Radiometry, WordCamera, boson_mode, y16_mode
from sensors.errors import (
    CloudError,
    DeviceAccessError,
    DeviceBusyError,
    DeviceError,
    DeviceFaultError,
    DeviceLostError,
    DeviceNotFoundError,
)
from sensors.importers.open_source import open_source
from sensors.recording import open_device as open_device_module
from sensors.recording.open_device import find_devices, open_device
from sensors.rig.camera import Intrinsics
from sensors.rig.frame import RigFrame
from sensors.rig.rig_calibration import calibration_to_json
from sensors.virtual.frame_loop import FrameLoop
from sensors.virtual.kinect2 import VirtualKinect2
from sensors.virtual.optris_direct import VirtualDirect
from sensors.virtual.pyrometer import LineFaults, VirtualPyrometer
from sensors.virtual.realsense import VirtualRealSense
from sensors.virtual.schedule import Faults
from sensors.virtual.v4l2 import VirtualLepton, VirtualOptris, VirtualWords, VirtualY16
from tests.helpers.samples import azure_calibration
from tests.helpers.swinging_ball import small_ball, swinging_ball

VALUES = {
    "depth": DepthImage,
    "color": ColorImage,
    "thermal": (ThermalImage, ThermalCounts),
    "pyrometer": Spot,
}


PATIENCE_S = StreamingCamera.silence_s
"""The product's own, before twins are waited for less long."""


@pytest.fixture(autouse=True)
def impatient(monkeypatch):
    """Twins answer at once; what is silent for a fifth of a second is gone."""
    monkeypatch.setattr(StreamingCamera, "silence_s", 0.2)
    monkeypatch.setattr(serial_line, "REPLY_S", 0.05)
    monkeypatch.setattr(serial_line, "QUIET_S", 0.005)
    monkeypatch.setattr(pyrometer, "POLL_HZ", 100.0)


@dataclass(frozen=True)
class Bench:
    """A twin on the bench: how the real driver opens it, and how its cable is pulled."""

    open: Callable[[], Device]
    unplug: Callable[[], None]


def bench_kinect2(faults, folder):
    twin = VirtualKinect2(FrameLoop(swinging_ball()), faults)
    return Bench(lambda: Kinect2(shim=twin.shim), twin.unplug)


def bench_realsense(faults, folder):
    twin = VirtualRealSense(FrameLoop(small_ball()), faults)
    settings = Settings(twin.size, twin.color_size)
    return Bench(lambda: RealSense(settings=settings, context=twin), twin.unplug)


def bench_optris(mode):
    def make(faults, folder):
        twin = VirtualOptris(LAYOUTS[mode], FrameLoop(swinging_ball()), faults)
        return Bench(lambda: Optris(twin.node, LAYOUTS[mode]), twin.unplug)

    return make


def bench_lepton(faults, folder):
    twin = VirtualLepton(FrameLoop(swinging_ball()), replace(faults, hurry=10))
    return Bench(lambda: Lepton(twin.node), twin.unplug)


def bench_y16(faults, folder):
    twin = VirtualY16(FrameLoop(swinging_ball()), faults, VirtualWords(Radiometry(0.01), 90.0))
    return Bench(lambda: WordCamera(twin.node, y16_mode(twin.size, 90.0, Radiometry(0.01))), twin.unplug)


def bench_boson(faults, folder):
    twin = VirtualY16(FrameLoop(swinging_ball()), faults, VirtualWords(Radiometry(0.01), 60.0, (256, 320)))
    return Bench(lambda: WordCamera(twin.node, boson_mode(True)), twin.unplug)


def bench_direct(faults, folder):
    config = folder / "generic.xml"
    config.write_text("<imager><serial>0</serial></imager>")
    twin = VirtualDirect(FrameLoop(swinging_ball()), faults)
    return Bench(lambda: OptrisDirect(config, twin.library), twin.unplug)


def bench_pyrometer(family, burst):
    def make(faults, folder):
        options = PyrometerOptions(family, burst=burst)
        twin = VirtualPyrometer(options)

        def opened():
            device = Pyrometer(twin.port, options)
            twin.faults = LineFaults(loss=faults.drop**2)
            return device

        return Bench(opened, twin.unplug)

    return make


BENCHES = {
    "kinect2": bench_kinect2,
    **{f"optris {mode}": bench_optris(mode) for mode in LAYOUTS},
    "optris-direct": bench_direct,
    "lepton": bench_lepton,
    "y16": bench_y16,
    "boson": bench_boson,
    "pyrometer ct": bench_pyrometer(CT, False),
    "pyrometer cs": bench_pyrometer(CS, False),
    "pyrometer ct burst": bench_pyrometer(CT, True),
}


WITHOUT_SDK = pytest.mark.skipif(
    find_spec("pyrealsense2") is None, reason="no pyrealsense2: pip install 'annotate-cloud[realsense]'"
)


@pytest.fixture(params=[*BENCHES, pytest.param("realsense", marks=WITHOUT_SDK)])
def bench(request, tmp_path):
    """Makes the bench of each kind of device in turn, with faults."""
    made = []

    def make(faults=None):
        kind = BENCHES.get(request.param, bench_realsense)
        made.append(kind(faults or Faults(), tmp_path))
        return made[-1]

    yield make
    for one in made:
        one.unplug()


def read_on(device, count):
    """So many readings, whatever faults lie between."""
    readings = []
    for _ in range(20 * count):
        try:
            reading = device.read(0.5)
        except DeviceFaultError:
            continue
        if reading is not None:
            readings.append(reading)
        if len(readings) == count:
            return readings
    raise AssertionError("the device gives too little")


def test_contract_stamps_increase_and_streams_are_announced(bench):
    with closing(bench().open()) as device:
        assert device.address and isinstance(device.serial, str)
        assert device.rates_hz and all(rate > 0 for rate in device.rates_hz.values())
        device.start()
        readings = read_on(device, 8)
    assert {r.stream for r in readings} == set(device.rates_hz)
    for stream in device.rates_hz:
        mine = [r for r in readings if r.stream == stream]
        assert all(isinstance(r.value, VALUES[stream]) for r in mine)
        assert all(a.stamp_ns < b.stamp_ns and a.arrival_ns <= b.arrival_ns for a, b in pairwise(mine))


def test_contract_a_timeout_gives_none_and_not_a_hang(bench):
    with closing(bench(Faults(drop=1.0)).open()) as device:
        device.start()
        try:
            assert device.read(0.02) is None or device.read(0.0) is None
        except DeviceFaultError as fault:
            assert device.address.startswith("pyrometer") and "answered 0 of 2 bytes" in str(fault)


def test_contract_unplugging_says_what_to_do(bench):
    made = bench()
    with closing(made.open()) as device:
        device.start()
        read_on(device, 2)
        made.unplug()
        with pytest.raises(DeviceLostError, match="; ") as lost:
            for _ in range(200):
                device.read(0.2)
    assert "\n" not in str(lost.value)


def test_contract_close_is_idempotent_and_ends_a_read(bench):
    device = bench(Faults(drop=1.0)).open()
    device.start()
    ended = []

    def read():
        with pytest.raises(DeviceLostError, match="; "):
            while True:
                try:
                    device.read(5.0)
                except DeviceFaultError:
                    continue
        ended.append(True)

    thread = threading.Thread(target=read)
    thread.start()
    device.close()
    thread.join(10)
    assert ended
    device.close()
    with pytest.raises(DeviceLostError, match="; "):
        device.read(0.01)


def test_contract_a_device_is_opened_once(bench):
    made = bench()
    with closing(made.open()) as device:
        with pytest.raises(DeviceBusyError, match=r"; |one camera at a time"):
            made.open()
        device.start()
        read_on(device, 1)
    if not device.address.startswith("optris-direct"):
        made.open().close()


def test_contract_what_is_lost_is_reported(bench):
    with closing(bench(Faults(drop=0.25)).open()) as device:
        device.start()
        readings = []
        dropped = 0
        while not dropped and len(readings) < 300:
            readings += read_on(device, 10)
            dropped = sum(r.dropped for r in readings)
    assert dropped > 0


# --- addresses -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "address",
    [pytest.param(a, marks=[WITHOUT_SDK] * ("realsense" in a)) for a in open_device_module.VIRTUAL],
)
def test_every_listed_virtual_device_opens(address):
    with closing(open_device(address, swinging_ball())) as device:
        assert device.address == address
        device.start()
        assert {r.stream for r in read_on(device, 4)} == set(device.rates_hz)


def test_a_virtual_device_shows_the_frames_it_is_given():
    """Any source of rig frames: a recorded session, the virtual rig. The first second is shown in a loop."""

    def endless():
        for index in count():
            depth = np.full((424, 512), 1000 + index, np.uint16)
            yield RigFrame(index, 0, depth, b"\xff\xd8\xff" if index % 2 else None)

    with closing(open_device("virtual:kinect2", endless())) as device:
        device.start()
        shown = {r.stream: r.value for r in read_on(device, 2)}
    assert 1000 <= shown["depth"].depth_mm[0, 0] < 1030 and shown["color"].encoded == b"\xff\xd8\xff"
    with pytest.raises(DeviceError, match="has no frames"):
        open_device("virtual:kinect2", iter(()))


@pytest.mark.parametrize("kind", ["optris", "optris-direct"])
def test_a_twin_of_a_source_without_thermal_says_so_at_once(kind):
    frames = [RigFrame(0, 0, np.zeros((424, 512), np.uint16))]
    with pytest.raises(DeviceError, match="has no thermal images; give one that has"):
        open_device(f"virtual:{kind}", frames)
    with pytest.raises(DeviceError, match="has no colour images; give one that has"):
        open_device("virtual:kinect2", frames)


@pytest.mark.parametrize(
    ("address", "match"),
    [
        ("", "is of no known kind; use kinect2"),
        ("webcam:0", "is of no known kind"),
        ("virtual:webcam", "has no virtual twin; use virtual: with"),
        ("virtual:azure", "has no virtual twin"),
        ("virtual:optris?mode=1hz", "mode '1hz' .* is unknown; use 128hz"),
        ("virtual:optris?speed=1", "unknown option 'speed'; its options: drop"),
        ("virtual:optris?drop=2", "drop '2' .* is not a number from 0 to 1"),
        ("virtual:optris?drop=nan", "is not a number from 0 to 1"),
        ("virtual:optris?drop", "malformed options"),
        ("virtual:optris?drop=0&drop=1", "gives an option twice"),
        ("virtual:pyrometer?family=ir", "family 'ir' .* is unknown; use ct, cs"),
        ("virtual:pyrometer?rs485=1.5", "is not an integer; give 1 to 32"),
        ("virtual:pyrometer?rs485=99", "rs485 '99' .* is not a number from 1 to 32"),
        ("virtual:pyrometer?emissivity=0.09", "emissivity '0.09' .* is not a number from 0.1"),
        ("virtual:pyrometer?family=cs&burst=yes", "cs family has no burst"),
        ("virtual:pyrometer?refuse=1&emissivity=2", "emissivity '2' .* is not a number"),
        ("optris:", "names no node; give for instance optris:/dev/video0"),
        ("optris:/dev/video77", "/dev/video77 does not exist; plug the device in"),
        ("pyrometer:/dev/ttyUSB77", "/dev/ttyUSB77 does not exist; plug the device in"),
        ("realsense:?size=1x1", "size '1x1' .* is unknown; use 848x480"),
        ("realsense:?preset=best", "preset 'best' .* is unknown; use default"),
        ("realsense:?laser=361", "laser '361' .* is not a number from 0 to 360"),
        ("kinect2:1?mode=1", "unknown option 'mode'; its options: mirror, turn"),
    ],
)
def test_a_bad_address_is_one_clear_line(address, match):
    with pytest.raises(DeviceError, match=match) as caught:
        open_device(address)
    assert "\n" not in str(caught.value)


@given(st.text(max_size=40))
def test_any_text_is_an_address_or_refused(text):
    try:
        address = Address(text)
        address.number("drop", 0.0, 0.0, 1.0)
        address.finish()
    except CloudError as error:
        assert "; " in str(error) or "is not a number" in str(error)


def test_options_of_a_virtual_pyrometer_reach_the_real_driver():
    with closing(open_device("virtual:pyrometer?emissivity=0.95&rs485=3&step=0.01")) as device:
        assert device.device.emissivity() == 0.95 and device.twin.emissivity == 0.95


# --- what keeps a node closed ----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("code", "kind", "match"),
    [
        (errno.EACCES, DeviceAccessError, r"belongs to group \w+ and you are not a member|udev rule"),
        (errno.EBUSY, DeviceBusyError, "in use by another program; close"),
        (errno.ENODEV, DeviceNotFoundError, "does not exist; plug"),
        (errno.EIO, DeviceError, r"cannot be opened \(Input/output error\); give a device node"),
    ],
)
def test_errors_of_the_system_name_the_remedy(monkeypatch, tmp_path, code, kind, match):
    def refuse(*arguments, **options):
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(node.os, "open", refuse)
    with pytest.raises(kind, match=match):
        check_node(tmp_path / "video0")


@pytest.mark.parametrize(("name", "group"), [("video3", "video"), ("ttyUSB0", "dialout")])
def test_without_permission_the_group_is_named(monkeypatch, name, group):
    """The node's own group; where the system does not know it, the one Debian gives to its kind."""
    error = node_error(Path("/nowhere") / name, errno.EACCES)
    assert f"belongs to group {group}" in str(error) and f"usermod -aG {group} $USER" in str(error)


def test_a_node_of_root_alone_wants_a_udev_rule(monkeypatch, tmp_path):
    monkeypatch.setattr(node, "_group", lambda path: "root")
    assert "udev rule" in str(node_error(tmp_path, errno.EACCES))


def test_a_kinect_that_may_not_be_opened_is_told_from_none(monkeypatch, tmp_path):
    """libfreenect2 lists only what it can open; the system's list of USB devices knows better."""
    entry = tmp_path / "2-1"
    entry.mkdir()
    for name, text in (("idVendor", "045e"), ("idProduct", "02c4"), ("busnum", "2"), ("devnum", "5")):
        (entry / name).write_text(text + "\n")
    monkeypatch.setattr(node.os, "open", lambda path, flags: (_ for _ in ()).throw(OSError(errno.EACCES, "")))
    node.check_usb(("0403:de37",), tmp_path)
    with pytest.raises(DeviceAccessError, match="/dev/bus/usb/002/005"):
        node.check_usb(kinect2.USB_IDS, tmp_path)


def test_video_nodes_of_a_camera_are_found_without_its_metadata_node(tmp_path):
    camera = tmp_path / "usb" / "1-2"
    (camera / "1-2:1.0").mkdir(parents=True)
    for name, text in (("idVendor", "0403"), ("idProduct", "de37"), ("serial", "77")):
        (camera / name).write_text(text)
    for index, name in enumerate(("video0", "video1")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "device").symlink_to(camera / "1-2:1.0")
        (tmp_path / name / "index").write_text(str(index))
    assert node.video_nodes("0403:de37", tmp_path) == [(Path("/dev/video0"), "77")]


def test_two_devices_with_one_serial_number_are_marked():
    notes = [found.note for found in open_device_module._numbered("kinect2", ["A", "B", "A"])]
    assert notes[1] == "" and notes[0] == notes[2] and "same serial number" in notes[0]


def test_an_azure_kinect_that_does_not_open_is_listed_with_the_reason(monkeypatch):
    """Its number is known only once it is open; another program may have it."""

    class Opened:
        serial, closed = "000042", 0

        def __init__(self, index):
            if index == 1:
                raise DeviceError("it cannot be opened")

        def close(self):
            Opened.closed += 1

    monkeypatch.setattr(
        azure_kinect, "load_k4a", lambda: SimpleNamespace(k4a_device_get_installed_count=lambda: 2)
    )
    monkeypatch.setattr(azure_kinect, "Camera", Opened)
    listed = [(found.address, found.note) for found in find_devices() if found.kind == "azure"]
    assert listed == [("azure:000042", ""), ("azure:", azure_kinect.CLOSED)] and Opened.closed == 1
    assert AzureKinect().serial == "000042"
    monkeypatch.setattr(azure_kinect, "azure_devices", lambda: [(1, "")])
    with pytest.raises(DeviceBusyError, match="no Azure Kinect can be opened; close the program"):
        AzureKinect()


# --- the command -----------------------------------------------------------------------------------


def test_devices_lists_what_there_is(annotate_cloud):
    done = annotate_cloud("devices", "--json")
    assert done.code == 0
    listed = {entry["address"]: entry for entry in done.result["devices"]}
    assert set(open_device_module.VIRTUAL) <= set(listed)
    assert all(listed[address]["virtual"] for address in open_device_module.VIRTUAL)
    assert "virtual:kinect2" in annotate_cloud("devices").out


def test_finding_sends_nothing_to_thermal_cameras_and_ports(monkeypatch):
    monkeypatch.setattr(open_device_module, "video_nodes", lambda usb_id: [(Path("/dev/video7"), "77")])
    port = SimpleNamespace(device="/dev/ttyUSB9", serial_number=None)
    monkeypatch.setattr(open_device_module, "comports", lambda: [port])
    found = {one.address: one for one in find_devices()}
    assert found["optris:/dev/video7"].serial == "77"
    assert "group video" in found["optris:/dev/video7"].note
    assert "group dialout" in found["pyrometer:/dev/ttyUSB9"].note


# --- cameras that people buy today -----------------------------------------------------------------


def test_without_their_libraries_they_say_what_to_install():
    cameras = ((AzureKinect, azure_devices), (Orbbec, orbbec_serials), (RealSense, realsense_serials))
    for kind, serials in cameras:
        if not serials():
            with pytest.raises(DeviceNotFoundError, match=r"install|plugged in"):
                kind()


def test_a_rational_lens_becomes_the_polynomial_one():
    """An Azure Kinect's depth camera: a hundredth of a pixel over the whole image."""
    coefficients = np.array([0.7, 0.3, 1e-4, -5e-5, 0.015, 1.03, 0.46, 0.08])
    matrix = np.array([[504.0, 0, 320], [0, 504.0, 330], [0, 0, 1]])
    camera = intrinsics_from_rational((640, 576), matrix, coefficients)
    import cv2

    from sensors.rig.camera import project

    v, u = np.mgrid[-0.6:0.6:25j, -0.6:0.6:25j]
    points = np.stack([u, v, np.ones_like(u)], axis=-1).reshape(-1, 3)
    expected = cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix, coefficients)[0].reshape(-1, 2)
    inside = ((expected >= 0) & (expected < (640, 576))).all(axis=-1)
    assert inside.mean() > 0.5
    np.testing.assert_allclose(project(camera, points)[inside], expected[inside], atol=0.05)


class AzureCaptures:
    """Three captures in place of an Azure Kinect."""

    serial = "000042"

    def __init__(self):
        self.stamps, self.closed = [10_000, 43_333, 143_333], False

    def start(self):
        pass

    def factory_calibration(self):
        return azure_calibration()

    def capture(self, timeout_ms):
        if not self.stamps:
            return None
        stamp, depth = self.stamps.pop(0), np.full((576, 640), 1500, np.uint16)
        return Capture(StampedDepth(depth, depth + 1, stamp), (b"\xff\xd8\xff", stamp + 100))

    def close(self):
        self.closed = True


def test_an_azure_kinect_by_its_captures(monkeypatch):
    monkeypatch.setattr(StreamingCamera, "silence_s", 0.1)
    camera = AzureCaptures()
    with closing(AzureKinect(camera=camera)) as device:
        assert device.address == "azure:000042" and device.calibration is None
        device.start()
        np.testing.assert_allclose(device.calibration.color_from_depth.translation_m, (-0.03, 0, 0))
        readings = [device.read(0.5) for _ in range(6)]
        assert [r.stream for r in readings] == ["depth", "color"] * 3
        assert [r.dropped for r in readings] == [0, 0, 0, 0, 2, 2]
        assert (readings[0].value.infrared == 1501).all()
        assert readings[0].stamp_ns == 10_000_000 and readings[1].value.encoded == b"\xff\xd8\xff"
        with pytest.raises(DeviceLostError, match="sent nothing for"):
            while True:
                device.read(0.05)
    assert camera.closed


def test_a_camera_whose_clock_was_reset_is_lost_rather_than_silent():
    """Its images would all be older than the last one before."""
    camera = AzureCaptures()
    camera.stamps = [9_000_000, 8_966_000, 33_000]
    with closing(AzureKinect(camera=camera)) as device:
        device.start()
        assert [device.read(0.5).stream for _ in range(2)] == ["depth", "color"]
        with pytest.raises(DeviceLostError, match="back by 9 s"):
            device.read(0.5)


def test_microsofts_sdk_and_the_reader_agree_on_a_real_recording_to_the_bit(shared_data):
    """The driver runs on the SDK's playback; what it reads is what the importer reads from the file."""
    try:
        load_k4a()
    except DeviceNotFoundError as error:
        pytest.skip(str(error))
    path = shared_data / "azure_kinect" / "recording.mkv"
    source = open_source(path)
    (frame,) = source
    with closing(AzureKinect(camera=Playback(path), color_size=(1280, 720))) as device:
        device.start()
        depth, color = device.read(1.0), device.read(1.0)
        np.testing.assert_array_equal(depth.value.depth_mm, frame.depth_mm)
        np.testing.assert_array_equal(depth.value.infrared, frame.infrared)
        assert color.value.encoded == frame.color_encoded and depth.stamp_ns == color.stamp_ns
        assert calibration_to_json(device.calibration) == calibration_to_json(source.calibration)
        assert device.read(0.0) is None


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
        """A camera whose viewer has left the depth image mirrored; infrared knows no such setting."""

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
            return SimpleNamespace(
                get_count=lambda: 1,
                get_device_serial_number_by_index=lambda index: "CP1",
                get_device_by_serial_number=lambda serial: serial,
            )

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
            depth = {
                "get_height": 2,
                "get_width": 3,
                "get_data": np.ascontiguousarray(image).view(np.uint8),
                "get_depth_scale": 0.5,
                "get_timestamp_us": (10**6 - 66_667 * self.left) * FakeOrbbec.stamped,
            }
            frame = SimpleNamespace(**{name: (lambda v=value: v) for name, value in depth.items()})
            return SimpleNamespace(
                get_depth_frame=lambda: frame, get_color_frame=lambda: None, get_frame=lambda kind: None
            )


def test_an_orbbec_by_pyorbbecsdks_names(monkeypatch):
    monkeypatch.setitem(sys.modules, "pyorbbecsdk", FakeOrbbec)
    assert [found.address for found in find_devices() if found.kind == "orbbec"] == ["orbbec:CP1"]
    with closing(open_device("orbbec:CP1")) as device:
        device.start()
        np.testing.assert_allclose(device.calibration.color_from_depth.translation_m, (-0.032, 0, 0))
        readings = [device.read(0.5), device.read(0.5)]
        np.testing.assert_array_equal(readings[0].value.depth_mm, [[0, 0, 1], [2, 2, 2]])
        assert readings[1].stamp_ns - readings[0].stamp_ns == 66_667_000
        assert device.rates_hz == {"depth": 15.0, "color": 30.0} and readings[1].dropped == 0
        assert device.read(0.0) is None


def test_an_orbbec_without_a_clock_is_stamped_by_arrival(monkeypatch):
    """Every image says 0 until somebody sets the camera's clock (orbbec/OrbbecSDK issue 91)."""
    monkeypatch.setitem(sys.modules, "pyorbbecsdk", FakeOrbbec)
    monkeypatch.setattr(FakeOrbbec, "stamped", False)
    with closing(open_device("orbbec:CP1")) as device:
        device.start()
        first, second = device.read(0.5), device.read(0.5)
    assert 0 < second.stamp_ns - first.stamp_ns < 10**9
    assert abs(second.arrival_ns - second.stamp_ns) < 10**9


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


def test_the_driver_reads_what_orbbecs_sdk_plays(tmp_path, monkeypatch):
    """A Femto Bolt's recording, written as the SDK writes it: all comes, bit for bit, and losses are counted.

    On a busy machine the SDK itself drops images, others each time it plays, and then waits for ever: it is
    played until all have come. Its streams start one after the other: about every second time the first depth
    image comes without its infrared one, whichever way the SDK is asked to gather them.
    """
    try:
        sdk = load_sdk()
    except DeviceNotFoundError as error:
        pytest.skip(str(error))
    from tests.helpers.orbbec_files import jpeg_of, write_orbbec_bag

    depth_lens = Intrinsics(640, 576, 504.0, 504.0, 320.0, 330.0, 0.1)
    color_lens = Intrinsics(1920, 1080, 1100.0, 1100.0, 960.0, 540.0, 0.08)
    rng, frames = np.random.default_rng(0), []
    for number in range(6):
        depth, infrared = rng.integers(0, 4000, (2, 576, 640), np.uint16)
        stamp_us = 1_000_000 + 33_333 * number
        frames.append((number, stamp_us, depth, infrared, jpeg_of(color_lens, 40 + number)))
    path = write_orbbec_bag(tmp_path / "bolt.bag", depth_lens, color_lens, frames)
    monkeypatch.setattr(Orbbec, "silence_s", PATIENCE_S)  # the SDK is no twin: it may pause on a busy machine
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


def test_a_cut_depth_frame_is_a_fault():
    values = {"get_height": 2, "get_width": 3, "get_data": np.zeros(10, np.uint8), "get_depth_scale": 1.0}
    with pytest.raises(DeviceFaultError, match="5 pixels came, not 6; wait for the next"):
        depth_of(SimpleNamespace(**{name: (lambda v=value: v) for name, value in values.items()}))
