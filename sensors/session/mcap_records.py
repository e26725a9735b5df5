"""The records of an MCAP file, whole or cut off.

``mcap``'s own random access needs the index at a file's end, which a recording that was killed has not. So
records are found by their lengths, in the file's order, and parsed by ``mcap``.
"""

import io
import os
import struct
import zlib
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import BinaryIO

import lz4.frame
import zstandard
from mcap.exceptions import EndOfFile, McapError
from mcap.opcode import Opcode
from mcap.records import Chunk, McapRecord, Message
from mcap.stream_reader import StreamReader

from sensors.errors import FormatError

MAGIC = b"\x89MCAP0\r\n"
MAX_RECORD_BYTES = 1 << 28
"""Bytes of a record, and of what a chunk unpacks to: room for the largest image that a camera may have."""
CACHED_CHUNKS = 8
"""Unpacked chunks kept: one holds a depth image and what came with it. Chosen by eye."""

_HEAD = struct.Struct("<BQ")  # opcode, length (MCAP specification, "Records")
_TIMES = struct.Struct("<QQ")  # message_start_time, message_end_time (the same, "Chunk")
_WANTED = {Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.CHUNK, Opcode.METADATA, Opcode.STATISTICS}
_BROKEN = (McapError, struct.error, ValueError, OverflowError, RuntimeError, zstandard.ZstdError)


def record_offsets(file: BinaryIO) -> Iterator[int]:
    """Offsets of the records that are there in full; those of a truncated file simply end early.

    Raises FormatError when the file is empty or no MCAP file.
    """
    size = os.fstat(file.fileno()).st_size
    file.seek(0)
    if file.read(len(MAGIC)) != MAGIC:
        raise FormatError(f"{file.name} is {'empty' if size == 0 else 'no MCAP file'}; give a session")
    offset = len(MAGIC)
    while offset + _HEAD.size <= size:
        file.seek(offset)
        opcode, length = _HEAD.unpack(file.read(_HEAD.size))
        if opcode == 0 or length > size - offset - _HEAD.size:
            return
        yield offset
        if opcode == Opcode.FOOTER:
            return
        offset += _HEAD.size + length


def end_of_records(file: BinaryIO) -> int:
    """Offset behind the last record that is there in full."""
    last = max(record_offsets(file), default=None)
    if last is None:
        return len(MAGIC)
    file.seek(last)
    _, length = _HEAD.unpack(file.read(_HEAD.size))
    return last + _HEAD.size + int(length)


def is_complete(file: BinaryIO) -> bool:
    """Whether the file ends as a finished MCAP file does, with the magic."""
    file.seek(end_of_records(file))
    return file.read(len(MAGIC) + 1) == MAGIC


def chunk_end_ns(file: BinaryIO, offset: int) -> int | None:
    """Latest log time of a chunk, even a damaged one or one cut off, as it states it; None for no chunk."""
    file.seek(offset)
    head = file.read(_HEAD.size + _TIMES.size)
    if len(head) < _HEAD.size + _TIMES.size or head[0] != Opcode.CHUNK:
        return None
    return int(_TIMES.unpack_from(head, _HEAD.size)[1])


def records_at(file: BinaryIO, offset: int) -> list[McapRecord]:
    """The ``mcap.records`` at an offset: one, a chunk's contents, or none of a kind that no session needs.

    Raises FormatError when they are corrupt, naming file and offset.
    """
    file.seek(offset)
    head = file.read(_HEAD.size)
    opcode, length = _HEAD.unpack(head)
    if opcode not in _WANTED:
        return []
    try:
        if length > MAX_RECORD_BYTES:
            raise ValueError(f"a record of {length} bytes")
        records = _records(head + file.read(length))
        return _records(_unpacked(records[0])) if isinstance(records[0], Chunk) else records
    except _BROKEN as error:
        reason = str(error) or type(error).__name__
        raise FormatError(
            f"{file.name} is damaged at byte {offset} ({reason}); restore it from a copy, "
            f"or save the rest of it: annotate-cloud repair {file.name}"
        ) from error


class MessageReader:
    """Messages by their places in an MCAP file, at random; the last few chunks stay unpacked."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._chunk = lru_cache(CACHED_CHUNKS)(self._read_chunk)

    def read(self, offset: int, slot: int) -> bytes:
        """The bytes of message ``slot`` of the chunk at ``offset``. Raises FormatError where none is."""
        records = self._chunk(offset)
        record = records[slot] if slot < len(records) else None
        if not isinstance(record, Message):
            raise FormatError(f"{self._path} was changed while it was read; open it again")
        return record.data

    def _read_chunk(self, offset: int) -> list[McapRecord]:
        with self._path.open("rb") as file:
            return records_at(file, offset)


def _records(data: bytes) -> list[McapRecord]:
    """The records that lie one after another in ``data``. Raises EndOfFile where it ends within one."""
    stream, records, end = io.BytesIO(data), list[McapRecord](), 0
    try:
        for record in StreamReader(stream, skip_magic=True, emit_chunks=True).records:
            records.append(record)
            end = stream.tell()
    except EndOfFile:
        if end < len(data):
            raise
    return records


def _unpacked(chunk: Chunk) -> bytes:
    """A chunk's records as bytes. ``mcap``'s own unpacking has no bound on what they take."""
    size, data = chunk.uncompressed_size, chunk.data
    if size > MAX_RECORD_BYTES:
        raise ValueError(f"a chunk of {size} bytes")
    if chunk.compression == "zstd":
        # A frame gets the memory it claims, whatever the limit.
        claimed = zstandard.frame_content_size(data)
        data = zstandard.decompress(data, size) if claimed in (size, -1) else b""
    elif chunk.compression == "lz4":
        data = lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size + 1)
    elif chunk.compression:
        raise ValueError(f"compression {chunk.compression!r} is not supported, convert it to zstd")
    if len(data) != size:
        raise ValueError(f"a chunk holds more or less than the {size} bytes it states")
    if chunk.uncompressed_crc not in (0, zlib.crc32(data)):
        raise ValueError("a chunk with a wrong checksum")
    return data
