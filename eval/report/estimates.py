"""Scores with their intervals, as text."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from annotate.array_types import Float64, Index
from annotate.scheme.scheme import BACKGROUND_PART, Part, Scheme
from eval.compare.compare import Comparison
from eval.report.agreement import Agreement
from eval.scores import confusion, intervals
from eval.scores.joint_scores import GROUPS, INSIDE, SCORES, WITHIN_MM, JointDifference, JointEstimates

SUMMARY = {
    "mean_recall": "Mean recall",
    "miou": "mIoU",
    "person_iou": "Person IoU",
    "boundary_f": "Boundary F, 2 px",
    "left_right_swap_rate": "Left-right swaps",
    "ece": "Calibration error",
}
"""Titles of the scores that a summary has."""
SWAPS = "left_right_swap_rate"
SHARES = frozenset((SWAPS, "ece"))
"""Scores in percent; lower is better."""
MILLIMETRES = SCORES[0]
"""Score in millimetres; lower is better."""
JOINT_SCORES = dict(zip(SCORES, ("Error, mm", *(f"Within {mm:.0f} mm" for mm in WITHIN_MM)), strict=True))
"""Titles of the scores of joints."""
AGREED_JOINTS = {MILLIMETRES: "Joints apart, mm", "pck_100mm": "Joints within 100 mm"}
"""Titles of the scores of joints of an agreement."""


@dataclass(frozen=True)
class Estimate:
    """A score with its 95 % interval; NaN if unknown."""

    value: float
    low: float
    high: float

    @property
    def known(self) -> bool:
        """False for the score of a part that no frame shows."""
        return not np.isnan(self.value)

    @property
    def bounded(self) -> bool:
        """True if the score has an interval."""
        return not (np.isnan(self.low) or np.isnan(self.high))


class Scored(Protocol):
    """Scores (...) by name with their intervals (2, ...): a comparison or a difference."""

    @property
    def scores(self) -> Mapping[str, Float64]: ...

    @property
    def ci95(self) -> Mapping[str, Float64]: ...


def estimate(scored: Scored, name: str, *index: int) -> Estimate:
    """Return a score by its name; index: part id, tolerance or distance."""
    low, high = (ends[index] for ends in scored.ci95[name])
    return Estimate(float(scored.scores[name][index]), float(low), float(high))


def printed(name: str, found: Estimate, sign: str = "") -> str:
    """Return a score to three digits, in percent (``SHARES``) or in millimetres, with its interval.

    The text is "--" if the score is unknown.
    """
    if not found.known:
        return "--"
    scale, digits, unit = (100, 1, " %") if name in SHARES else (1, 1 if name == MILLIMETRES else 3, "")
    value, low, high = (f"{e * scale:{sign}.{digits}f}" for e in (found.value, found.low, found.high))
    return f"{value}{unit} [{low}, {high}]" if found.bounded else value + unit


def joint_estimate(scored: JointEstimates | JointDifference, name: str, group: str) -> Estimate:
    """Return a score, by its name, of a group of joints."""
    i = GROUPS.index(group)
    return Estimate(float(scored.scores[name][i]), *map(float, scored.ci95[name][:, i]))


def group_recall(comparison: Comparison, frames: Index) -> Estimate:
    """Return the mean recall of some frames (n,); faster than ``Comparison.only``."""
    clusters = intervals.clusters_of([comparison.subjects[i] for i in frames])
    recall = confusion.mean_recall
    value, ends = intervals.frames_interval(comparison.matrices[frames], clusters, recall)
    return Estimate(float(value), *map(float, ends))


def shown_order(scheme: Scheme) -> tuple[Part, ...]:
    """Return the parts in the order of tables and figures: the background last, as in the paper."""
    return (*scheme.parts, BACKGROUND_PART)


def row_shares(comparison: Comparison) -> Float64:
    """Return the confusion matrix as shares of each true part, in the order shown; NaN if absent."""
    matrix = comparison.confusion
    whole = np.broadcast_to(matrix.sum(1)[:, None], matrix.shape)
    return in_shown_order(confusion.ratio(matrix, whole), comparison.scheme)


def in_shown_order(table: Float64, scheme: Scheme) -> Float64:
    """Return a table (n, n) by part id, reordered as ``shown_order``."""
    ids = [part.id for part in shown_order(scheme)]
    return table[np.ix_(ids, ids)]


def summary_of(scheme: Scheme) -> dict[str, str]:
    """Return the titles of the summary's scores by name; without swaps where no part has a twin."""
    return {name: title for name, title in SUMMARY.items() if scheme.twins or name != SWAPS}


def agreed(found: Agreement, name: str, *index: int, joint: str = INSIDE) -> Estimate:
    """Return a score of an agreement by its name; index: as in ``estimate``; joint: of ``GROUPS``.

    The interval is over people; it is unknown for fewer than two known people.
    """
    joints = found.comparison.joints
    if name in SCORES and joints is None:
        return Estimate(np.nan, np.nan, np.nan)
    if name in SCORES and joints is not None:
        of = joint_estimate(joints.estimates, name, joint)
        return of if found.has_people else replace(of, low=np.nan, high=np.nan)
    if found.has_people:
        return estimate(found.comparison, name, *index)
    return Estimate(float(found.comparison.scores[name][index]), np.nan, np.nan)


def agreement_row(found: Agreement) -> dict[str, str]:
    """Return an agreement's scores by their titles, as text."""
    titles = {name: title for name, title in summary_of(found.comparison.scheme).items() if name != "ece"}
    titles |= AGREED_JOINTS
    scores = {title: printed(name, agreed(found, name)) for name, title in titles.items()}
    shares = {"Same facing": found.same_facing, "Same posture": found.same_posture}
    return scores | {
        title: f"{same} of {frames}" if frames else "--" for title, (same, frames) in shares.items()
    }
