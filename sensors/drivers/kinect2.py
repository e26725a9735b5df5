"""Kinect v2 through libfreenect2 (0.2): depth with its infrared image, colour as the device's own JPEG.

libfreenect2's images and intrinsics are mirrored left to right (OpenKinect/libfreenect2 issues 172 and 474).
The driver mirrors both back, as kinect2_bridge.cpp of code-iai/iai_kinect2 does (``cv::flip(.., 1)``).
"""

import ctypes
from ctypes import CDLL, CFUNCTYPE, POINTER, Structure, c_char_p, c_float, c_int, c_uint32, c_void_p
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sensors.device.mounting import Mounting
from sensors.device.node import check_usb
from sensors.device.protocol import ColorImage, DepthImage
from sensors.device.streaming_camera import DEPTH_CAMERA_RATES_HZ, StreamingCamera, choose
from sensors.drivers.kinect2_build import built_shim
from sensors.errors import DeviceBusyError, DeviceError, DeviceFaultError, DeviceNotFoundError
from sensors.files.jpeg import mirrored_jpeg
from sensors.rig.camera import Intrinsics
from sensors.rig.rig_calibration import RigCalibration
from sensors.rig.wrapping_counter import WrappingCounter

USB_IDS = ("045e:02d8", "045e:02c4")  # a Kinect v2 and its preview version (libfreenect2.hpp)
TICK_NS = 125_000  # ns; one step of the device's clock
DEPTH_SHAPE = (424, 512)
BUFFER_BYTES = 8 << 20  # longest packet of libfreenect2
COLOR, INFRARED, DEPTH = 1, 2, 4  # frame types (libfreenect2's Frame::Type)
INFRARED_PARAMS, COLOR_PARAMS = 9, 26
MIRRORED = Mounting(mirror=True)  # transformation between libfreenect2's images and the driver's, either way


class Frame(Structure):
    """``k2_frame``: header of a frame."""

    _fields_ = [
        (name, c_uint32) for name in ("type", "timestamp", "sequence", "status", "width", "height", "bytes")
    ]


PROTOTYPES: dict[str, Any] = {
    "k2_count": CFUNCTYPE(c_int),
    "k2_serial": CFUNCTYPE(c_int, c_int, POINTER(ctypes.c_char), c_int),
    "k2_open": CFUNCTYPE(c_void_p, c_char_p),
    "k2_params": CFUNCTYPE(None, c_void_p, POINTER(c_float), POINTER(c_float)),
    "k2_start": CFUNCTYPE(c_int, c_void_p),
    "k2_read": CFUNCTYPE(c_int, c_void_p, c_int, POINTER(Frame), c_void_p, c_uint32),
    "k2_close": CFUNCTYPE(None, c_void_p),
}


class Shim(SimpleNamespace):
    """C function pointers of ``PROTOTYPES`` by name, of the compiled library or of a software twin."""


class Kinect2(StreamingCamera):
    """The Kinect v2 with this serial number, or the only one. Depth and colour are not synchronised.

    The calibration has only the depth camera, because the firmware's model of colour is not a pinhole camera.
    Raises DeviceError if the camera cannot be opened.
    """

    def __init__(self, serial: str = "", shim: Shim | None = None) -> None:
        self._shim = shim or load_shim()
        serials = kinect2_serials(self._shim)
        if not serials and shim is None:
            check_usb(USB_IDS)
        chosen = choose("Kinect v2", serials, serial)
        super().__init__(f"kinect2:{chosen}", chosen, DEPTH_CAMERA_RATES_HZ)
        self._handle = self._shim.k2_open(chosen.encode())
        if not self._handle:
            raise DeviceBusyError(f"{self.address} cannot be opened; close the program that uses it")
        self._buffer = ctypes.create_string_buffer(BUFFER_BYTES)
        self._clock, self._numbers = WrappingCounter(), {DEPTH: WrappingCounter(), COLOR: WrappingCounter()}
        self._before: dict[int, int] = {}
        self._infrared: tuple[int, NDArray[np.uint16] | None] = (-1, None)

    def _begin(self) -> RigCalibration:
        if self._shim.k2_start(self._handle):
            raise DeviceError(f"{self.address} does not start; use a USB 3 port and plug in its power")
        infrared, color = (c_float * INFRARED_PARAMS)(), (c_float * COLOR_PARAMS)()
        self._shim.k2_params(self._handle, infrared, color)
        fx, fy, cx, cy, k1, k2, k3, p1, p2 = infrared
        mirrored = Intrinsics(512, 424, fx, fy, cx, cy, k1, k2, p1, p2, k3)
        return RigCalibration(MIRRORED.camera(mirrored))

    def _receive(self, timeout_s: float) -> None:
        frame = Frame()
        wait_ms = round(1000 * timeout_s)
        code = self._shim.k2_read(self._handle, wait_ms, ctypes.byref(frame), self._buffer, BUFFER_BYTES)
        if code < 0:
            raise DeviceFaultError(f"{self.address} sent {frame.bytes} bytes as one frame; plug it in again")
        if code and frame.type == INFRARED:
            self._infrared = frame.sequence, self._image(frame)
        elif code:
            self._take_frame(frame)

    def _end(self) -> None:
        self._shim.k2_close(self._handle)

    def _take_frame(self, frame: Frame) -> None:
        """Queue the frame in the buffer; a late or broken frame counts as lost."""
        number = self._numbers[frame.type].unwrap(frame.sequence)
        before = self._before.setdefault(frame.type, number - 1)
        stamp_ns = self._clock.unwrap(frame.timestamp) * TICK_NS
        image, (infrared_number, infrared) = self._image(frame), self._infrared
        if frame.type == COLOR:
            encoded = bytes(memoryview(self._buffer)[: frame.bytes])
            value: ColorImage | DepthImage = ColorImage(mirrored_jpeg(encoded))
        elif image is None:
            return
        else:
            value = DepthImage(image, infrared if infrared_number == frame.sequence else None)
        if number > before and not frame.status:
            self._before[frame.type] = number
            self._take(stamp_ns, value, number - before - 1)

    def _image(self, frame: Frame) -> NDArray[np.uint16] | None:
        """Return the buffer's float image rounded and mirrored, uint16 (424, 512); None if its size is not
        ``DEPTH_SHAPE``.
        """
        if (frame.height, frame.width) != DEPTH_SHAPE or frame.bytes != 4 * frame.height * frame.width:
            return None
        values = np.frombuffer(memoryview(self._buffer), np.float32, frame.height * frame.width)
        return MIRRORED.image(uint16_from_float(values.reshape(DEPTH_SHAPE)))


def load_shim(path: Path | None = None) -> Shim:
    """Return the compiled shim, by default built for this libfreenect2. Raises DeviceNotFoundError if it
    cannot be built or loaded.
    """
    path = path or built_shim()
    try:
        library = CDLL(str(path))
        return Shim(**{name: prototype((name, library)) for name, prototype in PROTOTYPES.items()})
    except (OSError, AttributeError) as error:
        raise DeviceNotFoundError(
            f"{path.name} cannot be loaded ({error}); install the libfreenect2 that it was built with"
        ) from error


def kinect2_serials(shim: Shim) -> list[str]:
    """Return the serial numbers of the devices that can be opened."""
    text = ctypes.create_string_buffer(64)
    found = range(shim.k2_count())
    return [text.value.decode("ascii", "replace") for index in found if not shim.k2_serial(index, text, 64)]


def uint16_from_float(values: NDArray[np.float32]) -> NDArray[np.uint16]:
    """Return libfreenect2's float image (h, w) rounded; NaN and negative values become 0."""
    good = np.isfinite(values) & (values > 0)
    return np.rint(np.where(good, values, 0)).clip(0, 65535).astype(np.uint16)
