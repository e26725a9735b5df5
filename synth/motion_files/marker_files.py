"""C3D and TRC recordings of markers, with sentences on what was assumed for defective files."""

import math
import re
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

import numpy as np

from annotate.array_types import Float64
from sensors.errors import CloudError, FormatError
from synth.motion_files.c3d_file import parse_c3d
from synth.motion_files.vertical_axis import UNSTATED, Upward

MAX_FILE_BYTES = 1_000_000_000  # a C3D may hold force plates and muscle signals too
# Frames times markers, 24 bytes each: an hour of 100 markers at 120 frames/s. Short rows of a TRC claim more
# positions than the file's size shows.
MAX_POSITIONS = 50_000_000
FARTHEST = 1e9  # no marker's coordinate: a kilometre in micrometres
# Metres per unit by its spelling in small letters.
UNITS_M = {
    **dict.fromkeys(("m", "meter", "meters", "metre", "metres"), 1.0),
    **dict.fromkeys(("cm", "centimeters", "centimetres"), 0.01),
    **dict.fromkeys(("mm", "millimeters", "millimetres"), 0.001),
    **dict.fromkeys(("dm", "decimeters", "decimetres"), 0.1),
    **dict.fromkeys(("um", "micrometers", "micrometres"), 1e-6),
    **dict.fromkeys(("in", "inch", "inches"), 0.0254),
    **dict.fromkeys(("ft", "foot", "feet"), 0.3048),
}
# Frames a second of separate poses; at this rate each frame is fitted without regard to the one before.
POSE_RATE = 1.0
MAX_HEAD_LINES = 60  # lines in front of a TRC's frames: five, and comments; untuned


@dataclass(frozen=True)
class Markers:
    """Marker positions over time.

    labels: M names as spelt in the file. positions: float64 (F, M, 3) in the file's unit and axes, NaN where
    not seen. unit: as in the file ("m", "mm"), or "". up: the stated vertical axis. assumed: sentences on
    defects and how they were read. Raises FormatError for impossible sizes.
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
            raise FormatError(f"the file has {self.frames_per_second:g} frames per second; give 1 to 10000")


def read_markers(path: Path) -> Markers:
    """Read a C3D or TRC file; ``assumed`` of the result names its defects.

    Raises FormatError when it is neither, too large or without positions.
    """
    readers = {".c3d": _read_c3d, ".trc": _read_trc}
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise CloudError(f"{path} is not a marker file; give .c3d or .trc")
    try:
        if path.stat().st_size > MAX_FILE_BYTES:
            raise FormatError(f"the file is larger than {MAX_FILE_BYTES} bytes; cut the recording")
        return _without_zeros(reader(path))
    except FormatError as error:
        raise FormatError(f"{path}: {error}") from error
    except OSError as error:
        raise CloudError(f"{path} cannot be read ({error.strerror or error}); check the path") from error


def _without_zeros(markers: Markers) -> Markers:
    zero = (markers.positions == 0).all(axis=2)
    markers.positions[zero | ~(np.abs(markers.positions) < FARTHEST).all(axis=2)] = np.nan
    if np.isnan(markers.positions).all():
        raise FormatError("the file has no position in any frame; record again")
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
        return _parse_trc(file)


def _parse_trc(lines: Iterable[str]) -> Markers:
    """Read TRC lines of Motion Analysis, Vicon, OpenSim, Pose2Sim and pyomeca, also defective ones.

    Cells are separated by tabs, commas, semicolons or blanks. A marker's name is over the first of its three
    columns, so a missing name does not shift the others.
    """
    lines = (line for line in lines if line.strip() and not line.lstrip().startswith(("#", "//")))
    assumed: list[str] = []
    head = _Head.of(lines)
    odd: Counter[str] = Counter()
    times, rows, labels = _frames(lines, head, odd)
    if not rows:
        raise FormatError("the TRC holds no frame; copy it again")
    assumed += [f"{count} {what}" for what, count in odd.items()]
    if (claimed := head.number("NumFrames")) != len(rows):
        assumed.append(f"frames: the file states {claimed:g} and holds {len(rows)}")
    if len(labels) != head.number("NumMarkers"):
        assumed.append(f"markers: the file states {head.number('NumMarkers'):g} and holds {len(labels)}")
    if unnamed := labels.count(""):
        assumed.append(f"{unnamed} markers have no label and are named by their number, from 1")
    labels = tuple(label or str(number) for number, label in enumerate(labels, 1))
    rate = _rate(head, times, assumed)
    unit = head.values.get("Units", "").lower()
    return Markers(labels, np.stack(rows), rate, unit, assumed=tuple(assumed))


@dataclass(frozen=True)
class _Head:
    """Named values of a TRC, its labels, and the separator of its cells, None for any blanks."""

    values: dict[str, str]
    labels: tuple[str, ...]
    separator: str | None

    @staticmethod
    def of(lines: Iterator[str]) -> "_Head":
        names: list[str] = []
        values: dict[str, str] = {}
        for line in islice(lines, MAX_HEAD_LINES):
            separator = next((mark for mark in "\t;," if mark in line), None)
            cells = _cells(line, separator)
            if re.fullmatch(r"frame\s?#.*|frame", cells[0].casefold()):
                return _Head(values, _labels(cells[2:]), separator)
            if names and not values:
                values = dict(zip(names, cells, strict=False))
            names = cells if "DataRate" in cells or "NumFrames" in cells else []
        raise FormatError("the file has no row of labels that begins with Frame#; give a TRC file")

    def number(self, name: str) -> float:
        return _number(self.values.get(name, ""))


def _cells(line: str, separator: str | None) -> list[str]:
    found = separator if separator is not None and separator in line else None
    return [cell.strip() for cell in line.rstrip("\r\n").split(found)] or [""]


def _labels(cells: list[str]) -> tuple[str, ...]:
    """Return the label over each third column, "" without one; all labels for a row of labels only."""
    if len(cells) > 3 and cells[::3] == cells[1::3] == cells[2::3]:
        cells = [cell if i % 3 == 0 else "" for i, cell in enumerate(cells)]
    named = [i for i, cell in enumerate(cells) if cell]
    each_third = not any(i % 3 for i in named)
    return tuple(cells[: max(named, default=-1) + 1 : 3] if each_third else [cells[i] for i in named])


def _frames(
    lines: Iterable[str], head: _Head, odd: Counter[str]
) -> tuple[list[float], list[Float64], tuple[str, ...]]:
    times: list[float] = []
    rows: list[Float64] = []
    labels = head.labels
    for line in lines:
        cells = _cells(line, head.separator)
        if math.isnan(_number(cells[0])):
            if rows:
                odd["lines are not frames and were left out"] += 1
            continue
        numbers = cells[2:]
        while numbers and not numbers[-1]:
            numbers.pop()
        if not rows:
            stated = head.number("NumMarkers")
            unnamed = min(int(stated), -(-len(numbers) // 3)) if 0 < stated < MAX_POSITIONS else 0
            labels += ("",) * (unnamed - len(labels))
        if (len(rows) + 1) * len(labels) > MAX_POSITIONS:
            claim = f"{len(rows) + 1} frames of {len(labels)} markers"
            raise FormatError(f"{claim} or more, over {MAX_POSITIONS} positions; cut the recording")
        if len(cells) - 2 < 3 * len(labels) and not line.endswith("\n"):
            odd["frame at the end is cut off and was left out"] += 1
            continue
        times.append(_number(cells[1]) if len(cells) > 1 else math.nan)
        rows.append(_row(numbers, len(labels), odd))
    return times, rows, labels


def _row(cells: list[str], markers: int, odd: Counter[str]) -> Float64:
    if len(cells) > 3 * markers:
        odd["frames have more numbers than markers; the rest was left out"] += 1
    numbers = [_number(cell) for cell in cells[: 3 * markers]]
    strange = sum(n != n and c.casefold() not in ("", "nan") for n, c in zip(numbers, cells, strict=False))
    if strange:
        odd["cells are not numbers and count as not seen"] += strange
    numbers += [math.nan] * (3 * markers - len(numbers))
    return np.array(numbers).reshape(markers, 3)


def _number(cell: str) -> float:
    try:
        return float(cell.replace(",", "."))
    except ValueError:
        return math.nan


def _rate(head: _Head, times: list[float], assumed: list[str]) -> float:
    for rate in (head.number("DataRate"), head.number("CameraRate")):
        if 1 <= rate <= 10_000:
            return rate
    step = np.diff(times)
    rate = 1 / float(np.median(step)) if len(step) and np.median(step) > 0 else math.nan
    usable = 1 <= rate <= 10_000
    source = f"{rate:.5g} follow from the times" if usable else "100 frames a second are assumed"
    assumed.append(f"no rate is stated; {source}")
    return rate if usable else 100.0
