"""The messages of a ROS 1 bag, whole, cut off, or never closed by its recorder (``.bag.active``).

Records are found by their lengths, in the file's order, because a killed recorder has not written the index
at a file's end; rosbags refuses such a file. Format: ROS wiki, "Bags/Format/2.0". A killed recorder leaves
its last chunk with the length 0 (``startWritingChunk`` of rosbag/bag.cpp). An uncompressed chunk's records
then follow as if they were the file's own.
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
from sensors.importers.bags.ros_messages import READ, Entry, Place, bare
from sensors.session.mcap_records import MAX_RECORD_BYTES

MAGIC = b"#ROSBAG V2.0\n"
MAX_HEADER_BYTES = 1 << 20  # of a record: numbers and names of topics; untuned
CACHED_CHUNKS = 4  # unpacked chunks kept: messages that belong together are neighbours; untuned
_LENGTH = 4  # bytes of a length
_MESSAGE, _CHUNK, _DESCRIPTION = b"\2", b"\5", b"\7"
_WHOLE = -1  # chunk of a record that lies in none

Topics = dict[int, tuple[str, str]]
"""Name and bare type of topics by the number of their connection."""


class _Record(NamedTuple):
    """Record: fields by name, offset and length of its data."""

    fields: dict[bytes, bytes]
    start: int
    size: int

    @property
    def op(self) -> bytes:
        return self.fields[b"op"]

    @property
    def connection(self) -> int:
        return self.number(b"conn")

    def number(self, name: bytes) -> int:
        """Return a four-byte field, -1 if it is absent."""
        number = self.fields.get(name, b"")
        return int.from_bytes(number, "little") if len(number) == _LENGTH else -1

    def logged_ns(self) -> int:
        time = self.fields.get(b"time", b"")
        seconds, nanoseconds = struct.unpack("<II", time) if len(time) == 8 else (0, 0)
        return int(seconds) * 1_000_000_000 + int(nanoseconds)

    def data(self, file: BinaryIO) -> bytes:
        file.seek(self.start)
        return file.read(self.size)

    def described(self, file: BinaryIO) -> tuple[str, str]:
        """Return the topic and bare type of a description."""
        about = _fields(self.data(file))
        # rosbag's own record has the topic; the publisher's may name another one that was remapped.
        topic = self.fields.get(b"topic") or about.get(b"topic", b"")
        return topic.decode("utf-8", "replace"), bare(about.get(b"type", b"").decode("ascii", "replace"))


class Ros1File:
    """Messages of a ROS 1 bag. Raises FormatError for a file of another version.

    lost: note on the truncated or damaged part, one sentence, or ""; final once ``entries`` has ended.
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
        """Return the topics of all types; of a file with an index, the topics of the index."""
        with self.path.open("rb") as file:
            known = self._indexed(file)
            if not known:
                described = (found for found in self._records(file) if found[2].op == _DESCRIPTION)
                known = {record.connection: record.described(source) for _, source, record in described}
        return {topic for topic, _ in known.values()}

    def entries(self, kinds: frozenset[str] = READ) -> Iterator[Entry]:
        """Yield every message of a type that is read, in the file's order."""
        with self.path.open("rb") as file:
            # Where the chunk with a topic's description is damaged, the index describes the topic again.
            known = self._indexed(file)
            for chunk, source, record in self._records(file):
                if record.op == _DESCRIPTION:
                    known.setdefault(record.connection, record.described(source))
                elif record.connection in known and known[record.connection][1] in kinds:
                    place = (chunk, record.start, record.size)
                    described, data = known[record.connection], record.data(source)
                    yield Entry(*described, "ros1", record.logged_ns(), place, data)

    def read(self, topic: str, place: Place) -> bytes:
        """Read a message's bytes."""
        chunk, start, size = place
        if chunk != _WHOLE:
            return self._unpacked(chunk)[start : start + size]
        with self.path.open("rb") as file:
            file.seek(start)
            return file.read(size)

    def _records(self, file: BinaryIO) -> Iterator[tuple[int, BinaryIO, _Record]]:
        """Yield each description and message: offset of its chunk, file or chunk that holds it, and the
        record.
        """
        end, offset = os.fstat(file.fileno()).st_size, len(MAGIC)
        while offset < end:
            record = _record_at(file, offset, end)
            if record is None:
                self.lost = f"{self.path.name} is cut off or damaged at byte {offset}: what follows is lost"
                return
            if record.op == _CHUNK:
                yield from self._inside(offset)
            elif record.op in (_DESCRIPTION, _MESSAGE):
                yield _WHOLE, file, record
            offset = record.start + record.size

    def _inside(self, chunk: int) -> Iterator[tuple[int, BinaryIO, _Record]]:
        """Yield the records of a chunk; a truncated chunk yields the records before its end."""
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
            packed, compression = record.data(file), record.fields.get(b"compression", b"none")
        stated = record.number(b"size")
        limit = min(stated, MAX_RECORD_BYTES) if stated > 0 else MAX_RECORD_BYTES
        try:
            if compression == b"none":
                return packed
            if compression == b"bz2":
                return bz2.BZ2Decompressor().decompress(packed, limit)
            if compression == b"lz4":
                return bytes(lz4.frame.LZ4FrameDecompressor().decompress(packed, limit))
            raise ValueError(f"compression {compression[:20].decode('latin-1')!r} is not lz4 or bz2")
        except (OSError, RuntimeError, ValueError, EOFError) as error:
            raise FormatError(
                f"{self.path.name} is damaged at byte {offset} ({error}); restore it from a copy"
            ) from error

    def _indexed(self, file: BinaryIO) -> Topics:
        """Return the topics in the index at the file's end; none where it is absent."""
        end = os.fstat(file.fileno()).st_size
        first = _record_at(file, len(MAGIC), end)
        at = int.from_bytes(first.fields.get(b"index_pos", b""), "little") if first else 0
        known: Topics = {}
        while len(MAGIC) < at < end and (record := _record_at(file, at, end)) and record.op == _DESCRIPTION:
            known.setdefault(record.connection, record.described(file))
            at = record.start + record.size
        return known


def _record_at(file: BinaryIO, offset: int, end: int) -> _Record | None:
    """Return the record at an offset; None where it is cut off or damaged."""
    file.seek(offset)
    length = int.from_bytes(file.read(_LENGTH), "little")
    start = offset + _LENGTH + length + _LENGTH
    if length > MAX_HEADER_BYTES or start > end:
        return None
    fields, size = _fields(file.read(length)), int.from_bytes(file.read(_LENGTH), "little")
    if b"op" not in fields or start + size > end or size > MAX_RECORD_BYTES:
        return None
    return _Record(fields, start, size)


def _fields(header: bytes) -> dict[bytes, bytes]:
    """Return the fields ``name=value`` of a header, up to the first damaged field."""
    fields, at = {}, 0
    while at + _LENGTH <= len(header):
        end = at + _LENGTH + int.from_bytes(header[at : at + _LENGTH], "little")
        name, equals, value = header[at + _LENGTH : end].partition(b"=")
        if not equals:
            break
        fields[name], at = value, end
    return fields
