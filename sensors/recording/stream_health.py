"""Health of a running rig: rates, drops, clocks, thermal flag (shutter), time until the disk is full."""

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from sensors.device.protocol import ColorImage, DepthImage, Device, Spot, ThermalCounts, ThermalImage, Value
from sensors.recording.arrival_times import Arrived
from sensors.recording.running_clock import RunningClock

FAULT_NS = 500_000_000  # ns for which a device's fault is reported; untuned
RECENT_NS = 5_000_000_000  # ns over which drops and bytes are counted; untuned


@dataclass(frozen=True)
class StreamHealth:
    """State of one stream.

    recent, lost, overrun: images received, lost, and lost in a full queue in the last 5 s. rate_hz: over the
    same 5 s. silent_s: since the last image; running_s: since the device was opened. away: True while the
    device is lost. count, dropped, left_out: usable, lost and corrupt images since the start. usable: False
    while the flag (shutter) is closed.
    """

    nominal_hz: float
    rate_hz: float = 0.0
    recent: int = 0
    lost: int = 0
    silent_s: float = math.inf
    count: int = 0
    dropped: int = 0
    overrun: int = 0
    running_s: float = 0.0
    away: bool = False
    left_out: int = 0
    value: Value | None = None
    usable: bool = True

    @property
    def shows(self) -> str:
        """Return the last value as text."""
        if not self.usable:
            return "flag closed"
        return "" if self.value is None else in_words(self.value)


@dataclass(frozen=True)
class Health:
    """State of a rig. away: addresses of lost devices. flag_closed_s: since the flag was closed.

    skew_ppm: of each device's clock. recording: session that is written. disk_minutes: until the disk is
    full, inf = unknown. trouble: reason why the last recording ended by itself. faults: recent protocol
    violations and left-out images, as text.
    """

    streams: Mapping[str, StreamHealth] = field(default_factory=dict)
    away: tuple[str, ...] = ()
    flag_closed_s: float = 0.0
    skew_ppm: Mapping[str, float] = field(default_factory=dict)
    recording: Path | None = None
    recorded_s: float = 0.0
    disk_minutes: float = math.inf
    trouble: str = ""
    faults: tuple[str, ...] = ()

    @property
    def dropped(self) -> int:
        """Return the number of lost images of all streams since the start."""
        return sum(stream.dropped for stream in self.streams.values())


class _Came(NamedTuple):
    """Arrival of one reading. lost: number of readings lost before it; overrun: of these, lost in a full
    queue.
    """

    at_ns: int
    lost: int
    overrun: int
    bytes: int


class _Stream:
    """Counts of one stream."""

    def __init__(self, address: str, nominal_hz: float) -> None:
        self.address, self.nominal_hz = address, nominal_hz
        self.recent = deque[_Came]()
        self.opened_ns = self.last_ns = 0
        self.count = self.dropped = self.left_out = 0
        self.value: Value | None = None
        self.usable = True

    def add(self, item: Arrived, left_out: bool) -> None:
        """Count a reading. left_out: True for a corrupt image, which is counted apart."""
        self.dropped += item.lost
        self.left_out += left_out
        if left_out:
            return
        value = item.reading.value
        self.recent.append(_Came(item.arrival_ns, item.lost, item.overrun, _bytes(value)))
        self.last_ns = item.arrival_ns
        self.count += item.usable
        self.value, self.usable = value, item.usable

    def begin(self, at_ns: int) -> None:
        """Restart the recent counts of a reopened device, because images missed meanwhile are not a fault."""
        self.recent.clear()
        self.opened_ns = at_ns

    def health(self, now_ns: int, away: bool) -> StreamHealth:
        """Return the state of the stream at ``now_ns``."""
        recent = self.recent
        while recent and now_ns - recent[0].at_ns > RECENT_NS:
            recent.popleft()
        span_s = (recent[-1].at_ns - recent[0].at_ns) * 1e-9 if len(recent) > 1 else 0.0
        since_ns = max(self.last_ns, self.opened_ns)
        return StreamHealth(
            self.nominal_hz,
            (len(recent) - 1) / span_s if span_s > 0 else 0.0,
            len(recent),
            sum(one.lost for one in recent),
            max(0.0, (now_ns - since_ns) * 1e-9) if since_ns else math.inf,
            self.count,
            self.dropped,
            sum(one.overrun for one in recent),
            (now_ns - self.opened_ns) * 1e-9 if self.opened_ns else 0.0,
            away,
            self.left_out,
            self.value,
            self.usable,
        )


class Watch:
    """Counters of started devices' readings by arrival time. latency_ns: by address, if known."""

    def __init__(self, devices: Sequence[Device], latency_ns: Mapping[str, int]) -> None:
        self._latency_ns = latency_ns
        self._clocks: dict[str, RunningClock] = {}
        self._streams = {
            name: _Stream(device.address, hz) for device in devices for name, hz in device.rates_hz.items()
        }
        self._closed_ns = 0

    def add(self, item: Arrived, left_out: bool = False) -> int:
        """Count a reading, and return its time on the host's clock. left_out: the image is corrupt."""
        stream, at_ns = item.reading.stream, item.arrival_ns
        if stream == "thermal":
            self._closed_ns = 0 if item.usable else self._closed_ns or at_ns
        for one in self._streams.values():
            if not one.opened_ns or (item.restarted and one.address == item.address):
                one.begin(at_ns)
        self._streams[stream].add(item, left_out)
        clock = self._clocks.get(item.address)
        if clock is None or item.restarted:
            clock = self._clocks[item.address] = RunningClock(self._latency_ns.get(item.address, 0))
        return clock.host_ns(item.stamp_ns, at_ns)

    def streams(self, now_ns: int, away: frozenset[str] = frozenset()) -> dict[str, StreamHealth]:
        """Return the states of all streams at ``now_ns`` on the arrivals' clock. away: lost addresses."""
        return {name: one.health(now_ns, one.address in away) for name, one in self._streams.items()}

    def flag_closed_s(self, now_ns: int) -> float:
        """Return the seconds for which the flag (shutter) has been closed, 0 while it is open."""
        return (now_ns - self._closed_ns) * 1e-9 if self._closed_ns else 0.0

    def skew_ppm(self) -> dict[str, float]:
        """Return the skew of every clock by address."""
        return {address: clock.skew_ppm for address, clock in self._clocks.items()}

    def bytes_per_s(self) -> float:
        """Return the received bytes a second, uncompressed."""
        came = [one.recent for one in self._streams.values() if one.recent]
        total = sum(one.bytes for recent in came for one in recent)
        first = min((recent[0].at_ns for recent in came), default=0)
        last = max((recent[-1].at_ns for recent in came), default=0)
        return total / ((last - first) * 1e-9) if last > first else 0.0


def in_words(value: Value) -> str:
    """Return a reading as text."""
    match value:
        case DepthImage(depth_mm):
            return f"{np.count_nonzero(depth_mm) / depth_mm.size:.0%} read"
        case ColorImage(encoded):
            return f"{len(encoded) / 1000:.0f} kB"
        case Spot(target_c):
            return f"{target_c:.1f} C"
        case ThermalImage(celsius):
            known = celsius[np.isfinite(celsius)]
            return f"{known.min():.1f} to {known.max():.1f} C" if known.size else "no temperatures"
        case ThermalCounts(counts):
            return f"{counts.min()} to {counts.max()} counts"


def _bytes(value: Value) -> int:
    match value:
        case DepthImage(depth_mm):
            return depth_mm.nbytes
        case ColorImage(encoded):
            return len(encoded)
        case Spot():
            return 12
        case ThermalImage(celsius):
            return celsius.size * 2
        case _:
            return value.counts.nbytes
