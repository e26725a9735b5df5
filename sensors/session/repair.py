"""Strict check of a session's file, and repair of a truncated or damaged one."""

import os
import zlib
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from os.path import samestat
from pathlib import Path
from statistics import median
from typing import BinaryIO

from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, DataEnd, McapRecord, Message, Metadata, Schema

from sensors.errors import CloudError, FormatError
from sensors.files.atomic import check_free, check_suffix, replacing
from sensors.files.own_files import own_file
from sensors.session.index import MAX_MESSAGES, read_contents, scan
from sensors.session.indexed_writer import IndexedWriter
from sensors.session.mcap_records import HEAD, MAGIC, parsed, spans
from sensors.session.messages import DEPTH, EVENTS, METADATA, event_from, event_message
from sensors.session.recognise import check_no_sessions
from sensors.session.recording_file import (
    SUFFIX,
    RecordingError,
    check_ended,
    final_of,
    recording_at,
    repaired_of,
)
from sensors.session.salvage import Piece, pieces
from sensors.session.stored_index import NAME, StoredIndex, read_index
from sensors.session.summary import Summary, read_summary

SMALL_BYTES = 1 << 12
"""Bytes of a depth image below which several share a chunk: a chunk takes a thousand times the time of an
empty message, of which a damaged file may hold millions (untuned)."""
LONGEST_LOSS_NS = 60 * 10**9
"""Nanoseconds from the last saved message beyond which the stated end of a lost chunk counts as damaged: a
chunk lasts a thirtieth of a second (untuned)."""
_DATA_END_BYTES = HEAD.size + 4
_BLOCK_BYTES = 1 << 20


def problems_of(path: Path) -> list[str]:
    """Return every problem of a session file, one line each: checksums, records, counts."""
    with path.open("rb") as file:
        return list(_problems(file))


def _problems(file: BinaryIO) -> Iterator[str]:
    size = os.fstat(file.fileno()).st_size
    for at, name in ((0, "first"), (max(0, size - len(MAGIC)), "last")):
        file.seek(at)
        if file.read(len(MAGIC)) != MAGIC:
            yield f"the {name} {len(MAGIC)} bytes are not a whole MCAP file's"
    summary = read_summary(file)
    for piece in pieces(file, summary):
        if piece.lost:
            yield f"bytes {piece.start} to {piece.end} cannot be read"
    if summary is None:
        yield "its index (the summary at its end) is missing or damaged"
        return
    if any(each.name == NAME for each in summary.attachments) and read_index(file, summary) is None:
        yield "the index of its images is damaged or of another file"
    if not _checksum_fits(file, summary):
        yield "the checksum of its data does not fit"
    try:
        scan(file)
    except CloudError as error:
        yield str(error)


def _checksum_fits(file: BinaryIO, summary: Summary) -> bool:
    """Return whether the CRC of all data, if stated, is right."""
    end = summary.start - _DATA_END_BYTES
    if end < 0:
        return False
    file.seek(end)
    record = file.read(_DATA_END_BYTES)
    if HEAD.unpack_from(record) != (Opcode.DATA_END, 4):
        return False
    stated = parsed(record)
    assert isinstance(stated, DataEnd)
    file.seek(0)
    crc, left = 0, end if stated.data_section_crc else 0
    while left and (block := file.read(min(left, _BLOCK_BYTES))):
        crc, left = zlib.crc32(block, crc), left - len(block)
    return crc == stated.data_section_crc


@dataclass(frozen=True)
class Repaired:
    """Result of ``repair``.

    frames: of the repaired session. changed: False where the session was intact. damaged, lost_bytes: number
    and length of unreadable places. lost_s: their duration, as far as known. lost_frames: number of missing
    frames, None = unknown.
    """

    path: Path
    frames: int
    lost_frames: int | None = 0
    lost_s: float = 0.0
    lost_bytes: int = 0
    damaged: int = 0
    changed: bool = True


def repair(path: Path, out: Path | None = None, *, overwrite: bool = False) -> Repaired:
    """Write an intact session with all readable records of a damaged one, which stays unchanged.

    The result is ``NAME.repaired.mcap``, for ``NAME.mcap.partial`` ``NAME.mcap``; an intact session gets
    none. Raises FormatError when nothing can be saved, ExistsError when the result's name is taken and
    ``overwrite`` is False, RecordingError while the recording runs.
    """
    source = recording_at(path)
    if source.is_dir():
        check_no_sessions(source)
        own = own_file(source)
        raise FormatError(f"{path} is {own.kind if own else 'a folder'}; give a recorded session")
    if not source.is_file():
        raise FormatError(f"{path} does not exist; give a recorded session")
    if out is not None:
        check_suffix(out, SUFFIX, "")
    target = out or (repaired_of(source) if source == final_of(source) else final_of(source))
    with _opened(source) as file:
        if source == final_of(source) and not list(_problems(file)):
            with suppress(CloudError):
                return Repaired(source, len(read_contents(source).places[DEPTH]), changed=False)
        if target.exists() and samestat(target.stat(), os.fstat(file.fileno())):
            raise FormatError(f"{target} is the damaged session itself; give another name")
        check_free(target, overwrite)
        with replacing(target, overwrite) as temporary:
            return _rewrite(file, temporary, target)


def _opened(source: Path) -> BinaryIO:
    """Open a session and lock it against writers until it is closed.

    Raises FormatError where it cannot be read, RecordingError while it is being recorded.
    """
    try:
        file = source.open("rb")
    except OSError as error:
        raise FormatError(
            f"{source} cannot be read ({error.strerror}); check path and permissions"
        ) from error
    try:
        check_ended(file)
        if not source.exists():
            raise RecordingError(f"{source} was completed meanwhile; use {final_of(source)}")
    except BaseException:
        file.close()
        raise
    return file


def _rewrite(file: BinaryIO, temporary: Path, target: Path) -> Repaired:
    """Copy all readable records. Raises FormatError where they make no session."""
    summary = read_summary(file)
    index = read_index(file, summary) if summary else None
    losses = Losses()
    with temporary.open("wb") as sink:
        copier = Copier(IndexedWriter(sink))
        for record in (*summary.schemas, *summary.channels) if summary else ():
            copier.add(record)
        for piece in pieces(file, summary):
            losses.add(piece)
            for span in spans(piece.data):
                if span.opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE):
                    copier.add(parsed(piece.data, span))
                elif span.opcode in (Opcode.METADATA, Opcode.ATTACHMENT):
                    copier.add_beside(parsed(piece.data, span), index)
        copier.finish(index)
    if not copier.frames:
        if not copier.nameless:
            _raise_damage(file)
        raise FormatError(
            f"{file.name}: no depth image can be saved, because the records that name the topics cannot be "
            "read; restore it from a copy"
        )
    frames = len(read_contents(temporary).places[DEPTH])
    stated = summary.counts[DEPTH] if summary and summary.statistics else None
    if stated is None and not losses.bytes:
        stated = frames
    lost_frames = None if stated is None else max(0, stated - frames)
    return Repaired(target, frames, lost_frames, losses.ns * 1e-9, losses.bytes, losses.places)


def _raise_damage(file: BinaryIO) -> None:
    """Raise FormatError with the first damage of a file, without the advice to repair the file."""
    try:
        scan(file)
    except FormatError as error:
        if error.__cause__ is None:
            raise
        raise FormatError(
            f"{file.name}: no depth image can be saved ({error.__cause__}); restore it from a copy"
        ) from error


class Losses:
    """Lost parts of a file: their number (``places``), bytes, and duration in nanoseconds."""

    def __init__(self) -> None:
        self.places = self.bytes = self._known_ns = 0
        self._last_ns: int | None = None
        self._gap = False
        self._steps_ns: list[int] = []
        self._gaps_ns: list[int] = []

    def add(self, piece: Piece) -> None:
        """Add the next record or gap of the file to the losses."""
        if piece.lost:
            self.places, self.bytes = self.places + 1, self.bytes + piece.end - piece.start
            self._gap |= not self._stated(piece.end_ns)
            return
        if piece.end_ns is None:
            return
        if self._last_ns is not None and piece.end_ns > self._last_ns:
            (self._gaps_ns if self._gap else self._steps_ns).append(piece.end_ns - self._last_ns)
        self._gap = False
        self._last_ns = max(self._last_ns or 0, piece.end_ns)

    @property
    def ns(self) -> int:
        """Return the duration of the lost parts: each gap of unknown length minus the usual step between
        chunks.
        """
        step_ns = round(median(self._steps_ns)) if self._steps_ns else 0
        return self._known_ns + sum(max(0, gap_ns - step_ns) for gap_ns in self._gaps_ns)

    def _stated(self, end_ns: int | None) -> bool:
        """Return whether a lost chunk states a credible end, and count its duration if so."""
        last_ns = self._last_ns
        if end_ns is None or last_ns is None or not last_ns < end_ns <= last_ns + LONGEST_LOSS_NS:
            return False
        self._known_ns, self._last_ns = self._known_ns + end_ns - last_ns, end_ns
        return True


class Copier:
    """Copier of records to a writer: schemas, channels, metadata, attachments and messages.

    frames, messages: depth images, and all messages, so far; nameless: messages whose topic is unknown.
    """

    def __init__(self, writer: IndexedWriter) -> None:
        self._writer = writer
        self._schemas: dict[int, int] = {0: 0}
        self._channels: dict[int, int] = {}
        self._topics: dict[int, str] = {}
        self._copied: set[str] = set()
        self._events = Counter[tuple[int, str]]()
        self._first_ns: int | None = None
        self.frames = self.nameless = self.messages = 0

    def add(self, record: McapRecord) -> None:
        """Copy one record; schemas and channels are copied once by number."""
        match record:
            case Schema() if record.id not in self._schemas:
                new = self._writer.register_schema(record.name, record.encoding, record.data)
                self._schemas[record.id] = new
            case Channel() if record.id not in self._channels and record.schema_id in self._schemas:
                schema, encoding = self._schemas[record.schema_id], record.message_encoding
                new = self._writer.register_channel(record.topic, encoding, schema, record.metadata)
                self._channels[record.id], self._topics[record.id] = new, record.topic
            case Message() if (
                record.channel_id in self._channels and max(record.log_time, record.publish_time) < 1 << 63
            ):
                self._add_message(record)
            case Message():
                self.nameless += 1

    def topic_of(self, message: Message) -> str | None:
        """Return the topic of a message; None where no channel of it was copied."""
        return self._topics.get(message.channel_id)

    def add_beside(self, record: McapRecord, index: StoredIndex | None) -> None:
        """Copy metadata or an attachment, except the index, and metadata that the index contains."""
        match record:
            case Metadata() if index is None or record.name != METADATA:
                self._writer.add_metadata(record.name, record.metadata)
            case Attachment() if record.name != NAME:
                self._writer.add_attachment(record)

    def finish(self, index: StoredIndex | None) -> None:
        """Add the index's messages that are lost, and end the file."""
        if index is not None:
            channels = {topic: self._channels[number] for number, topic in self._topics.items()}
            for topic, data in index.calibrations.items():
                if topic in channels and topic not in self._copied:
                    at_ns = self._first_ns or 0
                    self._writer.add_message(channels[topic], at_ns, data, at_ns)
            lost = Counter(index.events)
            lost.subtract(self._events)
            for stamp_ns, text in lost.elements():
                data = event_message(stamp_ns, text).SerializeToString()
                self._writer.add_message(channels[EVENTS], stamp_ns, data, stamp_ns)
            self._writer.add_metadata(METADATA, index.metadata)
        self._writer.finish()

    def _add_message(self, message: Message) -> None:
        channel, topic = self._channels[message.channel_id], self._topics[message.channel_id]
        self.messages += 1
        if self.messages > MAX_MESSAGES:
            raise FormatError(f"the session holds more than {MAX_MESSAGES} messages; record shorter sessions")
        self._writer.add_message(
            channel, message.log_time, message.data, message.publish_time, message.sequence
        )
        self._copied.add(topic)
        if topic == EVENTS:
            self._events[message.publish_time, event_from(message.data)] += 1
        self._first_ns = message.log_time if self._first_ns is None else self._first_ns
        if topic == DEPTH:
            self.frames += 1
            if len(message.data) >= SMALL_BYTES:  # a chunk for each frame, so that damage costs one frame
                self._writer.flush()
