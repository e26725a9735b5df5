"""Comparison of one set of labels with another."""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from sys import intern
from typing import Any, Self

import numpy as np

from annotate.array_types import Float64, Index, Int64, UInt8
from annotate.labelset.labelled_frames import LabelledFrames
from annotate.scheme.scheme import BACKGROUND, BACKGROUND_PART, Scheme
from eval.compare.common_scheme import common_scheme
from eval.compare.pairs import Digests, count_pairs, pair_up
from eval.scores import confusion, intervals
from eval.scores.confusion import Counts, Scores
from eval.scores.counts import FrameCounts, blocks, width
from eval.scores.joint_scores import JointErrors
from eval.scores.joints import N_JOINTS
from eval.scores.scores import PART_SCORES, named, plain, scores_of
from eval.scores.traits import Traits
from sensors.errors import CloudError

SUMMARY = ("mean_recall", "recall", "miou", "iou", "boundary_f", "left_right_swap_rate", "person_iou")
"""Scores of the short summary."""


@dataclass(frozen=True)
class Comparison:
    """Counts of F compared frames, and the scores derived from them.

    counts: with one leading axis, (F,). joints_mm, joints_seen: errors and visibility (F, 15) of
    the network's joints, as in ``JointErrors``; None if prediction or truth has no joint. extra_frames:
    number of predicted frames without a truth. Raises CloudError without frames or for a repeated id,
    ValueError for arrays of different lengths.
    """

    frame_ids: tuple[str, ...]
    subjects: tuple[str, ...]
    traits: tuple[Traits, ...]
    digests: tuple[Digests, ...]
    counts: FrameCounts
    joints_mm: Float64 | None = None
    joints_seen: UInt8 | None = None
    extra_frames: int = 0

    def __post_init__(self) -> None:
        n = len(self.frame_ids)
        if not n:
            raise CloudError("no frame was compared; give label sets that hold frames")
        if len(set(self.frame_ids)) != n:
            raise CloudError(f"{n} frames have {len(set(self.frame_ids))} different ids; give each its own")
        for name in ("subjects", "traits", "digests", "joints_mm", "joints_seen"):
            value = getattr(self, name)
            if value is not None and len(value) != n:
                raise ValueError(f"{len(value)} {name} for {n} frames")

    @property
    def scheme(self) -> Scheme:
        """Scheme of the compared labels."""
        return self.counts.scheme

    @property
    def matrices(self) -> Counts:
        """Confusion matrix of each frame, int32 (F, n, n), rows are the truth."""
        return self.counts.confusion

    @property
    def confusion(self) -> Counts:
        """Confusion matrix of the whole set, int64 (n, n)."""
        return self.total.confusion

    @cached_property
    def total(self) -> FrameCounts:
        """Counts summed over all frames."""
        return self.counts.total()

    @cached_property
    def scores(self) -> dict[str, Scores]:
        """Scores of the whole set by name."""
        return scores_of(self.total)

    @cached_property
    def by_cluster(self) -> Counts:
        """Counts (C, K) summed by cluster, the unit that the bootstrap draws: a subject, or a frame."""
        return intervals.cluster_sums(self.counts.flat, intervals.clusters_of(self.subjects))

    @cached_property
    def behind(self) -> dict[str, Int64]:
        """Number of clusters (...) in which each score is defined, by name."""
        behind: dict[str, Int64] = {}
        for rows in blocks(len(self.by_cluster)):
            for name, score in scores_of(FrameCounts(self.by_cluster[rows], self.scheme)).items():
                behind[name] = behind.get(name, np.int64(0)) + (~np.isnan(score)).sum(0)
        return behind

    @cached_property
    def resampled(self) -> dict[str, Scores]:
        """Scores (R, ...) of R bootstrap resamples, by name."""
        blocks_of = intervals.resampled_blocks(self.by_cluster)
        found = [scores_of(FrameCounts(sums, self.scheme)) for sums in blocks_of]
        return {name: np.concatenate([scores[name] for scores in found]) for name in found[0]}

    @cached_property
    def ci95(self) -> dict[str, Float64]:
        """95 % interval (2, ...) of each score, by name; NaN for a score that only one cluster has."""
        return {
            name: intervals.interval(self.scores[name], values, self.behind[name])
            for name, values in self.resampled.items()
        }

    @property
    def ci_note(self) -> str:
        """Reason to doubt the intervals; "" without one."""
        return intervals.note_on(self.subjects)

    @cached_property
    def frame_miou(self) -> Scores:
        """Mean IoU of each frame (F,); NaN without a person."""
        return confusion.miou(self.matrices)

    @property
    def error_kinds(self) -> dict[str, Counts]:
        """Numbers of wrong pixels by kind of error."""
        return confusion.error_kinds(self.confusion, self.scheme)

    @property
    def flipped_frames(self) -> int:
        """Number of frames whose mIoU rises where left and right are exchanged."""
        return int(confusion.flip_helps(self.matrices, self.scheme).sum())

    @property
    def undefined_shares(self) -> dict[str, float]:
        """Shares of all pixels that are undefined in the truth, and in the prediction only."""
        ignored, unnamed, pixels = self.total.undefined
        shares = confusion.ratio(np.array([ignored, unnamed]), np.array([pixels, pixels]))
        return {"truth": float(shares[0]), "predicted": float(shares[1])}

    @property
    def hashes(self) -> dict[str, str]:
        """SHA-256 of all frames' digests: of depth, truth and prediction."""
        return {
            name: hashlib.sha256("".join(of_frames).encode()).hexdigest()
            for name, of_frames in zip(Digests._fields, zip(*self.digests, strict=True), strict=True)
        }

    @property
    def n_subjects(self) -> int:
        """Number of different subjects."""
        return len(set(self.subjects))

    @cached_property
    def joints(self) -> JointErrors | None:
        """Errors of the network's joints; None without joints."""
        if self.joints_mm is None or self.joints_seen is None:
            return None
        return JointErrors(self.joints_mm, self.joints_seen, self.subjects)

    @property
    def has_confidence(self) -> bool:
        """True if the prediction has confidence."""
        return bool(self.total.reliability.any())

    def only(self, frames: Index) -> Self:
        """Return the comparison of the frames at indices (n,), in this order. Raises CloudError without
        frames.
        """
        if np.array_equal(frames, np.arange(len(self.frame_ids))):
            return self
        names = ("frame_ids", "subjects", "traits", "digests")
        picked: dict[str, Any] = {name: tuple(getattr(self, name)[i] for i in frames) for name in names}
        return replace(
            self,
            **picked,
            counts=self.counts.taken(frames),
            joints_mm=None if self.joints_mm is None else self.joints_mm[frames],
            joints_seen=None if self.joints_seen is None else self.joints_seen[frames],
        )

    def to_json(self) -> dict[str, Any]:
        """Return the summary scores as JSON, the output of `diff`; null for a part that no frame shows."""
        return {
            "frames": len(self.frame_ids),
            "scheme": self.scheme.name,
            **{name: named(name, self.scores[name], self.scheme) for name in SUMMARY},
            "joints": self.joints.to_json() if self.joints else None,
        }

    def to_evaluation_json(self) -> dict[str, Any]:
        """Return all scores as JSON, the output of `evaluate`."""
        scheme, parts = self.scheme, (BACKGROUND_PART, *self.scheme.parts)
        ids = [part.id for part in parts]
        return {
            "frames": len(self.frame_ids),
            "scheme": scheme.name,
            "subjects": self.n_subjects,
            **{name: named(name, score, scheme) for name, score in self.scores.items()},
            "ci95": {name: named(name, ends, scheme) for name, ends in self.ci95.items()},
            "ci_note": self.ci_note,
            "confusion": self.confusion[np.ix_(ids, ids)].tolist(),
            "parts": [part.name for part in parts],
            "pixels": {part.name: int(self.confusion[part.id].sum()) for part in parts},
            "frames_showing": {part.name: int(self.matrices[:, part.id].any(-1).sum()) for part in parts},
            "background": {name: plain(self.scores[name][BACKGROUND]) for name in PART_SCORES[:-1]},
            "absent_parts": [p.name for p in scheme.parts if np.isnan(self.scores["iou"][p.id])],
            "mious": {name: plain(v) for name, v in confusion.mean_ious(self.matrices).items()},
            "error_kinds": {name: int(n) for name, n in self.error_kinds.items()},
            "flipped_frames": self.flipped_frames,
            "undefined": {name: plain(share) for name, share in self.undefined_shares.items()},
            "joints": self.joints.to_json() if self.joints else None,
            "extra_frames": self.extra_frames,
        }


def compare_sets(
    predicted: LabelledFrames,
    truth: LabelledFrames,
    advance: Callable[[int], None] = lambda frames: None,
    workers: int | None = None,
    scheme: Scheme | None = None,
) -> Comparison:
    """Compare every frame of the truth with the prediction of the same id.

    scheme: of the comparison; by default the finest that both sets convert to. Raises FormatError where a
    set does not convert to it.

    Predicted frames without a truth are counted but not compared. advance: called with a number of finished
    frames. workers: processes; by default all cores for large sets. Raises CloudError for a frame that is
    missing or has another depth image, FormatError for a corrupt frame.
    """
    common = common_scheme(predicted.scheme, truth.scheme, scheme)
    pairs, extra = pair_up(predicted, truth)
    counts = np.empty((len(pairs), width(common.scheme.n_classes)), np.int32)
    joints = np.empty((len(pairs), N_JOINTS))
    seen = np.empty(joints.shape, np.uint8)
    texts: list[tuple[str, str, Traits, Digests]] = []
    for i, frame in enumerate(count_pairs((predicted, truth), pairs, common, workers)):
        counts[i], joints[i], seen[i] = frame.counts, frame.joints_mm, frame.joints_seen
        subject = intern(frame.subject or intervals.UNKNOWN)
        texts.append((pairs[i].truth.frame_id, subject, frame.traits, frame.digests))
        advance(1)
    frame_ids, subjects, traits, digests = zip(*texts, strict=True)
    return Comparison(
        frame_ids=frame_ids,
        subjects=subjects,
        traits=traits,
        digests=digests,
        counts=FrameCounts(counts, common.scheme),
        joints_mm=joints if np.isfinite(joints).any() else None,
        joints_seen=seen if np.isfinite(joints).any() else None,
        extra_frames=extra,
    )
