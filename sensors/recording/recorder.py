"""Recording: a thread for each device, bounded queues between, and one thread that writes the session.

Every message keeps its device's stamp; each device's zero is moved once, to the host's time of its first
message, and ``sensors.rig.clock`` fits the rest when the session is read.
"""

import shutil
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from queue import Empty, Full, Queue

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
)
from sensors.errors import DeviceError, DeviceFaultError
from sensors.rig.pairing import CLOCK, LATENCY
from sensors.session.messages import (
    COLOR,
    COUNTS,
    DEPTH,
    INFRARED,
    PYROMETER,
    THERMAL,
    color_message,
    image_message,
    spot_message,
    thermal_message,
)
from sensors.session.writer import SessionWriter

BACKLOG = 64
"""Readings a device may be ahead of the disk: two seconds of depth, 28 MB. Chosen by eye."""
READ_S = 0.2
"""Seconds a thread waits for a reading before it checks whether the recording has ended. Chosen by eye."""
LOOK_S = 1.0
"""Seconds between two checks of the disk's free space, and two updates of the preview. Chosen by eye."""
RATE_S = 2.0
"""Seconds over which the preview counts a stream's rate. Chosen by eye."""
RESERVE_BYTES = 300_000_000
"""Space that has to stay free: 20 s of raw depth, and what the system itself needs. Chosen by eye."""
TOPICS = {
    "depth": (DEPTH, INFRARED),
    "color": (COLOR,),
    "thermal": (THERMAL, COUNTS),
    "pyrometer": (PYROMETER,),
}
"""Topics of a device's streams."""
FLAG_CLOSED, FLAG_OPEN = "thermal flag closed", "thermal flag open"


@dataclass
class StreamState:
    """One stream so far, for the preview. shows: its latest value in words."""

    count: int = 0
    dropped: int = 0
    shows: str = ""
    recent_ns: deque[int] = field(default_factory=deque)

    @property
    def rate_hz(self) -> float:
        """Messages a second over the last ``RATE_S``."""
        if len(self.recent_ns) < 2:
            return 0.0
        return (len(self.recent_ns) - 1) / max((self.recent_ns[-1] - self.recent_ns[0]) * 1e-9, 1e-9)


@dataclass(frozen=True)
class Recorded:
    """How a recording ended. why: "asked" (by time or Ctrl-C), "disk" (full) or "lost" (the depth camera).

    events: how often each text was noted.
    """

    seconds: float
    streams: dict[str, StreamState]
    events: Counter[str]
    why: str


def clock_metadata(devices: Sequence[Device], latency_ms: Mapping[str, float]) -> dict[str, str]:
    """What a session notes of its clocks: which one stamped a topic, and how late that device's readings are.

    latency_ms: by address.
    """
    metadata: dict[str, str] = {}
    for device in devices:
        topics = [topic for stream in device.rates_hz for topic in TOPICS[stream]]
        metadata |= {f"{CLOCK}{topic}": device.address for topic in topics}
        if device.address in latency_ms:
            metadata |= {f"{LATENCY}{topic}": f"{latency_ms[device.address]:g}" for topic in topics}
    return metadata


def _check_apart(devices: Sequence[Device]) -> None:
    streams: dict[str, str] = {}
    for device in devices:
        for stream in device.rates_hz:
            if stream in streams:
                raise DeviceError(f"{streams[stream]} and {device.address} both give {stream}; record one")
            streams[stream] = device.address


class Recorder:
    """Records devices that have started into an open session; ``run`` closes them.

    infrared: whether to keep the depth camera's amplitude images, which calibration needs.
    Raises DeviceError where two devices have one stream.
    """

    def __init__(self, devices: Sequence[Device], writer: SessionWriter, infrared: bool = False) -> None:
        _check_apart(devices)
        self._writer, self._infrared = writer, infrared
        self._queues = {device.address: Queue[DeviceReading | Exception](BACKLOG) for device in devices}
        self._devices = {device.address: device for device in devices}
        self._overrun = Counter[str]()
        self._woken, self._stop = threading.Event(), threading.Event()
        self._zero_ns: dict[str, int] = {}
        self._flag_open = True
        self._unix_from_monotonic = time.time_ns() - time.monotonic_ns()
        self.streams = {name: StreamState() for device in devices for name in device.rates_hz}
        self.events = Counter[str]()

    def run(self, enough: Callable[[], bool], show: Callable[["Recorder"], None]) -> Recorded:
        """Record until ``enough`` or the disk is nearly full or the depth camera is lost.

        ``show`` is called once a second. Raises OSError when the disk fails.
        """
        threads = [
            threading.Thread(target=self._read, args=(d,), daemon=True) for d in self._devices.values()
        ]
        started = time.monotonic()
        try:
            for thread in threads:
                thread.start()
            why = self._write(enough, show)
        except KeyboardInterrupt:
            why = "asked"
        finally:
            self._stop.set()
            for thread in threads:
                if thread.ident is not None:
                    thread.join(5)
            for device in self._devices.values():
                device.close()
        self._drain()
        return Recorded(time.monotonic() - started, self.streams, self.events, why)

    def _read(self, device: Device) -> None:
        queue = self._queues[device.address]
        while not self._stop.is_set():
            try:
                item: DeviceReading | Exception | None = device.read(READ_S)
            except Exception as error:  # the writing thread handles it; here it would die with the thread
                item = error
            if item is None:
                continue
            try:
                queue.put_nowait(item)
            except Full:
                self._overrun[device.address] += 1
            self._woken.set()
            if isinstance(item, Exception) and not isinstance(item, DeviceFaultError):
                return

    def _write(self, enough: Callable[[], bool], show: Callable[["Recorder"], None]) -> str:
        looked = time.monotonic()
        while not enough():
            if not self._drain():
                return "lost"
            self._woken.wait(0.02)
            self._woken.clear()
            if time.monotonic() - looked >= LOOK_S:
                looked = time.monotonic()
                show(self)
                if shutil.disk_usage(self._writer.path.parent).free < RESERVE_BYTES:
                    self._note(self._now_ns(), "disk nearly full: recording ended")
                    return "disk"
        return "asked"

    def _drain(self) -> bool:
        """Write what has come; False when the depth camera is gone."""
        alive = True
        for address, queue in self._queues.items():
            with suppress(Empty):
                while True:
                    item = queue.get_nowait()
                    if isinstance(item, DeviceReading):
                        self._put(address, item)
                        continue
                    if not isinstance(item, DeviceError):
                        raise item
                    self._note(self._now_ns(), str(item))
                    gone = not isinstance(item, DeviceFaultError)
                    alive = alive and not (gone and "depth" in self._devices[address].rates_hz)
        return alive

    def _put(self, address: str, reading: DeviceReading) -> None:
        arrival = reading.arrival_ns + self._unix_from_monotonic
        stamp = reading.stamp_ns + self._zero_ns.setdefault(address, arrival - reading.stamp_ns)
        stream = self.streams[reading.stream]
        lost = reading.dropped + self._overrun.pop(address, 0)
        if lost:
            stream.dropped += lost
            self._note(stamp, f"{reading.stream}: {lost} dropped", arrival)
        if self._written(reading, stamp, arrival):
            stream.count += 1
            stream.recent_ns.append(reading.arrival_ns)
            while reading.arrival_ns - stream.recent_ns[0] > RATE_S * 1e9:
                stream.recent_ns.popleft()

    def _written(self, reading: DeviceReading, stamp: int, arrival: int) -> bool:
        """Write one reading; False for what a closed flag makes worthless."""
        stream, value = self.streams[reading.stream], reading.value
        if isinstance(value, ThermalImage | ThermalCounts):
            is_open = value.flag is Flag.OPEN
            if is_open != self._flag_open:
                self._flag_open = is_open
                self._note(stamp, FLAG_OPEN if is_open else FLAG_CLOSED, arrival)
            if not is_open:
                stream.shows = "flag closed"
                return False
        match value:
            case DepthImage(depth_mm, infrared):
                if self._infrared and infrared is not None:
                    self._writer.add(INFRARED, image_message(infrared, "infrared", stamp), stamp, arrival)
                self._writer.write_depth(depth_mm, stamp, arrival)
                stream.shows = f"{np.count_nonzero(depth_mm) / depth_mm.size:.0%} read"
            case ColorImage(encoded):
                self._writer.add(COLOR, color_message(encoded, stamp), stamp, arrival)
                stream.shows = f"{len(encoded) / 1000:.0f} kB"
            case Spot(target_c, head_c, box_c):
                self._writer.add(PYROMETER, spot_message(target_c, head_c, box_c, stamp), stamp, arrival)
                stream.shows = f"{target_c:.1f} C"
            case ThermalImage(celsius):
                self._writer.add(THERMAL, thermal_message(celsius, stamp), stamp, arrival)
                stream.shows = f"{np.nanmin(celsius):.1f} to {np.nanmax(celsius):.1f} C"
            case ThermalCounts(counts):
                self._writer.add(COUNTS, image_message(counts, "thermal", stamp), stamp, arrival)
                stream.shows = f"{counts.min()} to {counts.max()} counts"
        return True

    def _now_ns(self) -> int:
        """The host's clock as it stood at the start, whatever has been set since."""
        return time.monotonic_ns() + self._unix_from_monotonic

    def _note(self, stamp: int, text: str, arrival: int | None = None) -> None:
        self.events[text] += 1
        self._writer.event(stamp, text, arrival)
