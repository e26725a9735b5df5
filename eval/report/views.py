"""What the page shows of a result, as plain numbers in the order they are read."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from annotate.parts import BACKGROUND, BODY_PARTS, PARTS, Part
from eval import metrics, paper
from eval.boundary import DISTANCE_EDGES_PX, error_rate
from eval.compare import Comparison
from eval.metrics import MeanIou
from eval.report.figures import ERROR_KINDS
from eval.results import Result

SHOWN_ORDER = (*(part.id for part in BODY_PARTS), BACKGROUND)
"""Part ids as the paper's tables list them: background last."""

MAX_ROWS = 200
"""Frames or subjects listed at most; the rest is counted."""


@dataclass(frozen=True)
class Estimate:
    """A score with its 95 % interval; without one, both ends are the value."""

    value: float
    low: float
    high: float

    @property
    def known(self) -> bool:
        """False for the score of a part that no frame shows."""
        return not np.isnan(self.value)


@dataclass(frozen=True)
class PartRow:
    """One body part's scores, and its recall in the paper's Tables 2 and 3."""

    part: Part
    pixels: int
    frames: int
    recall: Estimate
    precision: Estimate
    iou: Estimate
    dice: Estimate
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
    """Error rate of the person pixels at one distance to a border."""

    label: str
    rate: float
    share_of_pixels: float


@dataclass(frozen=True)
class SubjectRow:
    """Frame mIoUs of one subject: 5th, 25th, 50th, 75th and 95th percentile."""

    name: str
    frames: int
    quantiles: tuple[float, ...]


@dataclass(frozen=True)
class LeftRight:
    """How far sides are confused: see `eval.metrics` for each."""

    swap_rate: Estimate
    share_of_errors: float
    merged_miou: float
    flipped_frames: int


@dataclass(frozen=True)
class View:
    """Everything the page says about one result, except its pictures."""

    result: Result
    scores: dict[str, Estimate]
    verdict: str
    parts: list[PartRow]
    shares: list[list[float]]
    difference: list[list[float]]
    errors: list[ErrorRow]
    error_share: float
    distances: list[DistanceRow]
    left_right: LeftRight
    inside: dict[str, float]
    mious: MeanIou
    subjects: list[SubjectRow]
    frames: list[tuple[str, str, float]]
    undefined: dict[str, float]
    absent: list[str]


def view_of(result: Result) -> View:
    """Derive all numbers of one result's sections from its counts."""
    comparison = result.comparison
    confusion = comparison.confusion
    shares = metrics.ratio(confusion, np.broadcast_to(confusion.sum(1, keepdims=True), confusion.shape))
    inside = metrics.without_background(confusion)
    errors = _error_rows(comparison)
    scores = {name: _estimate(comparison, name) for name, v in comparison.scores.items() if not v.ndim}
    return View(
        result=result,
        scores=scores,
        verdict=verdict(scores["mean_recall"]),
        parts=[_part_row(comparison, part) for part in BODY_PARTS],
        shares=shown(shares),
        difference=shown(shares - paper.TABLE3_REAL),
        errors=errors,
        error_share=sum(row.pixels for row in errors) / max(int(confusion.sum()), 1),
        distances=_distance_rows(comparison),
        left_right=_left_right(comparison, scores["left_right_swap_rate"]),
        inside={"mean_recall": float(metrics.mean_recall(inside)), "miou": float(metrics.miou(inside))},
        mious=metrics.mean_ious(comparison.matrices),
        subjects=_subject_rows(comparison),
        frames=_frame_rows(comparison),
        undefined=comparison.undefined_shares,
        absent=[part.title for part in BODY_PARTS if np.isnan(comparison.scores["iou"][part.id])],
    )


def verdict(mean_recall: Estimate) -> str:
    """Where a mean recall stands between the paper's two, in words."""
    if not mean_recall.known:
        return "no body part in the truth"
    real = paper.mean_recall_of(paper.TABLE3_REAL)
    synthetic = paper.mean_recall_of(paper.TABLE2_SYNTHETIC)
    for level, name in ((synthetic, "synthetic"), (real, "real")):
        if mean_recall.low > level:
            return f"above the paper's {name} {level:.3f}"
        if mean_recall.low <= level <= mean_recall.high:
            return f"about the paper's {name} {level:.3f}"
    return f"below the paper's real {real:.3f}"


def shown(table: NDArray[np.float64]) -> list[list[float]]:
    """A table (12, 12) by part id in the order it is shown."""
    return [[float(v) for v in row] for row in table[np.ix_(SHOWN_ORDER, SHOWN_ORDER)]]


def shown_parts() -> list[Part]:
    """The classes in the order they are shown."""
    return [PARTS[i] for i in SHOWN_ORDER]


def axis_ticks(views: list[View]) -> list[float]:
    """Ticks of the forest plots by tenths, from below the lowest score or paper value up to 1."""
    ends = [e.low for v in views for row in v.parts for e in (row.recall, row.iou) if e.known]
    ends += [row.paper_real for v in views for row in v.parts]
    lowest = min(max(int(np.floor(min(ends) * 10)), 0), 9)
    return [tenth / 10 for tenth in range(lowest, 11)]


def _estimate(comparison: Comparison, name: str, part_id: int | None = None) -> Estimate:
    pick = (...,) if part_id is None else (..., part_id)
    low, high = comparison.ci95[name][pick]
    return Estimate(float(comparison.scores[name][pick]), float(low), float(high))


def _part_row(comparison: Comparison, part: Part) -> PartRow:
    by_frame = comparison.matrices[:, part.id].sum(-1)
    estimates = {
        name: _estimate(comparison, name, part.id) for name in ("recall", "precision", "iou", "dice")
    }
    return PartRow(
        part=part,
        pixels=int(by_frame.sum()),
        frames=int((by_frame > 0).sum()),
        **estimates,
        paper_synthetic=float(paper.TABLE2_SYNTHETIC[part.id, part.id]),
        paper_real=float(paper.TABLE3_REAL[part.id, part.id]),
    )


def _error_rows(comparison: Comparison) -> list[ErrorRow]:
    kinds = {name: int(count) for name, count in vars(metrics.error_kinds(comparison.confusion)).items()}
    wrong = max(sum(kinds.values()), 1)
    return [ErrorRow(*ERROR_KINDS[name], count, count / wrong) for name, count in kinds.items()]


def _distance_rows(comparison: Comparison) -> list[DistanceRow]:
    counts = comparison.by_distance.sum(0)
    rates, pixels = error_rate(counts), counts[:, 1]
    starts = (0, *(int(edge) for edge in DISTANCE_EDGES_PX))
    labels = [f"{a}" if b - a == 1 else f"{a} to {b - 1}" for a, b in pairwise(starts)]
    labels.append(f"{starts[-1]} and more")
    shares = pixels / max(int(pixels.sum()), 1)
    return [DistanceRow(*row) for row in zip(labels, rates.tolist(), shares.tolist(), strict=True)]


def _left_right(comparison: Comparison, swap_rate: Estimate) -> LeftRight:
    swapped = next(r for r in _error_rows(comparison) if r.title == ERROR_KINDS["left_right_swap"][0])
    return LeftRight(
        swap_rate=swap_rate,
        share_of_errors=swapped.share,
        merged_miou=float(metrics.miou(metrics.merge_left_right(comparison.confusion))),
        flipped_frames=int(metrics.flip_helps(comparison.matrices).sum()),
    )


def _subject_rows(comparison: Comparison) -> list[SubjectRow]:
    owner, scores = np.array(comparison.subjects), comparison.frame_miou
    rows = []
    for name in sorted(set(comparison.subjects))[:MAX_ROWS]:
        own = scores[(owner == name) & ~np.isnan(scores)]
        spread = np.quantile(own, [0.05, 0.25, 0.5, 0.75, 0.95]) if own.size else np.full(5, np.nan)
        rows.append(SubjectRow(name, int((owner == name).sum()), tuple(spread.tolist())))
    return rows


def _frame_rows(comparison: Comparison) -> list[tuple[str, str, float]]:
    """Frames by mIoU, worst first: id, subject, mIoU; frames without a score last."""
    order = np.argsort(comparison.frame_miou, kind="stable")[:MAX_ROWS]
    return [(comparison.frame_ids[i], comparison.subjects[i], float(comparison.frame_miou[i])) for i in order]
