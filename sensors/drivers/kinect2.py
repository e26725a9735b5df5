"""Kinect v2 through libfreenect2 (0.2): depth with its infrared image, colour as the device's own JPEG."""

from ctypes import byref, c_float, create_string_buffer

import numpy as np
from numpy.typing import NDArray

from sensors.device.choose import choose
from sensors.device.depth_camera import DepthCamera, TimedImage
from sensors.device.protocol import ColorImage, DepthImage
from sensors.device.ticks import RunningNumbers, WrappingCounter
from sensors.device.usb import check_usb
from sensors.drivers.kinect2_shim import (
    COLOR,
    COLOR_PARAMS,
    DEPTH,
    INFRARED,
    INFRARED_PARAMS,
    Frame,
    Shim,
    load_shim,
)
from sensors.errors import DeviceBusyError, DeviceError, DeviceFaultError
from sensors.rig.camera import Intrinsics
from sensors.rig.rig_calibration import RigCalibration

USB_IDS = ("045e:02d8", "045e:02c4")
"""A Kinect v2, and its preview version (libfreenect2.hpp)."""
TICK_NS = 125_000
"""Nanoseconds of one step of the device's clock (see ``ticks``)."""
DEPTH_SHAPE = (424, 512)
BUFFER_BYTES = 8 << 20
"""libfreenect2's own packets are no longer."""


class Kinect2(DepthCamera):
    """One Kinect v2. serial: which, or empty for the only one. Depth and colour are not synchronised.

    Its calibration has the depth camera alone: the firmware's model of colour is no pinhole camera.
    Raises DeviceError.
    """

    def __init__(self, serial: str = "", shim: Shim | None = None) -> None:
        library = shim or load_shim()
        serials = kinect2_serials(library)
        if not serials and shim is None:
            check_usb(USB_IDS)
        chosen = choose("Kinect v2", serials, serial)
        super().__init__(f"kinect2:{chosen}", chosen, _Library(library, chosen))


class _Library:
    """The shim as a ``CaptureLibrary``: a capture is one image, of one stream."""

    def __init__(self, shim: Shim, serial: str) -> None:
        self._shim, self._name = shim, f"kinect2:{serial}"
        self._handle = shim.k2_open(serial.encode())
        if not self._handle:
            raise DeviceBusyError(f"{self._name} cannot be opened; close the program that uses it")
        self._buffer = create_string_buffer(BUFFER_BYTES)
        # Both streams are stamped by one clock.
        self._clock = WrappingCounter()
        self._numbers = {DEPTH: RunningNumbers(), COLOR: RunningNumbers()}
        self._lost = {DEPTH: 0, COLOR: 0}
        self._infrared: tuple[int, NDArray[np.uint16] | None] = (-1, None)

    def start(self) -> RigCalibration:
        """Begin both streams; only then can the factory calibration be read."""
        if self._shim.k2_start(self._handle):
            raise DeviceError(f"{self._name} does not start; use a USB 3 port, and plug its power in")
        infrared, color = (c_float * INFRARED_PARAMS)(), (c_float * COLOR_PARAMS)()
        self._shim.k2_params(self._handle, infrared, color)
        fx, fy, cx, cy, k1, k2, k3, p1, p2 = infrared
        return RigCalibration(Intrinsics(512, 424, fx, fy, cx, cy, k1, k2, p1, p2, k3))

    def capture(self, timeout_s: float) -> list[TimedImage]:
        frame = Frame()
        wait_ms = round(1000 * timeout_s)
        code = self._shim.k2_read(self._handle, wait_ms, byref(frame), self._buffer, BUFFER_BYTES)
        if code < 0:
            raise DeviceFaultError(
                f"{self._name} sent {frame.bytes} bytes at once; unplug it and plug it in again"
            )
        if code and frame.type == INFRARED:
            # It waits for the depth image of its number.
            self._infrared = frame.sequence, self._image(frame)
            return []
        return self._images(frame) if code else []

    def close(self) -> None:
        self._shim.k2_close(self._handle)

    def _images(self, frame: Frame) -> list[TimedImage]:
        """The frame in the buffer; none where it is late or broken, which counts as lost."""
        lost = self._numbers[frame.type].lost_before(frame.sequence)
        if lost is None:
            return []
        self._lost[frame.type] += lost
        stamp_ns = self._clock.unwrap(frame.timestamp) * TICK_NS
        value = self._color(frame) if frame.type == COLOR else self._depth(frame)
        if frame.status or value is None:
            self._lost[frame.type] += 1
            return []
        lost, self._lost[frame.type] = self._lost[frame.type], 0
        return [TimedImage(stamp_ns, value, lost)]

    def _color(self, frame: Frame) -> ColorImage:
        return ColorImage(bytes(memoryview(self._buffer)[: frame.bytes]))

    def _depth(self, frame: Frame) -> DepthImage | None:
        image, (number, infrared) = self._image(frame), self._infrared
        if image is None:
            return None
        return DepthImage(image, infrared if number == frame.sequence else None)

    def _image(self, frame: Frame) -> NDArray[np.uint16] | None:
        """uint16 (424, 512): the float image in the buffer, rounded; None for one of another size."""
        if (frame.height, frame.width) != DEPTH_SHAPE or frame.bytes != 4 * frame.height * frame.width:
            return None
        values = np.frombuffer(memoryview(self._buffer), np.float32, frame.height * frame.width)
        return uint16_from_float(values.reshape(DEPTH_SHAPE))


def kinect2_serials(shim: Shim) -> list[str]:
    """Serial numbers of the devices that can be opened."""
    text = create_string_buffer(64)
    found = range(shim.k2_count())
    return [text.value.decode("ascii", "replace") for index in found if not shim.k2_serial(index, text, 64)]


def uint16_from_float(values: NDArray[np.float32]) -> NDArray[np.uint16]:
    """uint16 (h, w): libfreenect2's float millimetres, or amplitude, rounded; no or negative values are 0."""
    good = np.isfinite(values) & (values > 0)
    return np.rint(np.where(good, values, 0)).clip(0, 65535).astype(np.uint16)
