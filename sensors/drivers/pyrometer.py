"""Optris pyrometers (CT and CS families) over a serial line: the reference for the thermal camera.

Constants are untuned.
"""

import threading
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from math import nan
from pathlib import Path

from sensors.device.address import Address
from sensors.device.mounting import NO_YES
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

SCALES = {"0.1": TENTHS, "0.01": HUNDREDTHS}  # by the option ``step``: K of one step of a reading
POLL_HZ = 10.0  # readings a second, few because drift takes minutes
BURST_HZ = 100.0  # nominal readings a second of a burst
SAME_K, APART_K = 0.3, 3.0  # K; most between two readings of one target, least between two targets
OPENING_TRIES = 3  # attempts to identify a device on a noisy line
SILENT_READS = 3  # requests without a reply after which the device counts as lost


@dataclass(frozen=True)
class PyrometerOptions:
    """Options of a pyrometer. baud, emissivity (0.1 to 1.1): None = as the device has it.

    rs485: bus address or None. scale: HUNDREDTHS for high-resolution models. burst: a CT sends readings
    unrequested. Raises DeviceError for a burst of a CS.
    """

    family: PyrometerFamily = CT
    baud: int | None = None
    rs485: int | None = None
    scale: Scale = TENTHS
    burst: bool = False
    emissivity: float | None = None

    def __post_init__(self) -> None:
        if self.burst and not self.family.burst:
            raise DeviceError(f"the {self.family.name} family has no burst mode; leave the option burst out")


class Pyrometer:
    """A pyrometer on a serial port, stamped by arrival. Opening checks its family. Raises DeviceError if it
    does not open or is of the other family.
    """

    calibration = None

    def __init__(self, port: Path, options: PyrometerOptions | None = None) -> None:
        self._options = options = options or PyrometerOptions()
        self._family, self._scale, self._burst = options.family, options.scale, options.burst
        self.address = f"pyrometer:{port}?family={self._family.name}"
        self.rates_hz: Mapping[str, float] = {Spot.stream: BURST_HZ if self._burst else POLL_HZ}
        self._line = SerialLine(port, options.baud or self._family.baud, options.rs485)
        self._closed, self._streaming = threading.Event(), False
        self._due_s = 0.0
        self._silent, self._last_ns, self._dropped = 0, 0, 0
        self._parser = BurstParser(3, self._scale)
        self._ready: list[tuple[float, ...]] = []
        try:
            self.serial = self._identify()
            if options.emissivity is not None:
                self.set_emissivity(options.emissivity)
        except DeviceError:
            self.close()
            raise

    def start(self) -> None:
        """Begin to read; in burst mode (unrequested readings), set up and switch on the burst."""
        if self._burst:
            self._line.send(BURST_ITEMS)
            self._line.send(bytes([BURST_SWITCH, 1]))
            self._streaming = True
        self._due_s = time.monotonic()

    def read(self, timeout_s: float) -> DeviceReading | None:
        """Return the next temperatures, or None after ``timeout_s``; a reply may take REPLY_S longer.

        Raises DeviceFaultError for a short, late or impossible reply, DeviceLostError once the device is
        gone.
        """
        end_s = time.monotonic() + timeout_s
        spot = None
        if not self._closed.is_set():
            spot = self._next_burst(end_s) if self._burst else self._poll(end_s)
        if spot is None:
            if self._closed.is_set():
                raise DeviceLostError(f"{self.address} is closed; open it again")
            return None
        arrival_ns = max(time.monotonic_ns(), self._last_ns + 1)
        self._last_ns, dropped, self._dropped = arrival_ns, self._dropped, 0
        return DeviceReading(arrival_ns, arrival_ns, spot, dropped)

    def emissivity(self) -> float:
        """Return the device's emissivity, 0.1 to 1.1. Do not call while the device sends a burst."""
        return int.from_bytes(self._line.request(bytes([self._family.emissivity]), 2)) / 1000

    def set_emissivity(self, emissivity: float) -> None:
        """Set the emissivity and read it back, because the device does not acknowledge."""
        with suppress(DeviceFaultError):
            self._line.request(emissivity_command(self._family, emissivity), 2)
        now = self.emissivity()
        if round(now * 1000) != round(emissivity * 1000):
            raise DeviceFaultError(
                f"{self._line.port} has emissivity {now:g} although {emissivity:g} was set; try again, give "
                "the right family, or switch the device off and on, because its checksum may be switched off"
            )

    def close(self) -> None:
        """Stop a burst and release the line; idempotent."""
        if self._closed.is_set():
            return
        self._closed.set()
        if self._streaming:
            with suppress(DeviceError):
                self._line.write(bytes([BURST_SWITCH, 0]))
        self._line.close()

    def _celsius(self, code: int | None) -> float:
        return nan if code is None else self._scale.decode(self._line.request(bytes([code]), 2))

    def _identify(self) -> str:
        """Return the serial number of a device of the right family; repeat on a noisy line."""
        for _ in range(OPENING_TRIES - 1):
            try:
                return self._serial_number()
            except ChatterError:
                # A CT whose last program was killed goes on with its burst.
                self._line.write(bytes([BURST_SWITCH, 0]))
            except DeviceFaultError:
                continue
        return self._serial_number()

    def _serial_number(self) -> str:
        number = int.from_bytes(self._line.request(bytes([self._family.serial]), 3))
        self._check_family()
        return str(number)

    def _check_family(self) -> None:
        """Raise DeviceError for a device of the other family, by reading commands that harm neither family.

        A CT's box temperature has the code of a CS' current target, and only a CS has a processor
        temperature. Both signs together are proof.
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
            return bool(self._line.request(bytes([CS_PROCESSOR]), 2))
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


def pyrometer_options(address: Address) -> PyrometerOptions:
    """Return the options of an address. Raises DeviceError for unknown options or values."""
    options = PyrometerOptions(
        address.choice("family", FAMILIES, "ct"),
        address.given_integer("baud", 9600, 115200),
        address.given_integer("rs485", 1, 32),
        address.choice("step", SCALES, "0.1"),
        address.choice("burst", NO_YES, "no"),
        address.given_number("emissivity", 0.1, 1.1),
    )
    address.finish()
    return options
