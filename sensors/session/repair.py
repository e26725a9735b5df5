"""Repair of a session that was cut off while it was recorded, or is damaged."""

from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from mcap.records import Channel, McapRecord, Message, Metadata, Schema
from mcap.writer import Writer

from sensors.errors import FormatError
from sensors.files.atomic import check_free, replacing
from sensors.session.lock import check_ended
from sensors.session.mcap_records import chunk_end_ns, end_of_records, record_offsets, records_at
from sensors.session.messages import DEPTH, METADATA
from sensors.session.paths import final_of, recording_at
from sensors.session.reader import Session
from sensors.session.writer import CHUNK_BYTES

LONGEST_LOSS_NS = 60 * 10**9
"""A lost chunk that states to end later than this after what was saved is believed to be damaged there too.
Chosen by eye: a chunk of a recording lasts a thirtieth of a second."""


@dataclass(frozen=True)
class Repaired:
    """Result of ``repair``. frames: of the whole session. damaged: records that could not be read.

    lost_s: how long the lost chunks lasted, as far as they still state it.
    """

    path: Path
    frames: int
    lost_s: float = 0.0
    damaged: int = 0
    changed: bool = True


def repair(path: Path, out: Path | None = None, *, overwrite: bool = False) -> Repaired:
    """Rewrite a session as a whole one with all that can be read; a whole one stays as it is.

    The result takes the file's place; that of ``NAME.mcap.partial`` is called ``NAME.mcap``, and the partial
    file goes. With ``out`` the file stays as it is. Nothing changes before the result is whole.
    Raises FormatError when nothing can be saved, ExistsError when another file has the result's name and
    ``overwrite`` is False.
    """
    source = recording_at(path)
    if not source.is_file():
        raise FormatError(f"{path} does not exist; give a recorded session")
    with suppress(FormatError):
        if source == final_of(source) and not (whole := Session(source)).truncated:
            return Repaired(source, len(whole), changed=False)
    target = out or final_of(source)
    if target != source:
        check_free(target, overwrite)
    with source.open("rb") as file, replacing(target) as temporary:
        check_ended(file)
        lost_ns, damaged = _copy(file, temporary)
        frames = len(Session(temporary))
    if out is None and target != source:
        source.unlink()
    return Repaired(target, frames, lost_ns * 1e-9, damaged)


def _copy(file: BinaryIO, out: Path) -> tuple[int, int]:
    """Copy what can be read. Nanoseconds that are lost, and the number of damaged records."""
    lost_ns = damaged = 0
    with out.open("wb") as sink:
        writer = Writer(sink, chunk_size=CHUNK_BYTES)
        writer.start(profile="", library=METADATA)
        copier = Copier(writer)
        for offset in record_offsets(file):
            try:
                records = records_at(file, offset)
            except FormatError:
                damaged += 1
                lost_ns += copier.missing_ns(chunk_end_ns(file, offset))
                continue
            for record in records:
                copier.add(record)
        lost_ns += copier.missing_ns(chunk_end_ns(file, end_of_records(file)))
        writer.finish()
    if not copier.has_depth:
        raise FormatError(f"{file.name} holds no depth image that can be read; record it again")
    return lost_ns, damaged


class Copier:
    """Copies records to a writer: schemas, channels, metadata and messages."""

    def __init__(self, writer: Writer) -> None:
        self._writer = writer
        self._schemas: dict[int, int] = {0: 0}
        self._channels: dict[int, int] = {}
        self._topics: dict[int, str] = {}
        self._last_ns: int | None = None
        self.has_depth = False

    def add(self, record: McapRecord) -> None:
        """Copy one record; of a schema or channel the first that has its number."""
        match record:
            case Schema() if record.id not in self._schemas:
                new = self._writer.register_schema(record.name, record.encoding, record.data)
                self._schemas[record.id] = new
            case Channel() if record.id not in self._channels and record.schema_id in self._schemas:
                schema, encoding = self._schemas[record.schema_id], record.message_encoding
                new = self._writer.register_channel(record.topic, encoding, schema, record.metadata)
                self._channels[record.id], self._topics[record.id] = new, record.topic
            case Metadata():
                self._writer.add_metadata(record.name, record.metadata)
            case Message() if record.channel_id in self._channels:
                self._add_message(record)

    def missing_ns(self, end_ns: int | None) -> int:
        """How long after the last message copied a chunk that ends at ``end_ns`` lasted."""
        if (
            end_ns is None
            or self._last_ns is None
            or not self._last_ns < end_ns <= self._last_ns + LONGEST_LOSS_NS
        ):
            return 0
        lost_ns, self._last_ns = end_ns - self._last_ns, end_ns
        return lost_ns

    def _add_message(self, message: Message) -> None:
        channel = self._channels[message.channel_id]
        self._writer.add_message(
            channel, message.log_time, message.data, message.publish_time, message.sequence
        )
        self._last_ns = max(self._last_ns or 0, message.log_time)
        self.has_depth |= self._topics[message.channel_id] == DEPTH
