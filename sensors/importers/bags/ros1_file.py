"""The messages of a ROS 1 bag, whole, cut off, or never closed by its recorder (``.bag.active``).

Records are found by their lengths, in the file's order, because the index at a file's end is absent where
the recorder was killed; rosbags refuses such a file. Format: ROS wiki, "Bags/Format/2.0". A recorder that
was killed leaves its last chunk with the length 0 (``startWritingChunk`` of rosbag/bag.cpp): an uncompressed
chunk's records then follow as if they were the file's own.
"""

import bz2
import io
import os
import struct
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import BinaryIO, NamedTuple

import lz4.frame

from sensors.errors import FormatError
from sensors.importers.bags.entries import Entry, Place, bare
from sensors.importers.bags.ros_messages import READ
from sensors.session.mcap_records import MAX_RECORD_BYTES

MAGIC = b"#ROSBAG V2.0\n"
MAX_HEADER_BYTES = 1 << 20
"""Bytes of a record's header: its fields are numbers and names of topics. Untuned."""
CACHED_CHUNKS = 4
"""Unpacked chunks kept: messages that belong together lie in neighbouring ones. Untuned."""
_LENGTH, _TIME, _CONNECTION = struct.Struct("<I"), struct.Struct("<II"), struct.Struct("<I")
_MESSAGE, _CHUNK, _DESCRIPTION = b"\2", b"\5", b"\7"
_WHOLE = -1
"""Place of a record that lies in no chunk."""


class _Record(NamedTuple):
    """A record: its fields by name, where its data begin and their length, where the next record begins."""

    fields: dict[bytes, bytes]
    start: int
    size: int

    @property
    def op(self) -> bytes:
        return self.fields.get(b"op", b"")

    @property
    def connection(self) -> int:
        """Number of the topic that it belongs to, -1 for none."""
        number = self.fields.get(b"conn", b"")
        return int(_CONNECTION.unpack(number)[0]) if len(number) == _CONNECTION.size else -1


class Ros1File:
    """A ROS 1 bag's messages. lost: what is cut off or damaged, one sentence, "" for nothing.

    ``lost`` is known when ``entries`` has ended. Raises FormatError.
    """

    encoding = "ros1"

    def __init__(self, path: Path) -> None:
        self.path, self.lost = path, ""
        self._unpacked = lru_cache(CACHED_CHUNKS)(self._unpack)
        with path.open("rb") as file:
            if (head := file.read(len(MAGIC))) != MAGIC:
                version = head.decode("ascii", "replace").strip()
                raise FormatError(
                    f"{path} cannot be read (it begins with {version!r}); convert it to a bag 2.0"
                )

    @property
    def topics(self) -> set[str]:
        """Topics of all types; only the topics of the index, if the file has one."""
        with self.path.open("rb") as file:
            known = self._indexed(file) or dict(self._described(file))
        return {topic for topic, _ in known.values()}

    def entries(self, kinds: frozenset[str] = READ) -> Iterator[Entry]:
        """Yield every message of a type that is read, in the file's order."""
        with self.path.open("rb") as file:
            # Where the chunk is damaged in which a topic is described, the index describes it again.
            known = self._indexed(file)
            for chunk, source, record in self._records(file):
                if record.op == _DESCRIPTION:
                    known.setdefault(*_described(record, source))
                elif record.connection in known and known[record.connection][1] in kinds:
                    topic, kind = known[record.connection]
                    place = (chunk, record.start, record.size)
                    yield Entry(topic, kind, "ros1", _logged_ns(record), place, _data(source, record))

    def read(self, topic: str, place: Place) -> bytes:
        """Read a message's bytes."""
        chunk, start, size = place
        if chunk != _WHOLE:
            return self._unpacked(chunk)[start : start + size]
        with self.path.open("rb") as file:
            file.seek(start)
            return file.read(size)

    def _records(self, file: BinaryIO) -> Iterator[tuple[int, BinaryIO, _Record]]:
        """Yield descriptions and messages: their chunk, the file or chunk that holds them, and the record."""
        end, offset = os.fstat(file.fileno()).st_size, len(MAGIC)
        while offset < end:
            record = _record_at(file, offset, end)
            if record is None:
                self.lost = f"{self.path.name} is cut off or damaged at byte {offset}: what follows is lost"
                return
            if record.op == _CHUNK and record.size:
                yield from self._inside(offset)
            elif record.op in (_DESCRIPTION, _MESSAGE):
                yield _WHOLE, file, record
            offset = record.start + record.size

    def _inside(self, chunk: int) -> Iterator[tuple[int, BinaryIO, _Record]]:
        """Yield the records of a chunk, as far as it is whole."""
        try:
            inside = io.BytesIO(self._unpacked(chunk))
        except FormatError as error:
            self.lost = f"{error}: messages of that chunk are lost"
            return
        offset, end = 0, inside.getbuffer().nbytes
        while offset < end and (record := _record_at(inside, offset, end)) is not None:
            yield chunk, inside, record
            offset = record.start + record.size
        if offset < end:
            self.lost = f"{self.path.name} is damaged at byte {chunk}: messages of that chunk are lost"

    def _unpack(self, offset: int) -> bytes:
        """Return the records of the chunk at ``offset``."""
        with self.path.open("rb") as file:
            record = _record_at(file, offset, os.fstat(file.fileno()).st_size)
            if record is None:
                raise FormatError(f"{self.path} was changed while it was read; open it again")
            packed, compression = _data(file, record), record.fields.get(b"compression", b"none")
        stated = _LENGTH.unpack(record.fields[b"size"])[0] if len(record.fields.get(b"size", b"")) == 4 else 0
        limit = min(stated or MAX_RECORD_BYTES, MAX_RECORD_BYTES)
        try:
            return _decompressed(packed, compression, limit)
        except (OSError, RuntimeError, ValueError, EOFError) as error:
            raise FormatError(f"{self.path.name} is damaged at byte {offset} ({error})") from error

    def _described(self, file: BinaryIO) -> Iterator[tuple[int, tuple[str, str]]]:
        return (_described(r, source) for _, source, r in self._records(file) if r.op == _DESCRIPTION)

    def _indexed(self, file: BinaryIO) -> dict[int, tuple[str, str]]:
        """Return the topics and types by connection, as the index has them; none where it is absent."""
        end = os.fstat(file.fileno()).st_size
        first = _record_at(file, len(MAGIC), end)
        at = int.from_bytes(first.fields.get(b"index_pos", b""), "little") if first else 0
        known: dict[int, tuple[str, str]] = {}
        while len(MAGIC) < at < end and (record := _record_at(file, at, end)) and record.op == _DESCRIPTION:
            known.setdefault(*_described(record, file))
            at = record.start + record.size
        return known


def _record_at(file: BinaryIO, offset: int, end: int) -> _Record | None:
    """Return the record at an offset; None where it is not there in full, or is none."""
    file.seek(offset)
    head = file.read(_LENGTH.size)
    if len(head) < _LENGTH.size:
        return None
    (length,) = _LENGTH.unpack(head)
    after = offset + _LENGTH.size + length
    if length > MAX_HEADER_BYTES or after + _LENGTH.size > end:
        return None
    fields, size = _fields(file.read(length)), _LENGTH.unpack(file.read(_LENGTH.size))[0]
    start = after + _LENGTH.size
    if b"op" not in fields or start + size > end or size > MAX_RECORD_BYTES:
        return None
    return _Record(fields, start, size)


def _fields(header: bytes) -> dict[bytes, bytes]:
    """Return the fields ``name=value`` of a header, up to the first one that is damaged."""
    fields, at = {}, 0
    while at + _LENGTH.size <= len(header):
        (length,) = _LENGTH.unpack_from(header, at)
        name, equals, value = header[at + _LENGTH.size : at + _LENGTH.size + length].partition(b"=")
        if not equals:
            break
        fields[name] = value
        at += _LENGTH.size + length
    return fields


def _data(file: BinaryIO, record: _Record) -> bytes:
    file.seek(record.start)
    return file.read(record.size)


def _described(record: _Record, source: BinaryIO) -> tuple[int, tuple[str, str]]:
    """Return a connection's number, its topic and bare type."""
    about = _fields(_data(source, record))
    # rosbag's own record has the topic; the publisher's may name another one that was remapped.
    topic = record.fields.get(b"topic") or about.get(b"topic", b"")
    kind = bare(about.get(b"type", b"").decode("ascii", "replace"))
    return record.connection, (topic.decode("utf-8", "replace"), kind)


def _logged_ns(record: _Record) -> int:
    time = record.fields.get(b"time", b"")
    if len(time) != _TIME.size:
        return 0
    seconds, nanoseconds = _TIME.unpack(time)
    return int(seconds) * 1_000_000_000 + int(nanoseconds)


def _decompressed(packed: bytes, compression: bytes, limit: int) -> bytes:
    """Return a chunk's records, at most ``limit`` bytes."""
    if compression == b"none":
        return packed
    if compression == b"bz2":
        return bz2.BZ2Decompressor().decompress(packed, limit)
    if compression == b"lz4":
        return bytes(lz4.frame.LZ4FrameDecompressor().decompress(packed, limit))
    raise ValueError(f"compression {compression[:20]!r} is not supported")
