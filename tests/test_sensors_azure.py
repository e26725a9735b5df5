"""Azure Kinect: the driver by its captures, and Microsoft's SDK on a real recording."""

from contextlib import closing
from types import SimpleNamespace

import numpy as np
import pytest

from sensors.device.streaming_camera import StreamingCamera
from sensors.drivers import azure_kinect
from sensors.drivers.azure_kinect import AzureKinect
from sensors.drivers.k4a import Capture, StampedDepth, load_k4a
from sensors.errors import (
    DeviceBusyError,
    DeviceError,
    DeviceLostError,
    DeviceNotFoundError,
)
from sensors.importers.open_source import open_source
from sensors.recording.open_device import find_devices
from sensors.rig.rig_calibration import calibration_to_json
from tests.helpers.azure_playback import Playback
from tests.helpers.samples import azure_calibration


@pytest.fixture(autouse=True)
def impatient(monkeypatch):
    """A camera that is silent for a fifth of a second is gone."""
    monkeypatch.setattr(StreamingCamera, "silence_s", 0.2)


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


class AzureCaptures:
    """Captures with these stamps in place of an Azure Kinect."""

    serial = "000042"

    def __init__(self, *stamps_us):
        self.stamps, self.closed = list(stamps_us), False

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


def test_an_azure_kinect_by_its_captures():
    camera = AzureCaptures(10_000, 43_333, 143_333)
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
    with closing(AzureKinect(camera=AzureCaptures(9_000_000, 8_966_000, 33_000))) as device:
        device.start()
        assert [device.read(0.5).stream for _ in range(2)] == ["depth", "color"]
        with pytest.raises(DeviceLostError, match="back by 9 s"):
            device.read(0.5)


def test_microsofts_sdk_and_the_importer_agree_on_a_real_recording_to_the_bit(shared_data):
    """The driver runs on the SDK's playback of the file that the importer reads."""
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
