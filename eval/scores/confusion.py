"""Scores of body-part labels, derived from one confusion matrix a frame.

A matrix is int64 (12, 12): rows are the true part, columns the predicted part, by id. Scores take any leading
axes (..., 12, 12): of frames or of resamples. Three rules:
- Pixels undefined in the truth are ignored.
- Pixels undefined in the prediction count as background.
- A class without pixels has the score NaN and is left out of means.
"""

import numpy as np
from numpy.typing import NDArray

from annotate.array_types import Bool, Float64, Int64, UInt8
from annotate.parts import BACKGROUND, LEFT_RIGHT, N_CLASSES, NEIGHBOURS, TWIN_PARTS, UNDEFINED
from eval.scores import kernels

Labels = UInt8
Counts = Int64
Scores = Float64

WORST_SHARE = 0.05  # of the frames, the worst by mIoU (Wang et al. 2023, q = 5)

_UNNAMED, _ODD = N_CLASSES, N_CLASSES + 1
_CODE = np.full(kernels.CODES, _ODD, np.uint8)
_CODE[:N_CLASSES], _CODE[UNDEFINED] = np.arange(N_CLASSES), _UNNAMED
"""Row of each label in a table of pixels: parts by id, undefined, invalid."""

NEIGHBOUR = np.array([[frozenset((a, b)) in NEIGHBOURS for b in range(N_CLASSES)] for a in range(N_CLASSES)])
"""Flags (12, 12) of parts joined by anatomy."""
_MERGED_ID = np.unique(np.minimum(np.arange(N_CLASSES), TWIN_PARTS), return_inverse=True)[1]


def confusion_matrix(truth: Labels, predicted: Labels) -> Counts:
    """Count pixels by true and predicted part: int64 (12, 12) from two label maps of one shape.

    Raises ValueError for different shapes or an id that is neither a part nor 255.
    """
    return counted(truth, predicted)[0]


def counted(truth: Labels, predicted: Labels) -> tuple[Counts, Counts]:
    """Return the confusion matrix, and (3,): pixels undefined in the truth, in the prediction only, and all.

    Raises ValueError as ``confusion_matrix``.
    """
    if truth.shape != predicted.shape:
        raise ValueError(f"truth is {truth.shape} but the prediction is {predicted.shape}")
    table = kernels.pairs(np.ascontiguousarray(truth), np.ascontiguousarray(predicted), _CODE)
    if table[_ODD].any() or table[:, _ODD].any():
        found = np.union1d(truth, predicted)
        odd = found[_CODE[found] == _ODD]
        raise ValueError(f"label {odd[0]} is not a part id; use 0 to {N_CLASSES - 1}, or {UNDEFINED}")
    matrix = table[:N_CLASSES, :N_CLASSES].copy()
    unnamed = table[:N_CLASSES, _UNNAMED]
    matrix[:, BACKGROUND] += unnamed
    return matrix, np.array([table[_UNNAMED].sum(), unnamed.sum(), truth.size], np.int64)


def named(predicted: Labels) -> Labels:
    """Return a prediction with its undefined pixels as background."""
    return np.where(predicted == UNDEFINED, np.uint8(BACKGROUND), predicted)


def ratio(part: NDArray[np.generic], whole: NDArray[np.generic]) -> Scores:
    """Return part / whole, NaN where whole is 0; arrays of one shape."""
    over, under = np.asarray(part, np.float64), np.asarray(whole, np.float64)
    return np.asarray(np.divide(over, under, out=np.full(over.shape, np.nan), where=under > 0))


def recall(matrix: Counts) -> Scores:
    """Return the share of each true part's pixels with that prediction (..., 12)."""
    return ratio(_diagonal(matrix), matrix.sum(-1))


def precision(matrix: Counts) -> Scores:
    """Return the share of each predicted part's pixels that are right (..., 12)."""
    return ratio(_diagonal(matrix), matrix.sum(-2))


def iou(matrix: Counts) -> Scores:
    """Return the intersection over union of each part (..., 12)."""
    hit = _diagonal(matrix)
    return ratio(hit, matrix.sum(-1) + matrix.sum(-2) - hit)


def dice(matrix: Counts) -> Scores:
    """Return the Dice coefficient (F1 by pixels) of each part (..., 12)."""
    return ratio(2 * _diagonal(matrix), matrix.sum(-1) + matrix.sum(-2))


def over_parts(scores: Scores) -> Scores:
    """Return the mean over the body parts present: (..., n), background first -> (...)."""
    return present_mean(scores[..., 1:], axis=-1)


def present_mean(scores: Scores, axis: int) -> Scores:
    """Return the mean of the known values along an axis; NaN without one."""
    return ratio(np.nansum(scores, axis=axis), (~np.isnan(scores)).sum(axis))


def mean_recall(matrix: Counts) -> Scores:
    """Return the mean recall of the body parts (...)."""
    return over_parts(recall(matrix))


def miou(matrix: Counts) -> Scores:
    """Return the mean IoU of the body parts (...)."""
    return over_parts(iou(matrix))


def mean_ious(matrices: Counts) -> dict[str, float]:
    """Return mean IoUs of the body parts of frames (F, 12, 12).

    over_set: of the summed matrix. over_images: mean of the frames' mIoU. over_parts: mean
    over frames of each part, then over parts. worst: mean of the worst 5 % of the frames (at least one).
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
    """Return the IoU of person against background (...)."""
    missed = matrix[..., 1:, BACKGROUND].sum(-1)
    invented = matrix[..., BACKGROUND, 1:].sum(-1)
    hit = matrix[..., 1:, 1:].sum((-1, -2))
    return ratio(hit, hit + missed + invented)


def error_rate_on_person(matrix: Counts) -> Scores:
    """Return the share of the true person's pixels with a wrong prediction (...)."""
    all_pixels = matrix[..., 1:, :].sum((-1, -2))
    return ratio(all_pixels - _diagonal(matrix)[..., 1:].sum(-1), all_pixels)


def without_background(matrix: Counts) -> Counts:
    """Return the counts of pixels with a body part in truth and prediction."""
    inner = matrix.copy()
    inner[..., BACKGROUND, :] = 0
    inner[..., :, BACKGROUND] = 0
    return inner


def merge_left_right(matrix: Counts) -> Counts:
    """Return the confusion with left and right merged: (..., 12, 12) -> (..., 8, 8)."""
    group = np.eye(_MERGED_ID.max() + 1, dtype=np.int64)[_MERGED_ID]
    return np.asarray(group.T @ matrix @ group)


def left_right_swap_rate(matrix: Counts) -> Scores:
    """Return the share of the limb pixels predicted as the other side's twin (...)."""
    limbs = np.array(LEFT_RIGHT).ravel()
    return ratio(_swapped(matrix), matrix[..., limbs, :].sum((-1, -2)))


def flip_helps(matrix: Counts) -> Bool:
    """Return flags (...): exchanging left and right in the whole prediction raises mIoU."""
    return np.asarray(miou(matrix[..., TWIN_PARTS]) > miou(matrix))


def error_kinds(matrix: Counts) -> dict[str, Counts]:
    """Count wrong pixels by kind, each (...); together all off the diagonal."""
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
