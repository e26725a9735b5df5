"""Difference of two results' scores, with intervals."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from annotate.array_types import Float64, UInt8
from annotate.scheme.merging import finest_common
from annotate.scheme.scheme import Scheme
from eval.compare.common_scheme import converted_counts, scheme_note
from eval.compare.compare import Comparison
from eval.compare.results import Result
from eval.scores import intervals
from eval.scores.confusion import Scores
from eval.scores.counts import FrameCounts
from eval.scores.joint_scores import JointDifference, joint_difference
from eval.scores.scores import FROM_CONFUSION, named, plain, scores_of

TESTED = ("mean_recall", "miou")
MIN_SUBJECTS = 6  # fewer give no two-sided Wilcoxon p below 5 %


@dataclass(frozen=True)
class Difference:
    """Scores of A minus B by name, with 95 % intervals (2, ...) by Student's t over subjects.

    paired: True if A and B are compared on the frames they share, False if on different frames. frames,
    subjects: numbers in A and in B. wilcoxon_p: two-sided, on the subjects' mean recall and mIoU; None if
    unpaired or with too few subjects. joints: of the network's joints; None where A or B has none. scheme: of
    the scores; the finest common one of results of two schemes, whose scores of borders and confidence are
    NaN. note: reasons to doubt the difference.
    """

    a: str
    b: str
    paired: bool
    frames: tuple[int, int]
    subjects: tuple[int, int]
    scores: dict[str, Scores]
    ci95: dict[str, Float64]
    wilcoxon_p: dict[str, float | None]
    joints: JointDifference | None
    scheme: Scheme
    note: str

    def to_json(self) -> dict[str, Any]:
        """Return the JSON of `compare`; null for a score that A or B lacks."""
        return {
            "a": self.a,
            "b": self.b,
            "paired": self.paired,
            "scheme": self.scheme.name,
            "frames": list(self.frames),
            "subjects": list(self.subjects),
            "difference": {name: named(name, value, self.scheme) for name, value in self.scores.items()},
            "ci95": {name: named(name, ends, self.scheme) for name, ends in self.ci95.items()},
            "wilcoxon_p": {name: None if p is None else plain(p) for name, p in self.wilcoxon_p.items()},
            "joints": self.joints.to_json() if self.joints else None,
            "note": self.note,
        }


def difference(a: Result, b: Result) -> Difference:
    """Return A minus B over the shared frames (same id and depth), or else over all frames as two samples.

    Results of two schemes are compared in their finest common scheme.
    """
    if a.comparison.scheme == b.comparison.scheme:
        return _in_one_scheme(a, b, _different_digests)
    common = finest_common(a.comparison.scheme, b.comparison.scheme)
    found = _in_one_scheme(
        _converted(a, common.scheme, common.from_first),
        _converted(b, common.scheme, common.from_second),
        _different_sizes,
    )
    lost = "scores of borders and confidence need the labels: evaluate both with --scheme"
    return replace(
        _without_borders(found), note="; ".join(filter(None, [scheme_note(common.scheme), lost, found.note]))
    )


def _converted(result: Result, scheme: Scheme, table: UInt8) -> Result:
    counts = converted_counts(result.comparison.counts, scheme, table)
    return replace(result, comparison=replace(result.comparison, counts=counts))


def _without_borders(found: Difference) -> Difference:
    """Return a difference whose scores are NaN unless the confusion matrix alone gives them."""
    scores, ci95 = (
        {name: one if name in FROM_CONFUSION else np.full_like(one, np.nan) for name, one in values.items()}
        for values in (found.scores, found.ci95)
    )
    return replace(found, scores=scores, ci95=ci95)


Differ = Callable[[Comparison, Comparison], int]
"""Function that returns the number of frames whose truths differ between two comparisons."""


def _different_digests(first: Comparison, second: Comparison) -> int:
    return sum(x.truth != y.truth for x, y in zip(first.digests, second.digests, strict=True))


def _different_sizes(first: Comparison, second: Comparison) -> int:
    """Compare the sizes of the true parts, because labels of two schemes have different digests."""
    return int((first.matrices.sum(-1) != second.matrices.sum(-1)).any(-1).sum())


def _in_one_scheme(a: Result, b: Result, differ: Differ) -> Difference:
    at_b = {key: i for i, key in enumerate(_keys(b.comparison))}
    shared = [(i, at_b[key]) for i, key in enumerate(_keys(a.comparison)) if key in at_b]
    if not shared:
        notes = ["no frame in common (id and depth): the two are compared as different samples"]
        notes += [f"{one.title}: {one.comparison.ci_note}" for one in (a, b) if one.comparison.ci_note]
        return _difference(a, b, (a.comparison, b.comparison), False, notes)
    of_a, of_b = (np.array(index, np.int64) for index in zip(*shared, strict=True))
    first = a.comparison.only(of_a)
    # Equal subjects: each resample draws the same frames of both.
    second = replace(b.comparison.only(of_b), subjects=first.subjects)
    return _difference(a, b, (first, second), True, _notes_on_shared(a, b, (first, second), differ))


def _keys(comparison: Comparison) -> list[tuple[str, str]]:
    depths = [digests.depth for digests in comparison.digests]
    return list(zip(comparison.frame_ids, depths, strict=True))


def _notes_on_shared(a: Result, b: Result, sets: tuple[Comparison, Comparison], differ: Differ) -> list[str]:
    first = sets[0]
    notes, count = [first.ci_note] if first.ci_note else [], len(first.frame_ids)
    if other := differ(*sets):
        notes.append(f"{other} of {count} frames have different truths in A and B")
    left_out = [len(one.comparison.frame_ids) - count for one in (a, b)]
    if any(left_out):
        notes.append(f"{left_out[0]} frames of A and {left_out[1]} of B are not shared: left out")
    return notes


def _difference(
    a: Result, b: Result, sets: tuple[Comparison, Comparison], paired: bool, notes: list[str]
) -> Difference:
    first, second = sets
    values, ci95 = {}, {}
    for name, score in first.scores.items():
        values[name] = score - second.scores[name]
        resampled, n = [one.resampled[name] for one in sets], [one.behind[name] for one in sets]
        if paired:
            apart = resampled[0] - resampled[1]
            ci95[name] = intervals.paired_interval(values[name], apart, np.minimum(*n))
        else:
            ci95[name] = intervals.unpaired_interval(values[name], resampled, n)
    return Difference(
        a=a.title,
        b=b.title,
        paired=paired,
        frames=(len(first.frame_ids), len(second.frame_ids)),
        subjects=(first.n_subjects, second.n_subjects),
        scores=values,
        ci95=ci95,
        wilcoxon_p={name: _wilcoxon_p(first, second, name) if paired else None for name in TESTED},
        joints=joint_difference(first.joints, second.joints, paired)
        if first.joints and second.joints
        else None,
        scheme=first.scheme,
        note="; ".join(notes),
    )


def _wilcoxon_p(first: Comparison, second: Comparison, name: str) -> float | None:
    if first.n_subjects < MIN_SUBJECTS:
        return None
    from scipy.stats import wilcoxon

    means = [scores_of(FrameCounts(c.by_cluster, c.scheme))[name] for c in (first, second)]
    gaps = means[0] - means[1]
    gaps = gaps[~np.isnan(gaps) & (gaps != 0)]
    return float(wilcoxon(gaps).pvalue) if gaps.size else 1.0
