"""One contract for every device that can be opened here, addresses, and errors on opening."""

import threading
from contextlib import closing
from dataclasses import replace
from importlib.util import find_spec
from itertools import count, pairwise
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sensors.device.address import Address
from sensors.device.protocol import ColorImage, DepthImage, Spot, ThermalCounts, ThermalImage
from sensors.device.streaming_camera import StreamingCamera
from sensors.drivers import kinect2, pyrometer, serial_line
from sensors.drivers.azure_kinect import AzureKinect, azure_devices
from sensors.drivers.lepton import Lepton
from sensors.drivers.optris import LAYOUTS, Optris
from sensors.drivers.optris_direct import OptrisDirect
from sensors.drivers.orbbec import Orbbec, orbbec_serials
from sensors.drivers.pyrometer import Pyrometer, PyrometerOptions
from sensors.drivers.pyrometer_protocol import CS, CT
from sensors.drivers.realsense import RealSense, Settings, realsense_serials
from sensors.drivers.y16 import Radiometry, WordCamera, boson_mode, y16_mode
from sensors.errors import (
    CloudError,
    DeviceBusyError,
    DeviceError,
    DeviceFaultError,
    DeviceLostError,
    DeviceNotFoundError,
)
from sensors.recording import open_device as open_device_module
from sensors.recording.open_device import find_devices, open_device
from sensors.rig.frame import RigFrame
from sensors.virtual.frame_loop import FrameLoop
from sensors.virtual.kinect2 import VirtualKinect2
from sensors.virtual.optris_direct import VirtualDirect
from sensors.virtual.pyrometer import LineFaults, VirtualPyrometer
from sensors.virtual.realsense import VirtualRealSense
from sensors.virtual.schedule import Faults
from sensors.virtual.v4l2 import VirtualLepton, VirtualOptris, VirtualWords, VirtualY16
from tests.helpers.swinging_ball import small_ball, swinging_ball

THERMAL = (ThermalImage, ThermalCounts)
VALUES = {"depth": DepthImage, "color": ColorImage, "thermal": THERMAL, "pyrometer": Spot}


@pytest.fixture(autouse=True)
def impatient(monkeypatch):
    """Twins answer at once; a device that is silent for a fifth of a second is gone."""
    monkeypatch.setattr(StreamingCamera, "silence_s", 0.2)
    monkeypatch.setattr(serial_line, "REPLY_S", 0.05)
    monkeypatch.setattr(serial_line, "QUIET_S", 0.005)
    monkeypatch.setattr(pyrometer, "POLL_HZ", 100.0)


# Each bench returns a twin with faults, and a function that opens the real driver on it.


def bench_kinect2(faults, folder):
    twin = VirtualKinect2(FrameLoop(swinging_ball()), faults)
    return twin, lambda: kinect2.Kinect2(shim=twin.shim)


def bench_realsense(faults, folder):
    twin = VirtualRealSense(FrameLoop(small_ball()), faults)
    settings = Settings(twin.size, twin.color_size)
    return twin, lambda: RealSense(settings=settings, context=twin)


def bench_optris(mode):
    def make(faults, folder):
        twin = VirtualOptris(LAYOUTS[mode], FrameLoop(swinging_ball()), faults)
        return twin, lambda: Optris(twin.node, LAYOUTS[mode])

    return make


def bench_lepton(faults, folder):
    twin = VirtualLepton(FrameLoop(swinging_ball()), replace(faults, hurry=10))
    return twin, lambda: Lepton(twin.node)


def bench_words(mode, shape):
    def make(faults, folder):
        words = VirtualWords(Radiometry(0.01), mode.rate_hz, shape)
        twin = VirtualY16(FrameLoop(swinging_ball()), faults, words)
        return twin, lambda: WordCamera(twin.node, mode)

    return make


def bench_direct(faults, folder):
    config = folder / "generic.xml"
    config.write_text("<imager><serial>0</serial></imager>")
    twin = VirtualDirect(FrameLoop(swinging_ball()), faults)
    return twin, lambda: OptrisDirect(config, twin.library)


def bench_pyrometer(family, burst):
    def make(faults, folder):
        options = PyrometerOptions(family, burst=burst)
        twin = VirtualPyrometer(options)

        def opened():
            device = Pyrometer(twin.port, options)
            twin.faults = LineFaults(loss=faults.drop**2)
            return device

        return twin, opened

    return make


BENCHES = {
    "kinect2": bench_kinect2,
    **{f"optris {mode}": bench_optris(mode) for mode in LAYOUTS},
    "optris-direct": bench_direct,
    "lepton": bench_lepton,
    "y16": bench_words(y16_mode((160, 120), 90.0, Radiometry(0.01)), (120, 160)),
    "boson": bench_words(boson_mode(True), (256, 320)),
    "pyrometer ct": bench_pyrometer(CT, False),
    "pyrometer cs": bench_pyrometer(CS, False),
    "pyrometer ct burst": bench_pyrometer(CT, True),
    "realsense": bench_realsense,
}
WITHOUT_SDK = pytest.mark.skipif(
    find_spec("pyrealsense2") is None, reason="no pyrealsense2: pip install 'annotate-cloud[realsense]'"
)


@pytest.fixture(params=[pytest.param(kind, marks=[WITHOUT_SDK] * (kind == "realsense")) for kind in BENCHES])
def bench(request, tmp_path):
    """Make the bench of each kind of device in turn, with faults."""
    made = []

    def make(faults=None):
        twin, opened = BENCHES[request.param](faults or Faults(), tmp_path)
        made.append(twin)
        return SimpleNamespace(open=opened, unplug=twin.unplug)

    yield make
    for twin in made:
        twin.unplug()


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


def test_contract_of_streams_stamps_and_one_opening(bench):
    made = bench()
    with closing(made.open()) as device:
        assert device.address and isinstance(device.serial, str)
        assert device.rates_hz and all(rate > 0 for rate in device.rates_hz.values())
        with pytest.raises(DeviceBusyError, match=r"; |one camera at a time"):
            made.open()
        device.start()
        readings = read_on(device, 8)
    assert {r.stream for r in readings} == set(device.rates_hz)
    for stream in device.rates_hz:
        mine = [r for r in readings if r.stream == stream]
        assert all(isinstance(r.value, VALUES[stream]) for r in mine)
        assert all(a.stamp_ns < b.stamp_ns and a.arrival_ns <= b.arrival_ns for a, b in pairwise(mine))
    if not device.address.startswith("optris-direct"):
        made.open().close()


def test_contract_a_timeout_gives_none_and_not_a_hang(bench):
    with closing(bench(Faults(drop=1.0)).open()) as device:
        device.start()
        try:
            assert device.read(0.02) is None or device.read(0.0) is None
        except DeviceFaultError as fault:
            assert device.address.startswith("pyrometer") and "answered 0 of 2 bytes" in str(fault)


def test_contract_unplugging_gives_the_remedy(bench):
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


def test_contract_losses_are_reported(bench):
    with closing(bench(Faults(drop=0.25)).open()) as device:
        device.start()
        dropped, read = 0, 0
        while not dropped and read < 300:
            dropped += sum(r.dropped for r in read_on(device, 10))
            read += 10
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
    """Any source of rig frames; the first second is shown in a loop."""

    def endless():
        for index in count():
            depth = np.full((424, 512), 1000 + index, np.uint16)
            yield RigFrame(index, 0, depth, b"\xff\xd8\xff" if index % 2 else None)

    with closing(open_device("virtual:kinect2", endless())) as device:
        device.start()
        shown = {r.stream: r.value for r in read_on(device, 2)}
    assert 1000 <= shown["depth"].depth_mm[0, 0] < 1030 and shown["color"].encoded == b"\xff\xd8\xff"
    with pytest.raises(DeviceError, match="have no frames to show"):
        open_device("virtual:kinect2", iter(()))
    depth_only = [RigFrame(0, 0, np.zeros((424, 512), np.uint16))]
    for kind, missing in (("optris", "thermal"), ("optris-direct", "thermal"), ("kinect2", "colour")):
        with pytest.raises(DeviceError, match=f"have no {missing} images to show; give a session"):
            open_device(f"virtual:{kind}", depth_only)


@pytest.mark.parametrize(
    ("address", "match"),
    [
        ("", "is of an unknown kind; use kinect2"),
        ("virtual:azure", "virtual device 'virtual:azure' does not exist; use virtual:"),
        ("virtual:optris?mode=1hz", "mode '1hz' .* is unknown; use 128hz"),
        ("virtual:optris?speed=1", "unknown option 'speed'; use drop"),
        ("virtual:optris?drop=2", "drop '2' .* is impossible; give a number from 0 to 1"),
        ("virtual:optris?drop=nan", "is impossible; give a number from 0 to 1"),
        ("virtual:optris?drop", "malformed options"),
        ("virtual:optris?drop=0&drop=1", "gives an option twice"),
        ("virtual:pyrometer?family=ir", "family 'ir' .* is unknown; use ct, cs"),
        ("virtual:pyrometer?rs485=1.5", "is not a whole number; give one from 1 to 32"),
        ("virtual:pyrometer?rs485=99", "rs485 '99' .* is impossible; give a number from 1 to 32"),
        ("virtual:pyrometer?emissivity=0.09", "emissivity '0.09' .* is impossible; give a number from 0.1"),
        ("virtual:pyrometer?family=cs&burst=yes", "cs family has no burst"),
        ("virtual:pyrometer?refuse=1&emissivity=2", "emissivity '2' .* is impossible; give a number"),
        *((f"{k}:", f"names no node; give for instance {k}:/dev/video0") for k in ("optris", "y16")),
        *((f"{k}:/no", "/no does not exist; plug the dev") for k in ("optris", "pyrometer", "y16", "lepton")),
        ("realsense:?size=1x1", "size '1x1' .* is unknown; use 848x480"),
        ("realsense:?preset=best", "preset 'best' .* is unknown; use default"),
        ("realsense:?laser=361", "laser '361' .* is impossible; give a number from 0 to 360"),
        ("kinect2:1?mode=1", "unknown option 'mode'; use mirror, turn"),
        ("y16:/dev/video77?scale=0.01", "only one of scale and offset; give both, or none for counts"),
        ("y16:/dev/video77?width=0", "width '0' .* is impossible; give a number from 1"),
        ("y16:/dev/video77?mode=1", "use height, mirror, offset, rate, scale, turn, width"),
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


# --- the list of devices ---


def test_devices_lists_virtual_devices_thermal_cameras_and_ports(annotate_cloud, monkeypatch):
    monkeypatch.setattr(open_device_module, "video_nodes", lambda usb_id: [(Path("/dev/video7"), "77")])
    port = SimpleNamespace(device="/dev/ttyUSB9", serial_number=None)
    monkeypatch.setattr(open_device_module, "comports", lambda: [port])
    found = {one.address: one for one in find_devices()}
    assert found["optris:/dev/video7"].serial == "77"
    assert "group video" in found["optris:/dev/video7"].note
    assert "group dialout" in found["pyrometer:/dev/ttyUSB9"].note
    done = annotate_cloud("devices", "--json")
    listed = {entry["address"]: entry for entry in done.result["devices"]}
    assert done.code == 0 and all(listed[address]["virtual"] for address in open_device_module.VIRTUAL)
    notes = [found.note for found in open_device_module._numbered("kinect2", ["A", "B", "A"])]
    assert notes[1] == "" and notes[0] == notes[2] and "same serial number" in notes[0]


def test_without_their_libraries_they_give_the_package_to_install():
    for kind, serials in (
        (AzureKinect, azure_devices),
        (Orbbec, orbbec_serials),
        (RealSense, realsense_serials),
    ):
        if not serials():
            with pytest.raises(DeviceNotFoundError, match=r"install|plugged in"):
                kind()
