"""Difference of two results' scores, with intervals."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from annotate.array_types import Float64
from eval.compare.compare import Comparison
from eval.compare.results import Result
from eval.scores import intervals
from eval.scores.confusion import Scores
from eval.scores.counts import FrameCounts
from eval.scores.joint_scores import JointDifference, joint_difference
from eval.scores.scores import named, plain, scores_of

TESTED = ("mean_recall", "miou")
MIN_SUBJECTS = 6  # fewer give no two-sided Wilcoxon p below 5 %


@dataclass(frozen=True)
class Difference:
    """Scores of A minus B by name, with 95 % intervals (2, ...) by Student's t over subjects.

    paired: True if A and B are compared on the frames they share, False if on different frames. frames,
    subjects: numbers in A and in B. wilcoxon_p: two-sided, on the subjects' mean recall and mIoU; None if
    unpaired or with too few subjects. joints: of the network's joints; None where A or B has none. note:
    reasons to doubt the difference.
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
    note: str

    def to_json(self) -> dict[str, Any]:
        """Return the JSON of `compare`; null for a score that A or B lacks."""
        return {
            "a": self.a,
            "b": self.b,
            "paired": self.paired,
            "frames": list(self.frames),
            "subjects": list(self.subjects),
            "difference": {name: named(name, value) for name, value in self.scores.items()},
            "ci95": {name: named(name, ends) for name, ends in self.ci95.items()},
            "wilcoxon_p": {name: None if p is None else plain(p) for name, p in self.wilcoxon_p.items()},
            "joints": self.joints.to_json() if self.joints else None,
            "note": self.note,
        }


def difference(a: Result, b: Result) -> Difference:
    """Return A minus B over the shared frames (same id and depth), or else over all frames as two samples."""
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
    return _difference(a, b, (first, second), True, _notes_on_shared(a, b, first, second))


def _keys(comparison: Comparison) -> list[tuple[str, str]]:
    depths = [digests.depth for digests in comparison.digests]
    return list(zip(comparison.frame_ids, depths, strict=True))


def _notes_on_shared(a: Result, b: Result, first: Comparison, second: Comparison) -> list[str]:
    notes, count = [first.ci_note] if first.ci_note else [], len(first.frame_ids)
    other = sum(x.truth != y.truth for x, y in zip(first.digests, second.digests, strict=True))
    if other:
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
        note="; ".join(notes),
    )


def _wilcoxon_p(first: Comparison, second: Comparison, name: str) -> float | None:
    if first.n_subjects < MIN_SUBJECTS:
        return None
    from scipy.stats import wilcoxon

    means = [scores_of(FrameCounts(c.by_cluster))[name] for c in (first, second)]
    gaps = means[0] - means[1]
    gaps = gaps[~np.isnan(gaps) & (gaps != 0)]
    return float(wilcoxon(gaps).pvalue) if gaps.size else 1.0
