"""Numbers of results that the page shows, in reading order."""

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from annotate.array_types import Float64, Index
from annotate.parts import BODY_PARTS, Part
from eval.compare.compare import Comparison
from eval.compare.results import Result
from eval.report.estimates import SUMMARY, Estimate, estimate, group_recall, row_shares
from eval.scores import confusion
from eval.scores.joint_errors import summary
from eval.scores.scores import DISTANCES
from eval.scores.traits import groups

ROWS = 200
"""Frames listed at most; chosen by eye."""

PART_SCORES = {"recall": "Recall", "precision": "Precision", "iou": "IoU", "dice": "Dice",
               "boundary_iou_by_part": "Boundary IoU"}  # fmt: skip
"""Scores of a part, with their titles."""

INSIDE = ("mean_recall_person", "miou_person", "error_rate_inside", "error_rate_near", "mean_recall_all",
          "miou_merged")  # fmt: skip
"""Scores that show where and of what kind the errors are."""

THRESHOLDS_MM = tuple(range(0, 301, 10))
"""Distances of the PCK curve, millimetres."""


class PartRow(NamedTuple):
    """One body part's scores by name."""

    part: Part
    pixels: int
    frames: int
    scores: dict[str, Estimate]


class DistanceRow(NamedTuple):
    """Error rate of the person pixels at one distance to a border: of all, and by true part (12,)."""

    label: str
    rate: Estimate
    share_of_pixels: float
    by_part: Float64


class ResultView(NamedTuple):
    """One result's numbers on the page.

    scores, inside: by name, of `SUMMARY` and `INSIDE`. shares: confusion (12, 12) as shares of each true
    part. errors: share of each of `confusion.error_kinds` in all wrong pixels. frames: id, subject, what
    makes it hard and mIoU, worst first.
    """

    result: Result
    scores: dict[str, Estimate]
    inside: dict[str, Estimate]
    parts: list[PartRow]
    shares: Float64
    errors: dict[str, float]
    distances: list[DistanceRow]
    frames: list[tuple[str, str, str, float]]


def view_of(result: Result) -> ResultView:
    """Derive all numbers of one result's sections from its counts."""
    comparison = result.comparison
    kinds = {name: int(count) for name, count in confusion.error_kinds(comparison.confusion).items()}
    wrong = max(sum(kinds.values()), 1)
    scores, inside = ({name: estimate(comparison, name) for name in names} for names in (SUMMARY, INSIDE))
    return ResultView(
        result,
        scores,
        inside,
        [_part_row(comparison, part) for part in BODY_PARTS],
        row_shares(comparison.confusion),
        {name: count / wrong for name, count in kinds.items()},
        _distance_rows(comparison),
        _frame_rows(comparison),
    )


def _part_row(comparison: Comparison, part: Part) -> PartRow:
    by_frame = comparison.matrices[:, part.id].sum(-1)
    scores = {name: estimate(comparison, name, part.id) for name in PART_SCORES}
    return PartRow(part, int(by_frame.sum()), int((by_frame > 0).sum()), scores)


def _distance_rows(comparison: Comparison) -> list[DistanceRow]:
    pixels = comparison.total.by_distance.sum(0)[:, 1]
    shares = pixels / max(int(pixels.sum()), 1)
    by_part = comparison.scores["error_by_distance_by_part"]
    return [
        DistanceRow(
            name.replace(" px", ""), estimate(comparison, "error_by_distance", i), share, by_part[:, i]
        )
        for i, (name, share) in enumerate(zip(DISTANCES, shares.tolist(), strict=True))
    ]


def _frame_rows(comparison: Comparison) -> list[tuple[str, str, str, float]]:
    """Without a score last."""
    c, order = comparison, np.argsort(comparison.frame_miou, kind="stable")[:ROWS]
    return [
        (c.frame_ids[i], c.subjects[i], ", ".join(c.traits[i].hard), float(c.frame_miou[i])) for i in order
    ]


class JointsView(NamedTuple):
    """A result's joints. total: see `joint_errors.summary`. pck: shares within each of `THRESHOLDS_MM`."""

    title: str
    total: dict[str, Any]
    pck: list[float]


def joints_of(result: Result) -> JointsView | None:
    """None where the truth knew no joints."""
    errors = result.comparison.joints_mm
    if errors is None or np.isnan(errors).all():
        return None
    scored = errors[~np.isnan(errors)]
    pck = [float((scored <= limit).mean()) for limit in THRESHOLDS_MM]
    return JointsView(result.title, summary(errors), pck)


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
