"""FLIR Lepton 2.5 and 3.x (radiometric) on a PureThermal board: temperatures, and the state of the shutter.

Behind the image come rows of telemetry, which name what the words are. Source: Lepton Engineering Datasheet
500-0659-00-09 rev 203, tables 2 (telemetry) and 3 (status bits); low words come first.
"""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from sensors.device.protocol import Flag, ThermalCounts, ThermalImage
from sensors.device.v4l2_camera import CaptureKind, V4l2Camera
from sensors.drivers.y16 import FOURCC, Radiometry
from sensors.errors import DeviceFaultError
from sensors.rig.wrapping_counter import WrappingCounter

USB_ID = "1e4e:0100"
"""Vendor and product of the PureThermal boards (GroupGets)."""
RATE_HZ = 9.0
"""Images a second; the 27 Hz of the detector are not exported."""
SIZES = {(160, 122): (120, 160), (80, 63): (60, 80)}
"""Frames with telemetry (width, height) of a Lepton 3.x and a 2.5, and the shapes of their images."""
ROW_WORDS = 80
"""Words of a row of telemetry, named A, B, C; a Lepton 3.x has two in each row of the image."""
UPTIME, STATUS, GAIN, EFFECTIVE_GAIN, TLINEAR, RESOLUTION = (0, 1), (0, 3), (2, 5), (2, 6), (2, 48), (2, 49)
"""Row and first word of: milliseconds since the start (32 bits), status bits (32), gain, gain in automatic
mode, whether the words are temperatures, and whether in hundredths (1) or tenths (0) of a kelvin."""
FFC_BIT, AGC_BIT = 4, 12
"""Of the status: the state of the flat-field correction (two bits), whether AGC is on."""
STATES = (Flag.INITIALIZING, Flag.OPEN, Flag.CLOSED, Flag.OPEN)
"""Of the shutter, by the flat-field correction: never made, imminent (in two seconds), running, done."""
GAINS = ("high", "low", "auto")


@dataclass(frozen=True)
class Telemetry:
    """Telemetry of an image. kelvin: of one step of a word, None if the words are not temperatures.

    gain: "high" (to 140 C) or "low" (to 400 C), in which one step means the same. agc: whether the words are
    stretched to 8 bits for display.
    """

    uptime_ms: int
    flag: Flag
    gain: str
    agc: bool
    kelvin: float | None


def telemetry_of(words: NDArray[np.uint16]) -> Telemetry:
    """Telemetry from the words (n,) behind an image, n at least 240."""
    rows = words.reshape(-1, ROW_WORDS)

    def long(at: tuple[int, int]) -> int:
        return int(rows[at]) | int(rows[at[0], at[1] + 1]) << 16

    status, gain = long(STATUS), int(rows[GAIN])
    effective = int(rows[EFFECTIVE_GAIN]) if gain == GAINS.index("auto") else gain
    kelvin = (0.01 if rows[RESOLUTION] else 0.1) if rows[TLINEAR] else None
    state = STATES[status >> FFC_BIT & 3]
    return Telemetry(long(UPTIME), state, "low" if effective else "high", bool(status >> AGC_BIT & 1), kelvin)


class Lepton(V4l2Camera):
    """One Lepton. Stamps are of its own clock; dropped counts by the gaps between them.

    telemetry: of the latest image. Its words are counts where it says so. Raises DeviceError for a node that
    does not open or gives no telemetry.
    """

    def __init__(self, node: Path, serial: str = "", kind: CaptureKind = cv2.VideoCapture) -> None:
        super().__init__(f"lepton:{node}", node, serial, RATE_HZ, kind)
        self._clock = WrappingCounter()
        self.telemetry: Telemetry | None = None
        remedy = f"update the board's firmware, or use y16:{node} with scale and offset"
        self._configure(FOURCC, list(SIZES), RATE_HZ, remedy)

    def _take_frame(self) -> None:
        words = self._words()
        height = SIZES[self._size][0]
        self.telemetry = found = telemetry_of(words[height:].ravel())
        if found.agc:
            raise DeviceFaultError(f"{self.address} has its automatic gain control on; switch it off")
        image, stamp_ns = words[:height].copy(), 1_000_000 * self._clock.unwrap(found.uptime_ms)
        if found.kelvin is None:
            self._take(stamp_ns, ThermalCounts(image, np.zeros(0, np.uint16), found.flag))
        else:
            celsius = Radiometry(found.kelvin).celsius(image, self.address)
            self._take(stamp_ns, ThermalImage(celsius, found.flag))
