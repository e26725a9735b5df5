"""Reliability of a prediction's confidence, by bins; labels that the prediction doubts.

Only pixels count where the prediction names a body part and the truth is defined: where it names none,
label sets hold no confidence.
"""

from typing import NamedTuple

import numpy as np

from annotate.array_types import Bool, Float32, Int64
from annotate.parts import BACKGROUND, N_CLASSES, UNDEFINED, on_body
from eval.scores.confusion import Counts, Labels, Scores, ratio

N_BINS = 15
"""Bins of equal width on [0, 1] (Guo et al., On Calibration of Modern Neural Networks, ICML 2017)."""

LEVELS = 255
"""Confidence is counted in steps of 1/255, as label sets store it: sums stay whole numbers."""


def reliability_counts(truth: Labels, predicted: Labels, confidence: Float32, near: Bool) -> Counts:
    """Pixels, right ones, sum of confidence in 1/255, by bin, inside and near borders: int64 (2, 15, 3)."""
    seen = _compared(truth, predicted)
    level = _level(confidence[seen])
    where = near[seen] * N_BINS + np.minimum(level * N_BINS // LEVELS, N_BINS - 1)
    right = (truth == predicted)[seen]
    size = 2 * N_BINS
    pixels = np.bincount(where, minlength=size)
    hits = np.bincount(where[right], minlength=size)
    # Weights make bincount count in float64, where whole numbers of this size are exact.
    sums = np.bincount(where, weights=level, minlength=size).astype(np.int64)
    return np.stack([pixels, hits, sums], axis=-1).reshape(2, N_BINS, 3).astype(np.int64)


def label_quality(truth: Labels, predicted: Labels, confidence: Float32) -> Counts:
    """Sum of each true label's probability in 1/255, and pixels, by true part: int64 (12, 2).

    A label that the prediction shares has the confidence as its probability, another one at most
    the rest. Low means: the label is wrong, or the prediction is, with conviction.
    """
    seen = _compared(truth, predicted) & (truth != BACKGROUND)
    level, parts = _level(confidence[seen]), truth[seen]
    given = np.where((truth == predicted)[seen], level, LEVELS - level)
    sums = np.bincount(parts, weights=given, minlength=N_CLASSES)
    return np.stack([sums, np.bincount(parts, minlength=N_CLASSES)], axis=-1).astype(np.int64)


def _compared(truth: Labels, predicted: Labels) -> Bool:
    return np.asarray((truth != UNDEFINED) & on_body(predicted))


def _level(confidence: Float32) -> Int64:
    return np.rint(np.clip(confidence, 0, 1) * LEVELS).astype(np.int64)


class Curve(NamedTuple):
    """Reliability by bin (..., 15): mean confidence and accuracy (NaN where empty), and pixels."""

    confidence: Scores
    accuracy: Scores
    pixels: Counts


def reliability_curve(counts: Counts) -> Curve:
    """The curve of reliability counts (..., 15, 3)."""
    pixels = counts[..., 0]
    return Curve(ratio(counts[..., 2], pixels * LEVELS), ratio(counts[..., 1], pixels), pixels)


def calibration_error(counts: Counts) -> Scores:
    """Expected calibration error (..., 15, 3) -> (...): mean gap of accuracy and confidence, by pixels.

    NaN without a pixel. Source: Naeini et al., AAAI 2015; Guo et al., ICML 2017.
    """
    gaps = np.abs(counts[..., 1] - counts[..., 2] / LEVELS).sum(-1)
    return ratio(gaps, counts[..., 0].sum(-1))
