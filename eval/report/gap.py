"""The domain gap: every result beside the first one, part by part and for each kind of frame."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from annotate.parts import BODY_PARTS, Part
from eval import paper
from eval.paired import Difference, difference
from eval.report.estimates import Estimate, group_estimates
from eval.results import Result
from eval.traits import groups

MAX_VALUES = 24
"""Values of a trait listed at most, the most frequent ones: a thousand subjects make no table."""

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


def differences(results: Sequence[Result]) -> list[Difference]:
    """Every result but the first, less the first."""
    return [difference(result, results[0]) for result in results[1:]]


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
    low, high = found.ci95[name][(..., *index)]
    return Estimate(float(found.values[name][(..., *index)]), float(low), float(high))


def group_tables(results: Sequence[Result]) -> list[GroupTable]:
    """One table a trait that tells frames apart in any of the results."""
    by_result = [groups(r.comparison.subjects, r.comparison.traits) for r in results]
    kinds = [kind for kind in KIND_TITLES if any(len(found.get(kind, {})) > 1 for found in by_result)]
    # Two results of one kind each (synthetic and real, say) still differ in it.
    kinds += [k for k in KIND_TITLES if k not in kinds and len({v for f in by_result for v in f.get(k, {})}) > 1]
    tables = []
    for kind in sorted(kinds, key=list(KIND_TITLES).index):
        counts: dict[str, int] = {}
        for found in by_result:
            for value, mask in found.get(kind, {}).items():
                counts[value] = counts.get(value, 0) + int(mask.sum())
        frequent = set(sorted(counts, key=lambda value: -counts[value])[:MAX_VALUES])
        rows = [
            GroupRow(value, [_cell(r, found.get(kind, {}).get(value)) for r, found in zip(results, by_result, strict=True)])
            for value in counts
            if value in frequent
        ]
        tables.append(GroupTable(KIND_TITLES[kind], rows, len(counts) - len(rows)))
    return tables


def _cell(result: Result, mask: np.ndarray[tuple[int], np.dtype[np.bool_]] | None) -> GroupCell:
    if mask is None or not mask.any():
        return GroupCell(0, {})
    return GroupCell(int(mask.sum()), group_estimates(result.comparison, mask))
