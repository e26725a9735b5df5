"""Health of a running rig: rates, drops, clocks, the flag, and how long the disk will last."""

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from sensors.device.protocol import ColorImage, DepthImage, Spot, ThermalImage, Value
from sensors.recording.host_clock import HostClock
from sensors.recording.intake import Arrived

FAULT_NS = 500_000_000
"""How long after it a device's fault is one: half a second, in which a slow camera sends four images. Chosen
by eye."""
RECENT_NS = 5_000_000_000
"""Span over which drops and bytes are counted. Chosen by eye."""


@dataclass(frozen=True)
class StreamHealth:
    """One stream. recent, lost: images that came, and that were lost, in the last five seconds.

    overrun: how many of the lost ones were not taken in time. rate_hz: over these; nominal_hz: stated by the
    device. silent_s: since the last image. count, dropped: since the start.
    """

    nominal_hz: float
    rate_hz: float = 0.0
    recent: int = 0
    lost: int = 0
    silent_s: float = math.inf
    count: int = 0
    dropped: int = 0
    overrun: int = 0


@dataclass(frozen=True)
class Health:
    """A rig at one moment. away: addresses that are lost. flag_closed_s: since when the flag is closed.

    skew_ppm: how much too fast each device's clock runs. running_s: since the start. recording: the session
    that is written; recorded_s: for how long. disk_minutes: until the disk is full, inf where unknown.
    trouble: why the last recording ended by itself. faults: what devices sent lately that they must not.
    """

    streams: Mapping[str, StreamHealth] = field(default_factory=dict)
    away: tuple[str, ...] = ()
    flag_closed_s: float = 0.0
    skew_ppm: Mapping[str, float] = field(default_factory=dict)
    running_s: float = 0.0
    recording: Path | None = None
    recorded_s: float = 0.0
    disk_minutes: float = math.inf
    trouble: str = ""
    faults: tuple[str, ...] = ()

    @property
    def dropped(self) -> int:
        """Images lost since the start, of all streams."""
        return sum(stream.dropped for stream in self.streams.values())


class Watch:
    """Counts what comes, by the times of its arrival alone.

    rates_hz: nominal, by stream. latency_ns: by address, where it is known.
    """

    def __init__(self, rates_hz: Mapping[str, float], latency_ns: Mapping[str, int]) -> None:
        self._rates_hz, self._latency_ns = rates_hz, latency_ns
        self._clocks: dict[str, HostClock] = {}
        self._recent = {stream: deque[tuple[int, int, int, int]]() for stream in rates_hz}
        self._last_ns = dict[str, int]()
        self._count, self._dropped = dict.fromkeys(rates_hz, 0), dict.fromkeys(rates_hz, 0)
        self._start_ns = 0
        self._closed_ns = 0

    def add(self, item: Arrived) -> int:
        """Count a reading; when it was made, on the host's clock."""
        stream, at_ns = item.reading.stream, item.arrival_ns
        self._start_ns = self._start_ns or at_ns
        if stream == "thermal":
            self._closed_ns = 0 if item.usable else self._closed_ns or at_ns
        self._recent[stream].append((at_ns, item.lost, item.overrun, _size(item.reading.value)))
        self._last_ns[stream] = at_ns
        self._count[stream] += 1
        self._dropped[stream] += item.lost
        clock = self._clocks.get(item.address)
        if clock is None or item.restarted:
            clock = self._clocks[item.address] = HostClock(self._latency_ns.get(item.address, 0))
        return clock.host_ns(item.stamp_ns, at_ns)

    def streams(self, now_ns: int) -> dict[str, StreamHealth]:
        """Every stream as it is at ``now_ns``, on the clock of the arrivals."""
        return {stream: self._stream(stream, now_ns) for stream in self._rates_hz}

    def _stream(self, stream: str, now_ns: int) -> StreamHealth:
        recent, last_ns = self._recent[stream], self._last_ns.get(stream)
        while recent and now_ns - recent[0][0] > RECENT_NS:
            recent.popleft()
        span_s = (recent[-1][0] - recent[0][0]) * 1e-9 if len(recent) > 1 else 0.0
        count, dropped = self._count[stream], self._dropped[stream]
        if last_ns is None:
            silent_s = self.running_s(now_ns) if self._start_ns else math.inf
        else:
            silent_s = max(0.0, (now_ns - last_ns) * 1e-9)
        rate_hz = (len(recent) - 1) / span_s if span_s > 0 else 0.0
        lost, overrun = (sum(row[i] for row in recent) for i in (1, 2))
        nominal_hz = self._rates_hz[stream]
        return StreamHealth(nominal_hz, rate_hz, len(recent), lost, silent_s, count, dropped, overrun)

    def running_s(self, now_ns: int) -> float:
        """Seconds since the first reading."""
        return (now_ns - self._start_ns) * 1e-9 if self._start_ns else 0.0

    def flag_closed_s(self, now_ns: int) -> float:
        """Seconds for which the flag has been closed; 0 while it is open."""
        return (now_ns - self._closed_ns) * 1e-9 if self._closed_ns else 0.0

    def skew_ppm(self) -> dict[str, float]:
        """Skew of every clock, by address."""
        return {address: clock.skew_ppm for address, clock in self._clocks.items()}

    def bytes_per_s(self) -> float:
        """Bytes that come in a second, uncompressed."""
        total = sum(size for recent in self._recent.values() for *_, size in recent)
        first = min((recent[0][0] for recent in self._recent.values() if recent), default=0)
        last = max((recent[-1][0] for recent in self._recent.values() if recent), default=0)
        return total / ((last - first) * 1e-9) if last > first else 0.0


def _size(value: Value) -> int:
    """Bytes of a reading."""
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
