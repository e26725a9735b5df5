"""Optris PI cameras through the vendor's libirdirectsdk.so: temperatures, and the flag (shutter).

Source of the C interface: irdirectsdk.h of libirimager (Evocortex). Constants are untuned unless a source is
given.
"""

import ctypes
import queue
import re
import threading
import time
from contextlib import suppress
from ctypes import CDLL, CFUNCTYPE, POINTER, Structure, c_char_p, c_float, c_int, c_longlong, c_uint
from ctypes.util import find_library
from functools import lru_cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sensors.device.protocol import Flag, ThermalImage
from sensors.device.streaming_camera import StreamingCamera
from sensors.drivers.y16 import check_temperatures
from sensors.errors import DeviceBusyError, DeviceError, DeviceNotFoundError
from sensors.files.bounded import MAX_IMAGE_SIDE, read_bounded

RATE_HZ = 128.0  # the PI200's fastest; the XML file may choose a slower mode
QUEUE = 64  # images that may wait for a slow reader: 0.5 s
IDLE_S = 0.002  # s between two calls without a new image
LARGEST_JUMP = 1000  # frames; a larger jump of the camera's counter is a reset or a wrap
OWN_AMBIENT_C = -999.0  # below absolute zero, the library measures the ambient temperature itself


class FrameMetadata(Structure):
    """``EvoIRFrameMetadata``. timestamp: units of 100 ns."""

    _fields_ = [
        ("counter", c_uint),
        ("counterHW", c_uint),
        ("timestamp", c_longlong),
        ("timestampMedia", c_longlong),
        ("flagState", c_int),
        ("tempChip", c_float),
        ("tempFlag", c_float),
        ("tempBox", c_float),
    ]


_SIZE = (POINTER(c_int), POINTER(c_int))
PROTOTYPES: dict[str, Any] = {
    "usb_init": CFUNCTYPE(c_int, c_char_p, c_char_p, c_char_p),
    "get_serial": CFUNCTYPE(c_int, POINTER(ctypes.c_ulong)),
    "get_thermal_image_size": CFUNCTYPE(c_int, *_SIZE),
    "get_thermal_image_metadata": CFUNCTYPE(c_int, *_SIZE, POINTER(ctypes.c_ushort), POINTER(FrameMetadata)),
    "set_radiation_parameters": CFUNCTYPE(c_int, c_float, c_float, c_float),
    "terminate": CFUNCTYPE(c_int),
}  # by name without ``evo_irimager_``; all return 0 on success


class DirectLibrary(SimpleNamespace):
    """C function pointers of ``PROTOTYPES`` by name, of the vendor's library or of its software twin.

    in_use: True while the library has its single camera open.
    """

    in_use = False


class _Received(NamedTuple):
    """Image of the library. values: uint16 (h, w), raw output, not yet Celsius."""

    stamp_ns: int
    values: NDArray[np.uint16]
    flag: Flag
    dropped: int
    arrival_ns: int


class OptrisDirect(StreamingCamera):
    """The camera of the vendor's ``config`` (generic.xml). Raises DeviceError if it cannot be opened.

    A thread calls the library, because a call blocks for an unknown time.
    """

    def __init__(self, config: Path, library: DirectLibrary | None = None) -> None:
        check_config(config)
        self._library = library or load_library()
        if self._library.in_use:
            raise DeviceBusyError("the vendor's library serves one camera at a time; close the other")
        if self._library.usb_init(str(config).encode(), None, None):
            raise DeviceError(
                f"the vendor's library cannot open a camera with {config}; plug it in, "
                "get its calibration with ir_download_calibration, and close other programs that use it"
            )
        self._library.in_use = True
        number = ctypes.c_ulong()
        serial = "" if self._library.get_serial(ctypes.byref(number)) else str(number.value)
        super().__init__(f"optris-direct:{config}", serial, {ThermalImage.stream: RATE_HZ})
        self.shape = self._read_shape()
        self._queue: queue.Queue[_Received] = queue.Queue(QUEUE)
        self._thread = threading.Thread(target=self._run, name=self.address, daemon=True)

    def _begin(self) -> None:
        self._thread.start()

    def _receive(self, timeout_s: float) -> None:
        with suppress(queue.Empty):
            stamp_ns, values, flag, dropped, arrival_ns = self._queue.get(timeout=max(timeout_s, 1e-6))
            celsius = celsius_of(values)
            if flag is Flag.OPEN:
                check_temperatures(celsius, values, self.address)
            self._take(stamp_ns, ThermalImage(celsius, flag), dropped, arrival_ns)

    def set_emissivity(self, emissivity: float) -> None:
        """Set the emissivity, 0.1 to 1.1. Raises DeviceError if the library refuses it."""
        if self._library.set_radiation_parameters(emissivity, 1.0, OWN_AMBIENT_C):
            raise DeviceError(f"{self.address} refused emissivity {emissivity:g}; give 0.1 to 1.1")

    def _end(self) -> None:
        self._library.terminate()
        if self._thread.is_alive():
            self._thread.join(self.silence_s)
        self._library.in_use = False

    def _run(self) -> None:
        before, dropped = FrameMetadata(), 0
        while not self._closed.is_set():
            values, metadata = np.empty(self.shape, np.uint16), FrameMetadata()
            height, width = (c_int(side) for side in self.shape)
            pointer = values.ctypes.data_as(POINTER(ctypes.c_ushort))
            failed = self._library.get_thermal_image_metadata(
                ctypes.byref(width), ctypes.byref(height), pointer, ctypes.byref(metadata)
            )
            arrival_ns = time.monotonic_ns()
            if failed or metadata.timestamp <= before.timestamp:
                self._closed.wait(IDLE_S)
                continue
            jump = metadata.counterHW - before.counterHW
            dropped += jump - 1 if before.timestamp and 1 < jump < LARGEST_JUMP else 0
            before = metadata
            image = _Received(
                100 * metadata.timestamp, values, flag_of(metadata.flagState), dropped, arrival_ns
            )
            try:
                self._queue.put_nowait(image)
                dropped = 0
            except queue.Full:
                dropped += 1

    def _read_shape(self) -> tuple[int, int]:
        width, height = c_int(), c_int()
        self._library.get_thermal_image_size(ctypes.byref(width), ctypes.byref(height))
        if not (0 < width.value <= MAX_IMAGE_SIDE and 0 < height.value <= MAX_IMAGE_SIDE):
            self._library.terminate()
            self._library.in_use = False
            raise DeviceError(f"the camera reports {width.value}x{height.value} pixels; switch it off and on")
        return height.value, width.value


def celsius_of(values: NDArray[np.uint16]) -> NDArray[np.float32]:
    """Return float32 (h, w) of the library's output: (v - 1000) / 10 (irdirectsdk.h)."""
    return ((values.astype(np.float32) - 1000) / 10).astype(np.float32)


def flag_of(state: int) -> Flag:
    """Return the library's flag state; ``Flag.ERROR`` for an undefined state."""
    return Flag(state) if state in {flag.value for flag in Flag} else Flag.ERROR


def check_config(config: Path) -> None:
    """Raise DeviceNotFoundError if the file, or the ``Cali-<serial>.xml`` that it refers to, is missing.

    Raises DeviceError for high precision, because the C interface does not report its decimal places
    (``IRImager::getTemprangeDecimal``).
    """
    remedy = "make it with ir_generate_configuration"
    text = read_bounded(config, remedy=remedy, error=DeviceNotFoundError).decode("utf-8", "replace")
    # Comments hold example settings.
    text = re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL)
    found = dict(re.findall(r"<(serial|calipath|enable_high_precision)>\s*([^<>]*?)\s*</\1>", text))
    if found.get("enable_high_precision", "0") != "0":
        raise DeviceError(f"{config} has enable_high_precision 1, which has another unit; set it to 0")
    number, folder = found.get("serial", "0"), found.get("calipath", "")
    if not re.fullmatch(r"\d{1,12}", number) or int(number) == 0 or not folder:
        return
    needed = Path(folder) / f"Cali-{int(number)}.xml"
    if not needed.exists():
        raise DeviceNotFoundError(
            f"calibration {needed} is missing; "
            "run: sudo ir_download_calibration, or copy it from the vendor's disk"
        )


@lru_cache(maxsize=1)
def load_library() -> DirectLibrary:
    """Return the vendor's library. Raises DeviceNotFoundError if it is not installed."""
    path = find_library("irdirectsdk")
    if path is None:
        raise DeviceNotFoundError(
            "libirdirectsdk.so is not installed; install libirimager from evocortex.org, "
            "or read raw counts with: optris:/dev/video0"
        )
    try:
        library = CDLL(path)
        pointers = {name: kind((f"evo_irimager_{name}", library)) for name, kind in PROTOTYPES.items()}
    except (OSError, AttributeError) as error:
        raise DeviceNotFoundError(f"{path} cannot be used ({error}); install libirimager 2") from error
    return DirectLibrary(**pointers)
