"""Points of a LAS or LAZ file through laspy (extra ``exchange``)."""

import struct
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sensors.errors import FormatError
from sensors.importers.cloud_header import MAX_POINTS

CHUNK = 1_000_000
"""Points unpacked at once; chosen by eye."""
_VLR_BYTES, _EVLR_BYTES, _CHUNK_BYTES = 54, 60, 20
"""Least bytes of a variable length record, of an extended one, and of a chunk: one point (the format)."""
FAR_M = 1000.0
"""Metres from the origin beyond which a cloud is moved to its own centre; chosen by eye."""


def read_las(path: Path) -> NDArray[np.float64]:
    """All points (n, 3) in metres; less their own rounded centre where they are far from the origin.

    Georeferenced clouds lie millions of metres from the origin; only their shape is wanted here.
    Raises FormatError.
    """
    try:
        import laspy
    except ImportError as error:
        raise FormatError(f"{path} needs laspy; pip install 'annotate-cloud[exchange]'") from error
    try:
        _check_counts(path)
        with laspy.open(path, laz_backend=laspy.LazBackend.Lazrs) as reader:
            header, expected = reader.header, reader.header.point_count
            if not 0 < expected <= MAX_POINTS:
                raise FormatError(f"{path} claims {expected} points; give 1 to {MAX_POINTS}")
            chunks = [
                np.stack([chunk[axis] for axis in "XYZ"], axis=-1) * header.scales + header.offsets
                for chunk in reader.chunk_iterator(CHUNK)
            ]
    except (FormatError, KeyboardInterrupt, SystemExit):
        raise
    except BaseException as error:  # a panic of the LAZ decoder is no Exception
        raise FormatError(f"{path} cannot be read ({str(error)[:80]}); restore it from a copy") from error
    points = np.concatenate(chunks) if chunks else np.zeros((0, 3))
    if len(points) != expected:
        raise FormatError(f"{path} holds {len(points)} of its {expected} points; restore it from a copy")
    finite = points[np.isfinite(points).all(axis=1)]
    centre = np.rint(np.median(finite, axis=0)) if len(finite) else np.zeros(3)
    return points - centre if np.abs(centre).max() > FAR_M else points


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
