"""UVC thermal cameras that give 16-bit words (Y16): a FLIR Boson, or any by its scale and offset."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from sensors.checks.celsius_check import scales_of_cameras
from sensors.device.address import Address
from sensors.device.protocol import ThermalCounts, ThermalImage
from sensors.device.v4l2_camera import CaptureKind, V4l2Camera
from sensors.drivers.flag_watch import FlagWatch
from sensors.errors import DeviceError, DeviceFaultError

FOURCC = "Y16 "
COLDEST_C, HOTTEST_C = -60.0, 650.0
"""Degrees Celsius between which the middle of an image of temperatures lies: wider than these cameras'
ranges, but narrow enough for raw counts, or another scale, to fall outside. Untuned."""
ABSOLUTE_ZERO_C = -273.15
BOSON_USB_ID = "09cb:4007"
"""Vendor and product of a Boson (FLIR; flirpy looks for it)."""
BOSON_SIZES = ((640, 512), (320, 256))
BOSON_HZ = 60.0
"""Images a second; 8.6 of models for export (FLIR's data sheet 102-2013-40)."""
BOSON_KELVIN = 0.01
"""Temperature of one step of a radiometric Boson's words in high gain (TLinear: kelvin x 100). Words of low
gain (kelvin x 50) are refused. Source: notes on FLIR's Boson SDK; flirpy issue 87 names the mode."""


@dataclass(frozen=True)
class Radiometry:
    """Celsius = scale * word + offset_c."""

    scale: float
    offset_c: float = ABSOLUTE_ZERO_C

    def celsius(self, words: NDArray[np.uint16], name: str) -> NDArray[np.float32]:
        """float32 (h, w). Raises DeviceFaultError with ``name`` for words that are not temperatures."""
        celsius = words * np.float32(self.scale) + np.float32(self.offset_c)
        check_temperatures(celsius, words, name)
        return celsius.astype(np.float32)


def check_temperatures(celsius: NDArray[np.float32], words: NDArray[np.uint16], name: str) -> None:
    """Raise DeviceFaultError, with the scale that fits, where the middle of an image is no temperature.

    celsius: (h, w), made of ``words``, which the camera ``name`` sent.
    """
    middle = float(np.median(celsius))
    if COLDEST_C <= middle <= HOTTEST_C:
        return
    fits = [f"{one.name} (scale={one.step:g}&offset={one.offset:g})" for one in scales_of_cameras(words)]
    remedy = (
        f"they fit {' or '.join(fits)}: read the camera as y16 with that scale"
        if fits
        else "switch its temperature output on, or give its scale and offset"
    )
    raise DeviceFaultError(
        f"{name} sent words about {np.median(words):.0f}, which would be {middle:.0f} C; {remedy}"
    )


class WordCamera(V4l2Camera):
    """A camera of 16-bit words. radiometry: None where they are no temperatures.

    The flag is recognised in the images; dropped counts by the gaps between stamps.
    """

    _radiometry: Radiometry | None
    _flag: FlagWatch

    def _watch(self, radiometry: Radiometry | None, rate_hz: float) -> None:
        self._radiometry, self._flag = radiometry, FlagWatch(rate_hz)

    def _take_frame(self) -> None:
        words, stamp_ns = self._words().copy(), self._stamp_ns()
        flag = self._flag.see(words)
        if self._radiometry is None:
            self._take(stamp_ns, ThermalCounts(words, np.zeros(0, np.uint16), flag))
        else:
            self._take(stamp_ns, ThermalImage(self._radiometry.celsius(words, self.address), flag))


class Y16Camera(WordCamera):
    """One camera of a size (width, height). Raises DeviceError where the node has another, or none."""

    def __init__(
        self,
        node: Path,
        size: tuple[int, int],
        rate_hz: float,
        radiometry: Radiometry | None = None,
        serial: str = "",
        kind: CaptureKind = cv2.VideoCapture,
    ) -> None:
        address = f"y16:{node}?width={size[0]}&height={size[1]}&rate={rate_hz:g}"
        if radiometry is not None:
            address += f"&scale={radiometry.scale!r}&offset={radiometry.offset_c!r}"
        super().__init__(address, node, serial, rate_hz, kind)
        self._watch(radiometry, rate_hz)
        self._configure(FOURCC, [size], rate_hz, "give its width and height")


class Boson(WordCamera):
    """A FLIR Boson 640 or 320. celsius: whether its words are temperatures, as those of radiometric ones.

    Raises DeviceError for a node that does not open, or of another size.
    """

    def __init__(
        self,
        node: Path,
        celsius: bool = False,
        rate_hz: float = BOSON_HZ,
        serial: str = "",
        kind: CaptureKind = cv2.VideoCapture,
    ) -> None:
        address = f"boson:{node}?rate={rate_hz:g}" + "&celsius=yes" * celsius
        super().__init__(address, node, serial, rate_hz, kind)
        self._watch(Radiometry(BOSON_KELVIN) if celsius else None, rate_hz)
        self._configure(FOURCC, BOSON_SIZES, rate_hz, "switch its output to 16 bits (RAW16)")


def radiometry_of(address: Address) -> Radiometry | None:
    """The scale and offset that an address gives, or None. Raises DeviceError for one without the other."""
    scale, offset_c = address.given_number("scale", 1e-6, 10.0), address.given_number("offset", -1e4, 1e4)
    if (scale is None) != (offset_c is None):
        raise DeviceError(
            f"{address.text!r} gives only one of scale and offset; give both, or none for counts"
        )
    return None if scale is None or offset_c is None else Radiometry(scale, offset_c)
