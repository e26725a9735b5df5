"""Readings as they arrive: stamps on one time scale, and the events in between.

Every reading keeps its device's stamp; a device's zero is moved to the host's time of its first reading. A
device that was away, or whose clock was set, begins an *epoch*: its zero is moved anew, and an event states
where (``sensors.rig.clock.begins_of`` reads it).
"""

from dataclasses import dataclass

from sensors.device.protocol import DeviceReading, Flag, ThermalCounts, ThermalImage
from sensors.rig.clock import BACK, EPOCH_MARGIN_NS, SET_ANEW

FLAG_CLOSED, FLAG_OPEN = "thermal flag closed", "thermal flag open"
LEAP_NS = 1_000_000_000
"""Nanoseconds below the least delay from which the device's clock was set forward. A driver delays a first
image by less (untuned)."""
FORGET = 1e-3
"""Rise of the least delay per time: five times the skew of a bad crystal (untuned)."""


@dataclass(frozen=True)
class Arrived:
    """A reading and the address that it came from. stamp_ns, arrival_ns: since 1970, device's and host's.

    lost: how many of its stream were lost before it; overrun: how many of these came while the queue was
    full. usable: False while the flag is closed. restarted: whether it is the first of an epoch.
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
    """Event of a recording. stamp_ns: on the clock of its source; arrival_ns: on the host's, if different."""

    stamp_ns: int
    text: str
    arrival_ns: int | None = None


class _Epoch:
    """Clock of one device since its zero was moved. zero_ns: from its stamps to session stamps."""

    def __init__(self, zero_ns: int) -> None:
        self.zero_ns = zero_ns
        self._least_ns: float | None = None
        self._arrival_ns = 0
        self._stamp_ns = dict[str, int]()

    def add(self, reading: DeviceReading) -> bool:
        """Add a reading and return True; add nothing and return False where the clock was set before."""
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
    """Stamps readings and notes what happened between them. For one thread.

    unix_from_monotonic_ns: from ``time.monotonic_ns`` to nanoseconds since 1970. away: addresses that are
    lost now.
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
        made: list[Arrived | Event] = [Event(stamp_ns, begun.format(address), arrival_ns)] if begun else []
        if lost := reading.dropped + overrun:
            why = f", {overrun} as writing was too slow" if overrun else ""
            made.append(Event(stamp_ns, f"{reading.stream}: {lost} dropped{why}", arrival_ns))
        usable = True
        if isinstance(reading.value, ThermalImage | ThermalCounts):
            usable = reading.value.flag is Flag.OPEN
            if usable != self._flag_open:
                self._flag_open = usable
                made.append(Event(stamp_ns, FLAG_OPEN if usable else FLAG_CLOSED, arrival_ns))
        restarted = bool(begun)
        arrived = Arrived(address, reading, stamp_ns, arrival_ns, lost, usable, restarted, overrun)
        return [*made, arrived]

    def _begun(self, address: str, reading: DeviceReading, arrival_ns: int) -> str:
        """Return the text of the event that begins an epoch, with a place for the address; "" within one."""
        epoch, text = self._epochs.get(address), ""
        if address in self.away:
            self.away.discard(address)
            text = BACK
        elif epoch is not None and not epoch.add(reading):
            text = SET_ANEW
        elif epoch is not None:
            return ""
        # Twice the margin: another stream of the device may have been stamped earlier and arrive later.
        earliest_ns = self._last_ns.get(address, -(1 << 62)) + 2 * EPOCH_MARGIN_NS
        self._epochs[address] = _Epoch(max(arrival_ns, earliest_ns) - reading.stamp_ns)
        self._epochs[address].add(reading)
        return text
