"""Index stored in a session: all data except the images, so that opening a session reads no chunk.

Images are paired by device stamps, but MCAP's own index has only log times. Therefore the writer adds an
attachment with the attachment's CRC. It holds a JSON header (4 bytes of length in front), then the messages
in the file's order as columns packed by zstd. If another program rewrites the file and copies the attachment,
the attachment contradicts the summary and is ignored.
"""

import base64
import json
import struct
import zlib
from collections import Counter
from dataclasses import dataclass, field
from typing import BinaryIO

import numpy as np
import zstandard
from mcap.opcode import Opcode
from numpy.typing import NDArray

from sensors.session.mcap_records import HEAD
from sensors.session.summary import Summary

NAME, MEDIA_TYPE, VERSION = "annotate-cloud index", "application/octet-stream", 1
MAX_HEADER_BYTES = 1 << 22
MAX_COLUMN_BYTES = 1 << 27
"""Bytes of the header, with 40,000 events, and of the unpacked columns, 3 million messages. A session with
more carries no index: opening reads all of it."""
COLUMNS = 5  # numbers of a message in the index
_LENGTH = struct.Struct("<I")
_NUMBER_BYTES = 8
_BROKEN = (ValueError, KeyError, TypeError, AttributeError, RecursionError, struct.error, zstandard.ZstdError)


class ContradictionError(ValueError):
    """Error of an index that is damaged, or belongs to another file."""


@dataclass
class StoredIndex:
    """Data of a session except its images.

    columns: int64 (5, n), one column per message in the file's order. Rows: number of its topic, device
    stamp, log time, number of its chunk, number among the records of the chunk. ends: for every chunk, the
    offsets of its first byte and of the byte behind its message indexes. calibrations: the first message of
    each topic. events: (stamp, text).
    """

    topics: list[str] = field(default_factory=list)
    columns: NDArray[np.int64] = field(default_factory=lambda: np.empty((COLUMNS, 0), np.int64))
    ends: list[tuple[int, int]] = field(default_factory=list)
    metadata: dict[str, str] = field(default_factory=dict)
    calibrations: dict[str, bytes] = field(default_factory=dict)
    events: list[tuple[int, str]] = field(default_factory=list)

    def encode(self) -> bytes | None:
        """Return the attachment's data; None for a session that is too long."""
        columns, ends = self.columns, np.array(self.ends, np.int64).reshape(-1, 2).T
        header = {
            "version": VERSION,
            "messages": columns.shape[1],
            "chunks": ends.shape[1],
            "topics": self.topics,
            "metadata": self.metadata,
            "calibrations": {t: base64.b64encode(m).decode() for t, m in self.calibrations.items()},
            "events": self.events,
        }
        text = json.dumps(header).encode()
        if columns.nbytes + ends.nbytes > MAX_COLUMN_BYTES or len(text) > MAX_HEADER_BYTES:
            return None
        # Differences of neighbours, because small numbers compress better.
        steps = [np.diff(each, axis=1, prepend=0).astype("<i8").tobytes() for each in (columns, ends)]
        return _LENGTH.pack(len(text)) + text + zstandard.compress(b"".join(steps))

    @classmethod
    def decode(cls, data: bytes) -> "StoredIndex":
        """Invert ``encode``. Raises ContradictionError for malformed data."""
        try:
            (length,) = _LENGTH.unpack_from(data)
            if length > MAX_HEADER_BYTES:
                raise ContradictionError("too much text")
            header = json.loads(data[_LENGTH.size : _LENGTH.size + length])
            if header["version"] != VERSION:
                raise ContradictionError("an unknown version")
            columns, ends = _unpacked(data[_LENGTH.size + length :], header["messages"], header["chunks"])
            return cls(
                [str(topic) for topic in header["topics"]],
                columns,
                [(begin, end) for begin, end in ends.T.tolist()],
                {str(key): str(value) for key, value in header["metadata"].items()},
                {str(t): base64.b64decode(m) for t, m in header["calibrations"].items()},
                [(int(stamp_ns), str(text)) for stamp_ns, text in header["events"]],
            )
        except _BROKEN as error:
            raise ContradictionError(str(error)) from error


def _unpacked(packed: bytes, messages: int, chunks: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return columns int64 (5, messages) and bounds int64 (2, chunks). Raises ContradictionError where
    ``packed`` has another size.
    """
    split = COLUMNS * messages
    size = _NUMBER_BYTES * (split + 2 * chunks)
    # Decompression allocates the memory that the header claims.
    if messages < 0 or chunks < 0 or size > MAX_COLUMN_BYTES:
        raise ContradictionError("an impossible size")
    if zstandard.frame_content_size(packed) != size:
        raise ContradictionError("more or less messages than stated")
    steps = np.frombuffer(zstandard.decompress(packed, max(1, size)), "<i8")
    parts = steps[:split].reshape(COLUMNS, -1), steps[split:].reshape(2, -1)
    columns, ends = (np.cumsum(part, axis=1, dtype=np.int64) for part in parts)
    return columns, ends


def read_index(file: BinaryIO, summary: Summary) -> StoredIndex | None:
    """Return the index of a file; None without one, or if the index contradicts the summary."""
    found = next((each for each in summary.attachments if each.name == NAME), None)
    if found is None or not HEAD.size <= found.length <= 2 * MAX_COLUMN_BYTES:
        return None
    if found.offset + found.length > summary.start:
        return None
    file.seek(found.offset)
    record = file.read(found.length)
    head = (Opcode.ATTACHMENT, found.length - HEAD.size)
    if len(record) != found.length or HEAD.unpack_from(record) != head:
        return None
    content, crc = record[HEAD.size : -4], record[-4:]
    if zlib.crc32(content).to_bytes(4, "little") != crc:
        return None
    try:
        index = StoredIndex.decode(content[len(content) - found.data_size :])
        _check(index, summary)
    except ContradictionError:
        return None
    return index


def _check(index: StoredIndex, summary: Summary) -> None:
    """Raise ContradictionError where the index does not belong to the file of the summary."""
    topic, _, arrival_ns, chunk, _ = columns = index.columns
    ends = np.array(index.ends, np.int64).reshape(-1, 2)
    stated = summary.chunks
    if not np.array_equal(ends, np.stack([stated["offset"], stated["end"]], axis=1)):
        raise ContradictionError("other chunks")
    if (columns < 0).any() or (topic >= len(index.topics)).any() or (chunk >= len(ends)).any():
        raise ContradictionError("a message in no chunk")
    counts = np.bincount(topic, minlength=len(index.topics)).tolist()
    if summary.counts != Counter(dict(zip(index.topics, counts, strict=True))):
        raise ContradictionError("another number of messages")
    starts = np.flatnonzero(np.diff(chunk, prepend=-1))
    if len(starts) != len(ends) or (np.diff(chunk) < 0).any():
        raise ContradictionError("a chunk without messages")
    if len(starts) and not (
        np.array_equal(np.minimum.reduceat(arrival_ns, starts), stated["first_ns"])
        and np.array_equal(np.maximum.reduceat(arrival_ns, starts), stated["last_ns"])
    ):
        raise ContradictionError("other times")
