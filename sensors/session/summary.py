"""Summary at the end of a finished MCAP file: places of its chunks, topics of its messages.

Layout: MCAP specification, "Footer", "Chunk Index", "Summary Section".
"""

import os
import struct
import zlib
from collections import Counter, defaultdict
from dataclasses import dataclass
from typing import Any, BinaryIO

import numpy as np
from mcap.opcode import Opcode
from mcap.records import AttachmentIndex, Channel, MetadataIndex, Schema, Statistics
from numpy.typing import NDArray

from sensors.session.mcap_records import BROKEN, HEAD, MAGIC, MAX_RECORD_BYTES, parsed, spans

CHUNK = np.dtype([("offset", "i8"), ("end", "i8"), ("first_ns", "i8"), ("last_ns", "i8")])
"""Byte of a chunk, the byte behind it and its message indexes, earliest and latest log time."""
_FOOTER = struct.Struct("<QQI")  # summary_start, summary_offset_start, summary_crc
_CHUNK = struct.Struct("<QQQQI")  # message_start_time, message_end_time, offset, length, bytes of a map
_INDEXES = struct.Struct("<Q")  # message_index_length
FOOTER_BYTES = HEAD.size + _FOOTER.size + len(MAGIC)


@dataclass(frozen=True)
class Summary:
    """Contents of a summary. chunks: CHUNK (n,), by offset. start: offset of the summary's first byte."""

    start: int
    chunks: NDArray[np.void]
    schemas: list[Schema]
    channels: list[Channel]
    statistics: Statistics | None
    attachments: list[AttachmentIndex]
    metadata: list[MetadataIndex]

    @property
    def counts(self) -> Counter[str]:
        """Return the number of messages by topic, as the statistics state it."""
        names = {channel.id: channel.topic for channel in self.channels}
        counts: Counter[str] = Counter()
        for number, messages in (self.statistics.channel_message_counts if self.statistics else {}).items():
            counts[names.get(number, "")] += messages
        return counts


def read_summary(file: BinaryIO) -> Summary | None:
    """Return the summary of a file; None where it is missing or damaged."""
    size = os.fstat(file.fileno()).st_size
    footer_at = size - FOOTER_BYTES
    if footer_at < len(MAGIC):
        return None
    file.seek(footer_at)
    footer = file.read(FOOTER_BYTES - len(MAGIC))
    start, _, crc = _FOOTER.unpack_from(footer, HEAD.size)
    whole = HEAD.unpack_from(footer) == (Opcode.FOOTER, _FOOTER.size)
    if not whole or not len(MAGIC) <= start <= footer_at or footer_at - start > MAX_RECORD_BYTES:
        return None
    file.seek(start)
    data = file.read(footer_at - start)
    if crc not in (0, zlib.crc32(footer[: HEAD.size + 16], zlib.crc32(data))):
        return None
    try:
        return _summary(start, data)
    except BROKEN:
        return None


def _summary(start: int, data: bytes) -> Summary:
    records: defaultdict[int, list[Any]] = defaultdict(list)
    chunks = []
    for span in spans(data):
        if span.opcode == Opcode.CHUNK_INDEX:
            first, last, offset, length, map_bytes = _CHUNK.unpack_from(data, span.start)
            (indexes,) = _INDEXES.unpack_from(data, span.start + _CHUNK.size + map_bytes)
            chunks.append((offset, offset + length + indexes, first, last))
        elif span.opcode != Opcode.SUMMARY_OFFSET:
            records[span.opcode].append(parsed(data, span))
    return Summary(
        start,
        np.sort(np.array(chunks, CHUNK), order="offset"),
        records[Opcode.SCHEMA],
        records[Opcode.CHANNEL],
        next(iter(records[Opcode.STATISTICS]), None),
        records[Opcode.ATTACHMENT_INDEX],
        records[Opcode.METADATA_INDEX],
    )
