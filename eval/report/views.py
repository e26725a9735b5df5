"""What the page shows of a result, as plain numbers in the order they are read."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from annotate.parts import BODY_PARTS, Part
from eval.compare import paper
from eval.compare.compare import Comparison
from eval.compare.results import Result
from eval.report.estimates import Estimate, estimate, quantiles, row_shares, shown, summary_of, verdict
from eval.report.figures import ERROR_KINDS
from eval.scores import confusion
from eval.scores.joint_errors import summary
from eval.scores.scores import DISTANCES

ROWS = 200
"""Frames or subjects listed at most; chosen by eye."""

PART_SCORES = {"recall": "Recall", "precision": "Precision", "iou": "IoU", "dice": "Dice",
               "boundary_iou_by_part": "Boundary IoU"}  # fmt: skip
"""Scores of a part, with their titles."""


INSIDE = ("mean_recall_person", "miou_person", "error_rate_inside", "error_rate_near", "mean_recall_all",
          "miou_merged")  # fmt: skip
"""Scores that show where and of what kind the errors are."""

THRESHOLDS_MM = tuple(range(0, 301, 10))
"""Distances of the PCK curve, millimetres."""


@dataclass(frozen=True)
class PartRow:
    """One body part's scores by name, and its recall in the paper's Tables 2 and 3."""

    part: Part
    pixels: int
    frames: int
    scores: dict[str, Estimate]
    paper_synthetic: float
    paper_real: float


@dataclass(frozen=True)
class ErrorRow:
    """Wrong pixels of one kind, as a share of all wrong pixels."""

    title: str
    rgb: tuple[int, int, int]
    pixels: int
    share: float


@dataclass(frozen=True)
class DistanceRow:
    """Error rate of the person pixels at one distance to a border: of all, and by true part's title."""

    label: str
    rate: Estimate
    share_of_pixels: float
    by_part: dict[str, float]


@dataclass(frozen=True)
class SubjectRow:
    """Frame mIoUs of one subject: 5th, 25th, 50th, 75th and 95th percentile."""

    name: str
    frames: int
    quantiles: tuple[float, ...]


@dataclass(frozen=True)
class ResultView:
    """One result's numbers on the page."""

    result: Result
    scores: dict[str, Estimate]
    verdict: str
    parts: list[PartRow]
    shares: list[list[float]]
    difference: list[list[float]]
    errors: list[ErrorRow]
    error_share: float
    distances: list[DistanceRow]
    flipped_frames: int
    inside: dict[str, Estimate]
    mious: dict[str, float]
    subjects: list[SubjectRow]
    frames: list[tuple[str, str, str, float]]
    undefined: dict[str, float]
    absent: list[str]


def view_of(result: Result) -> ResultView:
    """Derive all numbers of one result's sections from its counts."""
    comparison = result.comparison
    matrix = comparison.confusion
    shares = row_shares(matrix)
    errors = _error_rows(comparison)
    scores = summary_of(comparison)
    return ResultView(
        result=result,
        scores=scores,
        verdict=verdict(scores["mean_recall"]),
        parts=[_part_row(comparison, part) for part in BODY_PARTS],
        shares=shown(shares),
        difference=shown(shares - paper.TABLE3_REAL),
        errors=errors,
        error_share=sum(row.pixels for row in errors) / max(int(matrix.sum()), 1),
        distances=_distance_rows(comparison),
        flipped_frames=int(confusion.flip_helps(comparison.matrices).sum()),
        inside={name: estimate(comparison, name) for name in INSIDE},
        mious=confusion.mean_ious(comparison.matrices),
        subjects=_subject_rows(comparison),
        frames=_frame_rows(comparison),
        undefined=comparison.undefined_shares,
        absent=[part.title for part in BODY_PARTS if np.isnan(comparison.scores["iou"][part.id])],
    )


def _part_row(comparison: Comparison, part: Part) -> PartRow:
    by_frame = comparison.matrices[:, part.id].sum(-1)
    return PartRow(
        part=part,
        pixels=int(by_frame.sum()),
        frames=int((by_frame > 0).sum()),
        scores={name: estimate(comparison, name, part.id) for name in PART_SCORES},
        paper_synthetic=float(paper.TABLE2_SYNTHETIC[part.id, part.id]),
        paper_real=float(paper.TABLE3_REAL[part.id, part.id]),
    )


def _error_rows(comparison: Comparison) -> list[ErrorRow]:
    kinds = {name: int(count) for name, count in confusion.error_kinds(comparison.confusion).items()}
    wrong = max(sum(kinds.values()), 1)
    return [ErrorRow(*ERROR_KINDS[name], count, count / wrong) for name, count in kinds.items()]


def _distance_rows(comparison: Comparison) -> list[DistanceRow]:
    pixels = comparison.total.by_distance.sum(0)[:, 1]
    by_part = comparison.scores["error_by_distance_by_part"]
    shares = pixels / max(int(pixels.sum()), 1)
    return [
        DistanceRow(
            distance.replace(" px", ""),
            estimate(comparison, "error_by_distance", i),
            float(shares[i]),
            {part.title: float(by_part[part.id, i]) for part in BODY_PARTS},
        )
        for i, distance in enumerate(DISTANCES)
    ]


def _subject_rows(comparison: Comparison) -> list[SubjectRow]:
    owner, scores = np.array(comparison.subjects), comparison.frame_miou
    names = sorted(set(comparison.subjects))[:ROWS]
    return [SubjectRow(name, int((owner == name).sum()), quantiles(scores[owner == name])) for name in names]


def _frame_rows(comparison: Comparison) -> list[tuple[str, str, str, float]]:
    """Frames by mIoU, worst first: id, subject, what makes it hard, mIoU; without a score last."""
    order = np.argsort(comparison.frame_miou, kind="stable")[:ROWS]
    return [
        (
            comparison.frame_ids[i],
            comparison.subjects[i],
            ", ".join(comparison.traits[i].hard),
            float(comparison.frame_miou[i]),
        )
        for i in order
    ]


@dataclass(frozen=True)
class JointsView:
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
