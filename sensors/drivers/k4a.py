"""Microsoft's Azure Kinect SDK (libk4a 1.4) by its C interface, from the wheel pyk4a-bundle or the system.

The wheel's own Python module is not used, because NumPy 2 cannot load it below glibc 2.38. Source of
functions, structures and numbers: k4a.h and k4atypes.h (MIT).
"""

import os
from collections.abc import Callable
from ctypes import (
    CDLL,
    Structure,
    byref,
    c_bool,
    c_int,
    c_int32,
    c_size_t,
    c_uint32,
    c_uint64,
    c_void_p,
    create_string_buffer,
    string_at,
)
from ctypes.util import find_library
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sensors.errors import DeviceError, DeviceNotFoundError

COLOR_MJPG, COLOR_1080P, NARROW_UNBINNED, FPS_30 = 0, 2, 2, 2
SUCCEEDED, FAILED = 0, 1  # results of the library; its third means a small buffer or a timeout


class Configuration(Structure):
    """``k4a_device_configuration_t``: unsynchronised images of a single device."""

    _fields_ = (
        ("color_format", c_int),
        ("color_resolution", c_int),
        ("depth_mode", c_int),
        ("camera_fps", c_int),
        ("synchronized_images_only", c_bool),
        ("depth_delay_off_color_usec", c_int32),
        ("wired_sync_mode", c_int),
        ("subordinate_delay_off_master_usec", c_uint32),
        ("disable_streaming_indicator", c_bool),
    )


class StampedDepth(NamedTuple):
    """Depth and infrared uint16 (h, w), in millimetres and amplitude, with their stamp in microseconds."""

    depth_mm: NDArray[np.uint16]
    infrared: NDArray[np.uint16] | None
    stamp_us: int


class Capture(NamedTuple):
    """Images of one capture. color: JPEG bytes and stamp in microseconds."""

    depth: StampedDepth | None
    color: tuple[bytes, int] | None


_RESULTS: dict[str, Any] = {
    "k4a_device_get_installed_count": c_uint32,
    "k4a_image_get_buffer": c_void_p,
    "k4a_image_get_size": c_size_t,
    "k4a_image_get_device_timestamp_usec": c_uint64,
    **{f"k4a_capture_get_{kind}_image": c_void_p for kind in ("depth", "ir", "color")},
}  # functions that do not return an int


@cache
def load_k4a() -> CDLL:
    """Return the library. Raises DeviceNotFoundError if it is not installed."""
    path = bundled("libk4a-*") or find_library("k4a")
    if path is None:
        raise DeviceNotFoundError(
            "the Azure Kinect SDK is not installed; pip install 'annotate-cloud[kinect]'"
        )
    # Without this the library prints to stdout when no device is connected.
    os.environ.setdefault("K4A_ENABLE_LOG_TO_STDOUT", "0")
    try:
        library = CDLL(str(path))
    except OSError as error:
        raise DeviceNotFoundError(
            f"the Azure Kinect SDK cannot be loaded ({error}); install the missing library"
        ) from error
    for name, kind in _RESULTS.items():
        getattr(library, name).restype = kind
    return library


def bundled(pattern: str) -> Path | None:
    """Return the path of a library that the installed wheel brings; None without the wheel or the library."""
    spec = find_spec("pyk4a")
    if spec is None or spec.origin is None:
        return None
    return next(Path(spec.origin).parent.parent.glob(f"pyk4a_bundle.libs/{pattern}"), None)


class Camera:
    """An open Azure Kinect. Raises DeviceError if it cannot be opened."""

    def __init__(self, index: int) -> None:
        self._k4a, self._handle = load_k4a(), c_void_p()
        if self._k4a.k4a_device_open(c_uint32(index), byref(self._handle)):
            raise DeviceError("the Azure Kinect cannot be opened; close the program that uses it")

    @property
    def serial(self) -> str:
        """Return the serial number."""
        return read_text(lambda *buffer: self._k4a.k4a_device_get_serialnum(self._handle, *buffer)).decode()

    def start(self) -> None:
        """Begin to stream depth of the narrow field of view and 1080p JPEG at 30 images a second."""
        wanted = Configuration(COLOR_MJPG, COLOR_1080P, NARROW_UNBINNED, FPS_30)
        if self._k4a.k4a_device_start_cameras(self._handle, byref(wanted)):
            raise DeviceError("the Azure Kinect does not start; use a USB 3 port and plug in its power")

    def factory_calibration(self) -> bytes:
        """Return the factory's JSON."""
        return read_text(lambda *buffer: self._k4a.k4a_device_get_raw_calibration(self._handle, *buffer))

    def capture(self, timeout_ms: int) -> Capture | None:
        """Return the next capture, or None after the timeout."""
        capture = c_void_p()
        result = self._k4a.k4a_device_get_capture(self._handle, byref(capture), c_int32(timeout_ms))
        if result == FAILED:
            raise DeviceError("the Azure Kinect is no longer connected; plug it in again")
        return read_capture(self._k4a, capture) if result == SUCCEEDED else None

    def close(self) -> None:
        """Stop and release the device."""
        self._k4a.k4a_device_stop_cameras(self._handle)
        self._k4a.k4a_device_close(self._handle)


def read_capture(k4a: CDLL, capture: c_void_p) -> Capture:
    """Return copies of a capture's images, and release the capture."""
    images = {kind: _image(k4a, capture, kind) for kind in ("depth", "ir", "color")}
    k4a.k4a_capture_release(capture)
    depth, infrared, color = images["depth"], images["ir"], images["color"]
    amplitude = None if infrared is None else _grey(infrared)
    return Capture(
        None if depth is None else StampedDepth(_grey(depth), amplitude, depth[1]),
        None if color is None else (color[0], color[1]),
    )


def _image(k4a: CDLL, capture: c_void_p, kind: str) -> tuple[bytes, int, int, int] | None:
    """Return bytes, stamp in microseconds, height and width of one image of a capture."""
    handle = getattr(k4a, f"k4a_capture_get_{kind}_image")(capture)
    if not handle:
        return None
    image = c_void_p(handle)
    data = string_at(k4a.k4a_image_get_buffer(image), k4a.k4a_image_get_size(image))
    sizes = k4a.k4a_image_get_height_pixels(image), k4a.k4a_image_get_width_pixels(image)
    stamp_us = int(k4a.k4a_image_get_device_timestamp_usec(image))
    k4a.k4a_image_release(image)
    return data, stamp_us, *sizes


def _grey(image: tuple[bytes, int, int, int]) -> NDArray[np.uint16]:
    return np.frombuffer(image[0], "<u2").reshape(image[2:]).astype(np.uint16)


def read_text(call: Callable[..., int]) -> bytes:
    """Return the text that a k4a function writes into a buffer.

    The function is called twice: without a buffer for the size, then with one. Raises DeviceError.
    """
    size = c_size_t(0)
    if call(None, byref(size)) == FAILED:
        raise DeviceError("the Azure Kinect does not answer; plug it in again")
    buffer = create_string_buffer(size.value)
    if call(buffer, byref(size)) != SUCCEEDED:
        raise DeviceError("the Azure Kinect does not answer; plug it in again")
    return buffer.raw[: size.value].rstrip(b"\0")
