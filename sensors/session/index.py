"""Index of a session file: calibration, events, and the place of every image."""

from array import array
from pathlib import Path

import numpy as np
from mcap.records import Channel, McapRecord, Message, Metadata, Schema, Statistics
from numpy.typing import NDArray

from sensors.errors import FormatError
from sensors.rig.rig_calibration import MAX_CALIBRATION_BYTES
from sensors.session.mcap_records import is_complete, record_offsets, records_at
from sensors.session.messages import (
    CALIBRATIONS,
    DEPTH,
    EVENTS,
    IMAGES,
    METADATA,
    SCHEMAS,
    SHIFT,
    TF,
    calibration_from,
    event_from,
)

PLACE = np.dtype([("stamp_ns", "i8"), ("arrival_ns", "i8"), ("offset", "i8"), ("slot", "i8")])
"""Where a message lies: record ``slot`` of the chunk at byte ``offset``; its time by device and host."""
Places = NDArray[np.void]
"""PLACE (n,): the messages of one topic, sorted by device stamp."""


class Contents:
    """All of a session but its images, read once, front to back, chunk by chunk, every CRC checked.

    places: by image topic, empty where there are none. truncated: whether the file was cut off, no error.
    Raises FormatError when it is no session, damaged, or without depth images; CalibrationError when the
    calibration is missing or impossible.
    """

    def __init__(self, path: Path) -> None:
        self._path, self._count = path, 0
        self._expected: int | None = None
        self.events: list[tuple[int, str]] = []
        self.metadata: dict[str, str] = {}
        self._found = {topic: array("q") for topic in IMAGES}  # the four numbers of PLACE one after another
        self._calibrations: dict[str, bytes] = {}
        self._schemas: dict[int, str] = {}
        self._topics: dict[int, str] = {}
        try:
            with path.open("rb") as file:
                for offset in record_offsets(file):
                    for slot, record in enumerate(records_at(file, offset)):
                        self._add(offset, slot, record)
                self.truncated = not is_complete(file)
        except OSError as error:
            raise FormatError(f"{path} cannot be read ({error.strerror}); give a recorded session") from error
        if not self.truncated and self._expected not in (None, self._count):
            raise FormatError(
                f"{path} holds {self._count} of its {self._expected} messages; restore it from a copy, "
                f"or save the rest of it: annotate-cloud repair {path}"
            )
        if not self._found[DEPTH]:
            raise FormatError(f"{path} has no depth images ({DEPTH}); give a session of a depth camera")
        self.calibration = calibration_from(self._calibrations)
        self.places = {topic: _sorted(numbers) for topic, numbers in self._found.items()}

    def _add(self, offset: int, slot: int, record: McapRecord) -> None:
        match record:
            case Message():
                self._count += 1
                self._add_message(offset, slot, record)
            case Schema():
                self._schemas.setdefault(record.id, record.name)
            case Channel():
                self._add_channel(record)
            case Statistics():
                self._expected = record.message_count
            case Metadata() if record.name == METADATA:
                self.metadata = {_plain(key): _plain(value) for key, value in record.metadata.items()}

    def _add_channel(self, channel: Channel) -> None:
        expected = SCHEMAS.get(channel.topic)
        if expected is None or channel.id in self._topics:
            return
        name = self._schemas.get(channel.schema_id, "none")
        if channel.message_encoding != "protobuf" or name != expected.DESCRIPTOR.full_name:
            raise FormatError(
                f"{self._path}: topic {channel.topic} is {_plain(channel.message_encoding)} {_plain(name)}; "
                f"only protobuf {expected.DESCRIPTOR.full_name} is read"
            )
        self._topics[channel.id] = channel.topic

    def _add_message(self, offset: int, slot: int, message: Message) -> None:
        topic = self._topics.get(message.channel_id)
        if topic in self._found:
            if message.publish_time >= 1 << 63 or message.log_time >= 1 << 63:
                raise FormatError(f"{self._path}: an impossible time in {topic}; record it again")
            self._found[topic].extend((message.publish_time, message.log_time, offset, slot))
        elif topic is not None and topic in (*CALIBRATIONS, TF, SHIFT):
            # One too large is kept as far as calibration_from needs to refuse it.
            self._calibrations.setdefault(topic, message.data[: MAX_CALIBRATION_BYTES + 1])
        elif topic == EVENTS:
            self.events.append((message.publish_time, _plain(event_from(message.data))))


def _sorted(numbers: "array[int]") -> Places:
    places = np.frombuffer(numbers, PLACE)
    return places[np.argsort(places["stamp_ns"], kind="stable")]


def _plain(text: str) -> str:
    """The printable characters of a file's text, which is shown to people."""
    return "".join(c for c in text if c.isprintable())
