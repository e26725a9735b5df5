"""Scores of body-part labels, derived from one confusion matrix a frame.

A matrix is int64 (n, n), where n is ``Scheme.n_classes``: rows are the true part, columns the predicted part,
by id. Scores take any leading axes (..., n, n): of frames or of resamples. Four rules:
- A thing is a part, and is not of the person.
- Pixels undefined in the truth are ignored.
- Pixels undefined in the prediction count as background.
- A class without pixels has the score NaN and is left out of means.
"""

import numpy as np
from numpy.typing import NDArray

from annotate.array_types import Bool, Float64, Int64, UInt8
from annotate.scheme.scheme import BACKGROUND, UNDEFINED, Scheme
from eval.scores import kernels

Labels = UInt8
Counts = Int64
Scores = Float64

WORST_SHARE = 0.05  # of the frames, the worst by mIoU (Wang et al. 2023, q = 5)


def confusion_matrix(truth: Labels, predicted: Labels, scheme: Scheme) -> Counts:
    """Count pixels by true and predicted part: int64 (n, n) from two label maps of one shape.

    Raises ValueError for different shapes or an id that the scheme lacks.
    """
    return counted(truth, predicted, scheme)[0]


def counted(truth: Labels, predicted: Labels, scheme: Scheme) -> tuple[Counts, Counts]:
    """Return the confusion matrix, and (3,): pixels undefined in the truth, in the prediction only, and all.

    Raises ValueError as ``confusion_matrix``.
    """
    if truth.shape != predicted.shape:
        raise ValueError(f"truth is {truth.shape} but the prediction is {predicted.shape}")
    unnamed = scheme.n_classes
    unknown = unnamed + 1
    code = np.full(kernels.CODES, unknown, np.uint16)
    code[scheme.is_label] = np.flatnonzero(scheme.is_label)
    code[UNDEFINED] = unnamed
    images = np.ascontiguousarray(truth), np.ascontiguousarray(predicted)
    table = kernels.pairs(*images, code, unknown + 1)
    if table[unknown].any() or table[:, unknown].any():
        found = np.union1d(truth, predicted)
        odd = found[code[found] == unknown]
        raise ValueError(f"label {odd[0]} is not a part of scheme {scheme.name!r}; use {scheme.label_text}")
    matrix = table[:unnamed, :unnamed].copy()
    matrix[:, BACKGROUND] += table[:unnamed, unnamed]
    undefined = [table[unnamed].sum(), table[:unnamed, unnamed].sum(), truth.size]
    return matrix, np.array(undefined, np.int64)


def named(predicted: Labels) -> Labels:
    """Return a prediction with its undefined pixels as background."""
    return np.where(predicted == UNDEFINED, np.uint8(BACKGROUND), predicted)


def ratio(part: NDArray[np.generic], whole: NDArray[np.generic]) -> Scores:
    """Return part / whole, NaN where whole is 0; arrays of one shape."""
    over, under = np.asarray(part, np.float64), np.asarray(whole, np.float64)
    return np.asarray(np.divide(over, under, out=np.full(over.shape, np.nan), where=under > 0))


def recall(matrix: Counts) -> Scores:
    """Return the share of each true part's pixels with that prediction (..., n)."""
    return ratio(_diagonal(matrix), matrix.sum(-1))


def precision(matrix: Counts) -> Scores:
    """Return the share of each predicted part's pixels that are right (..., n)."""
    return ratio(_diagonal(matrix), matrix.sum(-2))


def iou(matrix: Counts) -> Scores:
    """Return the intersection over union of each part (..., n)."""
    hit = _diagonal(matrix)
    return ratio(hit, matrix.sum(-1) + matrix.sum(-2) - hit)


def dice(matrix: Counts) -> Scores:
    """Return the Dice coefficient (F1 by pixels) of each part (..., n)."""
    return ratio(2 * _diagonal(matrix), matrix.sum(-1) + matrix.sum(-2))


def over_parts(scores: Scores) -> Scores:
    """Return the mean over the parts present: (..., n), background first -> (...)."""
    return present_mean(scores[..., 1:], axis=-1)


def present_mean(scores: Scores, axis: int) -> Scores:
    """Return the mean of the known values along an axis; NaN without one."""
    return ratio(np.nansum(scores, axis=axis), (~np.isnan(scores)).sum(axis))


def mean_recall(matrix: Counts) -> Scores:
    """Return the mean recall of the parts (...)."""
    return over_parts(recall(matrix))


def miou(matrix: Counts) -> Scores:
    """Return the mean IoU of the parts (...)."""
    return over_parts(iou(matrix))


def mean_ious(matrices: Counts) -> dict[str, float]:
    """Return mean IoUs of the parts of frames (F, n, n).

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


def person_iou(matrix: Counts, scheme: Scheme) -> Scores:
    """Return the IoU of the person, all parts of the body, against all else (...)."""
    body = _is_body(scheme).astype(np.int64)
    true, drawn, hit = matrix.sum(-1) @ body, matrix.sum(-2) @ body, matrix @ body @ body
    return ratio(hit, true + drawn - hit)


def error_rate_on_person(matrix: Counts, scheme: Scheme) -> Scores:
    """Return the share of the true person's pixels with a wrong prediction (...)."""
    body = _is_body(scheme).astype(np.int64)
    all_pixels = matrix.sum(-1) @ body
    return ratio(all_pixels - _diagonal(matrix) @ body, all_pixels)


def on_person(matrix: Counts, scheme: Scheme) -> Counts:
    """Return the counts of pixels with a part of the body in truth and prediction."""
    body = _is_body(scheme)
    return matrix * np.outer(body, body)


def merge_left_right(matrix: Counts, scheme: Scheme) -> Counts:
    """Return the confusion with left and right merged: (..., n, n) -> (..., m, m), one class for twins."""
    kept, merged = [min(pair) for pair in scheme.twins], [max(pair) for pair in scheme.twins]
    sums = matrix.copy()
    sums[..., kept, :] += sums[..., merged, :]
    sums[..., kept] += sums[..., merged]
    return np.delete(np.delete(sums, merged, axis=-2), merged, axis=-1)


def left_right_swap_rate(matrix: Counts, scheme: Scheme) -> Scores:
    """Return the share of the pixels of parts with a twin that are predicted as the twin (...).

    0 in a scheme without twins.
    """
    if not scheme.twins:
        return np.zeros(matrix.shape[:-2])
    limbs = np.array(scheme.twins).ravel()
    return ratio(_swapped(matrix, scheme), matrix[..., limbs, :].sum((-1, -2)))


def flip_helps(matrix: Counts, scheme: Scheme) -> Bool:
    """Return flags (...): exchanging left and right in the whole prediction raises mIoU."""
    return np.asarray(miou(matrix[..., scheme.twin_table[: scheme.n_classes]]) > miou(matrix))


def error_kinds(matrix: Counts, scheme: Scheme) -> dict[str, Counts]:
    """Count wrong pixels by kind, each (...); together all off the diagonal."""
    return {name: (matrix * flags).sum((-1, -2)) for name, flags in error_flags(scheme).items()}


def error_flags(scheme: Scheme) -> dict[str, Bool]:
    """Return flags (n, n) of pairs of a true and a predicted part by kind of error.

    Each pair off the diagonal has one kind. A thing in place of the body is a missed person.
    """
    body = _is_body(scheme)
    flags = {"missed_person": np.outer(body, ~body), "invented_person": np.outer(~body, body)}
    pairs = {"left_right_swap": map(tuple, scheme.twins), "neighbour_part": map(tuple, scheme.neighbours)}
    rest = ~np.eye(len(body), dtype=np.bool_) & (body[:, None] == body)
    for name, of_kind in pairs.items():
        kind = np.zeros_like(rest)
        for one, other in of_kind:
            kind[one, other] = kind[other, one] = True
        flags[name] = kind & rest
        rest = rest & ~kind
    return flags | {"other_part": rest}


def _is_body(scheme: Scheme) -> Bool:
    """Return flags (n,) by id, False for the background and things."""
    flags = ~scheme.is_thing[: scheme.n_classes]
    flags[BACKGROUND] = False
    return flags


def _diagonal(matrix: Counts) -> Counts:
    return np.diagonal(matrix, axis1=-2, axis2=-1)


def _swapped(matrix: Counts, scheme: Scheme) -> Counts:
    left, right = np.array(scheme.twins).T
    return np.asarray(matrix[..., left, right].sum(-1) + matrix[..., right, left].sum(-1), np.int64)
