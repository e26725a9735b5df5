"""Kinect v2 through libfreenect2 (0.2): depth with its infrared image, colour as the device's own JPEG."""

import time
from collections.abc import Mapping
from ctypes import byref, c_float, create_string_buffer
from threading import Event, Lock

import numpy as np
from numpy.typing import NDArray

from sensors.device.choose import choose
from sensors.device.protocol import ColorImage, DepthImage, Reading
from sensors.device.ticks import Sequence, WrappingCounter
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
from sensors.errors import DeviceBusyError, DeviceError, DeviceFaultError, DeviceLostError
from sensors.rig.camera import Intrinsics
from sensors.rig.kinect2_factory import KinectColorParams

USB_IDS = ("045e:02d8", "045e:02c4")
"""A Kinect v2, and its preview version (libfreenect2.hpp)."""
TICK_NS = 125_000
RATE_HZ = 30.0
DEPTH_SHAPE, COLOR_SIZE = (424, 512), (1920, 1080)
BUFFER_BYTES = 8 << 20
"""libfreenect2's own packets are no longer."""
SILENCE_S = 2.0
"""libfreenect2 does not tell that a device was unplugged: it falls silent."""
SLICE_S = 0.1


class Kinect2:
    """One Kinect v2. serial: which, or empty for the only one. Depth and colour are not synchronised.

    color_params: the factory's mapping from depth to colour, for ``annotate.cloud.registration``.
    Raises DeviceError.
    """

    def __init__(self, serial: str = "", shim: Shim | None = None) -> None:
        self._shim = shim or load_shim()
        serials = kinect2_serials(self._shim)
        if not serials and shim is None:
            check_usb(USB_IDS)
        self.serial = choose("Kinect v2", serials, serial)
        self.address = f"kinect2:{self.serial}"
        self.rates_hz: Mapping[str, float] = {DepthImage.stream: RATE_HZ, ColorImage.stream: RATE_HZ}
        self._handle = self._shim.k2_open(self.serial.encode())
        if not self._handle:
            raise DeviceBusyError(f"{self.address} cannot be opened; close the program that uses it")
        self._lock, self._closed = Lock(), Event()
        self._buffer = create_string_buffer(BUFFER_BYTES)
        # Both streams are stamped by one clock.
        self._clock = WrappingCounter()
        self._numbers = {DEPTH: Sequence(), COLOR: Sequence()}
        self._dropped = {DEPTH: 0, COLOR: 0}
        self._infrared: tuple[int, NDArray[np.uint16] | None] = (-1, None)
        self._heard_s = time.monotonic()
        self._params: tuple[Intrinsics, KinectColorParams] | None = None

    def start(self) -> None:
        """Begin both streams; only then the device tells its factory calibration."""
        if self._shim.k2_start(self._handle):
            raise DeviceError(f"{self.address} does not start; use a USB 3 port, and plug its power in")
        self._params = self._ask_params()
        self._heard_s = time.monotonic()

    @property
    def cameras(self) -> Mapping[str, Intrinsics]:
        """Factory intrinsics of the infrared and the colour camera; empty before ``start``."""
        if self._params is None:
            return {}
        depth, color = self._params
        lens = Intrinsics(*COLOR_SIZE, color.f, color.f, color.cx, color.cy)
        return {DepthImage.stream: depth, ColorImage.stream: lens}

    @property
    def color_params(self) -> KinectColorParams:
        """The factory's colour polynomials. Raises DeviceError before ``start``."""
        if self._params is None:
            raise DeviceError(f"{self.address} tells its calibration once it runs; start it first")
        return self._params[1]

    def read(self, timeout_s: float) -> Reading | None:
        """Next depth or colour image; see ``Device.read``."""
        end_s = time.monotonic() + timeout_s
        while True:
            left_s = end_s - time.monotonic()
            frame = Frame()
            with self._lock:
                if self._closed.is_set():
                    raise DeviceLostError(f"{self.address} is closed; open it again")
                wait_ms = max(0, round(1000 * min(left_s, SLICE_S)))
                code = self._shim.k2_read(self._handle, wait_ms, byref(frame), self._buffer, BUFFER_BYTES)
            arrival_ns = time.monotonic_ns()
            if code == 1 and (reading := self._reading(frame, arrival_ns)) is not None:
                return reading
            if code < 0:
                raise DeviceFaultError(f"{self.address} sent {frame.bytes} bytes at once; plug it in anew")
            if code == 0 and time.monotonic() - self._heard_s > SILENCE_S:
                raise DeviceLostError(
                    f"{self.address} has sent nothing for {SILENCE_S:g} s; check its USB 3 cable and power"
                )
            if left_s <= SLICE_S:
                return None

    def close(self) -> None:
        """Stop and give the device back; idempotent."""
        if not self._closed.is_set():
            self._closed.set()
            with self._lock:
                self._shim.k2_close(self._handle)

    def _reading(self, frame: Frame, arrival_ns: int) -> Reading | None:
        """The frame in the buffer; None for one that is late or broken, which counts as dropped.

        None too for an infrared image, which waits for the depth image of its number.
        """
        self._heard_s = time.monotonic()
        if frame.type == INFRARED:
            self._infrared = frame.sequence, self._image(frame)
            return None
        lost = self._numbers[frame.type].lost_before(frame.sequence)
        if lost is None:
            return None
        self._dropped[frame.type] += lost
        stamp_ns = self._clock.unwrap(frame.timestamp) * TICK_NS
        value = self._color(frame) if frame.type == COLOR else self._depth(frame)
        if frame.status or value is None:
            self._dropped[frame.type] += 1
            return None
        dropped, self._dropped[frame.type] = self._dropped[frame.type], 0
        return Reading(stamp_ns, arrival_ns, value, dropped)

    def _color(self, frame: Frame) -> ColorImage:
        return ColorImage(bytes(memoryview(self._buffer)[: frame.bytes]))

    def _depth(self, frame: Frame) -> DepthImage | None:
        image, (number, infrared) = self._image(frame), self._infrared
        if image is None:
            return None
        return DepthImage(image, infrared if number == frame.sequence else None)

    def _image(self, frame: Frame) -> NDArray[np.uint16] | None:
        """The float image in the buffer, rounded; None for one of another size."""
        if (frame.height, frame.width) != DEPTH_SHAPE or frame.bytes != 4 * frame.height * frame.width:
            return None
        values = np.frombuffer(memoryview(self._buffer), np.float32, frame.height * frame.width)
        return uint16_from_float(values.reshape(DEPTH_SHAPE))

    def _ask_params(self) -> tuple[Intrinsics, KinectColorParams]:
        infrared, color = (c_float * INFRARED_PARAMS)(), (c_float * COLOR_PARAMS)()
        self._shim.k2_params(self._handle, infrared, color)
        fx, fy, cx, cy, k1, k2, k3, p1, p2 = infrared
        depth = Intrinsics(512, 424, fx, fy, cx, cy, k1, k2, p1, p2, k3)
        f, _, color_cx, color_cy, shift_d, shift_m = color[:6]
        mx, my = tuple(color[6:16]), tuple(color[16:26])
        return depth, KinectColorParams(f, color_cx, color_cy, shift_d, shift_m, mx, my)


def kinect2_serials(shim: Shim) -> list[str]:
    """Serial numbers of the devices that can be opened."""
    text = create_string_buffer(64)
    found = range(shim.k2_count())
    return [text.value.decode("ascii", "replace") for index in found if not shim.k2_serial(index, text, 64)]


def uint16_from_float(values: NDArray[np.float32]) -> NDArray[np.uint16]:
    """libfreenect2's float millimetres, or amplitude, rounded; negative, infinite or NaN becomes 0."""
    good = np.isfinite(values) & (values > 0)
    return np.rint(np.where(good, values, 0)).clip(0, 65535).astype(np.uint16)
