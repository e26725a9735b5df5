"""The binary protocol of Optris' pyrometers: one command table a family, numbers, checksum, burst.

Source: Optris, "CT/CTlaser/CTvideo communication interface" (2020-04) and the CSlaser manual, chapter 8.3.
The families give the same codes different meanings (03, 81), so no code is sent that is not in a table.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import reduce
from operator import xor

from sensors.errors import DeviceFaultError

TARGET_RANGE_C = (-50.0, 975.0)
"""What an LT head (8 to 14 um) measures; there are no error codes, so anything else is a fault."""

SYNC = b"\xaa\xaa"


@dataclass(frozen=True)
class Scale:
    """Conversion of two bytes to a temperature: (value - offset) / steps_per_c."""

    offset: int
    steps_per_c: int

    def decode(self, reply: bytes) -> float:
        """Celsius of two bytes. Raises DeviceFaultError where no LT head measures that."""
        celsius = (int.from_bytes(reply) - self.offset) / self.steps_per_c
        low, high = TARGET_RANGE_C
        if not low <= celsius <= high:
            raise DeviceFaultError(
                f"the pyrometer sent {celsius:g} C, outside {low:g} to {high:g} C; check cable and baud rate"
            )
        return celsius

    def encode(self, celsius: float) -> bytes:
        """Inverse of ``decode``, rounded."""
        return round(celsius * self.steps_per_c + self.offset).to_bytes(2)


TENTHS = Scale(1000, 10)
HUNDREDTHS = Scale(10000, 100)
"""High-resolution models (CSmicro hs, CT ... hs)."""


@dataclass(frozen=True)
class PyrometerFamily:
    """Command codes of one family; None = the family has no such command.

    current_target: the target before averaging and hold functions.
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
CS_PROCESSOR = 0x09
"""Command code of the processor's temperature, which only the CS family has."""
FAMILIES = {family.name: family for family in (CT, CS)}

BURST_LAYOUT, BURST_SWITCH = 0x51, 0x52
BURST_ITEMS = bytes([BURST_LAYOUT, 0x12, 0x30, 0, 0])
"""CT only: the command for bursts of process, head and box temperature, eight nibbles of which 0 ends."""


def emissivity_command(family: PyrometerFamily, emissivity: float) -> bytes:
    """The command that sets the emissivity, 0.1 to 1.1, with the family's checksum."""
    command = bytes([family.set_emissivity]) + round(emissivity * 1000).to_bytes(2)
    return command + bytes([checksum(command)]) if family.checksum else command


def checksum(command: bytes) -> int:
    """XOR of a command's bytes, RS485 prefix excluded."""
    return reduce(xor, command, 0)


class BurstParser:
    """Finds the frames ``AA AA`` + two bytes a value in a stream that may start, or go wrong, anywhere.

    A temperature's low byte may be AA too, so the first of three AA is data: out of step a frame counts only
    where the next begins right behind it, every value is possible, and no later AA pair does as well.
    skipped: bytes that belonged to no frame so far.
    """

    def __init__(self, values: int, scale: Scale = TENTHS) -> None:
        self._length, self._scale = len(SYNC) + 2 * values, scale
        self._waiting = bytearray()
        self._in_step = False
        self.skipped = 0

    def feed(self, data: bytes) -> Iterator[tuple[float, ...]]:
        """Take more of the stream; yield each complete frame's values in Celsius."""
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
