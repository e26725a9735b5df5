"""Recordings of markers: C3D and TRC files to positions, and what was assumed where a file has defects."""

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from annotate.array_types import Float64
from sensors.errors import CloudError, FormatError
from synth.motion_files.c3d_file import parse_c3d
from synth.motion_files.trc_file import parse_trc
from synth.motion_files.vertical_axis import UNSTATED, Upward

MAX_FILE_BYTES = 1_000_000_000
"""Of a C3D, which may hold force plates and muscle signals too, or a TRC."""
MAX_POSITIONS = 50_000_000
"""Frames times markers, 24 bytes each: an hour of 100 markers at 120 frames/s. Short rows of a TRC claim more
than its size shows."""
FARTHEST = 1e9
"""Coordinate that no marker has: a kilometre in micrometres."""
UNITS_M = {
    **dict.fromkeys(("m", "meter", "meters", "metre", "metres"), 1.0),
    **dict.fromkeys(("cm", "centimeters", "centimetres"), 0.01),
    **dict.fromkeys(("mm", "millimeters", "millimetres"), 0.001),
    **dict.fromkeys(("dm", "decimeters", "decimetres"), 0.1),
    **dict.fromkeys(("um", "micrometers", "micrometres"), 1e-6),
    **dict.fromkeys(("in", "inch", "inches"), 0.0254),
    **dict.fromkeys(("ft", "foot", "feet"), 0.3048),
}
"""Metres per unit as files spell it, in small letters."""


@dataclass(frozen=True)
class Markers:
    """Marker positions over time.

    labels: M names as the file spells them. positions: float64 (F, M, 3) in the file's unit and axes, NaN
    where a marker was not seen. frames_per_second. unit: as the file declares ("m", "mm"), "" if nothing.
    up: the vertical axis that the file states. assumed: a line for each defect of the file and how it was
    read. Raises FormatError when sizes are impossible.
    """

    labels: tuple[str, ...]
    positions: Float64
    frames_per_second: float
    unit: str = ""
    up: Upward = UNSTATED
    assumed: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        frames, markers = self.positions.shape[:2]
        if self.positions.shape != (frames, len(self.labels), 3):
            raise FormatError(
                f"{markers} marker positions for {len(self.labels)} labels; give one label each"
            )
        if frames < 1 or markers < 1:
            raise FormatError(f"{frames} frames of {markers} markers; give at least one of each")
        if not (math.isfinite(self.frames_per_second) and 1 <= self.frames_per_second <= 10_000):
            raise FormatError(f"{self.frames_per_second} frames per second; give 1 to 10000")


def read_markers(path: Path) -> Markers:
    """Read a C3D or TRC file, also with defects, which ``assumed`` of the result names.

    Raises FormatError when it is neither, too large or holds no positions.
    """
    readers = {".c3d": _read_c3d, ".trc": _read_trc}
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise CloudError(f"{path} is not a marker file; give .c3d or .trc")
    try:
        if path.stat().st_size > MAX_FILE_BYTES:
            raise FormatError(f"larger than {MAX_FILE_BYTES} bytes; cut the recording")
        return _without_zeros(reader(path))
    except FormatError as error:
        raise FormatError(f"{path}: {error}") from error
    except OSError as error:
        raise CloudError(f"{path} cannot be read ({error.strerror or error}); check the path") from error


def _without_zeros(markers: Markers) -> Markers:
    """Markers where a place of exactly (0, 0, 0) counts as not seen, as some programs write it."""
    zero = (markers.positions == 0).all(axis=2)
    markers.positions[zero | ~(np.abs(markers.positions) < FARTHEST).all(axis=2)] = np.nan
    if np.isnan(markers.positions).all():
        raise FormatError("no position in any frame; record again")
    if not zero.any():
        return markers
    note = f"{np.count_nonzero(zero)} positions are exactly 0, 0, 0 and count as not seen"
    return replace(markers, assumed=(*markers.assumed, note))


def _read_c3d(path: Path) -> Markers:
    points = parse_c3d(path.read_bytes(), MAX_POSITIONS)
    up = Upward(points.up, "Y_SCREEN" if points.up else "", "z")
    return Markers(points.labels, points.positions, points.frames_per_second, points.unit, up, points.assumed)


def _read_trc(path: Path) -> Markers:
    # Names in a laboratory's own encoding must not stop the numbers from being read.
    with path.open("rb") as raw:
        wide = raw.read(2) in (b"\xff\xfe", b"\xfe\xff")  # "Unicode text" of Excel
    with path.open(encoding="utf-16" if wide else "utf-8-sig", errors="replace") as file:
        points = parse_trc(file, MAX_POSITIONS)
    return Markers(
        points.labels, points.positions, points.frames_per_second, points.unit, UNSTATED, points.assumed
    )
