"""FLIR's data in a JPEG: the records of its FFF file, spread over APP1 segments, in either byte order.

Layout: ExifTool, FLIR.pm ("FLIR FFF tag table", "ProcessFLIR"). Cameras of FLIR write the file's header and
directory big-endian, DJI's (Zenmuse XT 2) little-endian; each record states its own order by its first word.
"""

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, NamedTuple

SEGMENT = b"FLIR\0"
RAW, PHOTO, CAMERA = 0x01, 0x0E, 0x20
"""Types of records: raw thermal image, embedded photograph, camera information."""
MAX_RECORDS = 10_000
"""Entries of a directory; cameras write some ten. Untuned."""
IMAGE_AT = 32
"""Bytes in front of an image in its record (ExifTool, FLIR.pm)."""
_VERSIONS = range(100, 200)
"""Versions of an FFF header, which determine its byte order."""
_ENTRY_BYTES = 32
"""Bytes of an entry of the directory (ExifTool, FLIR.pm)."""


class Record(NamedTuple):
    """One record. order: ``<`` or ``>``, of its numbers."""

    data: bytes
    order: str

    def numbers(self, layout: str, at: int) -> tuple[float, ...]:
        """Return numbers of a ``struct`` layout. Raises struct.error beyond the record's end."""
        return struct.unpack_from(self.order + layout, self.data, at)


def flir_segments(file: BinaryIO) -> Iterator[bytes]:
    """Yield the contents of a JPEG's FLIR segments in the file's order, without their header.

    Reading stops at the image data.
    """
    if file.read(2) != b"\xff\xd8":
        return
    while True:
        marker = file.read(2)
        while len(marker) == 2 and marker == b"\xff\xff":  # fill bytes
            marker = marker[1:] + file.read(1)
        if len(marker) < 2 or marker[0] != 0xFF or marker[1] in (0xD9, 0xDA):
            return
        if marker[1] == 0x01 or 0xD0 <= marker[1] <= 0xD8:
            continue
        length = file.read(2)
        size = int.from_bytes(length, "big") - 2
        if len(length) < 2 or size < 0:
            return
        if marker[1] == 0xE1:
            content = file.read(size)
            if content.startswith(SEGMENT):
                yield content
        else:
            file.seek(size, 1)


def has_flir(path: Path) -> bool:
    """Return whether a JPEG holds FLIR's data; False for a file that cannot be read."""
    try:
        with path.open("rb") as file:
            return next(flir_segments(file), None) is not None
    except OSError:
        return False


def flir_records(segments: list[bytes]) -> dict[int, Record]:
    """Return the first record of each type. Raises ValueError where the file is malformed or cut off."""
    if not segments:
        raise ValueError("it has no FLIR segment")
    # "FLIR", 0, 1, number of the segment, number of the last.
    ordered = sorted((segment for segment in segments if len(segment) > 8), key=lambda segment: segment[6])
    if not ordered or len(ordered) <= ordered[0][7]:
        raise ValueError("some of its FLIR segments are missing")
    fff = b"".join(segment[8:] for segment in ordered)
    if len(fff) < 64 or fff[:4] not in (b"FFF\0", b"AFF\0"):
        raise ValueError("its FLIR data is no FFF file")
    order = next((o for o in "><" if struct.unpack_from(f"{o}I", fff, 20)[0] in _VERSIONS), None)
    if order is None:
        raise ValueError("its FFF file has an unknown version")
    start, count = struct.unpack_from(f"{order}II", fff, 24)
    if count > MAX_RECORDS or start + count * _ENTRY_BYTES > len(fff):
        raise ValueError("its directory is cut off")
    records: dict[int, Record] = {}
    for entry in range(count):
        (kind,) = struct.unpack_from(f"{order}H", fff, start + entry * _ENTRY_BYTES)
        at, size = struct.unpack_from(f"{order}II", fff, start + entry * _ENTRY_BYTES + 12)
        if kind in (RAW, PHOTO, CAMERA) and kind not in records and size >= IMAGE_AT:
            if at + size > len(fff):
                raise ValueError(f"its record {kind} is cut off")
            data = fff[at : at + size]
            # The first word is 2 or 3: 256 or more means the other order.
            records[kind] = Record(data, "<" if data[0] and not data[1] else ">")
    return records
