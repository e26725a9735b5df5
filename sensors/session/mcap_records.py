"""Records of an MCAP file, whole or cut off, found by their lengths in the file's order.

``mcap`` parses them; its own random access needs the index at the end, which a killed recording lacks.
"""

import io
import os
import struct
import zlib
from array import array
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import BinaryIO, NamedTuple

import lz4.frame
import zstandard
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Chunk, McapRecord, Message
from mcap.stream_reader import StreamReader

from sensors.errors import FormatError
from sensors.files.own_files import RECORDING, own_file

MAGIC = b"\x89MCAP0\r\n"
MAX_RECORD_BYTES = 1 << 28  # of a record, and of an unpacked chunk: room for the largest image
MAX_CHUNK_RECORDS = 1 << 18  # a chunk of 4 MB, which ROS and Foxglove write, has room for 135,000
CACHED_CHUNKS = 8  # unpacked chunks kept, of which each holds a depth image and its companions; untuned
HEAD = struct.Struct("<BQ")  # opcode, length (MCAP specification, "Records")
MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log_time, publish_time (the same, "Message")
BROKEN = (
    *(McapError, struct.error, ValueError, OverflowError, RuntimeError, StopIteration),
    zstandard.ZstdError,
)
"""Errors that a corrupt record raises."""
_WANTED = {Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.CHUNK, Opcode.METADATA, Opcode.STATISTICS}


class Span(NamedTuple):
    """Position of a record in its file or chunk. start, end: of its content, behind opcode and length."""

    opcode: int
    start: int
    end: int


def record_offsets(file: BinaryIO) -> Iterator[int]:
    """Yield the offsets of the whole records. Raises FormatError for a file that is empty or not MCAP."""
    size = os.fstat(file.fileno()).st_size
    file.seek(0)
    if file.read(len(MAGIC)) != MAGIC:
        own = own_file(Path(file.name))
        kind = "empty" if size == 0 else own.kind if own and own.kind != RECORDING else "not an MCAP file"
        raise FormatError(f"{file.name} is {kind}; give a session")
    offset = len(MAGIC)
    while offset + HEAD.size <= size:
        file.seek(offset)
        opcode, length = HEAD.unpack(file.read(HEAD.size))
        if opcode == 0 or length > size - offset - HEAD.size:
            return
        yield offset
        if opcode == Opcode.FOOTER:
            return
        offset += HEAD.size + length


def is_complete(file: BinaryIO) -> bool:
    """Return whether the file ends as a finished MCAP file does, with the magic."""
    end = len(MAGIC)
    for offset in record_offsets(file):
        file.seek(offset)
        _, length = HEAD.unpack(file.read(HEAD.size))
        end = offset + HEAD.size + int(length)
    file.seek(end)
    return file.read(len(MAGIC) + 1) == MAGIC


def contents_at(file: BinaryIO, offset: int) -> bytes:
    """Return the record at an offset with its head, or the records of a chunk, whose CRC is checked.

    Empty for kinds that no session needs. Raises FormatError, naming file and offset, for a corrupt record.
    """
    file.seek(offset)
    head = file.read(HEAD.size)
    with damage(file.name, offset):
        opcode, length = HEAD.unpack(head)
        if opcode not in _WANTED:
            return b""
        if length > MAX_RECORD_BYTES:
            raise ValueError(f"a record states {length} bytes, over {MAX_RECORD_BYTES}")
        data = file.read(length)
        if len(data) != length:
            raise ValueError("the file ends within it")
        return unpacked(parsed(head + data)) if opcode == Opcode.CHUNK else head + data


def records_at(
    file: BinaryIO, offset: int, kinds: Collection[int] = frozenset(_WANTED)
) -> Iterator[McapRecord]:
    """Yield the record at an offset, or the records inside it if it is a chunk, parsed one at a time.

    A list of parsed records would take many times the memory of their bytes. kinds: opcodes of the records to
    yield. Raises FormatError, naming file and offset, for a corrupt record.
    """
    data = contents_at(file, offset)
    with damage(file.name, offset):
        for span in spans(data):
            if span.opcode in kinds:
                yield parsed(data, span)


class MessageReader:
    """Messages by their places in an MCAP file, at random; the last few chunks stay unpacked."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._chunk = lru_cache(CACHED_CHUNKS)(self._read_chunk)

    def read(self, offset: int, slot: int, stamp_ns: int | None = None) -> bytes:
        """Return the bytes of message ``slot`` of the chunk at ``offset``.

        Raises FormatError where the record is not a message or its publish time is not ``stamp_ns``.
        """
        data, starts = self._chunk(offset)
        start = starts[slot] if 0 <= slot < len(starts) else len(data)
        opcode, length = HEAD.unpack_from(data, start) if start < len(data) else (0, 0)
        content = data[start + HEAD.size : start + HEAD.size + length]
        with damage(str(self._path), offset):
            if opcode != Opcode.MESSAGE:
                raise ValueError("its index names messages that are not there")
            if stamp_ns not in (None, MESSAGE.unpack_from(content)[-1]):
                raise ValueError("its index states another time than a message")
        return content[MESSAGE.size :]

    def _read_chunk(self, offset: int) -> tuple[bytes, "array[int]"]:
        with self._path.open("rb") as file:
            data = contents_at(file, offset)
        with damage(str(self._path), offset):
            return data, array("q", (span.start - HEAD.size for span in spans(data)))


def spans(data: bytes) -> Iterator[Span]:
    """Yield the consecutive records in ``data``. Raises ValueError where it ends within one."""
    at = number = 0
    while at < len(data):
        opcode, length = HEAD.unpack_from(data, at)
        at += HEAD.size
        number += 1
        if length > len(data) - at:
            raise ValueError("it ends within a record")
        if number > MAX_CHUNK_RECORDS:
            raise ValueError(f"a chunk has more than {MAX_CHUNK_RECORDS} records")
        yield Span(opcode, at, at + length)
        at += length


def parsed(data: bytes, span: Span | None = None) -> McapRecord:
    """Parse the record of ``data``, or of a span of it. Raises one of ``mcap``'s errors."""
    if span is not None and span.opcode == Opcode.MESSAGE:
        channel, sequence, log_time, publish_time = MESSAGE.unpack_from(data[span.start : span.end])
        content = data[span.start + MESSAGE.size : span.end]
        return Message(channel, log_time, content, publish_time, sequence)
    record = data if span is None else data[span.start - HEAD.size : span.end]
    return next(iter(StreamReader(io.BytesIO(record), skip_magic=True, emit_chunks=True).records))


def unpacked(chunk: McapRecord) -> bytes:
    """Return a chunk's records as bytes, bounded, which ``mcap``'s own unpacking is not."""
    assert isinstance(chunk, Chunk)
    size, data = chunk.uncompressed_size, chunk.data
    if size > MAX_RECORD_BYTES:
        raise ValueError(f"a chunk states {size} bytes, over {MAX_RECORD_BYTES}")
    if chunk.compression == "zstd":
        # A frame allocates the memory that it claims.
        claimed = zstandard.frame_content_size(data)
        data = zstandard.decompress(data, size) if claimed in (size, -1) else b""
    elif chunk.compression == "lz4":
        data = lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size + 1)
    elif chunk.compression:
        raise ValueError(f"compression {chunk.compression!r} is not supported, convert it to zstd")
    if len(data) != size:
        raise ValueError(f"a chunk holds more or less than the {size} bytes it states")
    if chunk.uncompressed_crc not in (0, zlib.crc32(data)):
        raise ValueError("a chunk has a wrong checksum")
    return data


@contextmanager
def damage(name: str, offset: int) -> Iterator[None]:
    """Convert the errors of a corrupt record to FormatError, with file and offset."""
    try:
        yield
    except BROKEN as error:
        reason = str(error) or type(error).__name__
        raise FormatError(
            f"{name} is damaged at byte {offset} ({reason}); restore it from a copy, "
            f"or save the rest of it: annotate-cloud repair {name}"
        ) from error
