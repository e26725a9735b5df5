"""Points of a LAS or LAZ file through laspy (extra ``exchange``)."""

import struct
from pathlib import Path

import numpy as np

from sensors.errors import FormatError
from sensors.importers.clouds.records import MAX_POINTS, CloudRecords

CHUNK = 1_000_000  # points unpacked at once; untuned
_VLR_BYTES, _EVLR_BYTES, _CHUNK_BYTES = 54, 60, 20  # least bytes of each (the format)
_COLORS = ("red", "green", "blue")


def read_las(path: Path) -> CloudRecords:
    """Read all points, x y z as doubles in the file's coordinates, with its colours. Raises FormatError where
    it is damaged.
    """
    try:
        import laspy
    except ImportError as error:
        raise FormatError(f"{path} needs laspy; pip install 'annotate-cloud[exchange]'") from error
    try:
        _check_counts(path)
        with laspy.open(path, laz_backend=laspy.LazBackend.Lazrs) as reader:
            header = reader.header
            if not 0 < header.point_count <= MAX_POINTS:
                raise FormatError(f"{path} has {header.point_count} points; give 1 to {MAX_POINTS}")
            colors = _COLORS if {*header.point_format.dimension_names}.issuperset(_COLORS) else ()
            layout = [*((axis, "<f8") for axis in "xyz"), *((name, "<u2") for name in colors)]
            records, held = np.zeros(header.point_count, layout), 0
            for chunk in reader.chunk_iterator(CHUNK):
                part = records[held : held + len(chunk)]
                for axis, scale, offset in zip("xyz", header.scales, header.offsets, strict=True):
                    part[axis] = np.asarray(chunk[axis.upper()]) * scale + offset
                for name in colors:
                    part[name] = chunk[name]
                held += len(chunk)
    except (FormatError, KeyboardInterrupt, SystemExit):
        raise
    except BaseException as error:  # a panic of the LAZ decoder is not an Exception
        raise FormatError(f"{path} cannot be read ({str(error)[:80]}); restore it from a copy") from error
    if held != len(records):
        raise FormatError(f"{path} holds {held} of its {len(records)} points; restore it from a copy")
    return CloudRecords(records)


def _check_counts(path: Path) -> None:
    """Raise ValueError for counts that exceed the size of the file.

    With wrong counts of records laspy does not end. With wrong counts of chunks its LAZ decoder runs out of
    memory and ends the process. Layout: ASPRS LAS 1.4 R15, "Public header block"; LASzip's chunk table. The
    table's offset is in front of the points, or at the file's end where it is -1 there.
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
