"""Recorder of a rig's readings and events into sessions. Constants are untuned.

Every message keeps its device's stamp; ``sensors.rig.clock`` fits the clocks when the session is read.
"""

import math
import shutil
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from sensors.device.protocol import ColorImage, DepthImage, Device, Spot, ThermalCounts, ThermalImage
from sensors.errors import CloudError, ExistsError, FormatError
from sensors.recording.arrival_times import Arrived, Event
from sensors.rig.pairing import CLOCK, LATENCY
from sensors.rig.rig_calibration import RigCalibration
from sensors.session import messages
from sensors.session.writer import SessionWriter

DISK_S = 1.0  # s between two checks of the disk's free space
RESERVE_BYTES = 300_000_000  # bytes that stay free: 20 s of raw depth, and room for the system
TOPICS = {
    "depth": (messages.DEPTH, messages.INFRARED),
    "color": (messages.COLOR,),
    "thermal": (messages.THERMAL, messages.COUNTS),
    "pyrometer": (messages.PYROMETER,),
}  # by stream
WORTHLESS_S = 10.0  # s below which a recording without depth images is removed
DISK_FULL = "disk nearly full: recording ended"


def clock_metadata(devices: Sequence[Device], latency_ms: Mapping[str, float]) -> dict[str, str]:
    """Return a session's clock and latency metadata of each topic. latency_ms: by address."""
    metadata: dict[str, str] = {}
    for device in devices:
        topics = [topic for stream in device.rates_hz for topic in TOPICS[stream]]
        metadata |= {f"{CLOCK}{topic}": device.address for topic in topics}
        if device.address in latency_ms:
            metadata |= {f"{LATENCY}{topic}": f"{latency_ms[device.address]:g}" for topic in topics}
    return metadata


def write_item(writer: SessionWriter, item: Arrived | Event, infrared: bool = False) -> None:
    """Write an event or a reading; skip readings of a thermal camera whose flag (shutter) is closed.

    item: images must have passed ``ImageCheck``. infrared: keep amplitude images. Raises OSError, and
    FormatError for an impossible time.
    """
    if isinstance(item, Event):
        writer.event(item.stamp_ns, item.text, item.arrival_ns)
        return
    if not item.usable:
        return
    stamp_ns, arrival_ns = item.stamp_ns, item.arrival_ns
    match item.reading.value:
        case DepthImage(depth_mm, amplitude):
            if infrared and amplitude is not None:
                infrared_message = messages.image_message(amplitude, "infrared", stamp_ns)
                writer.add(messages.INFRARED, infrared_message, stamp_ns, arrival_ns)
            writer.write_depth(depth_mm, stamp_ns, arrival_ns)
            return
        case ColorImage(encoded):
            topic, message = messages.COLOR, messages.color_message(encoded, stamp_ns)
        case Spot(target_c, head_c, box_c):
            topic, message = messages.PYROMETER, messages.spot_message(target_c, head_c, box_c, stamp_ns)
        case ThermalImage(celsius):
            topic, message = messages.THERMAL, messages.thermal_message(celsius, stamp_ns)
        case ThermalCounts(counts):
            topic, message = messages.COUNTS, messages.image_message(counts, "thermal", stamp_ns)
    writer.add(topic, message, stamp_ns, arrival_ns)


@dataclass
class Take:
    """State of one recording.

    infrared: keep amplitude images. started_s, ended_s: ``time.monotonic``, inf = not yet. events: number of
    each text. frames: number of depth images.
    """

    writer: SessionWriter
    infrared: bool
    started_s: float = field(default_factory=time.monotonic)
    ended_s: float = math.inf
    events: Counter[str] = field(default_factory=Counter)
    frames: int = 0

    @property
    def path(self) -> Path:
        """Return the current path of the recorded readings."""
        return self.writer.partial if self.writer.partial.exists() else self.writer.path

    @property
    def seconds(self) -> float:
        """Return the duration so far."""
        return min(time.monotonic(), self.ended_s) - self.started_s


class Recorder:
    """Writer of a rig's readings and events into sessions. For one thread.

    take: current recording. last: current or previous recording. trouble: reason why the last recording ended
    by itself, or "". free_bytes: of the disk, 0 = unknown.
    """

    def __init__(self, name: str, calibration: RigCalibration, metadata: dict[str, str]) -> None:
        self._name, self._calibration, self._metadata = name, calibration, metadata
        self._folder = Path.cwd()
        self.take: Take | None = None
        self.last: Take | None = None
        self.trouble, self.free_bytes = "", 0

    def begin(self, path: Path, subject: str, overwrite: bool, infrared: bool) -> None:
        """Begin a session. Raises ExistsError, and CloudError during another recording."""
        if self.take is not None:
            raise CloudError(f"{self.take.writer.path} is being recorded; end that recording first")
        metadata = self._metadata | ({messages.SUBJECT: subject} if subject else {})
        writer = SessionWriter(path, self._calibration, self._name, overwrite=overwrite, metadata=metadata)
        writer.__enter__()
        self._folder, self.trouble = path.parent, ""
        self.take = self.last = Take(writer, infrared)

    def write(self, item: Arrived | Event) -> None:
        """Write a reading or an event during a recording."""
        if (take := self.take) is None:
            return
        if isinstance(item, Event):
            take.events[item.text] += 1
        try:
            write_item(take.writer, item, take.infrared)
            take.frames += isinstance(item, Arrived) and item.reading.stream == "depth"
        except FormatError as error:
            self.write(Event(item.stamp_ns, f"left out: {error}", item.arrival_ns))
        except OSError as error:
            self.abandon()
            self.trouble = _cut_off(take, error)

    def end(self) -> Path | None:
        """End the session, if there is one, and return the path of the whole session.

        A session without depth images is unreadable: a short one is removed, a long one stays truncated.
        Raises OSError, and ExistsError if another program made a file of its name meanwhile.
        """
        if self.take is not None and not self.take.frames:
            self._end_without_depth(self.take)
        if (take := self._ended()) is None:
            return None
        try:
            take.writer.__exit__(None)
        except (OSError, ExistsError) as error:
            self.trouble = _cut_off(take, error) if isinstance(error, OSError) else str(error)
            raise
        return take.writer.path

    def abandon(self) -> None:
        """End the session, if there is one, and leave the file as a truncated recording."""
        if (take := self._ended()) is not None:
            with suppress(OSError):
                take.writer.__exit__(OSError)

    def _end_without_depth(self, take: Take) -> None:
        self.abandon()
        self.trouble = "nothing was recorded: no depth image came before the end; record for longer"
        if take.seconds < WORTHLESS_S:
            take.writer.partial.unlink(missing_ok=True)
        else:
            held = f"{take.writer.partial} holds the other cameras' images"
            self.trouble = f"no depth image came; {held}: check the depth camera"

    def _ended(self) -> Take | None:
        take, self.take = self.take, None
        if take is not None:
            take.ended_s = time.monotonic()
        return take

    def check_disk(self, now_ns: int) -> None:
        """End the session if the disk is nearly full, or its file was moved or removed."""
        with suppress(OSError):
            self.free_bytes = shutil.disk_usage(self._folder).free
        if (take := self.take) is None:
            return
        if not take.writer.is_in_place():
            self.abandon()
            self.trouble = _gone(take)
        elif self.free_bytes < RESERVE_BYTES:
            self.write(Event(now_ns, DISK_FULL))
            with suppress(OSError, ExistsError):
                self.end()
            self.trouble = DISK_FULL + (f"; {self.trouble}" if self.trouble else "")


def _cut_off(take: Take, error: OSError) -> str:
    """Return the message for a recording that a disk error ended."""
    if isinstance(error, FileNotFoundError):
        return _gone(take)
    why = error.strerror or error
    return f"the recording ended: {why}; {take.writer.partial} holds what came before: repair it"


def _gone(take: Take) -> str:
    """Return the message for a recording whose file was moved or removed."""
    return (
        f"the recording ended: {take.writer.partial} was moved or removed while it was written; "
        "look for it where it was moved to, and repair it"
    )
