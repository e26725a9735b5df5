"""One label set against another: what was counted, frame by frame, and the scores it gives."""

from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from annotate.labels import FrameLabels
from annotate.parts import BACKGROUND, BODY_PARTS, N_CLASSES, PARTS
from annotate.store import LabelSet
from eval import boundary, metrics
from eval.bootstrap import interval, resampled_sums
from eval.boundary import DISTANCE_EDGES_PX
from eval.metrics import Counts, Scores
from sensors.errors import CloudError

UNKNOWN_SUBJECT = "unknown"

JsonScore: TypeAlias = "float | list[JsonScore] | None"


@dataclass(frozen=True)
class Comparison:
    """Counts of F compared frames, from which every score is derived.

    matrices: int64 (F, 12, 12), rows truth. borders: int64 (F, 4), see `boundary_counts`.
    by_distance: int64 (F, 7, 2), see `errors_by_distance`. undefined: int64 (F, 3), see
    `undefined_pixels`. subjects: who is seen in each frame. extra_frames: how many predicted frames
    have no truth and were left out. Raises CloudError when nothing was compared, ValueError for
    arrays that do not fit together.
    """

    frame_ids: tuple[str, ...]
    subjects: tuple[str, ...]
    matrices: Counts
    borders: Counts
    by_distance: Counts
    undefined: Counts
    extra_frames: int = 0

    def __post_init__(self) -> None:
        n = len(self.frame_ids)
        if not n:
            raise CloudError("no frame was compared; give label sets that hold frames")
        expected = {
            "matrices": (n, N_CLASSES, N_CLASSES),
            "borders": (n, 4),
            "by_distance": (n, len(DISTANCE_EDGES_PX) + 1, 2),
            "undefined": (n, 3),
        }
        for name, shape in expected.items():
            actual = getattr(self, name).shape
            if actual != shape:
                raise ValueError(f"{name} is {actual}, but {n} frames need {shape}")
        if len(self.subjects) != n:
            raise ValueError(f"{len(self.subjects)} subjects for {n} frames")

    @cached_property
    def confusion(self) -> Counts:
        """All frames' pixels in one matrix, int64 (12, 12)."""
        return np.asarray(self.matrices.sum(0), np.int64)

    @cached_property
    def scores(self) -> dict[str, Scores]:
        """Scores of the whole set by name; parts' scores are (12,), all others are ()."""
        return _scores(self.confusion, self.borders.sum(0))

    @cached_property
    def ci95(self) -> dict[str, NDArray[np.float64]]:
        """95 % bootstrap interval of each score, (2, ...): lower and upper."""
        cells = N_CLASSES**2
        counts = np.concatenate([self.matrices.reshape(-1, cells), self.borders], axis=1)
        sums = resampled_sums(counts, self.subjects).astype(np.int64)
        resampled = _scores(sums[:, :cells].reshape(-1, N_CLASSES, N_CLASSES), sums[:, cells:])
        return {name: interval(values) for name, values in resampled.items()}

    @cached_property
    def frame_miou(self) -> Scores:
        """Mean IoU of each frame (F,); NaN where neither map shows a person."""
        return metrics.miou(self.matrices)

    @property
    def undefined_shares(self) -> dict[str, float]:
        """Shares of all pixels undefined in the truth (ignored), and in the prediction only."""
        ignored, unnamed, pixels = self.undefined.sum(0)
        shares = metrics.ratio(np.array([ignored, unnamed]), np.array([pixels, pixels]))
        return {"truth": float(shares[0]), "predicted": float(shares[1])}

    @property
    def n_subjects(self) -> int:
        """How many different people are seen."""
        return len(set(self.subjects))

    def to_json(self) -> dict[str, Any]:
        """The summary that `diff` prints; null stands for a part that no frame shows."""
        return {
            "frames": len(self.frame_ids),
            "mean_recall": _plain(self.scores["mean_recall"]),
            "recall": _by_name(self.scores["recall"]),
            "miou": _plain(self.scores["miou"]),
            "iou": _by_name(self.scores["iou"]),
            "boundary_f": _plain(self.scores["boundary_f"]),
            "left_right_swap_rate": _plain(self.scores["left_right_swap_rate"]),
            "person_iou": _plain(self.scores["person_iou"]),
        }

    def to_evaluation_json(self) -> dict[str, Any]:
        """What `evaluate` prints: the summary with intervals, confusion and what was left out."""
        per_part = {"recall", "precision", "iou", "dice"}
        return {
            **self.to_json(),
            "subjects": self.n_subjects,
            "ci95": {
                name: _by_name(ends) if name in per_part else _plain(ends) for name, ends in self.ci95.items()
            },
            "confusion": self.confusion.tolist(),
            "parts": [part.name for part in PARTS],
            "background": {name: _plain(self.scores[name][BACKGROUND]) for name in sorted(per_part)},
            "absent_parts": [p.name for p in BODY_PARTS if np.isnan(self.scores["iou"][p.id])],
            "mious": {name: _plain(v) for name, v in asdict(metrics.mean_ious(self.matrices)).items()},
            "undefined": {name: _plain(share) for name, share in self.undefined_shares.items()},
            "extra_frames": self.extra_frames,
        }


def compare_sets(predicted: LabelSet, truth: LabelSet) -> Comparison:
    """Compare every frame of the truth with the prediction of the same id.

    A truth frame without a prediction is an error, since leaving out what failed would flatter the
    score. Predicted frames without a truth are common (few of a session's frames are corrected);
    they are left out and counted. Raises CloudError naming the frame, or FormatError for a corrupt one.
    """
    frame_ids = truth.frame_ids
    known = set(predicted.frame_ids)
    missing = [frame_id for frame_id in frame_ids if frame_id not in known]
    if missing:
        raise CloudError(
            f"{predicted.path} lacks {len(missing)} of the {len(frame_ids)} frames of {truth.path}, "
            f"first {missing[0]}; predict or label them, or take them out of the truth"
        )
    pairs = ((predicted.read(frame_id), truth.read(frame_id)) for frame_id in frame_ids)
    counted = [(truth_frame.subject, *_count(guess, truth_frame)) for guess, truth_frame in pairs]
    if not counted:
        raise CloudError(f"{truth.path} holds no frames; give a label set with frames")
    subjects, matrices, borders, by_distance, undefined = zip(*counted, strict=True)
    return Comparison(
        frame_ids=tuple(frame_ids),
        subjects=tuple(subject or UNKNOWN_SUBJECT for subject in subjects),
        matrices=np.stack(matrices),
        borders=np.stack(borders),
        by_distance=np.stack(by_distance),
        undefined=np.stack(undefined),
        extra_frames=len(known) - len(frame_ids),
    )


def _count(predicted: FrameLabels, truth: FrameLabels) -> tuple[Counts, Counts, Counts, Counts]:
    if predicted.parts.shape != truth.parts.shape:
        raise CloudError(
            f"frame {truth.frame_id} is {predicted.parts.shape} in the prediction but {truth.parts.shape} "
            "in the truth; compare label sets over the same depth images"
        )
    pair = truth.parts, predicted.parts
    return (
        metrics.confusion_matrix(*pair),
        boundary.boundary_counts(*pair),
        boundary.errors_by_distance(*pair),
        metrics.undefined_pixels(*pair),
    )


def _scores(matrix: Counts, borders: Counts) -> dict[str, Scores]:
    return {
        "recall": metrics.recall(matrix),
        "precision": metrics.precision(matrix),
        "iou": metrics.iou(matrix),
        "dice": metrics.dice(matrix),
        "mean_recall": metrics.mean_recall(matrix),
        "miou": metrics.miou(matrix),
        "person_iou": metrics.person_iou(matrix),
        "left_right_swap_rate": metrics.left_right_swap_rate(matrix),
        "boundary_f": boundary.boundary_f(borders),
    }


def _plain(values: Scores | float) -> JsonScore:
    """Numbers as JSON has them: NaN, which it lacks, becomes null."""
    array = np.asarray(values, np.float64)
    if array.ndim:
        return [_plain(value) for value in array]
    return None if np.isnan(array) else float(array)


def _by_name(scores: Scores) -> dict[str, JsonScore]:
    """Body parts' scores (..., 12) by part name."""
    return {part.name: _plain(scores[..., part.id]) for part in BODY_PARTS}
