"""The domain gap: every result beside the first one, for each kind of frame."""

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from annotate.array_types import Index
from eval.compare.results import Result
from eval.report.estimates import Estimate, group_recall
from eval.scores.traits import groups

VALUES = 24
"""Values of a trait listed at most, the most frequent ones; chosen by eye."""

KIND_TITLES = {
    "subject": "Person",
    "activity": "Pose",
    "view": "Seen from",
    "distance": "Distance",
    "invalid depth": "Share of invalid depth",
    "status": "Labels",
    "hard": "What makes it hard",
}

Cell = tuple[int, Estimate] | None
"""Frames of one kind in one result, and their mean recall; None where it has none."""


class GroupTable(NamedTuple):
    """One trait: its title, each value's cells by result in the order to show, values left out."""

    title: str
    rows: list[tuple[str, list[Cell]]]
    left_out: int


def group_tables(results: Sequence[Result]) -> list[GroupTable]:
    """One table for each trait that differs between frames of a result or between results."""
    by_result = [groups(r.comparison.subjects, r.comparison.traits) for r in results]
    tables = (
        _group_table(title, results, [found.get(kind, {}) for found in by_result])
        for kind, title in KIND_TITLES.items()
    )
    return [table for table in tables if len(table.rows) > 1]


def _group_table(
    title: str, results: Sequence[Result], found_by: Sequence[Mapping[str, Index]]
) -> GroupTable:
    counts = Counter[str]()
    for found in found_by:
        counts.update({value: len(frames) for value, frames in found.items()})
    frequent = {value for value, _ in counts.most_common(VALUES)}
    rows = [
        (value, [_cell(result, found.get(value)) for result, found in zip(results, found_by, strict=True)])
        for value in sorted(counts, key=_place)
        if value in frequent
    ]
    return GroupTable(title, rows, len(counts) - len(rows))


def _place(value: str) -> tuple[bool, float]:
    """Ranges ("under 1 m", "1 to 1.5 m") by their lower end; all else keeps its order."""
    start = re.match(r"(under )?([0-9.]+) ?(to|m|%)", value)
    return (False, float(start[2]) - bool(start[1]) * 1e-3) if start else (True, 0.0)


def _cell(result: Result, frames: Index | None) -> Cell:
    return None if frames is None else (len(frames), group_recall(result.comparison, frames))
