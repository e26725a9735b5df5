"""FLIR Lepton 2.5 and 3.x (radiometric) on a PureThermal board: temperatures, and the state of the shutter.

Rows of telemetry behind the image define the meaning of its words. Source: Lepton Engineering Datasheet
500-0659-00-09 rev 203, tables 2 (telemetry) and 3 (status bits); low words come first.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sensors.device.protocol import Flag, ThermalCounts, ThermalImage
from sensors.device.v4l2_camera import V4l2Camera, V4l2Node
from sensors.drivers.y16 import FOURCC, Radiometry
from sensors.errors import DeviceFaultError
from sensors.rig.wrapping_counter import WrappingCounter

USB_ID = "1e4e:0100"  # PureThermal boards (GroupGets)
RATE_HZ = 9.0  # exported Leptons, of 27 Hz of the detector
SIZES = {
    (160, 122): (120, 160),
    (80, 63): (60, 80),
}  # (width, height) with telemetry and image shape: 3.x, 2.5
ROW_WORDS = 80  # of telemetry, in rows A, B, C; a Lepton 3.x has two in each row of the image
# Row and first word of the uptime in ms and the status (32 bits each), the gain, the gain of automatic mode,
# whether words are temperatures, and their resolution: 1 = 0.01 K, 0 = 0.1 K.
UPTIME, STATUS, GAIN, EFFECTIVE_GAIN, TLINEAR, RESOLUTION = (0, 1), (0, 3), (2, 5), (2, 6), (2, 48), (2, 49)
FFC_BIT, AGC_BIT = (
    4,
    12,
)  # of the status: state of the flat-field correction (two bits), automatic gain control
STATES = (
    Flag.INITIALIZING,
    Flag.OPEN,
    Flag.CLOSED,
    Flag.OPEN,
)  # correction never made, imminent, running, done
GAINS = ("high", "low", "auto")


@dataclass(frozen=True)
class Telemetry:
    """Telemetry of an image.

    kelvin: kelvins per step of a pixel word, None if words are not temperatures. gain: "high" (to 140 C) or
    "low" (to 400 C). agc: True if words are stretched to 8 bits for display.
    """

    uptime_ms: int
    flag: Flag
    gain: str
    agc: bool
    kelvin: float | None


def telemetry_of(words: NDArray[np.uint16]) -> Telemetry:
    """Return the telemetry in the words (n,) behind an image, n at least 240."""
    rows = words.reshape(-1, ROW_WORDS)

    def long(at: tuple[int, int]) -> int:
        return int(rows[at]) | int(rows[at[0], at[1] + 1]) << 16

    status, gain = long(STATUS), int(rows[GAIN])
    effective = int(rows[EFFECTIVE_GAIN]) if gain == GAINS.index("auto") else gain
    kelvin = (0.01 if rows[RESOLUTION] else 0.1) if rows[TLINEAR] else None
    state = STATES[status >> FFC_BIT & 3]
    return Telemetry(long(UPTIME), state, "low" if effective else "high", bool(status >> AGC_BIT & 1), kelvin)


class Lepton(V4l2Camera):
    """A Lepton, stamped by its own clock. telemetry: of the latest image.

    Raises DeviceError for a node that does not open or has no telemetry.
    """

    def __init__(self, node: V4l2Node) -> None:
        super().__init__(f"lepton:{node.path}", node, RATE_HZ)
        self._clock = WrappingCounter()
        self.telemetry: Telemetry | None = None
        remedy = f"update the board's firmware, or use y16:{node.path} with scale and offset"
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
