"""Recording: what devices give is written into a session by one thread, that of the caller.

Every message keeps its device's stamp; ``sensors.rig.clock`` fits the clocks when the session is read.
"""

import shutil
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from sensors.device.protocol import ColorImage, DepthImage, Device, Spot, ThermalCounts, ThermalImage
from sensors.interrupt import interruptible
from sensors.recording.intake import Arrived, Event, Intake, StreamState
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

LOOK_S = 1.0
"""Seconds between two checks of the disk's free space, and two updates of the preview. Chosen by eye."""
RESERVE_BYTES = 300_000_000
"""Space that has to stay free: 20 s of raw depth, and what the system itself needs. Chosen by eye."""
TOPICS = {
    "depth": (DEPTH, INFRARED),
    "color": (COLOR,),
    "thermal": (THERMAL, COUNTS),
    "pyrometer": (PYROMETER,),
}
"""Topics of a device's streams."""
DISK_FULL = "disk nearly full: recording ended"


@dataclass(frozen=True)
class Recorded:
    """End of a recording. why: "asked" (by time or Ctrl-C), "disk" (full) or "lost" (the depth camera).

    events: how often each text was noted.
    """

    seconds: float
    streams: dict[str, StreamState]
    events: Counter[str]
    why: str


def clock_metadata(devices: Sequence[Device], latency_ms: Mapping[str, float]) -> dict[str, str]:
    """A session's metadata on clocks: which one stamped a topic, and how late that device's readings are.

    latency_ms: by address.
    """
    metadata: dict[str, str] = {}
    for device in devices:
        topics = [topic for stream in device.rates_hz for topic in TOPICS[stream]]
        metadata |= {f"{CLOCK}{topic}": device.address for topic in topics}
        if device.address in latency_ms:
            metadata |= {f"{LATENCY}{topic}": f"{latency_ms[device.address]:g}" for topic in topics}
    return metadata


def write_item(writer: SessionWriter, item: Arrived | Event, infrared: bool = False) -> None:
    """Write a reading or an event; what a closed flag makes worthless is left out.

    infrared: whether to keep the depth camera's amplitude images, which calibration needs. Raises OSError,
    and CalibrationError for an image of another size than its camera's calibration.
    """
    if isinstance(item, Event):
        writer.event(item.stamp_ns, item.text, item.arrival_ns)
        return
    if not item.usable:
        return
    stamp, arrival = item.stamp_ns, item.arrival_ns
    match item.reading.value:
        case DepthImage(depth_mm, amplitude):
            if infrared and amplitude is not None:
                writer.add(INFRARED, image_message(amplitude, "infrared", stamp), stamp, arrival)
            writer.write_depth(depth_mm, stamp, arrival)
        case ColorImage(encoded):
            writer.add(COLOR, color_message(encoded, stamp), stamp, arrival)
        case Spot(target_c, head_c, box_c):
            writer.add(PYROMETER, spot_message(target_c, head_c, box_c, stamp), stamp, arrival)
        case ThermalImage(celsius):
            # Else every frame would be refused when the session is read.
            if (camera := writer.calibration.thermal) is not None:
                camera.check_size("thermal image", celsius.shape)
            writer.add(THERMAL, thermal_message(celsius, stamp), stamp, arrival)
        case ThermalCounts(counts):
            writer.add(COUNTS, image_message(counts, "thermal", stamp), stamp, arrival)


class Recorder:
    """Records devices that have started into an open session; ``run`` closes them.

    infrared: as of ``write_item``. Raises DeviceError as ``Intake`` does.
    """

    def __init__(self, devices: Sequence[Device], writer: SessionWriter, infrared: bool = False) -> None:
        self._intake, self._writer, self._infrared = Intake(devices), writer, infrared
        self.streams = self._intake.streams
        self.events = Counter[str]()

    def run(self, enough: Callable[[], bool], show: Callable[["Recorder"], None]) -> Recorded:
        """Record until ``enough`` or the disk is nearly full or the depth camera is lost.

        ``show`` is called once a second. Raises OSError when the disk fails.
        """
        started = time.monotonic()
        try:
            with interruptible(), self._intake:
                why = self._write(enough, show)
        except KeyboardInterrupt:
            why = "asked"
        self._drain()
        return Recorded(time.monotonic() - started, self.streams, self.events, why)

    def _write(self, enough: Callable[[], bool], show: Callable[["Recorder"], None]) -> str:
        looked = time.monotonic()
        while not enough():
            self._drain()
            if self._intake.depth_lost:
                return "lost"
            self._intake.wait(0.02)
            if time.monotonic() - looked >= LOOK_S:
                looked = time.monotonic()
                show(self)
                if shutil.disk_usage(self._writer.path.parent).free < RESERVE_BYTES:
                    self._keep(Event(self._intake.now_ns(), DISK_FULL))
                    return "disk"
        return "asked"

    def _drain(self) -> None:
        for item in self._intake.drain():
            self._keep(item)

    def _keep(self, item: Arrived | Event) -> None:
        if isinstance(item, Event):
            self.events[item.text] += 1
        write_item(self._writer, item, self._infrared)
