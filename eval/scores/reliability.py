"""Reliability of a prediction's confidence by bins, and labels to which the prediction gives low probability.

Only pixels count with a predicted body part and a defined truth, because label sets hold confidence only
there.
"""

from typing import NamedTuple

import numpy as np

from annotate.array_types import Bool, Float32
from annotate.parts import BACKGROUND
from eval.scores import kernels as passes
from eval.scores.confusion import Counts, Labels, Scores, ratio

N_BINS = 15
"""Bins of equal width on [0, 1] (Guo et al., On Calibration of Modern Neural Networks, ICML 2017)."""

LEVELS = 255
"""Confidence is counted in steps of 1/255, as label sets store it: sums stay whole numbers."""


_BIN = np.minimum(np.arange(LEVELS + 1) * N_BINS // LEVELS, N_BINS - 1)
"""Bin (256,) of each step of confidence."""


def confidence_counts(
    truth: Labels, predicted: Labels, confidence: Float32, near: Bool
) -> tuple[Counts, Counts]:
    """Return reliability counts (2, 15, 3) and label-quality counts (12, 2), int64.

    near: bool (h, w), pixels near a border. Reliability: pixels, correct pixels and summed confidence in
    1/255, by bin, inside and near borders. Quality: summed probability of the true label in 1/255, and
    pixels, by true part. Where both labels agree, that probability is the confidence, else at most the rest.
    A low quality means a wrong label or a wrong, confident prediction.
    """
    images = truth, predicted, confidence, near
    table = passes.confidences(*map(np.ascontiguousarray, images))  # (part, right, near, step)
    by_step = table.sum(axis=0).swapaxes(0, 1)  # (near, right, step)
    steps = np.arange(LEVELS + 1)
    every = np.stack([by_step.sum(axis=1), by_step[:, 1], by_step.sum(axis=1) * steps], axis=-1)
    binned = np.add.reduceat(every, np.searchsorted(_BIN, np.arange(N_BINS)), axis=1)
    wrong, right = np.moveaxis(table.sum(axis=2), 1, 0)
    quality = np.stack([right @ steps + wrong @ (LEVELS - steps), (right + wrong).sum(axis=1)], axis=-1)
    quality[BACKGROUND] = 0
    return binned, quality


class Curve(NamedTuple):
    """Reliability curve by bin (..., 15): mean confidence and accuracy (NaN where empty), and pixels."""

    confidence: Scores
    accuracy: Scores
    pixels: Counts


def reliability_curve(counts: Counts) -> Curve:
    """Return the curve of reliability counts (..., 15, 3)."""
    pixels = counts[..., 0]
    return Curve(ratio(counts[..., 2], pixels * LEVELS), ratio(counts[..., 1], pixels), pixels)


def calibration_error(counts: Counts) -> Scores:
    """Return the expected calibration error (..., 15, 3) -> (...): pixel-weighted mean gap of accuracy and
    confidence.

    NaN without a pixel. Source: Naeini et al., AAAI 2015; Guo et al., ICML 2017.
    """
    gaps = np.abs(counts[..., 1] - counts[..., 2] / LEVELS).sum(-1)
    return ratio(gaps, counts[..., 0].sum(-1))
