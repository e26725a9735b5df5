"""Scores of body-part labels, all derived from one confusion matrix per frame.

A matrix is int64 (12, 12): rows are the true part, columns the predicted one, by part id. Every
score takes (..., 12, 12), so that one frame, the frames of a set, their sum, and the resamples of
a bootstrap go through the same code.

Three rules hold throughout:
- A pixel undefined in the truth is ignored; `counted` says how many there are.
- A pixel undefined in the prediction counts as background: who names no part has missed it.
- A class without pixels has the score NaN, which means leave it out, so it is never scored 0 or 1.
"""

import numpy as np
from numpy.typing import NDArray

from annotate.array_types import Bool, Float64, Int64, UInt8
from annotate.parts import BACKGROUND, LEFT_RIGHT, N_CLASSES, NEIGHBOURS, TWIN_PARTS, UNDEFINED
from eval.scores import kernels as passes

Labels = UInt8
Counts = Int64
Scores = Float64

WORST_SHARE = 0.05
"""Share of the frames, the worst by mIoU, whose mean is the worst case (Wang et al. 2023, q = 5)."""

_UNNAMED, _ODD = N_CLASSES, N_CLASSES + 1
_CODE = np.full(passes.CODES, _ODD, np.uint8)
_CODE[:N_CLASSES], _CODE[UNDEFINED] = np.arange(N_CLASSES), _UNNAMED
"""Row of each label in a table of pixels: parts by id, the undefined ones, those that should not be."""

NEIGHBOUR = np.array([[frozenset((a, b)) in NEIGHBOURS for b in range(N_CLASSES)] for a in range(N_CLASSES)])
"""Bool (12, 12): parts joined by anatomy."""
_MERGED_ID = np.unique(np.minimum(np.arange(N_CLASSES), TWIN_PARTS), return_inverse=True)[1]


def confusion_matrix(truth: Labels, predicted: Labels) -> Counts:
    """Count pixels by true and predicted part: int64 (12, 12) from two label maps of one shape.

    Raises ValueError for different shapes or an id that is neither a part nor 255.
    """
    return counted(truth, predicted)[0]


def counted(truth: Labels, predicted: Labels) -> tuple[Counts, Counts]:
    """Confusion matrix (12, 12), and pixels undefined in the truth, in the prediction only, and all (3,).

    int64. Raises ValueError as ``confusion_matrix``.
    """
    if truth.shape != predicted.shape:
        raise ValueError(f"truth is {truth.shape} but the prediction is {predicted.shape}")
    table = passes.pairs(np.ascontiguousarray(truth), np.ascontiguousarray(predicted), _CODE)
    if table[_ODD].any() or table[:, _ODD].any():
        found = np.union1d(truth, predicted)
        odd = found[_CODE[found] == _ODD]
        raise ValueError(f"label {odd[0]} is not a part id; use 0 to {N_CLASSES - 1}, or {UNDEFINED}")
    matrix = table[:N_CLASSES, :N_CLASSES].copy()
    unnamed = table[:N_CLASSES, _UNNAMED]
    matrix[:, BACKGROUND] += unnamed
    return matrix, np.array([table[_UNNAMED].sum(), unnamed.sum(), truth.size], np.int64)


def named(predicted: Labels) -> Labels:
    """A prediction with its undefined pixels turned to background, as every score reads it."""
    return np.where(predicted == UNDEFINED, np.uint8(BACKGROUND), predicted)


def ratio(part: NDArray[np.generic], whole: NDArray[np.generic]) -> Scores:
    """part / whole, NaN where whole is 0; arrays of one shape."""
    over, under = np.asarray(part, np.float64), np.asarray(whole, np.float64)
    return np.asarray(np.divide(over, under, out=np.full(over.shape, np.nan), where=under > 0))


def recall(matrix: Counts) -> Scores:
    """Share of each true part's pixels that are predicted as it (..., 12); the paper's diagonal."""
    return ratio(_diagonal(matrix), matrix.sum(-1))


def precision(matrix: Counts) -> Scores:
    """Share of the pixels predicted as a part that are it (..., 12)."""
    return ratio(_diagonal(matrix), matrix.sum(-2))


def iou(matrix: Counts) -> Scores:
    """Intersection over union of each part (..., 12); NaN for a part absent from both."""
    hit = _diagonal(matrix)
    return ratio(hit, matrix.sum(-1) + matrix.sum(-2) - hit)


def dice(matrix: Counts) -> Scores:
    """Dice coefficient (F1 by pixels) of each part (..., 12); NaN for a part absent from both."""
    return ratio(2 * _diagonal(matrix), matrix.sum(-1) + matrix.sum(-2))


def over_parts(scores: Scores) -> Scores:
    """Mean over the body parts present: (..., n) with background first -> (...); NaN if none is."""
    return present_mean(scores[..., 1:], axis=-1)


def present_mean(scores: Scores, axis: int) -> Scores:
    """Mean along an axis over what is not NaN, without a warning where nothing is left."""
    return ratio(np.nansum(scores, axis=axis), (~np.isnan(scores)).sum(axis))


def mean_recall(matrix: Counts) -> Scores:
    """Mean recall of the eleven body parts (...): the paper's 0.864 synthetic and 0.732 real."""
    return over_parts(recall(matrix))


def miou(matrix: Counts) -> Scores:
    """Mean IoU of the eleven body parts (...)."""
    return over_parts(iou(matrix))


def mean_ious(matrices: Counts) -> dict[str, float]:
    """Mean IoU of the body parts of a set (F, 12, 12), averaged in the ways that answer different questions.

    over_set: pixels of all frames in one matrix; large people weigh more. over_images: mean of
    the frames' own mIoU. over_parts: mean over frames of each part, then over parts; a rare part
    weighs as much as a common one. worst: mean of the worst 5 % of the frames (at least one).
    Source: Wang et al., Revisiting Evaluation Metrics for Semantic Segmentation, NeurIPS 2023.
    """
    mious = np.sort(miou(matrices))
    mious = mious[~np.isnan(mious)]
    worst = mious[: max(1, int(np.ceil(WORST_SHARE * mious.size)))]
    return {
        "over_set": float(miou(matrices.sum(0))),
        "over_images": float(present_mean(mious, axis=0)),
        "over_parts": float(over_parts(present_mean(iou(matrices), axis=0))),
        "worst": float(present_mean(worst, axis=0)),
    }


def person_iou(matrix: Counts) -> Scores:
    """IoU of person against background, parts forgotten (...)."""
    missed = matrix[..., 1:, BACKGROUND].sum(-1)
    invented = matrix[..., BACKGROUND, 1:].sum(-1)
    hit = matrix[..., 1:, 1:].sum((-1, -2))
    return ratio(hit, hit + missed + invented)


def error_rate_on_person(matrix: Counts) -> Scores:
    """Share of the true person's pixels that are predicted as anything else (...)."""
    all_pixels = matrix[..., 1:, :].sum((-1, -2))
    return ratio(all_pixels - _diagonal(matrix)[..., 1:].sum(-1), all_pixels)


def without_background(matrix: Counts) -> Counts:
    """Only pixels that truth and prediction both call a person: wrong parts, no missed person."""
    inner = matrix.copy()
    inner[..., BACKGROUND, :] = 0
    inner[..., :, BACKGROUND] = 0
    return inner


def merge_left_right(matrix: Counts) -> Counts:
    """Confusion of the eight classes left when twins are one: (..., 12, 12) -> (..., 8, 8)."""
    group = np.eye(_MERGED_ID.max() + 1, dtype=np.int64)[_MERGED_ID]
    return np.asarray(group.T @ matrix @ group)


def left_right_swap_rate(matrix: Counts) -> Scores:
    """Share of the limb pixels that are predicted as the other side's twin (...)."""
    limbs = np.array(LEFT_RIGHT).ravel()
    return ratio(_swapped(matrix), matrix[..., limbs, :].sum((-1, -2)))


def flip_helps(matrix: Counts) -> Bool:
    """Whether exchanging left and right in the whole prediction would raise mIoU (...)."""
    return np.asarray(miou(matrix[..., TWIN_PARTS]) > miou(matrix))


def error_kinds(matrix: Counts) -> dict[str, Counts]:
    """Wrong pixels of (..., 12, 12) by kind, each (...): together everything off the diagonal.

    Neighbours are parts joined by anatomy.
    """
    kinds = {
        "missed_person": matrix[..., 1:, BACKGROUND].sum(-1),
        "invented_person": matrix[..., BACKGROUND, 1:].sum(-1),
        "left_right_swap": _swapped(matrix),
        "neighbour_part": (matrix * NEIGHBOUR).sum((-1, -2)),
    }
    wrong = matrix.sum((-1, -2)) - _diagonal(matrix).sum(-1)
    return kinds | {"other_part": wrong - np.sum(list(kinds.values()), axis=0)}


def _diagonal(matrix: Counts) -> Counts:
    return np.diagonal(matrix, axis1=-2, axis2=-1)


def _swapped(matrix: Counts) -> Counts:
    left, right = np.array(LEFT_RIGHT).T
    return np.asarray(matrix[..., left, right].sum(-1) + matrix[..., right, left].sum(-1), np.int64)
