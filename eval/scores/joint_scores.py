"""Scores of joints from their errors, with intervals over people.

mpjpe_mm: mean distance without alignment, of the joints that the network gave. pck_100mm: share of the true
joints within 100 mm (ITOP's "mAP at 10 cm"); a joint that the network did not give is not within. Groups: all
joints inside the image, visible, hidden and outside ones (``joint_visibility``), and each joint inside.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from annotate.array_types import Bool, Float64, Int64, UInt8
from eval.scores import intervals
from eval.scores.confusion import Scores, ratio
from eval.scores.joint_visibility import HIDDEN, OUTSIDE, VISIBILITIES, VISIBLE
from eval.scores.joints import JOINT_NAMES

WITHIN_MM = (50.0, 100.0, 150.0)
INSIDE = "inside"
GROUPS = (INSIDE, "visible", "hidden", "outside", *JOINT_NAMES)
SCORES = ("mpjpe_mm", *(f"pck_{mm:.0f}mm" for mm in WITHIN_MM))
STEP_MM = 0.01  # mm; errors are summed as multiples of it
COUNTS = 3 + len(WITHIN_MM)
"""Numbers counted of a joint: true, given by the network, error in ``STEP_MM``, within each distance."""


@dataclass(frozen=True, eq=False)
class JointErrors:
    """Errors of joints (F, 15), millimetres, as in ``joint_errors_mm``.

    visibility: (F, 15), ids of ``VISIBILITIES``. subjects: (F,).
    """

    errors_mm: Float64
    visibility: UInt8
    subjects: tuple[str, ...]

    @property
    def given(self) -> Bool:
        """True (F, 15) for joints that the network gave and the truth has."""
        return np.isfinite(self.errors_mm)

    def counts(self, averaged: Bool | None = None) -> Int64:
        """Return the counts (F, 19, 6) of the joints by ``GROUPS``; averaged: joints of the mean error."""
        given = self.given if averaged is None else self.given & averaged
        steps = np.rint(np.where(given, self.errors_mm, 0.0) / STEP_MM)
        within = (self.errors_mm <= mm for mm in WITHIN_MM)
        columns = np.stack([~np.isnan(self.errors_mm), given, steps, *within], axis=-1).astype(np.int64)
        by = [np.where((self.visibility == seen)[..., None], columns, 0) for seen in range(len(VISIBILITIES))]
        own = by[VISIBLE] + by[HIDDEN]
        sums = (own, by[VISIBLE], by[HIDDEN], by[OUTSIDE])
        return np.concatenate([np.stack([one.sum(axis=1) for one in sums], axis=1), own], axis=1)

    def by_person(self, averaged: Bool | None = None) -> Int64:
        """Return the counts (C, 19, 6) of the clusters that a bootstrap draws."""
        counts = self.counts(averaged)
        clusters = intervals.clusters_of(self.subjects)
        sums = intervals.cluster_sums(counts.reshape(len(counts), -1), clusters)
        return sums.reshape(-1, *counts.shape[1:])

    @cached_property
    def estimates(self) -> "JointEstimates":
        """Scores with their intervals."""
        return estimates(self.by_person())

    def to_json(self) -> dict[str, Any]:
        """Return the scores as JSON: of joints inside the image, by visibility and by joint."""
        frames, lost = (~np.isnan(self.errors_mm)).any(axis=1), np.isinf(self.errors_mm).any(axis=1)
        rows = {group: self.estimates.to_json(group) for group in GROUPS}
        return {
            "frames": int(frames.sum()),
            "frames_without_joints": int(lost.sum()),
            **rows[INSIDE],
            **{group: rows[group] for group in VISIBILITIES},
            "by_joint": {name: rows[name] for name in JOINT_NAMES},
        }


@dataclass(frozen=True, eq=False)
class JointEstimates:
    """Scores of each group by name, with 95 % intervals; NaN if unknown.

    total: counts (19, 6); scores: (19,) of each name; ci95: (2, 19) of each name.
    """

    total: Int64
    scores: dict[str, Scores]
    ci95: dict[str, Float64]

    def to_json(self, group: str) -> dict[str, Any]:
        """Return a group's scores as JSON; None for unknown ones."""
        i = GROUPS.index(group)
        return {
            "joints": int(self.total[i, 0]),
            "missed": int(self.total[i, 0] - self.total[i, 1]),
            **{name: _known(self.scores[name][i]) for name in SCORES},
            "ci95": {name: [_known(end) for end in self.ci95[name][:, i]] for name in SCORES},
        }


def scores_of_joints(counts: Int64) -> dict[str, Scores]:
    """Return the scores (...) of counts (..., 6) by name; NaN without joints."""
    true, given, steps, *within = np.moveaxis(counts, -1, 0)
    shares = (ratio(some, true) for some in within)
    return dict(zip(SCORES, (ratio(steps, given) * STEP_MM, *shares), strict=True))


def estimates(by_person: Int64) -> JointEstimates:
    """Return the scores of the counts (C, 19, 6) of people."""
    total, (resampled, known) = by_person.sum(axis=0), _resampled(by_person)
    scores = scores_of_joints(total)
    ci95 = {}
    for name, value in scores.items():
        of = mean_interval if name == SCORES[0] else intervals.interval
        ci95[name] = of(value, resampled[name], known[name])
    return JointEstimates(total, scores, ci95)


def mean_interval(value: Scores, resampled: Scores, n: Int64 | int) -> Float64:
    """Return the interval (2, ...) of positive means, computed on the log scale; else as
    ``intervals.interval``.
    """
    half = intervals.standard_error(resampled, n) * intervals.quantile(np.asarray(n) - 1)
    relative = np.divide(half, value, out=np.zeros_like(half), where=value > 0)
    return np.stack([value * np.exp(-relative), value * np.exp(relative)])


@dataclass(frozen=True, eq=False)
class JointDifference:
    """Scores of A minus B by name (19,), with 95 % intervals (2, 19) by Student's t over people."""

    scores: dict[str, Scores]
    ci95: dict[str, Float64]

    def to_json(self) -> dict[str, Any]:
        """Return the differences by group as JSON; None for unknown ones."""
        return {
            group: {
                **{name: _known(self.scores[name][i]) for name in SCORES},
                "ci95": {name: [_known(end) for end in self.ci95[name][:, i]] for name in SCORES},
            }
            for i, group in enumerate(GROUPS)
        }


def joint_difference(a: JointErrors, b: JointErrors, paired: bool) -> JointDifference:
    """Return the scores of A minus B.

    paired: True for the same frames, people and truth; then the mean error is of the joints that both gave.
    """
    both = a.given & b.given if paired else None
    sums = [one.by_person(both) for one in (a, b)]
    (first, known_a), (second, known_b) = map(_resampled, sums)
    totals = [scores_of_joints(one.sum(axis=0)) for one in sums]
    values = {name: totals[0][name] - totals[1][name] for name in SCORES}
    ci95 = {}
    for name, value in values.items():
        if paired:
            n = np.minimum(known_a[name], known_b[name])
            half = intervals.standard_error(first[name] - second[name], n) * intervals.quantile(n - 1)
            ci95[name] = np.stack([value - half, value + half])
        else:
            # The interval of shares ends at 1: no mean error reaches this many millimetres.
            scale = 1e6 if name == SCORES[0] else 1.0
            resampled = (first[name] / scale, second[name] / scale)
            apart = intervals.unpaired_interval(value / scale, resampled, (known_a[name], known_b[name]))
            ci95[name] = apart * scale
    return JointDifference(values, ci95)


def _resampled(by_person: Int64) -> tuple[dict[str, Scores], dict[str, Int64]]:
    """Return the scores of resamples (R, 19) by name, and the numbers (19,) of people with each score."""
    sums = intervals.resampled_sums(by_person.reshape(len(by_person), -1)).reshape(-1, *by_person.shape[1:])
    known = {name: (~np.isnan(one)).sum(axis=0) for name, one in scores_of_joints(by_person).items()}
    return scores_of_joints(sums), known


def _known(value: float | np.floating[Any]) -> float | None:
    return float(value) if np.isfinite(value) else None
