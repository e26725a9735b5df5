"""Scores with their intervals, as the page and the tables beside it print them."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from annotate.array_types import Float64, Index, Int64
from annotate.parts import BACKGROUND, BODY_PARTS
from eval.compare import paper_results as paper
from eval.compare.compare import Comparison
from eval.compare.paired import Difference
from eval.scores import confusion, intervals

SUMMARY = {
    "mean_recall": "Mean recall",
    "miou": "mIoU",
    "person_iou": "Person IoU",
    "boundary_f": "Boundary F, 2 px",
    "left_right_swap_rate": "Left-right swaps",
    "ece": "Calibration error",
}
"""Scores of a result that stand side by side, with their titles."""

SHARES = frozenset(("left_right_swap_rate", "ece"))
"""Scores printed as percentages, of which less is better."""

SHOWN_ORDER = (*(part.id for part in BODY_PARTS), BACKGROUND)
"""Part ids as the paper's tables list them: background last."""


@dataclass(frozen=True)
class Estimate:
    """Score with its 95 % interval; the ends are NaN without an interval."""

    value: float
    low: float
    high: float

    @property
    def known(self) -> bool:
        """Return False for the score of a part that no frame shows."""
        return not np.isnan(self.value)

    @property
    def bounded(self) -> bool:
        """Return whether the estimate has an interval."""
        return not (np.isnan(self.low) or np.isnan(self.high))


def estimate(comparison: Comparison, name: str, *index: int) -> Estimate:
    """Return a score by its name in `eval.scores.scores.scores_of`. index: position in its array, e.g. part
    id.
    """
    return picked(comparison.scores[name], comparison.ci95[name], index)


def difference_of(found: Difference, name: str, *index: int) -> Estimate:
    """Return one score's difference with its interval."""
    return picked(found.values[name], found.ci95[name], index)


def picked(values: Float64, ends: Float64, index: tuple[int, ...] = ()) -> Estimate:
    """Return the estimate at an index of score values (...) and interval ends (2, ...)."""
    at: tuple[Any, ...] = (..., *index)
    low, high = ends[at]
    return Estimate(float(values[at]), float(low), float(high))


def printed(name: str, found: Estimate, percent: str = " %", sign: str = "") -> str:
    """Return a score as text: three digits and its interval in brackets; `SHARES` in percent; dashes if
    unknown.
    """
    if not found.known:
        return "--"
    scale, digits, unit = (100, 1, percent) if name in SHARES else (1, 3, "")
    value, low, high = (f"{e * scale:{sign}.{digits}f}" for e in (found.value, found.low, found.high))
    return f"{value}{unit} [{low}, {high}]" if found.bounded else value + unit


def group_recall(comparison: Comparison, frames: Index) -> Estimate:
    """Return the mean recall of some frames (n,) with its interval, from their confusion matrices alone.

    Much faster than `Comparison.only`, which resamples all counts.
    """
    matrices = comparison.matrices[frames]
    clusters = intervals.clusters_of([comparison.subjects[i] for i in frames])
    by_cluster = intervals.cluster_sums(matrices.reshape(len(matrices), -1), clusters)
    resampled = intervals.resampled_sums(by_cluster).reshape(-1, *matrices.shape[1:])
    value = confusion.mean_recall(matrices.sum(0))
    return picked(value, intervals.interval(value, confusion.mean_recall(resampled), len(by_cluster)))


def shown(table: Float64) -> list[list[float]]:
    """Return a table (12, 12) by part id as lists in display order."""
    return [[float(v) for v in row] for row in table[np.ix_(SHOWN_ORDER, SHOWN_ORDER)]]


def verdict(mean_recall: Estimate) -> str:
    """Return a sentence that compares a mean recall with the paper's two."""
    if not mean_recall.known:
        return "no body part in the truth"
    one = mean_recall
    low, high = (one.low, one.high) if one.bounded else (one.value, one.value)
    for level, name in ((paper.SYNTHETIC.mean_recall, "synthetic"), (paper.REAL.mean_recall, "real")):
        if high >= level:
            return f"{'above' if low > level else 'about'} the paper's {name} {level:.3f}"
    return f"below the paper's real {paper.REAL.mean_recall:.3f}"


def row_shares(matrix: Int64) -> Float64:
    """Return a confusion matrix (12, 12) as shares of each true part's pixels, NaN for an absent part."""
    return confusion.ratio(matrix, np.broadcast_to(matrix.sum(1, keepdims=True), matrix.shape))
