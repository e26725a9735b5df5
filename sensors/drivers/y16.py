"""UVC thermal cameras of 16-bit words (Y16): a FLIR Boson, or any camera by its scale and offset."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sensors.checks.celsius_check import scales_of_cameras
from sensors.device.address import Address
from sensors.device.protocol import ThermalCounts, ThermalImage
from sensors.device.v4l2_camera import V4l2Camera, V4l2Node
from sensors.drivers.flag_watch import FlagWatch
from sensors.errors import DeviceError, DeviceFaultError

FOURCC = "Y16 "
COLDEST_C, HOTTEST_C = -60.0, 650.0  # C; range of an image's median, which excludes raw counts; untuned
ABSOLUTE_ZERO_C = -273.15
BOSON_USB_ID = "09cb:4007"  # FLIR; as in flirpy
BOSON_SIZES = ((640, 512), (320, 256))
BOSON_HZ = 60.0  # 8.6 for export (FLIR's data sheet 102-2013-40)
# K of one step of a radiometric Boson's words in high gain (TLinear: kelvin x 100). Words of low gain (kelvin
# x 50) are refused. Source: notes on FLIR's Boson SDK; flirpy issue 87 names the mode.
BOSON_KELVIN = 0.01


@dataclass(frozen=True)
class Radiometry:
    """Scale and offset of thermal words: Celsius = scale * word + offset_c."""

    scale: float
    offset_c: float = ABSOLUTE_ZERO_C

    def celsius(self, words: NDArray[np.uint16], name: str) -> NDArray[np.float32]:
        """Return the temperatures float32 (h, w) of words (h, w), in Celsius.

        Raises DeviceFaultError with ``name`` for words that are not temperatures.
        """
        celsius = words * np.float32(self.scale) + np.float32(self.offset_c)
        check_temperatures(celsius, words, name)
        return celsius.astype(np.float32)


def check_temperatures(celsius: NDArray[np.float32], words: NDArray[np.uint16], name: str) -> None:
    """Raise DeviceFaultError, with the scale that fits, if an image's median is not a plausible temperature.

    celsius: (h, w), made of ``words`` of the camera ``name``.
    """
    middle = float(np.median(celsius))
    if COLDEST_C <= middle <= HOTTEST_C:
        return
    fits = [f"{one.name} (scale={one.step:g}&offset={one.offset:g})" for one in scales_of_cameras(words)]
    remedy = (
        f"read the camera as y16 with the scale that fits: {' or '.join(fits)}"
        if fits
        else "switch its temperature output on, or give its scale and offset"
    )
    raise DeviceFaultError(
        f"{name} sent values with a median of {np.median(words):.0f}, which would be {middle:.0f} C; {remedy}"
    )


@dataclass(frozen=True)
class WordMode:
    """Mode of a camera of 16-bit words.

    kind, options: of its address. sizes: possible (width, height). radiometry: None for raw counts. remedy:
    text of the error for a camera without any of the sizes.
    """

    kind: str
    options: str
    sizes: Sequence[tuple[int, int]]
    rate_hz: float
    radiometry: Radiometry | None
    remedy: str


class WordCamera(V4l2Camera):
    """Thermal camera of 16-bit words, whose closed flag (shutter) is detected in its images.

    Raises DeviceError if the camera supports no size of ``mode``.
    """

    def __init__(self, node: V4l2Node, mode: WordMode) -> None:
        super().__init__(f"{mode.kind}:{node.path}?{mode.options}", node, mode.rate_hz)
        self._radiometry, self._flag = mode.radiometry, FlagWatch(mode.rate_hz)
        self._configure(FOURCC, mode.sizes, mode.rate_hz, mode.remedy)

    def _take_frame(self) -> None:
        words, stamp_ns = self._words().copy(), self._stamp_ns()
        flag = self._flag.flag(words)
        if self._radiometry is None:
            self._take(stamp_ns, ThermalCounts(words, np.zeros(0, np.uint16), flag))
        else:
            self._take(stamp_ns, ThermalImage(self._radiometry.celsius(words, self.address), flag))


def y16_mode(size: tuple[int, int], rate_hz: float, radiometry: Radiometry | None = None) -> WordMode:
    """Return the mode of a camera with images of one size (width, height)."""
    options = f"width={size[0]}&height={size[1]}&rate={rate_hz:g}"
    if radiometry is not None:
        options += f"&scale={radiometry.scale!r}&offset={radiometry.offset_c!r}"
    return WordMode("y16", options, [size], rate_hz, radiometry, "give its width and height")


def boson_mode(celsius: bool = False, rate_hz: float = BOSON_HZ) -> WordMode:
    """Return the mode of a Boson 640 or 320. celsius: True for a radiometric camera, whose words are
    temperatures.
    """
    options = f"rate={rate_hz:g}" + "&celsius=yes" * celsius
    radiometry = Radiometry(BOSON_KELVIN) if celsius else None
    return WordMode(
        "boson", options, BOSON_SIZES, rate_hz, radiometry, "switch its output to 16 bits (RAW16)"
    )


def radiometry_of(address: Address) -> Radiometry | None:
    """Return the scale and offset of an address, or None. Raises DeviceError if one of the two is missing."""
    scale, offset_c = address.given_number("scale", 1e-6, 10.0), address.given_number("offset", -1e4, 1e4)
    if (scale is None) != (offset_c is None):
        raise DeviceError(
            f"{address.text!r} gives only one of scale and offset; give both, or none for counts"
        )
    return None if scale is None or offset_c is None else Radiometry(scale, offset_c)
