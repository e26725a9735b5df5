"""Points of a LAS or LAZ file through laspy (extra ``exchange``)."""

import struct
from importlib.util import find_spec
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from sensors.errors import FormatError
from sensors.importers.cloud_header import MAX_POINTS

CHUNK = 1_000_000
MAX_LAZ_RATIO = 200
"""Bytes of points that a byte of LAZ may claim; real scans compress to a tenth."""

_COUNTS = struct.Struct("<HII")  # at 94: header size, offset of the points, number of VLRs
_EVLRS = struct.Struct("<QI")  # at 235 from version 1.4 on: offset and number of EVLRs
_VLR_BYTES, _EVLR_BYTES, _LEAST_CHUNK_BYTES = 54, 60, 20
"""Least bytes of a variable length record, of an extended one, and of a chunk: one point as it is."""


def read_las(path: Path) -> NDArray[np.float64]:
    """All points (n, 3) in metres; less their own rounded centre where they are far from the origin.

    Georeferenced clouds lie millions of metres from the origin; only their shape is wanted here.
    Raises FormatError.
    """
    if find_spec("laspy") is None:
        raise FormatError(f"{path} needs laspy; pip install 'annotate-cloud[exchange]'")
    import laspy

    _check_counts(path)
    try:
        with laspy.open(path, laz_backend=laspy.LazBackend.Lazrs) as reader:
            header = reader.header
            least = header.point_count * header.point_format.size
            size = path.stat().st_size
            if not 0 < header.point_count <= MAX_POINTS:
                raise FormatError(f"{path} claims {header.point_count} points; give 1 to {MAX_POINTS}")
            if least > size * (MAX_LAZ_RATIO if header.are_points_compressed else 1):
                raise FormatError(f"{path} claims more points than it can hold; restore it from a copy")
            chunks = [
                np.stack([chunk[axis] for axis in "XYZ"], axis=-1) * header.scales + header.offsets
                for chunk in reader.chunk_iterator(CHUNK)
            ]
            expected = header.point_count
    except (FormatError, KeyboardInterrupt, SystemExit):
        raise
    except BaseException as error:  # a panic of the LAZ decoder is no Exception
        raise FormatError(f"{path} cannot be read ({str(error)[:80]}); restore it from a copy") from error
    points = np.concatenate(chunks) if chunks else np.zeros((0, 3))
    if len(points) != expected:
        raise FormatError(f"{path} holds {len(points)} of its {expected} points; restore it from a copy")
    finite = points[np.isfinite(points).all(axis=1)]
    centre = np.rint(np.median(finite, axis=0)) if len(finite) else np.zeros(3)
    return points - centre if np.abs(centre).max() > 1000 else points


def _check_counts(path: Path) -> None:
    """Raise FormatError for counts that laspy and its LAZ decoder believe, and the file has no room for.

    Layout: ASPRS LAS 1.4 R15, "Public header block"; LASzip's chunk table: its offset stands before the
    points, or at the file's end where that is -1; in it version, number of chunks.
    """
    try:
        size = path.stat().st_size
        with path.open("rb") as file:
            head = file.read(255)
            header_size, points, vlrs = _COUNTS.unpack_from(head, 94)
            evlr, evlrs = _EVLRS.unpack_from(head, 235) if head[25] >= 4 else (0, 0)
            chunks = _chunks(file, points, size) if head[104] & 0xC0 else 0
    except (OSError, struct.error, IndexError, ValueError, OverflowError) as error:
        raise FormatError(f"{path} has no header of a LAS file ({error}); restore it from a copy") from error
    room = vlrs * _VLR_BYTES <= points - header_size and points <= size
    if not room or evlrs * _EVLR_BYTES > max(0, size - evlr) or chunks * _LEAST_CHUNK_BYTES > size:
        raise FormatError(f"{path} claims more records than it can hold; restore it from a copy")


def _chunks(file: BinaryIO, points: int, size: int) -> int:
    """Number of chunks that a LAZ file claims."""
    file.seek(points)
    (table,) = struct.unpack("<q", file.read(8))
    if table == -1:
        file.seek(size - 8)
        (table,) = struct.unpack("<q", file.read(8))
    file.seek(table)
    return int(struct.unpack("<II", file.read(8))[1])
