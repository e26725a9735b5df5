"""Confidence intervals by a two-stage bootstrap: subjects are drawn first, then their frames.

Frames of one person resemble each other, so drawing frames alone would claim too much certainty
(Efron & Tibshirani 1993; for segmentation scores, arXiv 2307.10926). With one subject the interval
speaks only of that person's frames. With few subjects a percentile interval is too narrow: drawn
over 1,200 simulated sets, it held the true mean in 94 % of them with 80 subjects, in 86 % with 8.
"""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from eval.metrics import Counts, Scores

RESAMPLES = 2000
SEED = 20170606
LEVEL = 0.95


def resampled_sums(
    counts: Counts, subjects: Sequence[str], resamples: int = RESAMPLES, seed: int = SEED
) -> NDArray[np.float64]:
    """Sums of counts (frames, ...) over each resample: float64 (resamples, ...), whole numbers.

    A subject drawn c times gives c resamples of its n frames. Together they are one multinomial
    draw of c * n frames, which needs no loop over resamples. Raises ValueError where the number of
    subjects is not the number of frames.
    """
    if len(subjects) != len(counts) or not len(counts):
        raise ValueError(f"{len(counts)} frames but {len(subjects)} subjects; give one subject per frame")
    rng = np.random.default_rng(seed)
    names, owner = np.unique(np.array(subjects), return_inverse=True)
    drawn = rng.multinomial(len(names), np.full(len(names), 1 / len(names)), size=resamples)
    flat = counts.reshape(len(counts), -1).astype(np.float64)
    sums = np.zeros((resamples, flat.shape[1]))
    for subject in range(len(names)):
        own = flat[owner == subject]
        n = len(own)
        sums += rng.multinomial(drawn[:, subject] * n, np.full(n, 1 / n)) @ own
    return sums.reshape(resamples, *counts.shape[1:])


def interval(resampled: Scores, level: float = LEVEL) -> NDArray[np.float64]:
    """Percentile interval of resampled scores (resamples, ...): (2, ...), lower and upper.

    NaN resamples (a class that a resample happened to lack) are left out; NaN where all are.
    """
    tail = (1 - level) / 2
    scores = np.asarray(resampled, np.float64)
    flat = scores.reshape(len(scores), -1)
    columns = [column[~np.isnan(column)] for column in flat.T]
    ends = [np.quantile(c, [tail, 1 - tail]) if c.size else np.full(2, np.nan) for c in columns]
    return np.stack(ends, axis=-1).reshape(2, *scores.shape[1:])


def score_interval(
    score: Callable[[Counts], Scores], counts: Counts, subjects: Sequence[str]
) -> NDArray[np.float64]:
    """95 % interval of a score of summed counts: (frames, ...) -> (2, ...)."""
    return interval(score(resampled_sums(counts, subjects).astype(np.int64)))
