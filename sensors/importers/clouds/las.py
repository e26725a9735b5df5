"""Points of a LAS or LAZ file through laspy (extra ``exchange``)."""

import struct
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from sensors.errors import FormatError
from sensors.importers.clouds.records import MAX_POINTS, CloudRecords

if TYPE_CHECKING:
    from laspy import LasHeader, ScaleAwarePointRecord

CHUNK = 1_000_000
"""Points unpacked at once; untuned."""
_VLR_BYTES, _EVLR_BYTES, _CHUNK_BYTES = 54, 60, 20
"""Least bytes of a variable length record, of an extended one, and of a chunk: one point (the format)."""
_COLORS = ("red", "green", "blue")


def read_las(path: Path) -> CloudRecords:
    """Read all points, x y z as doubles in the file's coordinates, with its colours. Raises FormatError."""
    try:
        import laspy
    except ImportError as error:
        raise FormatError(f"{path} needs laspy; pip install 'annotate-cloud[exchange]'") from error
    try:
        _check_counts(path)
        with laspy.open(path, laz_backend=laspy.LazBackend.Lazrs) as reader:
            header = reader.header
            expected = header.point_count
            if not 0 < expected <= MAX_POINTS:
                raise FormatError(f"{path} claims {expected} points; give 1 to {MAX_POINTS}")
            chunks = [_records(chunk, header) for chunk in reader.chunk_iterator(CHUNK)]
    except (FormatError, KeyboardInterrupt, SystemExit):
        raise
    except BaseException as error:  # a panic of the LAZ decoder is no Exception
        raise FormatError(f"{path} cannot be read ({str(error)[:80]}); restore it from a copy") from error
    held = sum(map(len, chunks))
    if held != expected:
        raise FormatError(f"{path} holds {held} of its {expected} points; restore it from a copy")
    return CloudRecords(np.concatenate(chunks))


def _records(chunk: "ScaleAwarePointRecord", header: "LasHeader") -> NDArray[Any]:
    """Return laspy's points as records, with colours where the format has all three."""
    named = set(header.point_format.dimension_names)
    colors = _COLORS if named.issuperset(_COLORS) else ()
    records = np.zeros(len(chunk), [*((axis, "<f8") for axis in "xyz"), *((name, "<u2") for name in colors)])
    for axis, scale, offset in zip("xyz", header.scales, header.offsets, strict=True):
        records[axis] = np.asarray(chunk[axis.upper()]) * scale + offset
    for name in colors:
        records[name] = chunk[name]
    return records


def _check_counts(path: Path) -> None:
    """Raise ValueError for counts that the file has no room for: at those of records laspy never comes to an
    end, at that of chunks its LAZ decoder ends the process for want of memory.

    Layout: ASPRS LAS 1.4 R15, "Public header block"; LASzip's chunk table: its offset stands before the
    points, or at the file's end where that is -1; in it version, number of chunks.
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(255).ljust(255, b"\0")
        header_size, points, vlrs = struct.unpack_from("<HII", head, 94)
        evlr, evlrs = struct.unpack_from("<QI", head, 235) if head[25] >= 4 else (0, 0)
        table, chunks = points, 0
        if head[104] & 0xC0:
            for at in (points, size - 8):
                file.seek(at)
                (table,) = struct.unpack("<q", file.read(8))
                if table != -1:
                    break
            file.seek(table)
            _, chunks = struct.unpack("<II", file.read(8))
    room = vlrs * _VLR_BYTES <= points - header_size and evlrs * _EVLR_BYTES <= max(0, size - evlr)
    if not room or points > size or chunks * _CHUNK_BYTES > size:
        raise ValueError(f"{vlrs + evlrs} records and {chunks} chunks cannot be in {size} bytes")
