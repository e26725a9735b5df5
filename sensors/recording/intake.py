"""Readings of several devices: a thread for each, queues of bounded length, zeros on the host's clock.

Every reading keeps its device's stamp; each device's zero is moved once, to the host's time of its first
reading.
"""

import gc
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from queue import Full, Queue

import numpy as np

from sensors.device.protocol import (
    ColorImage,
    DepthImage,
    Device,
    DeviceReading,
    Flag,
    Spot,
    ThermalCounts,
    ThermalImage,
    Value,
)
from sensors.errors import DeviceError, DeviceFaultError

BACKLOG, BACKLOG_S = 64, 2.0
"""Readings, and seconds of readings, that a device may be ahead of the disk, whichever is more: 45 MB of a
Kinect v2. Chosen by eye: a disk that is busy with something else stalls for a second."""
READ_S = 0.2
"""Seconds a thread waits for a reading before it checks whether it is to end. Chosen by eye."""
RATE_S = 2.0
"""Seconds over which a stream's rate is counted. Chosen by eye."""
REOPEN_S = 1.0
"""Seconds between two attempts to open a lost device again. Chosen by eye."""
FLAG_CLOSED, FLAG_OPEN = "thermal flag closed", "thermal flag open"


@dataclass
class StreamState:
    """One stream so far. shows: its latest value in words; nominal_hz: the rate that its device states."""

    count: int = 0
    dropped: int = 0
    shows: str = ""
    recent_ns: deque[int] = field(default_factory=deque)
    nominal_hz: float = 0.0

    @property
    def rate_hz(self) -> float:
        """Messages a second over the last ``RATE_S``."""
        recent = list(self.recent_ns)
        if len(recent) < 2:
            return 0.0
        return (len(recent) - 1) / max((recent[-1] - recent[0]) * 1e-9, 1e-9)


@dataclass(frozen=True)
class Arrived:
    """A reading and the address that it came from. stamp_ns, arrival_ns: since 1970, device's and host's.

    lost: how many of its stream were lost before it; overrun: how many of these came while the queue was
    full. usable: False while the flag is closed. restarted: whether it is the first after its device was
    away.
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
    """What happened. stamp_ns: on the clock that noticed it; arrival_ns: on the host's, if different."""

    stamp_ns: int
    text: str
    arrival_ns: int | None = None


class Intake:
    """Readings of devices that have started; as a context it reads, and closes the devices at its end.

    Meanwhile the collector of cycles passes over all that was there before: a full run of it stops every
    thread for 60 ms (measured, 170,000 objects), twice that on a busy machine, and a thermal camera keeps its
    images for an eighth of a second.

    reopen: opens and starts a device that was lost; without it, a lost device stays lost. streams: what came
    so far; away: addresses that are lost now; faults: by address, when a device last sent what it must not,
    and what. Raises DeviceError where two devices have one stream, or
    none gives depth.
    """

    def __init__(self, devices: Sequence[Device], reopen: Callable[[str], Device] | None = None) -> None:
        _check_streams(devices)
        self._devices = {device.address: device for device in devices}
        self._depth = next(device.address for device in devices if "depth" in device.rates_hz)
        self._queues = {
            device.address: Queue[DeviceReading | Exception](
                max(BACKLOG, round(BACKLOG_S * sum(device.rates_hz.values())))
            )
            for device in devices
        }
        self._reopen = reopen
        self._overrun = Counter[str]()
        self._woken, self._stop = threading.Event(), threading.Event()
        self._threads: list[threading.Thread] = []
        self._zero_ns: dict[str, int] = {}
        self._flag_open = True
        self._unix_from_monotonic = time.time_ns() - time.monotonic_ns()
        self.streams = {
            name: StreamState(nominal_hz=hz) for device in devices for name, hz in device.rates_hz.items()
        }
        self.away: set[str] = set()
        self.faults: dict[str, Event] = {}

    def __enter__(self) -> "Intake":
        gc.freeze()
        self._threads = [
            threading.Thread(target=self._read, args=(address,), name=f"read {address}", daemon=True)
            for address in self._devices
        ]
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        for thread in self._threads:
            if thread.ident is not None:
                thread.join(5)
        for device in self._devices.values():
            device.close()
        gc.unfreeze()

    @property
    def depth_lost(self) -> bool:
        """Whether the depth camera is gone for good."""
        return self._reopen is None and self._depth in self.away

    def now_ns(self) -> int:
        """The host's clock as it stood at the start, whatever has been set since."""
        return time.monotonic_ns() + self._unix_from_monotonic

    def wait(self, timeout_s: float) -> None:
        """Wait until something may have come."""
        self._woken.wait(timeout_s)
        self._woken.clear()

    def drain(self) -> Iterator[Arrived | Event]:
        """All that has come until now. Raises what a device raised that is no DeviceError.

        No more than that: where devices are faster than who drains, their queues are never empty.
        """
        for address, queue in self._queues.items():
            for _ in range(queue.qsize()):
                item = queue.get_nowait()
                if isinstance(item, DeviceReading):
                    yield from self._arrived(address, item)
                elif not isinstance(item, DeviceError):
                    raise item
                else:
                    happened = Event(self.now_ns(), str(item))
                    if isinstance(item, DeviceFaultError):
                        self.faults[address] = happened
                    else:
                        self.away.add(address)
                    yield happened

    def _read(self, address: str) -> None:
        """A device's thread."""
        while not self._stop.is_set():
            try:
                item: DeviceReading | Exception | None = self._devices[address].read(READ_S)
            except Exception as error:  # who drains handles it; here it would die with the thread
                item = error
            if item is None:
                continue
            self._enqueue(address, item)
            gone = isinstance(item, Exception) and not isinstance(item, DeviceFaultError)
            if gone and not (isinstance(item, DeviceError) and self._opened_again(address)):
                return

    def _enqueue(self, address: str, item: DeviceReading | Exception) -> None:
        is_error = isinstance(item, Exception)
        while True:
            try:
                self._queues[address].put(item, is_error, READ_S)
            except Full:
                # An error must come through: it says that a device is gone.
                if is_error and not self._stop.is_set():
                    continue
                self._overrun[address] += 1
            break
        self._woken.set()

    def _opened_again(self, address: str) -> bool:
        """Open a lost device as soon as it is there again; False where nobody wants that any more."""
        if self._reopen is None:
            return False
        # What a maker's library raises at a camera that is gone, or half there, is not documented.
        with suppress(Exception):
            self._devices[address].close()
        while not self._stop.wait(REOPEN_S):
            with suppress(Exception):
                self._devices[address] = self._reopen(address)
                return True
        return False

    def _arrived(self, address: str, reading: DeviceReading) -> Iterator[Arrived | Event]:
        arrival = reading.arrival_ns + self._unix_from_monotonic
        if restarted := address in self.away:
            self.away.discard(address)
            self._zero_ns.pop(address, None)
            yield Event(arrival, f"{address} is back")
        stamp = reading.stamp_ns + self._zero_ns.setdefault(address, arrival - reading.stamp_ns)
        stream, overrun = self.streams[reading.stream], self._overrun.pop(address, 0)
        if lost := reading.dropped + overrun:
            stream.dropped += lost
            why = f", {overrun} as writing was too slow" if overrun else ""
            yield Event(stamp, f"{reading.stream}: {lost} dropped{why}", arrival)
        usable = True
        if isinstance(reading.value, ThermalImage | ThermalCounts):
            usable = reading.value.flag is Flag.OPEN
            if usable != self._flag_open:
                self._flag_open = usable
                yield Event(stamp, FLAG_OPEN if usable else FLAG_CLOSED, arrival)
        stream.shows = in_words(reading.value) if usable else "flag closed"
        if usable:
            stream.count += 1
            stream.recent_ns.append(reading.arrival_ns)
            while reading.arrival_ns - stream.recent_ns[0] > RATE_S * 1e9:
                stream.recent_ns.popleft()
        yield Arrived(address, reading, stamp, arrival, lost, usable, restarted, overrun)


def in_words(value: Value) -> str:
    """A reading in a few words."""
    match value:
        case DepthImage(depth_mm):
            return f"{np.count_nonzero(depth_mm) / depth_mm.size:.0%} read"
        case ColorImage(encoded):
            return f"{len(encoded) / 1000:.0f} kB"
        case Spot(target_c):
            return f"{target_c:.1f} C"
        case ThermalImage(celsius):
            return f"{np.nanmin(celsius):.1f} to {np.nanmax(celsius):.1f} C"
        case ThermalCounts(counts):
            return f"{counts.min()} to {counts.max()} counts"


def _check_streams(devices: Sequence[Device]) -> None:
    streams: dict[str, str] = {}
    for device in devices:
        for stream in device.rates_hz:
            if stream in streams:
                raise DeviceError(
                    f"{streams[stream]} and {device.address} both give {stream}; use one of them"
                )
            streams[stream] = device.address
    if "depth" not in streams:
        raise DeviceError("no device of the rig gives depth; name a depth camera too")
