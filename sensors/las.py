"""Points of a LAS or LAZ file through laspy (extra ``exchange``)."""

from importlib.util import find_spec
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sensors.cloud_header import MAX_POINTS
from sensors.errors import FormatError

CHUNK = 1_000_000
MAX_LAZ_RATIO = 200
"""Bytes of points that a byte of LAZ may claim; real scans compress to a tenth."""
MAX_VLRS = 10_000


def read_las(path: Path) -> NDArray[np.float64]:
    """All points (n, 3) in metres; less their own rounded centre where they are far from the origin.

    Georeferenced clouds lie millions of metres from the origin; only their shape is wanted here.
    Raises FormatError.
    """
    if find_spec("laspy") is None:
        raise FormatError(f"{path} needs laspy; install annotate-cloud[exchange]")
    import laspy

    try:
        with laspy.open(path) as reader:
            header = reader.header
            least = header.point_count * header.point_format.size
            size = path.stat().st_size
            if not 0 < header.point_count <= MAX_POINTS or header.number_of_evlrs > MAX_VLRS:
                raise FormatError(f"{path} claims {header.point_count} points; give 1 to {MAX_POINTS}")
            if least > size * (MAX_LAZ_RATIO if header.are_points_compressed else 1):
                raise FormatError(f"{path} claims more points than it can hold; restore it from a copy")
            chunks = [np.asarray(chunk.xyz, np.float64) for chunk in reader.chunk_iterator(CHUNK)]
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
