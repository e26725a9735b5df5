"""Recordings of markers: C3D and TRC files to positions in metres, z up."""

import math
import warnings
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from annotate.array_types import Float64
from sensors.errors import CloudError, FormatError

MAX_FILE_BYTES = 1_000_000_000
"""Of a C3D, which may hold force plates and muscle signals too, or a TRC."""
MAX_POSITIONS = 50_000_000
"""Frames times markers, 24 bytes each: an hour of 100 markers at 120 frames/s. Short rows of a TRC claim more
than its size shows."""
UNITS_M = {"m": 1.0, "meters": 1.0, "metres": 1.0, "cm": 0.01, "mm": 0.001, "millimeters": 0.001}


@dataclass(frozen=True)
class Markers:
    """Marker positions over time.

    labels: M names as the file spells them. positions: float64 (F, M, 3) in the file's unit and axes, NaN
    where a marker was not seen. frames_per_second. unit: as the file declares ("m", "mm"), "" if nothing.
    up: the file's vertical axis 0, 1 or 2 as declared, or -1. Raises FormatError when sizes are impossible.
    """

    labels: tuple[str, ...]
    positions: Float64
    frames_per_second: float
    unit: str = ""
    up: int = -1

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
    """Read a C3D or TRC file. Raises FormatError when it is neither, damaged or of impossible size."""
    readers = {".c3d": _read_c3d, ".trc": _read_trc}
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise CloudError(f"{path} is not a marker file; give .c3d or .trc")
    try:
        if path.stat().st_size > MAX_FILE_BYTES:
            raise FormatError(f"larger than {MAX_FILE_BYTES} bytes; cut the recording")
        return reader(path)
    except FormatError as error:
        raise FormatError(f"{path}: {error}") from error
    except OSError as error:
        raise CloudError(f"{path} cannot be read ({error.strerror or error}); check the path") from error


def _read_c3d(path: Path) -> Markers:
    try:
        import c3d
    except ImportError as error:
        raise CloudError("reading C3D needs c3d; pip install 'annotate-cloud[synth]'") from error
    # The library answers damaged bytes with whatever exception they run into, and with warnings.
    try:
        with path.open("rb") as file, warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return _c3d_points(c3d.Reader(file), path.stat().st_size)
    except (CloudError, OSError):
        raise
    except Exception as error:
        raise FormatError(f"damaged C3D ({' '.join(str(error).split())[:120]}); export it again") from error


def _c3d_points(reader: Any, size: int) -> Markers:  # noqa: ANN401 - c3d has no types
    frames, points = reader.last_frame - reader.first_frame + 1, reader.point_used
    word = 4 if reader.point_scale < 0 else 2
    if frames < 1 or points < 1:
        raise FormatError("the C3D holds no marker; record again")
    if frames * points * 4 * word > size:
        raise FormatError(
            f"the C3D claims {frames} frames of {points} points and is cut short; copy it again"
        )
    positions = np.full((frames, points, 3), np.nan)
    read = 0
    for _, found, _ in reader.read_frames(copy=False):
        seen = found[:, 3] >= 0
        positions[read, seen] = found[seen, :3]
        read += 1
    if read < frames:
        raise FormatError(f"the C3D ends after {read} of {frames} frames; copy it again")
    positions[~np.isfinite(positions).all(axis=2)] = np.nan
    labels = tuple(str(label).strip() for label in _texts(reader, "POINT:LABELS"))[:points]
    vertical = _parameter(reader, "POINT:Y_SCREEN").upper().lstrip("+-")
    up = "XYZ".find(vertical) if len(vertical) == 1 else -1
    unit = _parameter(reader, "POINT:UNITS").lower()
    return Markers(labels, positions, float(reader.point_rate), unit, up)


def _parameter(reader: Any, name: str) -> str:  # noqa: ANN401 - c3d has no types
    values = _texts(reader, name)
    return str(np.ravel(values)[0]).strip() if len(values) else ""


def _texts(reader: Any, name: str) -> NDArray[Any]:  # noqa: ANN401 - c3d has no types
    """Texts of a parameter, none where it is absent; the library makes an object of each that is claimed."""
    parameter = reader.get(name)
    if parameter is None or not parameter.dimensions:
        return np.array([])
    letters = math.prod(parameter.dimensions)
    if letters > len(parameter.bytes):
        raise FormatError(f"{name} claims {parameter.dimensions} letters; export it again")
    return np.atleast_1d(parameter.string_array) if letters else np.array([])


def _read_trc(path: Path) -> Markers:
    try:
        with path.open(encoding="utf-8-sig") as file:
            head = [file.readline().strip("\n") for _ in range(5)]
            if not head[0].startswith("PathFileType"):
                raise FormatError("no TRC header of five lines; give a TRC file")
            header = dict(zip(head[1].split("\t"), head[2].split("\t"), strict=False))
            frames, markers = int(header["NumFrames"]), int(header["NumMarkers"])
            rate, unit = float(header["DataRate"]), header["Units"].strip().lower()
            labels = tuple(label.strip() for label in head[3].rstrip().split("\t")[2::3])
            if len(labels) != markers or frames * markers > MAX_POSITIONS:
                claim = f"the TRC claims {frames} frames of {markers} markers"
                raise FormatError(f"{claim} and names {len(labels)}; copy it again")
            lines = islice(filter(str.strip, file), frames + 1)
            rows = [_trc_row(line.strip("\n"), markers) for line in lines]
    except (UnicodeDecodeError, KeyError, ValueError) as error:
        raise FormatError(f"damaged TRC header ({error}); export it again") from error
    if not rows or len(rows) != frames:
        raise FormatError(f"the TRC claims {frames} frames and holds {len(rows)}; copy it again")
    return Markers(labels, np.stack(rows), rate, unit)


def _trc_row(row: str, markers: int) -> Float64:
    cells = row.split("\t")[2:]
    cells = [*cells[: 3 * markers], *[""] * (3 * markers - len(cells))]
    if len(row.split("\t")) < 3 or any(cell.strip() for cell in row.split("\t")[2 + 3 * markers :]):
        raise FormatError(f"frame {row[:10]!r} does not have 3 numbers for each marker; export it again")
    try:
        found = np.array([float(cell) if cell.strip() else math.nan for cell in cells]).reshape(markers, 3)
    except ValueError as error:
        raise FormatError(f"frame {row[:10]!r}: {error}; export it again") from error
    found[~np.isfinite(found).all(axis=1)] = np.nan
    return found
