"""Reliability of a prediction's confidence by bins, and quality of labels by confidence.

Only pixels with a predicted part and a defined truth count; other pixels lack a confidence.
"""

from typing import NamedTuple

import numpy as np

from annotate.array_types import Bool, Float32
from annotate.scheme.scheme import BACKGROUND
from eval.scores import kernels
from eval.scores.confusion import Counts, Labels, Scores, ratio

N_BINS = 15  # of equal width (Guo et al., On Calibration of Modern Neural Networks, ICML 2017)
LEVELS = 255  # steps of confidence, as label sets store it
_BIN = np.minimum(np.arange(LEVELS + 1) * N_BINS // LEVELS, N_BINS - 1)
"""Bin (256,) of each step of confidence."""


def confidence_counts(
    truth: Labels, predicted: Labels, confidence: Float32, near: Bool, classes: int
) -> tuple[Counts, Counts]:
    """Count reliability (2, 15, 3) and label quality (classes, 2), int64; near: flags (h, w).

    Reliability: pixels, right pixels, sum of confidence in 1/255, by bin, inside and near borders. Quality:
    sum of the true labels' probabilities in 1/255, and pixels, by true part. The probability of a label is
    the confidence if the prediction agrees, else the rest. classes: as in ``kernels``.
    """
    sure, close = np.ascontiguousarray(confidence), np.ascontiguousarray(near)
    labels = np.ascontiguousarray(truth), np.ascontiguousarray(predicted)
    table = kernels.confidences(*labels, sure, close, classes)  # (part, right, near, step)
    by_step = table.sum(axis=0).swapaxes(0, 1)  # (near, right, step)
    steps = np.arange(LEVELS + 1)
    every = np.stack([by_step.sum(axis=1), by_step[:, 1], by_step.sum(axis=1) * steps], axis=-1)
    binned = np.add.reduceat(every, np.searchsorted(_BIN, np.arange(N_BINS)), axis=1)
    wrong, right = np.moveaxis(table.sum(axis=2), 1, 0)
    quality = np.stack([right @ steps + wrong @ (LEVELS - steps), (right + wrong).sum(axis=1)], axis=-1)
    quality[BACKGROUND] = 0
    return binned, quality


class Curve(NamedTuple):
    """Reliability by bin (..., 15): mean confidence and accuracy (NaN where empty), and pixels."""

    confidence: Scores
    accuracy: Scores
    pixels: Counts


def reliability_curve(counts: Counts) -> Curve:
    """Return the curve of reliability counts (..., 15, 3)."""
    pixels = counts[..., 0]
    return Curve(ratio(counts[..., 2], pixels * LEVELS), ratio(counts[..., 1], pixels), pixels)


def calibration_error(counts: Counts) -> Scores:
    """Return the expected calibration error (Guo et al. 2017): (..., 15, 3) -> (...); NaN without a pixel."""
    gaps = np.abs(counts[..., 1] - counts[..., 2] / LEVELS).sum(-1)
    return ratio(gaps, counts[..., 0].sum(-1))
