"""Optris pyrometers (CT and CS families) over a serial line: the reference for the thermal camera."""

import threading
import time
from collections.abc import Mapping
from contextlib import suppress
from math import nan
from pathlib import Path

from sensors.device.address import Address
from sensors.device.protocol import DeviceReading, Spot
from sensors.drivers.pyrometer_protocol import (
    BURST_ITEMS,
    BURST_SWITCH,
    CS,
    CS_PROCESSOR,
    CT,
    FAMILIES,
    HUNDREDTHS,
    TENTHS,
    BurstParser,
    PyrometerFamily,
    Scale,
    emissivity_command,
)
from sensors.drivers.serial_line import ChatterError, SerialLine, SilenceError
from sensors.errors import DeviceError, DeviceFaultError, DeviceLostError

SCALES = {"0.1": TENTHS, "0.01": HUNDREDTHS}
"""Scales by the option ``step``: how many kelvin a step of a reading is."""
YES_NO = {"yes": True, "no": False}
POLL_HZ = 10.0
"""Readings a second: the line stays idle most of the time, and drift takes minutes. Chosen by eye."""
BURST_HZ = 100.0
"""Readings a second of a burst, nominally. Chosen by eye."""
SAME_K, APART_K = 0.3, 3.0
"""Kelvin: two readings of one target, moments apart, differ by at most the first; readings of two things by
more than the second. Chosen by eye."""
OPENING_TRIES = 3
"""How often a device is identified on a noisy line. Chosen by eye."""
SILENT_READS = 3
"""Requests without any answer after which the device counts as gone. Chosen by eye."""


class Pyrometer:
    """One pyrometer on a serial line. Opening reads its serial number, and checks its family.

    port: the line. rs485: the device's address on a bus, or None. scale: HUNDREDTHS for high-resolution
    models. burst: CT only, let the device send by itself. emissivity: 0.1 to 1.1, or as the device has it.
    Neither family has a clock: stamps are arrivals.
    Raises DeviceError.
    """

    def __init__(
        self,
        port: Path,
        family: PyrometerFamily = CT,
        *,
        baud: int | None = None,
        rs485: int | None = None,
        scale: Scale = TENTHS,
        burst: bool = False,
        emissivity: float | None = None,
    ) -> None:
        if burst and not family.burst:
            raise DeviceError(f"the {family.name} family has no burst; leave burst out")
        self.address = f"pyrometer:{port}?family={family.name}"
        self.calibration = None
        self.rates_hz: Mapping[str, float] = {Spot.stream: BURST_HZ if burst else POLL_HZ}
        self._family, self._scale, self._burst = family, scale, burst
        self._line = SerialLine(port, baud or family.baud, rs485)
        self._closed, self._streaming = threading.Event(), False
        self._due_s = 0.0
        self._silent, self._last_ns, self._dropped = 0, 0, 0
        self._parser = BurstParser(3, scale)
        self._ready: list[tuple[float, ...]] = []
        try:
            self.serial = self._identify()
            if emissivity is not None:
                self.set_emissivity(emissivity)
        except DeviceError:
            self.close()
            raise

    def start(self) -> None:
        """Begin; a burst is set up and switched on."""
        if self._burst:
            self._line.send(BURST_ITEMS)
            self._line.send(bytes([BURST_SWITCH, 1]))
            self._streaming = True
        self._due_s = time.monotonic()

    def read(self, timeout_s: float) -> DeviceReading | None:
        """The next temperatures, or None after ``timeout_s`` seconds.

        An answer under way is waited for up to REPLY_S longer.
        Raises DeviceFaultError for a short, late or impossible reply, DeviceLostError once it is gone.
        """
        if self._closed.is_set():
            raise DeviceLostError(f"{self.address} is closed; open it again")
        end_s = time.monotonic() + timeout_s
        spot = self._next_burst(end_s) if self._burst else self._poll(end_s)
        if spot is None:
            if self._closed.is_set():
                raise DeviceLostError(f"{self.address} was closed; open it again")
            return None
        arrival_ns = max(time.monotonic_ns(), self._last_ns + 1)
        self._last_ns, dropped, self._dropped = arrival_ns, self._dropped, 0
        return DeviceReading(arrival_ns, arrival_ns, spot, dropped)

    def emissivity(self) -> float:
        """Emissivity by which the device computes its temperatures, 0.1 to 1.1; not within a burst."""
        return int.from_bytes(self._line.ask(bytes([self._family.emissivity]), 2)) / 1000

    def set_emissivity(self, emissivity: float) -> None:
        """Set it, and make sure: there is no acknowledgement but the value that is read back."""
        with suppress(DeviceFaultError):
            self._line.ask(emissivity_command(self._family, emissivity), 2)
        now = self.emissivity()
        if round(now * 1000) != round(emissivity * 1000):
            raise DeviceFaultError(
                f"{self._line.port} kept {now:g} when {emissivity:g} was set; "
                "try again, check the family, or switch the device off and on (its checksum may be off)"
            )

    def close(self) -> None:
        """Stop a burst and give the line back; idempotent."""
        if self._closed.is_set():
            return
        self._closed.set()
        if self._streaming:
            with suppress(DeviceError):
                self._line.write(bytes([BURST_SWITCH, 0]))
        self._line.close()

    def _celsius(self, code: int | None) -> float:
        return nan if code is None else self._scale.decode(self._line.ask(bytes([code]), 2))

    def _identify(self) -> str:
        """Serial number of a device of the right family; read again where the line is noisy."""
        for _ in range(OPENING_TRIES - 1):
            try:
                return self._serial_number()
            except ChatterError:
                # Only a CT chatters: its last user was killed in the middle of a burst.
                self._line.write(bytes([BURST_SWITCH, 0]))
            except DeviceFaultError:
                continue
        return self._serial_number()

    def _serial_number(self) -> str:
        number = int.from_bytes(self._line.ask(bytes([self._family.serial]), 3))
        self._check_family()
        return str(number)

    def _check_family(self) -> None:
        """Catch a device of the other family. Only reading commands are sent, which harm neither family.

        What a CT calls its box temperature a CS calls the current target, and only a CS has a processor
        temperature; both signs together are taken as proof.
        """
        pairs = [(self._celsius(CS.target), self._celsius(CS.current_target)) for _ in range(3)]
        same = all(abs(target - other) <= SAME_K for target, other in pairs)
        apart = all(abs(target - other) > APART_K for target, other in pairs)
        suspected = same if self._family is CT else apart
        if suspected and self._has_processor() == (self._family is CT):
            other = CS if self._family is CT else CT
            raise DeviceError(
                f"{self._line.port} answers like the {other.name} family, not {self._family.name}; "
                f"give family={other.name}"
            )

    def _has_processor(self) -> bool:
        try:
            return bool(self._line.ask(bytes([CS_PROCESSOR]), 2))
        except SilenceError:
            return False

    def _poll(self, end_s: float) -> Spot | None:
        closed = self._closed.wait(max(0.0, min(self._due_s, end_s) - time.monotonic()))
        if closed or self._due_s >= end_s:
            return None
        self._due_s = max(self._due_s + 1 / POLL_HZ, time.monotonic())
        codes = self._family.target, self._family.head, self._family.box
        try:
            spot = Spot(*(self._celsius(code) for code in codes))
        except DeviceFaultError as error:
            self._silent += isinstance(error, SilenceError)
            self._dropped += 1
            if self._silent >= SILENT_READS:
                raise DeviceLostError(f"{self._line.port} does not answer; check power and cable") from error
            raise
        self._silent = 0
        return spot

    def _next_burst(self, end_s: float) -> Spot | None:
        while not self._ready:
            left_s = end_s - time.monotonic()
            if left_s <= 0 or not (data := self._line.receive(1, left_s)):
                return None
            data += self._line.receive(4096, 0)
            skipped = self._parser.skipped
            self._ready += self._parser.feed(data)
            self._dropped += -(-(self._parser.skipped - skipped) // 8)
        return Spot(*self._ready.pop(0))


def open_pyrometer(address: Address, port: Path) -> Pyrometer:
    """The pyrometer on ``port`` with the options of its address. Raises DeviceError."""
    family = address.choice("family", FAMILIES, "ct")
    baud, rs485 = address.given_integer("baud", 9600, 115200), address.given_integer("rs485", 1, 32)
    scale, burst = address.choice("step", SCALES, "0.1"), address.choice("burst", YES_NO, "no")
    emissivity = address.given_number("emissivity", 0.1, 1.1)
    address.finish()
    return Pyrometer(port, family, baud=baud, rs485=rs485, scale=scale, burst=burst, emissivity=emissivity)
