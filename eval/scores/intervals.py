"""Confidence intervals by a bootstrap over subjects.

Whole subjects are drawn with replacement, because frames of one person resemble each other (Davison &
Hinkley, Bootstrap Methods and their Application, 1997, section 3.8). The frames of a single subject are drawn
one by one, and the interval holds for that person only.

Percentile intervals are too narrow for few subjects. So the width is Student's t times the standard error of
the resamples times sqrt(n / (n - 1)) (Hesterberg, American Statistician 69, 2015). The ends are computed on
the logit scale (Korn & Graubard, Survey Methodology 24, 1998; Dean & Pagano, J. Survey Statistics and
Methodology 3, 2015). People who do not differ get the rule of three (Hanley & Lippman-Hand, JAMA 249, 1983).
`tools/measure/coverage.py` measures the coverage. Constants are untuned.
"""

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from annotate.array_types import Float64, Int64
from eval.scores.confusion import Scores
from eval.scores.counts import blocks

RESAMPLES, SEED = 2000, 20170606
AT_ONCE = 4_000_000  # numbers drawn or summed at a time, 32 MB
LEVEL = 0.95
FEW = 4  # subjects; fewer get a note
RULE_OF_THREE = 3.0  # at most this / n of all people differ from n equal ones, with 95 % confidence
ROUNDING = 1e-12  # of shares; a smaller error is none
UNKNOWN = "unknown"
"""Subject of frames without a name."""


def clusters_of(subjects: Sequence[str]) -> Int64:
    """Return the cluster that each frame is drawn with, int64 (F,).

    The cluster is the frame's subject; the frame itself where the subject is ``UNKNOWN``, or the only one.
    """
    owner = np.unique(persons_of(subjects), return_inverse=True)[1].astype(np.int64)
    return owner if owner.max(initial=0) > 0 else np.arange(len(subjects))


def persons_of(subjects: Sequence[str]) -> list[str]:
    """Return the subjects (F,), with another name for each frame whose subject is ``UNKNOWN``."""
    return [f"{UNKNOWN} {i}" if name == UNKNOWN else name for i, name in enumerate(subjects)]


def cluster_sums(counts: Int64, clusters: Int64) -> Int64:
    """Return the sums of the frames' counts (F, K) by cluster: (C, K)."""
    if np.array_equal(clusters, np.arange(len(counts))):
        return counts
    order = np.argsort(clusters, kind="stable")
    own = np.split(order, np.cumsum(np.bincount(clusters))[:-1])
    return np.stack([counts[frames].sum(axis=0, dtype=np.int64) for frames in own])


def resampled_sums(by_cluster: Int64, resamples: int = RESAMPLES, seed: int = SEED) -> Int64:
    """Return the sums over each resample of C clusters: (C, K) -> int64 (resamples, K)."""
    return np.concatenate([*resampled_blocks(by_cluster, resamples, seed)])


def resampled_blocks(by_cluster: Int64, resamples: int = RESAMPLES, seed: int = SEED) -> Iterator[Int64]:
    """Yield the rows of ``resampled_sums`` in order, some at a time, because many parts have large counts."""
    (n, numbers), rng = by_cluster.shape, np.random.default_rng(seed)
    at_once = max(1, AT_ONCE // max(n, numbers))
    for first in range(0, resamples, at_once):
        size = min(at_once, resamples - first)
        sums = np.zeros((size, numbers), np.int64)
        drawn = rng.multinomial(n, np.full(n, 1 / n), size=size)
        for rows in blocks(n):
            # Products of float64 are fast and, below 2**53, exact.
            product = drawn[:, rows].astype(np.float64) @ by_cluster[rows].astype(np.float64)
            sums += product.astype(np.int64)
        yield sums


def standard_error(resampled: Scores, n: Int64 | int) -> Scores:
    """Return the standard error of a score from its resamples (R, ...) of n clusters (broadcast).

    NaN resamples are left out. NaN for fewer than two clusters.
    """
    known = ~np.isnan(resampled)
    count = known.sum(0)
    centred = np.where(known, resampled, 0.0)
    mean = centred.sum(0) / np.maximum(count, 1)
    variance = (np.where(known, centred - mean, 0.0) ** 2).sum(0) / np.maximum(count, 1)
    n = np.broadcast_to(n, variance.shape)
    widened = np.sqrt(variance * n / np.maximum(n - 1, 1))
    return np.where((n > 1) & (count > 0), widened, np.nan)


def quantile(degrees: Float64 | Int64 | int, level: float = LEVEL) -> Float64:
    """Return the half width of a t interval in standard errors. level: its coverage."""
    # As scipy.stats.t.ppf, but faster to import and to call.
    from scipy.special import stdtrit

    return np.asarray(stdtrit(np.maximum(degrees, 1), (1 + level) / 2), np.float64)


def interval(estimate: Scores, resampled: Scores, n: Int64 | int) -> Float64:
    """Return the interval (2, ...) of shares (...) from resamples (R, ...) of n clusters.

    NaN for NaN shares and for one cluster. Equal resamples give the rule of three: 3 / n of all clusters may
    have the share 0, or 1.
    """
    from scipy.special import expit, logit

    error = standard_error(resampled, n) * quantile(np.asarray(n) - 1)
    value = np.asarray(estimate, np.float64)
    spread = value * (1 - value)
    alike = (spread <= 0) | (error < ROUNDING)
    half = error / np.where(alike, 1.0, spread)
    middle = logit(np.where(alike, 0.5, value))
    ends = np.stack([expit(middle - half), expit(middle + half)])
    others = np.minimum(1.0, RULE_OF_THREE / np.maximum(n, 1))
    widest = np.stack([value * (1 - others), value + (1 - value) * others])
    return np.where(alike & ~np.isnan(error), widest, ends)


def frames_interval(
    counts: Int64, clusters: Int64, score: Callable[[Int64], Scores]
) -> tuple[Scores, Float64]:
    """Return the score of the summed counts (F, ...) of frames, and its interval (2, ...).

    Clusters without the score are not counted.
    """
    sums = cluster_sums(counts.reshape(len(counts), -1), clusters)
    resampled, each = (score(rows.reshape(-1, *counts.shape[1:])) for rows in (resampled_sums(sums), sums))
    value = score(counts.sum(0))
    return value, interval(value, resampled, (~np.isnan(each)).sum(0))


def paired_interval(value: Scores, resampled: Scores, n: Int64 | int) -> Float64:
    """Return the interval (2, ...) of a difference (...) on the same frames; as ``interval``."""
    half = standard_error(resampled, n) * quantile(np.asarray(n) - 1)
    return np.clip(np.stack([value - half, value + half]), -1.0, 1.0)


def unpaired_interval(value: Scores, resampled: Sequence[Scores], n: Sequence[Int64 | int]) -> Float64:
    """Return the interval (2, ...) of a difference of two samples, by Welch (Biometrika 34, 1947).

    resampled, n: of each sample, as in ``interval``.
    """
    a, b = (standard_error(scores, k) ** 2 for scores, k in zip(resampled, n, strict=True))
    spread = a**2 / np.maximum(np.asarray(n[0]) - 1, 1) + b**2 / np.maximum(np.asarray(n[1]) - 1, 1)
    degrees = np.divide((a + b) ** 2, spread, out=np.ones_like(spread), where=spread > 0)
    half = np.sqrt(a + b) * quantile(degrees)
    return np.clip(np.stack([value - half, value + half]), -1.0, 1.0)


def note_on(subjects: Sequence[str]) -> str:
    """Return the reason to doubt an interval over these frames' subjects; "" without one."""
    people, nameless = set(subjects), sum(name == UNKNOWN for name in subjects)
    if nameless:
        some = "" if nameless == len(subjects) else f" in {nameless} of {len(subjects)} frames"
        return f"subjects unknown{some}: drawn as if of different people; the interval is too narrow"
    if len(people) == 1:
        return "one subject: the interval is for the frames of this person only, not for other people"
    if len(people) < FEW:
        return f"{len(people)} subjects: the interval is wide and based on very little; measure more people"
    return ""
