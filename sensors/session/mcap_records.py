"""The records of an MCAP file, whole or cut off, each bounded before it is read.

``mcap.reader`` needs the index at a file's end and trusts the lengths it finds; a recording that was killed
has no index, and a hostile one has impossible lengths. The records themselves are parsed by ``mcap``.
"""

import io
import os
import struct
from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import BinaryIO

import lz4.frame
import zstandard
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, McapRecord, Message, Schema
from mcap.stream_reader import StreamReader, get_chunk_data_stream

from sensors.errors import FormatError

MAGIC = b"\x89MCAP0\r\n"
MAX_RECORD_BYTES = 1 << 28
"""Largest record or chunk accepted: room for the largest image that a camera may have."""
MAX_RECORDS, FREE_RECORDS = 200_000, 100
"""Records of a chunk: never more than the first, nor than the second and one for every byte on disk. Time
stamps and sequence numbers alone need more than that."""
COUNTED_BYTES = 256
"""So much of a channel's description counts as one record more: it is a table, read entry by entry."""
MAX_CHANNELS = 1000
"""Channels, and schemas, of a file; few have a hundred."""
CACHED_CHUNKS = 8

_HEAD = struct.Struct("<BQ")  # opcode, length (MCAP specification, "Records")
_WANTED = {Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.CHUNK, Opcode.METADATA, Opcode.STATISTICS}
_BROKEN = (
    McapError,
    struct.error,
    ValueError,
    KeyError,
    OverflowError,
    MemoryError,
    RuntimeError,
    EOFError,
    zstandard.ZstdError,
)


def record_offsets(file: BinaryIO) -> Iterator[int]:
    """Offsets of the records that are there in full; those of a truncated file simply end early.

    Raises FormatError when the file is empty or no MCAP file.
    """
    size = os.fstat(file.fileno()).st_size
    file.seek(0)
    if file.read(len(MAGIC)) != MAGIC:
        raise FormatError(
            f"{file.name} is {'empty' if size == 0 else 'no MCAP file'}; give a recorded session"
        )
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


def is_complete(file: BinaryIO) -> bool:
    """Whether the file ends as a finished MCAP file does: footer, then magic."""
    last = max(record_offsets(file), default=None)
    if last is None:
        return False
    file.seek(last)
    opcode, length = _HEAD.unpack(file.read(_HEAD.size))
    file.seek(length, os.SEEK_CUR)
    return opcode == Opcode.FOOTER and file.read() == MAGIC


def records_at(file: BinaryIO, offset: int) -> list[McapRecord]:
    """The ``mcap.records`` at an offset: one, a chunk's contents, or none where nobody needs them.

    Raises FormatError when they are corrupt, naming file and offset.
    """
    file.seek(offset)
    head = file.read(_HEAD.size)
    opcode, length = _HEAD.unpack(head)
    if opcode not in _WANTED:
        return []
    try:
        if length > MAX_RECORD_BYTES:
            raise ValueError(f"{length} bytes long")
        record = next(StreamReader(io.BytesIO(head + file.read(length)), True, emit_chunks=True).records)
        return _contents(record) if isinstance(record, Chunk) else [record]
    except _BROKEN as error:
        reason = str(error) or type(error).__name__
        raise FormatError(
            f"{file.name} is damaged at byte {offset} ({reason}); repair it, or restore it from a copy"
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


def _contents(chunk: Chunk) -> list[McapRecord]:
    most = min(MAX_RECORDS, FREE_RECORDS + len(chunk.data))
    if chunk.compression == "lz4":
        chunk = _without_lz4(chunk)
    if chunk.compression not in ("", "zstd"):
        raise ValueError(f"compression {chunk.compression[:20]!r} is not supported, convert it to zstd")
    size = chunk.uncompressed_size
    # zstandard allocates what the frame itself claims, whatever maximum it is given.
    claimed = zstandard.frame_content_size(chunk.data) if chunk.compression else len(chunk.data)
    if size > MAX_RECORD_BYTES or claimed not in (size, -1):
        raise ValueError(f"chunk claims {claimed} and {size} bytes")
    return _records(chunk, most) if size else []


def _records(chunk: Chunk, most: int) -> list[McapRecord]:
    """What an unpacked chunk holds. Raises ValueError where it is damaged, or more than ``most`` records."""
    stream, size = get_chunk_data_stream(chunk, validate_crc=True)
    records: list[McapRecord] = []
    count = 0
    while stream.count < size:
        opcode, length = _HEAD.unpack(stream.read(_HEAD.size))
        end = stream.count + length
        count += 1 + (length // COUNTED_BYTES if opcode == Opcode.CHANNEL else 0)
        if count > most:
            raise ValueError(f"more than {most} records in a chunk")
        if opcode == Opcode.MESSAGE:
            records.append(Message.read(stream, length))
        elif opcode == Opcode.CHANNEL:
            records.append(Channel.read(stream))
        elif opcode == Opcode.SCHEMA:
            records.append(Schema.read(stream))
        # mcap reads what is inside a channel or schema, whatever length the record has.
        if not stream.count <= end <= size:
            raise ValueError("a record reaches beyond its end")
        stream.read(end - stream.count)
    return records


def _without_lz4(chunk: Chunk) -> Chunk:
    """Ours are never so compressed, but other people's MCAP files are."""
    if chunk.uncompressed_size > MAX_RECORD_BYTES:
        raise ValueError(f"chunk claims {chunk.uncompressed_size} bytes")
    data = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=chunk.uncompressed_size)
    return replace(chunk, compression="", data=data)
