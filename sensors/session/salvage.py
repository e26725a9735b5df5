"""Search for intact records of a damaged MCAP file, and for the gaps between them.

Layout: MCAP specification. Records follow each other by their lengths. After a corrupt record, the next one
is located by the index of an intact summary. Without a summary it is the next chunk whose header and CRC are
right.
"""

import os
import re
import struct
import zlib
from bisect import bisect_right
from collections.abc import Iterator
from mmap import ACCESS_READ, mmap
from typing import BinaryIO, NamedTuple

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Chunk

from sensors.session.mcap_records import (
    BROKEN,
    HEAD,
    MAGIC,
    MAX_RECORD_BYTES,
    MESSAGE,
    parsed,
    spans,
    unpacked,
)
from sensors.session.summary import Summary

_TIMES = struct.Struct("<QQ")  # message_start_time, message_end_time of a chunk
# Opcode, length below 4 GiB, times, size and CRC, compression; the same, or a message.
_CHUNK_HEAD = re.compile(rb"\x06.{4}\0{4}.{28}(?:\x04\0{3}zstd|\x03\0{3}lz4|\0{4})", re.DOTALL)
_ANY_HEAD = re.compile(rb"\x05.{4}\0{4}|" + _CHUNK_HEAD.pattern, re.DOTALL)
_CHUNK_BYTES = 8 + 8 + 8 + 4 + 4 + 8  # of a chunk's content beside its compression's name and its records
_PARSED = (Opcode.HEADER, Opcode.SCHEMA, Opcode.CHANNEL, Opcode.METADATA)
_DATA_END_BYTES = 4
_LAST = max(Opcode)


class Piece(NamedTuple):
    """Record of a file, or gap between two records: bytes ``start`` to ``end``.

    data: the records to keep, one after another; empty for a record that repair writes itself. end_ns: latest
    log time of a chunk, as far as it is stated.
    """

    start: int
    end: int
    data: bytes = b""
    lost: bool = False
    end_ns: int | None = None


def pieces(file: BinaryIO, summary: Summary | None) -> Iterator[Piece]:
    """Yield the records and gaps of a file from its first record to the end of its data.

    summary: None = damaged or missing.
    """
    size = os.fstat(file.fileno()).st_size
    if size <= len(MAGIC):
        return
    with mmap(file.fileno(), 0, access=ACCESS_READ) as memory:
        end = size if summary is None else summary.start
        yield from _Walk(memory, end, summary).pieces()


class _Walk:
    """Iterator over the records and gaps of a file's bytes, up to ``end``."""

    def __init__(self, memory: mmap, end: int, summary: Summary | None) -> None:
        self._memory, self._end = memory, end
        self._known: list[int] = []
        self._ends_ns: dict[int, int] = {}
        self._chunked = False
        if summary is not None:
            chunks = summary.chunks["offset"].tolist()
            others = [each.offset for each in summary.metadata] + [
                each.offset for each in summary.attachments
            ]
            self._known = sorted(at for at in (*chunks, *others) if at < end)
            self._ends_ns = dict(zip(chunks, summary.chunks["last_ns"].tolist(), strict=True))
            self._chunked = bool(chunks)

    def pieces(self) -> Iterator[Piece]:
        """Yield all records and gaps in order."""
        at = len(MAGIC)
        while not self._is_end(at):
            opcode, piece = self._memory[at], self._sound(at) or self._lost(at)
            yield piece
            if opcode == Opcode.DATA_END and not piece.lost:
                return
            at = piece.end

    def _sound(self, at: int) -> Piece | None:
        """Return the intact record at an offset; None for a corrupt record or other bytes."""
        end = self._stated_end(at)
        if end is None or self._next_known(at) < end:
            return None
        try:
            return self._checked(at, end)
        except BROKEN:
            return None

    def _checked(self, at: int, end: int) -> Piece | None:
        """Return the record between two bytes, or None. Raises one of ``BROKEN`` where it is corrupt."""
        record = self._memory[at:end]
        opcode, content = record[0], record[HEAD.size :]
        if opcode == Opcode.CHUNK:
            return self._checked_chunk(at, record)
        if at in self._ends_ns:
            return None
        if opcode == Opcode.ATTACHMENT:
            crc = content[-4:]
            sound = crc in (b"\0\0\0\0", zlib.crc32(content[:-4]).to_bytes(4, "little"))
            parsed(record)
            return Piece(at, end, record) if sound else None
        if opcode == Opcode.MESSAGE_INDEX:
            sound = int.from_bytes(content[2:6], "little") == len(content) - 6
            return Piece(at, end) if sound else None
        if opcode == Opcode.DATA_END:
            return Piece(at, end) if len(content) == _DATA_END_BYTES else None
        if self._stated_end(end) is None and not self._is_end(end):
            return None
        if opcode == Opcode.MESSAGE:
            # Without a CRC: where messages lie in chunks, other bytes look like one.
            return None if self._chunked or len(content) < MESSAGE.size else Piece(at, end, record)
        if opcode in _PARSED:
            written = RecordBuilder()
            parsed(record).write(written)
            return Piece(at, end, record) if written.count == len(record) else None
        return None

    def _checked_chunk(self, at: int, record: bytes) -> Piece:
        chunk = parsed(record)
        assert isinstance(chunk, Chunk)
        data = unpacked(chunk)
        for span in spans(data):
            # Records without a CRC may hold anything.
            short = span.opcode == Opcode.MESSAGE and span.end - span.start < MESSAGE.size
            if short or span.opcode in _PARSED:
                parsed(data, span)
        self._chunked = True
        # The stated length has no CRC, and a wrong one would hide the next records.
        end = at + HEAD.size + _CHUNK_BYTES + len(chunk.compression) + len(chunk.data)
        return Piece(at, end, data, end_ns=_TIMES.unpack_from(record, HEAD.size)[1])

    def _is_end(self, at: int) -> bool:
        """Return whether the data ends at an offset, or only the magic follows."""
        return self._end - at in (0, len(MAGIC)) and self._memory[at : self._end] in (b"", MAGIC)

    def _stated_end(self, at: int) -> int | None:
        """Return the end offset that the record at an offset states; None for an impossible end."""
        if at + HEAD.size > self._end:
            return None
        opcode, length = HEAD.unpack_from(self._memory, at)
        possible = 0 < opcode <= _LAST and length <= min(MAX_RECORD_BYTES, self._end - at - HEAD.size)
        return at + HEAD.size + int(length) if possible else None

    def _next_known(self, at: int) -> int:
        """Return the offset of the first record after a byte offset that the file's summary lists, or the end
        of the data.
        """
        number = bisect_right(self._known, at)
        return self._known[number] if number < len(self._known) else self._end

    def _lost(self, at: int) -> Piece:
        """Return the gap from an offset up to the next intact record."""
        end_ns = self._ends_ns.get(at, self._stated_end_ns(at))
        own_end = self._stated_end(at)
        if self._chunked and self._known:
            end = self._next_known(at)
        elif own_end is not None and self._sound(own_end) is not None:
            end = own_end
        else:
            heads = _CHUNK_HEAD if self._chunked else _ANY_HEAD
            found = heads.search(self._memory, at + 1)
            while found is not None and self._sound(found.start()) is None:
                found = heads.search(self._memory, found.start() + 1)
            end = self._end if found is None else found.start()
        return Piece(at, end, lost=True, end_ns=end_ns)

    def _stated_end_ns(self, at: int) -> int | None:
        """Return the latest log time that a chunk at a byte states, even a damaged or truncated one."""
        if at + HEAD.size + _TIMES.size > self._end or self._memory[at] != Opcode.CHUNK:
            return None
        return int(_TIMES.unpack_from(self._memory, at + HEAD.size)[1])
