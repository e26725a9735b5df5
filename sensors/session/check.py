"""A strict check of a session's file: every byte that a checksum covers, every record, every count."""

import os
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from mcap.opcode import Opcode
from mcap.records import DataEnd

from sensors.errors import CloudError
from sensors.session.index import scan
from sensors.session.mcap_records import HEAD, MAGIC, parsed
from sensors.session.salvage import pieces
from sensors.session.stored_index import NAME, read_index
from sensors.session.summary import Summary, read_summary

_DATA_END_BYTES = HEAD.size + 4
_BLOCK_BYTES = 1 << 20


def problems_in(file: BinaryIO) -> list[str]:
    """Return every problem of an open session file, one line each; empty when it is whole."""
    return list(_problems(file))


def problems_of(path: Path) -> list[str]:
    """Return every problem of a session file, one line each."""
    with path.open("rb") as file:
        return problems_in(file)


def _problems(file: BinaryIO) -> Iterator[str]:
    size = os.fstat(file.fileno()).st_size
    for at, name in ((0, "first"), (max(0, size - len(MAGIC)), "last")):
        file.seek(at)
        if file.read(len(MAGIC)) != MAGIC:
            yield f"the {name} {len(MAGIC)} bytes are not those of a whole MCAP file"
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
    """Return whether the CRC of all data, if there is one, is that of the bytes."""
    end = summary.start - _DATA_END_BYTES
    if end < 0:
        return False
    file.seek(end)
    record = file.read(_DATA_END_BYTES)
    if HEAD.unpack_from(record) != (Opcode.DATA_END, 4):
        return False
    stated = parsed(record)
    assert isinstance(stated, DataEnd)
    if stated.data_section_crc == 0:
        return True
    file.seek(0)
    crc, left = 0, end
    while left and (block := file.read(min(left, _BLOCK_BYTES))):
        crc, left = zlib.crc32(block, crc), left - len(block)
    return crc == stated.data_section_crc
