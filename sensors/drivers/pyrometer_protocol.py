"""The binary protocol of Optris' pyrometers: one command table a family, numbers, checksum, burst.

Source: Optris, "CT/CTlaser/CTvideo communication interface" (2020-04) and the CSlaser manual, chapter 8.3.
Codes 03 and 81 differ between the families, so the driver sends only codes of the family's table.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import reduce
from operator import xor

from sensors.errors import DeviceFaultError

TARGET_RANGE_C = (-50.0, 975.0)  # of an LT head (8 to 14 um); values outside are faults
SYNC = b"\xaa\xaa"


@dataclass(frozen=True)
class Scale:
    """Conversion of two bytes to a temperature: (value - offset) / steps_per_c."""

    offset: int
    steps_per_c: int

    def decode(self, reply: bytes) -> float:
        """Return the Celsius of two bytes. Raises DeviceFaultError outside ``TARGET_RANGE_C``."""
        celsius = (int.from_bytes(reply) - self.offset) / self.steps_per_c
        low, high = TARGET_RANGE_C
        if not low <= celsius <= high:
            raise DeviceFaultError(
                f"the pyrometer sent {celsius:g} C, outside {low:g} to {high:g} C; check cable and baud rate"
            )
        return celsius

    def encode(self, celsius: float) -> bytes:
        """Return the two bytes of a temperature, rounded; inverse of ``decode``."""
        return round(celsius * self.steps_per_c + self.offset).to_bytes(2)


TENTHS = Scale(1000, 10)
HUNDREDTHS = Scale(10000, 100)  # high-resolution models (CSmicro hs, CT ... hs)


@dataclass(frozen=True)
class PyrometerFamily:
    """Command codes of a family, None = no such command.

    current_target: temperature before averaging and hold functions.
    """

    name: str
    baud: int
    checksum: bool
    burst: bool
    current_target: int
    box: int | None = None
    target: int = 0x01
    head: int = 0x02
    emissivity: int = 0x04
    serial: int = 0x0E
    set_emissivity: int = 0x84


CT = PyrometerFamily("ct", 115200, checksum=True, burst=True, current_target=0x81, box=0x03)
CS = PyrometerFamily("cs", 9600, checksum=False, burst=False, current_target=0x03)
CS_PROCESSOR = 0x09  # temperature of the processor, only of the CS family
FAMILIES = {family.name: family for family in (CT, CS)}
BURST_LAYOUT, BURST_SWITCH = 0x51, 0x52
BURST_ITEMS = bytes(
    [BURST_LAYOUT, 0x12, 0x30, 0, 0]
)  # CT: process, head and box temperature; nibbles, 0 ends


def emissivity_command(family: PyrometerFamily, emissivity: float) -> bytes:
    """Return the command that sets the emissivity, 0.1 to 1.1, with the family's checksum."""
    command = bytes([family.set_emissivity]) + round(emissivity * 1000).to_bytes(2)
    return command + bytes([checksum(command)]) if family.checksum else command


def checksum(command: bytes) -> int:
    """Return the XOR of a command's bytes, without the RS485 prefix."""
    return reduce(xor, command, 0)


class BurstParser:
    """Parser of burst frames, ``AA AA`` + two bytes per value, in a stream that may start or be damaged
    anywhere.

    A low byte may be AA too, so the first of three AA is data. While out of step, the parser accepts a frame
    under three conditions: the next frame follows directly, every value is possible, and no later AA pair
    fits. skipped: number of bytes in no frame.
    """

    def __init__(self, values: int, scale: Scale = TENTHS) -> None:
        self._length, self._scale = len(SYNC) + 2 * values, scale
        self._waiting = bytearray()
        self._in_step = False
        self.skipped = 0

    def feed(self, data: bytes) -> Iterator[tuple[float, ...]]:
        """Add bytes of the stream; yield each complete frame's values in Celsius."""
        self._waiting += data
        while len(self._waiting) >= self._length + (0 if self._in_step else len(SYNC) + 1):
            values = self._frame_at(0)
            if values is not None and (self._in_step or self._starts_here()):
                self._in_step = True
                del self._waiting[: self._length]
                yield values
            else:
                self._in_step = False
                self.skipped += 1
                del self._waiting[0]

    def _starts_here(self) -> bool:
        later = self._frame_at(1) is not None and self._sync_at(1 + self._length)
        return self._sync_at(self._length) and not later

    def _sync_at(self, at: int) -> bool:
        return self._waiting.startswith(SYNC, at)

    def _frame_at(self, at: int) -> tuple[float, ...] | None:
        if not self._sync_at(at):
            return None
        words = range(at + len(SYNC), at + self._length, 2)
        try:
            return tuple(self._scale.decode(bytes(self._waiting[word : word + 2])) for word in words)
        except DeviceFaultError:
            return None
