"""The domain gap: every result beside the first one, part by part and for each kind of frame."""

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from annotate.array_types import Index
from annotate.parts import BODY_PARTS, Part
from eval.compare import paper
from eval.compare.paired import Difference
from eval.compare.results import Result
from eval.report.estimates import Estimate, group_estimates, picked
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


@dataclass(frozen=True)
class GapRow:
    """A part's recall less its recall in the first result, for each of the others; the paper's gap beside."""

    part: Part
    base: float
    gaps: list[Estimate]
    paper_gap: float


@dataclass(frozen=True)
class GroupCell:
    """Frames of one kind in one result; no frames, no scores."""

    frames: int
    scores: dict[str, Estimate]


@dataclass(frozen=True)
class GroupRow:
    """One value of a trait, by result."""

    value: str
    cells: list[GroupCell]


@dataclass(frozen=True)
class GroupTable:
    """One trait: its title, rows in the order to show, and how many values were left out."""

    title: str
    rows: list[GroupRow]
    left_out: int


def part_gaps(results: Sequence[Result], found: Sequence[Difference]) -> list[GapRow]:
    """One row a body part."""
    gap = np.diagonal(paper.TABLE3_REAL) - np.diagonal(paper.TABLE2_SYNTHETIC)
    recall = results[0].comparison.scores["recall"]
    return [
        GapRow(
            part,
            float(recall[part.id]),
            [difference_of(one, "recall", part.id) for one in found],
            float(gap[part.id]),
        )
        for part in BODY_PARTS
    ]


def difference_of(found: Difference, name: str, *index: int) -> Estimate:
    """One score's difference with its interval."""
    return picked(found.values[name], found.ci95[name], index)


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
        GroupRow(
            value, [_cell(result, found.get(value)) for result, found in zip(results, found_by, strict=True)]
        )
        for value in sorted(counts, key=_place)
        if value in frequent
    ]
    return GroupTable(title, rows, len(counts) - len(rows))


def _place(value: str) -> tuple[bool, float]:
    """Ranges ("under 1 m", "1 to 1.5 m") by their lower end; all else keeps its order."""
    start = re.match(r"(under )?([0-9.]+) ?(to|m|%)", value)
    return (False, float(start[2]) - bool(start[1]) * 1e-3) if start else (True, 0.0)


def _cell(result: Result, frames: Index | None) -> GroupCell:
    if frames is None:
        return GroupCell(0, {})
    return GroupCell(len(frames), group_estimates(result.comparison, frames))
