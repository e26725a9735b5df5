"""Recordings of markers: C3D and TRC files to positions, and what was assumed where a file has defects."""

import math
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np

from annotate.array_types import Float64
from sensors.errors import CloudError, FormatError
from synth.markers.c3d_file import parse_c3d

MAX_FILE_BYTES = 1_000_000_000
"""Of a C3D, which may hold force plates and muscle signals too, or a TRC."""
MAX_POSITIONS = 50_000_000
"""Frames times markers, 24 bytes each: an hour of 100 markers at 120 frames/s. Short rows of a TRC claim more
than its size shows."""
MAX_HEAD_LINES = 60
"""Of a TRC before its frames: five, and comments."""
UNITS_M = {"m": 1.0, "meters": 1.0, "metres": 1.0, "cm": 0.01, "mm": 0.001, "millimeters": 0.001}


@dataclass(frozen=True)
class Markers:
    """Marker positions over time.

    labels: M names as the file spells them. positions: float64 (F, M, 3) in the file's unit and axes, NaN
    where a marker was not seen. frames_per_second. unit: as the file declares ("m", "mm"), "" if nothing.
    up: the file's vertical axis 0, 1 or 2 as declared, or -1. assumed: a line for each defect of the file and
    how it was read. Raises FormatError when sizes are impossible.
    """

    labels: tuple[str, ...]
    positions: Float64
    frames_per_second: float
    unit: str = ""
    up: int = -1
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
    markers.positions[zero | ~np.isfinite(markers.positions).all(axis=2)] = np.nan
    if np.isnan(markers.positions).all():
        raise FormatError("no position in any frame; record again")
    if not zero.any():
        return markers
    note = f"{np.count_nonzero(zero)} positions are exactly 0, 0, 0 and count as not seen"
    return Markers(**(vars(markers) | {"assumed": (*markers.assumed, note)}))


def _read_c3d(path: Path) -> Markers:
    return Markers(*parse_c3d(path.read_bytes(), MAX_POSITIONS))


def _read_trc(path: Path) -> Markers:
    # Names in a laboratory's own encoding must not stop the numbers from being read.
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        lines = (line for line in file if line.strip() and not line.lstrip().startswith(("#", "//")))
        head = _TrcHead.of(lines)
        odd: Counter[str] = Counter()
        times, rows, labels = _trc_frames(lines, head, odd)
    if not rows:
        raise FormatError("the TRC holds no frame; copy it again")
    assumed = [f"{count} {what}" for what, count in odd.items()]
    if (claimed := head.number("NumFrames")) != len(rows):
        assumed.append(f"frames: the file states {claimed:g} and holds {len(rows)}")
    if len(labels) != head.number("NumMarkers"):
        assumed.append(f"markers: the file states {head.number('NumMarkers'):g} and holds {len(labels)}")
    rate = _trc_rate(head, times, assumed)
    return Markers(labels, np.stack(rows), rate, head.values.get("Units", "").lower(), assumed=tuple(assumed))


@dataclass(frozen=True)
class _TrcHead:
    """Named values of a TRC, its labels, and what separates its cells: a tab, or None for any blanks."""

    values: dict[str, str]
    labels: tuple[str, ...]
    separator: str | None

    @staticmethod
    def of(lines: Iterator[str]) -> "_TrcHead":
        names: list[str] = []
        values: dict[str, str] = {}
        for line in islice(lines, MAX_HEAD_LINES):
            separator = "\t" if "\t" in line else None
            cells = [cell.strip() for cell in line.rstrip("\r\n").split(separator)]
            if cells[0].casefold().startswith("frame#"):
                return _TrcHead(values, tuple(filter(None, cells[2:])), separator)
            if names and not values:
                values = dict(zip(names, cells, strict=False))
            names = cells if "DataRate" in cells or "NumFrames" in cells else []
        raise FormatError("no row of labels that begins with Frame#; give a TRC file")

    def number(self, name: str) -> float:
        """Value of a name, NaN where it is none."""
        return _number(self.values.get(name, ""))


def _trc_frames(
    lines: Iterable[str], head: _TrcHead, odd: Counter[str]
) -> tuple[list[float], list[Float64], tuple[str, ...]]:
    """Times and positions (M, 3) of each frame, and M labels; counts in ``odd`` what is unlike a TRC."""
    times: list[float] = []
    rows: list[Float64] = []
    labels = head.labels
    for line in lines:
        cells = line.rstrip("\r\n").split(head.separator)
        if math.isnan(_number(cells[0])):
            if rows:
                odd["lines are no frames and were left out"] += 1
            continue
        numbers = cells[2:]
        while numbers and not numbers[-1].strip():
            numbers.pop()
        if not rows:
            stated = head.number("NumMarkers")
            unnamed = min(int(stated), -(-len(numbers) // 3)) if 0 < stated < MAX_POSITIONS else 0
            labels += tuple(str(number) for number in range(len(labels) + 1, unnamed + 1))
        if (len(rows) + 1) * len(labels) > MAX_POSITIONS:
            claim = f"{len(rows) + 1} frames of {len(labels)} markers"
            raise FormatError(f"{claim} or more, over {MAX_POSITIONS} positions; cut the recording")
        if len(cells) - 2 < 3 * len(labels) and not line.endswith("\n"):
            odd["frame at the end is cut off and was left out"] += 1
            continue
        times.append(_number(cells[1]) if len(cells) > 1 else math.nan)
        rows.append(_trc_row(numbers, len(labels), odd))
    return times, rows, labels


def _trc_row(cells: list[str], markers: int, odd: Counter[str]) -> Float64:
    if len(cells) > 3 * markers:
        odd["frames have more numbers than markers; what is behind was left out"] += 1
    numbers = [_number(cell) for cell in cells[: 3 * markers]]
    strange = sum(
        n != n and c.strip().casefold() not in ("", "nan") for n, c in zip(numbers, cells, strict=False)
    )
    if strange:
        odd["cells are no numbers and count as not seen"] += strange
    numbers += [math.nan] * (3 * markers - len(numbers))
    return np.array(numbers).reshape(markers, 3)


def _number(cell: str) -> float:
    """Number of a cell, with a decimal point or comma; NaN where it holds none."""
    try:
        return float(cell.replace(",", "."))
    except ValueError:
        return math.nan


def _trc_rate(head: _TrcHead, times: list[float], assumed: list[str]) -> float:
    for rate in (head.number("DataRate"), head.number("CameraRate")):
        if 1 <= rate <= 10_000:
            return rate
    step = np.diff(times)
    rate = 1 / float(np.median(step)) if len(step) and np.median(step) > 0 else math.nan
    usable = 1 <= rate <= 10_000
    assumed.append(f"no rate is stated; {rate:.5g} follow from the times" if usable else NO_RATE)
    return rate if usable else 100.0


NO_RATE = "no rate is stated; 100 frames a second are assumed"
