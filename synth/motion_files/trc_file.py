"""TRC files as Motion Analysis, Vicon, OpenSim, Pose2Sim and pyomeca write them, also with defects.

Cells are separated by tabs, commas, semicolons or blanks. A marker's name stands over the first of its three
columns, so a column without a name shifts no other (Vicon and Cortex write such columns for markers that they
could not label).
"""

import math
import re
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import islice
from typing import NamedTuple

import numpy as np

from annotate.array_types import Float64
from sensors.errors import FormatError

MAX_HEAD_LINES = 60
"""Lines in front of a TRC's frames at most: five, and comments. Untuned."""
NO_RATE = "no rate is stated; 100 frames a second are assumed"


class TrcPoints(NamedTuple):
    """Points of a TRC: labels, M names; positions, float64 (F, M, 3) in its unit and axes, NaN where not
    seen; frames_per_second; unit, "" if none is stated; assumed, one line each."""

    labels: tuple[str, ...]
    positions: Float64
    frames_per_second: float
    unit: str
    assumed: tuple[str, ...]


def parse_trc(lines: Iterable[str], most: int) -> TrcPoints:
    """Return the points of a TRC's lines.

    Raises FormatError when they are no TRC, or frames times markers are none or more than ``most``.
    """
    lines = (line for line in lines if line.strip() and not line.lstrip().startswith(("#", "//")))
    assumed: list[str] = []
    head = _Head.of(lines)
    odd: Counter[str] = Counter()
    times, rows, labels = _frames(lines, head, odd, most)
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
    return TrcPoints(labels, np.stack(rows), rate, head.values.get("Units", "").lower(), tuple(assumed))


@dataclass(frozen=True)
class _Head:
    """Named values of a TRC, its labels, and what separates its cells: None for any blanks."""

    values: dict[str, str]
    labels: tuple[str, ...]
    separator: str | None

    @staticmethod
    def of(lines: Iterator[str]) -> "_Head":
        names: list[str] = []
        values: dict[str, str] = {}
        for line in islice(lines, MAX_HEAD_LINES):
            separator = _separator(line)
            cells = _cells(line, separator)
            if re.fullmatch(r"frame\s?#.*|frame", cells[0].casefold()):
                return _Head(values, _labels(cells[2:]), separator)
            if names and not values:
                values = dict(zip(names, cells, strict=False))
            names = cells if "DataRate" in cells or "NumFrames" in cells else []
        raise FormatError("no row of labels that begins with Frame#; give a TRC file")

    def number(self, name: str) -> float:
        """Return the value of a name, NaN where it is none."""
        return _number(self.values.get(name, ""))


def _separator(line: str) -> str | None:
    """Return what separates the cells of a header's line, None for any blanks."""
    return next((mark for mark in "\t;," if mark in line), None)


def _cells(line: str, separator: str | None) -> list[str]:
    """Return the cells of a line; of one without the separator, what stands between blanks."""
    found = separator if separator is not None and separator in line else None
    return [cell.strip() for cell in line.rstrip("\r\n").split(found)] or [""]


def _labels(cells: list[str]) -> tuple[str, ...]:
    """Return the name over each third column, "" where it has none, also where it is over all three; of other
    names in a row all of them."""
    if len(cells) > 3 and cells[::3] == cells[1::3] == cells[2::3]:
        cells = [cell if i % 3 == 0 else "" for i, cell in enumerate(cells)]
    named = [i for i, cell in enumerate(cells) if cell]
    each_third = not any(i % 3 for i in named)
    return tuple(cells[: max(named, default=-1) + 1 : 3] if each_third else [cells[i] for i in named])


def _frames(
    lines: Iterable[str], head: _Head, odd: Counter[str], most: int
) -> tuple[list[float], list[Float64], tuple[str, ...]]:
    """Return times and positions (M, 3) of frames, and M labels; count in ``odd`` what is unlike a TRC."""
    times: list[float] = []
    rows: list[Float64] = []
    labels = head.labels
    for line in lines:
        cells = _cells(line, head.separator)
        if math.isnan(_number(cells[0])):
            if rows:
                odd["lines are no frames and were left out"] += 1
            continue
        numbers = cells[2:]
        while numbers and not numbers[-1]:
            numbers.pop()
        if not rows:
            stated = head.number("NumMarkers")
            unnamed = min(int(stated), -(-len(numbers) // 3)) if 0 < stated < most else 0
            labels += ("",) * (unnamed - len(labels))
        if (len(rows) + 1) * len(labels) > most:
            claim = f"{len(rows) + 1} frames of {len(labels)} markers"
            raise FormatError(f"{claim} or more, over {most} positions; cut the recording")
        if len(cells) - 2 < 3 * len(labels) and not line.endswith("\n"):
            odd["frame at the end is cut off and was left out"] += 1
            continue
        times.append(_number(cells[1]) if len(cells) > 1 else math.nan)
        rows.append(_row(numbers, len(labels), odd))
    return times, rows, labels


def _row(cells: list[str], markers: int, odd: Counter[str]) -> Float64:
    if len(cells) > 3 * markers:
        odd["frames have more numbers than markers; what is behind was left out"] += 1
    numbers = [_number(cell) for cell in cells[: 3 * markers]]
    strange = sum(n != n and c.casefold() not in ("", "nan") for n, c in zip(numbers, cells, strict=False))
    if strange:
        odd["cells are no numbers and count as not seen"] += strange
    numbers += [math.nan] * (3 * markers - len(numbers))
    return np.array(numbers).reshape(markers, 3)


def _number(cell: str) -> float:
    """Return the number of a cell, with a decimal point or comma; NaN where it holds none."""
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
    assumed.append(f"no rate is stated; {rate:.5g} follow from the times" if usable else NO_RATE)
    return rate if usable else 100.0
