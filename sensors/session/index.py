"""What a session file contains and where: calibration, events, and the place of every image."""

from array import array
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from mcap.records import Channel, McapRecord, Message, Metadata, Schema, Statistics
from numpy.typing import NDArray

from sensors.errors import FormatError
from sensors.rig.rig_calibration import MAX_CALIBRATION_BYTES, RigCalibration
from sensors.session.mcap_records import is_complete, record_offsets, records_at
from sensors.session.messages import (
    CALIBRATIONS,
    DEPTH,
    EVENTS,
    IMAGES,
    METADATA,
    SCHEMAS,
    TF,
    calibration_from,
    event_from,
)

PLACE = np.dtype([("stamp_ns", "i8"), ("arrival_ns", "i8"), ("offset", "i8"), ("slot", "i8")])
"""Where a message lies: record ``slot`` of the chunk at byte ``offset``; its time by device and host."""
Places = NDArray[np.void]
"""PLACE (n,): the messages of one topic, sorted by device stamp."""


@dataclass(frozen=True)
class Contents:
    """All of a session but its images. places: by image topic, empty where there are none."""

    calibration: RigCalibration
    places: dict[str, Places]
    events: tuple[tuple[int, str], ...]
    metadata: dict[str, str]
    truncated: bool


def read_contents(path: Path) -> Contents:
    """Read a session once, front to back, one chunk at a time, every CRC checked.

    Raises FormatError when it is no session, damaged, or without depth images; CalibrationError when the
    calibration is missing or impossible. A truncated session is none of these.
    """
    scan = _Scan(path)
    try:
        with path.open("rb") as file:
            for offset in record_offsets(file):
                for slot, record in enumerate(records_at(file, offset)):
                    scan.add(offset, slot, record)
            truncated = not is_complete(file)
    except OSError as error:
        raise FormatError(f"{path} cannot be read ({error.strerror}); give a recorded session") from error
    if not truncated and scan.expected not in (None, scan.count):
        raise FormatError(
            f"{path} holds {scan.count} of its {scan.expected} messages; restore it from a copy, "
            f"or save the rest of it: annotate-cloud repair {path}"
        )
    if not scan.places[DEPTH]:
        raise FormatError(f"{path} has no depth images ({DEPTH}); give a session of a depth camera")
    return Contents(
        calibration=calibration_from(scan.calibrations),
        places={topic: _sorted(places) for topic, places in scan.places.items()},
        events=tuple(scan.events),
        metadata=scan.metadata,
        truncated=truncated,
    )


@dataclass
class _Scan:
    """What was found so far. places: the four numbers of PLACE one after another, by image topic."""

    path: Path
    places: dict[str, "array[int]"] = field(default_factory=lambda: {topic: array("q") for topic in IMAGES})
    calibrations: dict[str, bytes] = field(default_factory=dict)
    events: list[tuple[int, str]] = field(default_factory=list)
    metadata: dict[str, str] = field(default_factory=dict)
    schemas: dict[int, str] = field(default_factory=dict)
    topics: dict[int, str] = field(default_factory=dict)
    count: int = 0
    expected: int | None = None

    def add(self, offset: int, slot: int, record: McapRecord) -> None:
        match record:
            case Message():
                self.count += 1
                self._add_message(offset, slot, record)
            case Schema():
                self.schemas.setdefault(record.id, record.name)
            case Channel():
                self._add_channel(record)
            case Statistics():
                self.expected = record.message_count
            case Metadata() if record.name == METADATA:
                self.metadata = {_plain(key): _plain(value) for key, value in record.metadata.items()}

    def _add_channel(self, channel: Channel) -> None:
        expected = SCHEMAS.get(channel.topic)
        if expected is None or channel.id in self.topics:
            return
        name = self.schemas.get(channel.schema_id, "none")
        if channel.message_encoding != "protobuf" or name != expected.DESCRIPTOR.full_name:
            raise FormatError(
                f"{self.path}: topic {channel.topic} is {_plain(channel.message_encoding)} {_plain(name)}; "
                f"only protobuf {expected.DESCRIPTOR.full_name} is read"
            )
        self.topics[channel.id] = channel.topic

    def _add_message(self, offset: int, slot: int, message: Message) -> None:
        topic = self.topics.get(message.channel_id)
        if topic in self.places:
            if message.publish_time >= 1 << 63 or message.log_time >= 1 << 63:
                raise FormatError(f"{self.path}: an impossible time in {topic}; record it again")
            self.places[topic].extend((message.publish_time, message.log_time, offset, slot))
        elif topic is not None and (topic in CALIBRATIONS or topic == TF):
            # One too large is kept as far as calibration_from needs to refuse it.
            self.calibrations.setdefault(topic, message.data[: MAX_CALIBRATION_BYTES + 1])
        elif topic == EVENTS:
            self.events.append((message.publish_time, _plain(event_from(message.data))))


def _sorted(numbers: "array[int]") -> Places:
    places = np.frombuffer(numbers, PLACE)
    return places[np.argsort(places["stamp_ns"], kind="stable")]


def _plain(text: str) -> str:
    """The printable characters of a file's text, which is shown to people."""
    return "".join(c for c in text if c.isprintable())
