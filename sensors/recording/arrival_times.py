"""Readings in the order of arrival: stamps on one time scale, and events between them. Constants are untuned.

Every reading keeps its device's stamp, shifted so that the first stamp is its arrival on the host. After a
loss, or when its clock was set, a device begins an *epoch* with a new shift. An event marks the start of the
epoch (``sensors.rig.clock.begins_of`` reads it).
"""

from dataclasses import dataclass

from sensors.device.protocol import DeviceReading, Flag, ThermalCounts, ThermalImage
from sensors.rig.clock import BACK, EPOCH_MARGIN_NS, SET_ANEW

FLAG_CLOSED, FLAG_OPEN = "thermal flag closed", "thermal flag open"
# Ns below the least delay that mean a clock set forward; first images are late by less.
LEAP_NS = 1_000_000_000
FORGET = 1e-3  # rise of the least delay per time, five times the skew of a bad crystal


@dataclass(frozen=True)
class Arrived:
    """Reading with its times.

    stamp_ns, arrival_ns: since 1970, on the device's and the host's clock. lost: readings of its stream lost
    before it; overrun: of these, lost in a full queue. usable: False while the flag (shutter) is closed.
    restarted: True for the first reading of an epoch.
    """

    address: str
    reading: DeviceReading
    stamp_ns: int
    arrival_ns: int
    lost: int
    usable: bool
    restarted: bool = False
    overrun: int = 0


@dataclass(frozen=True)
class Event:
    """Event of a recording. stamp_ns: on its source's clock; arrival_ns: on the host's, if different."""

    stamp_ns: int
    text: str
    arrival_ns: int | None = None


class _Epoch:
    """Epoch of a device's clock. zero_ns: shift of its stamps."""

    def __init__(self, zero_ns: int) -> None:
        self.zero_ns = zero_ns
        self._least_ns: float | None = None
        self._arrival_ns = 0
        self._stamp_ns = dict[str, int]()

    def add(self, reading: DeviceReading) -> bool:
        """Add a reading and return True; return False if the clock was set before this reading."""
        delay_ns = reading.arrival_ns - reading.stamp_ns
        if reading.stamp_ns < self._stamp_ns.get(reading.stream, reading.stamp_ns):
            return False
        if self._least_ns is not None:
            since_ns = max(0, reading.arrival_ns - self._arrival_ns)
            if delay_ns < self._least_ns - LEAP_NS:
                return False
            self._least_ns = min(self._least_ns + FORGET * since_ns, delay_ns)
        else:
            self._least_ns = delay_ns
        self._stamp_ns[reading.stream], self._arrival_ns = reading.stamp_ns, reading.arrival_ns
        return True


class Arrivals:
    """Conversion of readings' stamps to one time scale, with events between readings. For one thread.

    unix_from_monotonic_ns: difference of the two clocks. away: addresses of lost devices.
    """

    def __init__(self, unix_from_monotonic_ns: int) -> None:
        self._unix_ns = unix_from_monotonic_ns
        self._epochs: dict[str, _Epoch] = {}
        self._last_ns: dict[str, int] = {}
        self._flag_open = True
        self.away: set[str] = set()

    def add(self, address: str, reading: DeviceReading, overrun: int) -> list[Arrived | Event]:
        """Return the events before a reading, then the reading. overrun: readings lost in a full queue."""
        arrival_ns = reading.arrival_ns + self._unix_ns
        begun = self._begun(address, reading, arrival_ns)
        stamp_ns = reading.stamp_ns + self._epochs[address].zero_ns
        self._last_ns[address] = max(stamp_ns, self._last_ns.get(address, stamp_ns))
        texts = [begun.format(address)] if begun else []
        if lost := reading.dropped + overrun:
            why = f", {overrun} as writing was too slow" if overrun else ""
            texts.append(f"{reading.stream}: {lost} dropped{why}")
        usable = True
        if isinstance(reading.value, ThermalImage | ThermalCounts):
            usable = reading.value.flag is Flag.OPEN
            if usable != self._flag_open:
                self._flag_open = usable
                texts.append(FLAG_OPEN if usable else FLAG_CLOSED)
        arrived = Arrived(address, reading, stamp_ns, arrival_ns, lost, usable, bool(begun), overrun)
        return [*(Event(stamp_ns, text, arrival_ns) for text in texts), arrived]

    def _begun(self, address: str, reading: DeviceReading, arrival_ns: int) -> str:
        """Return the text of the event that begins an epoch, with a placeholder for the address; "" within an
        epoch.
        """
        epoch, text = self._epochs.get(address), ""
        if address in self.away:
            self.away.discard(address)
            text = BACK
        elif epoch is not None and not epoch.add(reading):
            text = SET_ANEW
        elif epoch is not None:
            return ""
        # Twice the margin, because another stream may be stamped earlier and arrive later.
        earliest_ns = self._last_ns.get(address, -(1 << 62)) + 2 * EPOCH_MARGIN_NS
        self._epochs[address] = _Epoch(max(arrival_ns, earliest_ns) - reading.stamp_ns)
        self._epochs[address].add(reading)
        return text
