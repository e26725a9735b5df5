"""Azure Kinect through Microsoft's SDK (extra ``kinect``)."""

from contextlib import closing, suppress
from typing import Protocol

from sensors.device.protocol import ColorImage, DepthImage
from sensors.device.streaming_camera import DEPTH_CAMERA_RATES_HZ, StreamingCamera, choose
from sensors.drivers.k4a import Camera, Capture, load_k4a
from sensors.errors import DeviceBusyError, DeviceError, DeviceLostError, DeviceNotFoundError
from sensors.importers.azure_calibration import calibration_from_factory
from sensors.rig.rig_calibration import RigCalibration

DEPTH_SIZE, COLOR_SIZE = (640, 576), (1920, 1080)  # narrow view, unbinned; 1080p as the device's own JPEG
CLOSED = "close the program that uses it, or add its udev rule"


class Streaming(Protocol):
    """Source of captures: an open ``Camera`` or a recording. Methods raise DeviceError."""

    @property
    def serial(self) -> str: ...
    def start(self) -> None: ...
    def factory_calibration(self) -> bytes: ...
    def capture(self, timeout_ms: int) -> Capture | None: ...
    def close(self) -> None: ...


class AzureKinect(StreamingCamera):
    """Azure Kinect with this serial number, or the only one. Raises DeviceError if it cannot be opened.

    camera: replacement source of captures; color_size: of its colour images.
    """

    def __init__(
        self, serial: str = "", camera: Streaming | None = None, color_size: tuple[int, int] = COLOR_SIZE
    ) -> None:
        self._camera = camera or _opened(serial)
        self._color_size = color_size
        super().__init__(f"azure:{self._camera.serial}", self._camera.serial, DEPTH_CAMERA_RATES_HZ)

    def _begin(self) -> RigCalibration:
        try:
            self._camera.start()
        except DeviceError as error:
            raise DeviceError(
                f"{self.address} does not start; use a USB 3 port and plug in its power"
            ) from error
        factory = self._camera.factory_calibration()
        return calibration_from_factory(factory, DEPTH_SIZE, self._color_size, "NFOV_UNBINNED")

    def _receive(self, timeout_s: float) -> None:
        try:
            capture = self._camera.capture(round(timeout_s * 1000))
        except DeviceError as error:
            raise DeviceLostError(f"{self.address} is no longer connected; plug it in again") from error
        if capture is not None and capture.depth is not None:
            depth_mm, infrared, stamp_us = capture.depth
            self._take(1000 * stamp_us, DepthImage(depth_mm, infrared))
        if capture is not None and capture.color is not None:
            encoded, stamp_us = capture.color
            self._take(1000 * stamp_us, ColorImage(encoded))

    def _end(self) -> None:
        self._camera.close()


def _opened(serial: str) -> Camera:
    load_k4a()
    there = azure_devices()
    numbers = [number for _, number in there if number]
    if there and not numbers:
        raise DeviceBusyError(f"no Azure Kinect can be opened; {CLOSED}")
    chosen = choose("Azure Kinect", numbers, serial)
    try:
        return Camera(next(index for index, number in there if number == chosen))
    except DeviceError as error:
        raise DeviceBusyError(f"azure:{chosen} cannot be opened; {CLOSED}") from error


def azure_devices() -> list[tuple[int, str]]:
    """Return index and serial number of the connected devices; empty without the SDK.

    Each device is opened briefly to read its number, which is "" if the device does not open.
    """
    found = []
    with suppress(DeviceNotFoundError):
        for index in range(load_k4a().k4a_device_get_installed_count()):
            serial = ""
            with suppress(DeviceError), closing(Camera(index)) as camera:
                serial = camera.serial
            found.append((index, serial))
    return found
