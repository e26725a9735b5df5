"""Index of a session file: calibration, events, and the place of every image."""

from array import array
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Channel, McapRecord, Metadata, Schema, Statistics
from numpy.typing import NDArray

from sensors.errors import FormatError
from sensors.rig.rig_calibration import MAX_CALIBRATION_BYTES, RigCalibration
from sensors.session.mcap_records import (
    MAGIC,
    MESSAGE,
    Span,
    contents_at,
    damage,
    is_complete,
    parsed,
    record_offsets,
    spans,
)
from sensors.session.messages import (
    DEPTH,
    EVENTS,
    IMAGES,
    METADATA,
    OF_CALIBRATION,
    SCHEMAS,
    calibration_from,
    event_from,
)
from sensors.session.stored_index import StoredIndex, read_index
from sensors.session.summary import read_summary

MAX_MESSAGES = 1 << 24  # of a session that is read as a whole: each takes 32 bytes of memory
PLACE = np.dtype([("stamp_ns", "i8"), ("arrival_ns", "i8"), ("offset", "i8"), ("slot", "i8")])
"""Place of a message: record ``slot`` of the chunk at byte ``offset``; its time by device and host."""
Places = NDArray[np.void]
"""PLACE (n,): the messages of one topic, sorted by device stamp."""


@dataclass(frozen=True)
class Contents:
    """Data of a session without its images.

    places: positions of the images by topic, possibly empty. truncated: True if the file was cut off, which
    is not an error.
    """

    places: dict[str, Places]
    calibration: RigCalibration
    metadata: dict[str, str] = field(default_factory=dict)
    events: tuple[tuple[int, str], ...] = ()
    truncated: bool = False


def read_contents(path: Path) -> Contents:
    """Read a session's contents: by the index in the file, else from the whole file.

    With a whole index no chunk is read: damage in a chunk is found with its frame. Raises FormatError for a
    file that is not a session, is damaged or lacks depth images; CalibrationError for a missing or impossible
    calibration.
    """
    try:
        with path.open("rb") as file:
            return _indexed(file) or scan(file)
    except OSError as error:
        raise FormatError(f"{path} cannot be read ({error.strerror}); check path and permissions") from error


def _indexed(file: BinaryIO) -> Contents | None:
    """Return the contents by the file's own index; None where no index belongs to the file."""
    if file.read(len(MAGIC)) != MAGIC or (summary := read_summary(file)) is None:
        return None
    index = read_index(file, summary)
    return None if index is None else _contents_from(file.name, index)


def _contents_from(name: str, index: StoredIndex) -> Contents:
    topic, stamp_ns, arrival_ns, chunk, slot = index.columns
    begins = np.array([begin for begin, _ in index.ends], np.int64)
    all_places = np.empty(len(topic), PLACE)
    columns = (stamp_ns, arrival_ns, begins[chunk] if len(chunk) else chunk, slot)
    for key, column in zip(PLACE.names or (), columns, strict=True):
        all_places[key] = column
    numbers = {name: number for number, name in enumerate(index.topics)}
    places = {name: _sorted(all_places[topic == numbers.get(name, -1)]) for name in IMAGES}
    _check_depth(name, places)
    metadata = {plain(key): plain(value) for key, value in index.metadata.items()}
    events = tuple((stamp, plain(text)) for stamp, text in index.events)
    return Contents(places, calibration_from(index.calibrations), metadata, events)


def scan(file: BinaryIO) -> Contents:
    """Read the contents front to back, chunk by chunk, every CRC checked. Raises as ``read_contents``."""
    found = _Scan(file.name)
    for offset in record_offsets(file):
        data = contents_at(file, offset)
        with damage(file.name, offset):
            for slot, span in enumerate(spans(data)):
                found.add(offset, slot, data, span)
    truncated = not is_complete(file)
    if not truncated and found.expected not in (None, found.count):
        raise FormatError(
            f"{file.name} holds {found.count} of its {found.expected} messages; restore it from a copy, "
            f"or save the rest of it: annotate-cloud repair {file.name}"
        )
    places = {topic: _sorted(np.frombuffer(numbers, PLACE)) for topic, numbers in found.places.items()}
    _check_depth(file.name, places, truncated)
    events = tuple(found.events)
    return Contents(places, calibration_from(found.calibrations), found.metadata, events, truncated)


class _Scan:
    """Collector of a file's records, one after another. expected, count: messages stated and found."""

    def __init__(self, name: str) -> None:
        self._name, self.count = name, 0
        self.expected: int | None = None
        self.events: list[tuple[int, str]] = []
        self.metadata: dict[str, str] = {}
        self.places = {topic: array("q") for topic in IMAGES}  # the four numbers of PLACE one after another
        self.calibrations: dict[str, bytes] = {}
        self._schemas: dict[int, str] = {}
        self._topics: dict[int, str] = {}

    def add(self, offset: int, slot: int, data: bytes, span: Span) -> None:
        """Add the record of ``data`` at a span; slot: its number in the chunk at ``offset``."""
        if span.opcode == Opcode.MESSAGE:
            self._add_message(offset, slot, data, span)
        elif span.opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.STATISTICS, Opcode.METADATA):
            self._add_record(parsed(data, span))

    def _add_record(self, record: McapRecord) -> None:
        match record:
            case Schema():
                self._schemas.setdefault(record.id, record.name)
            case Channel():
                self._add_channel(record)
            case Statistics():
                self.expected = record.message_count
            case Metadata() if record.name == METADATA:
                self.metadata |= {plain(key): plain(value) for key, value in record.metadata.items()}

    def _add_channel(self, channel: Channel) -> None:
        expected = SCHEMAS.get(channel.topic)
        if expected is None or channel.id in self._topics:
            return
        name = self._schemas.get(channel.schema_id, "none")
        if channel.message_encoding != "protobuf" or name != expected.DESCRIPTOR.full_name:
            raise FormatError(
                f"{self._name}: topic {channel.topic} is {plain(channel.message_encoding)} {plain(name)}, "
                f"not protobuf {expected.DESCRIPTOR.full_name}; give a session of 'record' or 'import'"
            )
        self._topics[channel.id] = channel.topic

    def _add_message(self, offset: int, slot: int, data: bytes, span: Span) -> None:
        channel, _, arrival_ns, stamp_ns = MESSAGE.unpack_from(data[span.start : span.end][: MESSAGE.size])
        self.count += 1
        if self.count > MAX_MESSAGES:
            raise FormatError(
                f"{self._name} holds more than {MAX_MESSAGES} messages; record shorter sessions"
            )
        topic, start = self._topics.get(channel), span.start + MESSAGE.size
        if topic in self.places:
            if stamp_ns >= 1 << 63 or arrival_ns >= 1 << 63:
                raise FormatError(
                    f"{self._name}: {topic} has a message at {max(stamp_ns, arrival_ns) / 1e9:.0f} s "
                    "since 1970; set the clock to before 2262 and record again"
                )
            self.places[topic].extend((stamp_ns, arrival_ns, offset, slot))
        elif topic in OF_CALIBRATION:
            # One byte beyond the bound, so that calibration_from refuses a larger one.
            content = data[start : min(span.end, start + MAX_CALIBRATION_BYTES + 1)]
            self.calibrations.setdefault(topic, content)
        elif topic == EVENTS:
            self.events.append((stamp_ns, plain(event_from(data[start : span.end]))))


def _check_depth(name: str, places: dict[str, Places], truncated: bool = False) -> None:
    if not len(places[DEPTH]):
        if truncated:
            raise FormatError(f"{name} was cut off in front of its first depth image; restore it from a copy")
        raise FormatError(f"{name} has no depth images ({DEPTH}); give a session of a depth camera")


def _sorted(places: Places) -> Places:
    return places[np.argsort(places["stamp_ns"], kind="stable")]


def plain(text: str) -> str:
    """Return the printable characters of a file's text."""
    return "".join(c for c in text if c.isprintable())
