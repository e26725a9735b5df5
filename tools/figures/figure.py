"""Measured numbers, their intervals over people, and the test of a change."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple, TypeAlias

import numpy as np
from scipy.stats import t

from annotate.array_types import Float64, Int64
from eval.scores import intervals


class Figure(NamedTuple):
    """A measured number and its 95 % interval over people; NaN for an end that is not known.

    without: the number without each person, people in the order of their names; () for fewer than two.
    """

    value: float
    low: float = math.nan
    high: float = math.nan
    without: tuple[float, ...] = ()

    @property
    def certain(self) -> bool:
        """True without an interval: a count, a figure of one person, or of people who do not differ."""
        return math.isnan(self.low) or math.isnan(self.high)

    def text(self, spec: str) -> str:
        """Return the number and its interval by a format such as ``.3f`` or ``.1%``; "-" if not measured."""
        if math.isnan(self.value):
            return "-"
        value, low, high = (format(number, spec).replace("%", " %") for number in self[:3])
        between = "\u2026" if self.low < 0 else "\u2013"  # no dash beside a minus
        return value if self.certain else f"{value} ({low.removesuffix(' %')}{between}{high})"


Rows: TypeAlias = Mapping[str, Mapping[str, Figure]]
"""Figures by row and column."""


def moved(old: Figure, new: Figure, spec: str, paired: bool) -> bool:
    """Return whether two measurements differ in print and by more than chance (5 %).

    paired: True for the same recordings. Then Student's t over people of the jackknifed difference decides,
    or the print alone without people. Otherwise 0 must lie outside the interval of the difference, by MOVER
    (Zou & Donner, Statistics in Medicine 27, 2008).
    """
    if math.isnan(old.value) or math.isnan(new.value) or format(old.value, spec) == format(new.value, spec):
        return False
    if paired:
        apart = np.subtract(new.without, old.without) if len(new.without) == len(old.without) else np.zeros(0)
        return not apart.size or abs(new.value - old.value) > _half_width(apart)
    if old.certain or new.certain:
        return False
    lower, upper = sorted((old, new), key=lambda figure: figure.value)
    return upper.value - lower.value > math.hypot(lower.high - lower.value, upper.value - upper.low)


def _half_width(without: Sequence[float] | Float64) -> float:
    """Return the half width of Student's interval from the values without each person.

    NaN for fewer than two known values. Source: Miller, The jackknife, Biometrika 61, 1974.
    """
    known = np.asarray(without, np.float64)
    known = known[np.isfinite(known)]
    n = len(known)
    return float(t.ppf(0.975, n - 1) * known.std() * math.sqrt(n - 1)) if n > 1 else math.nan


def ratio(pairs: Int64) -> Float64:
    """Return the share of each pair (..., 2): right, and counted; NaN where nothing was counted."""
    return np.asarray(pairs[..., 0] / np.where(pairs[..., 1] > 0, pairs[..., 1], np.nan))


def over_people(counts: Int64, subjects: Sequence[str], score: Callable[[Int64], Float64]) -> Figure:
    """Return a score of the summed counts (F, ...) of frames, with its interval over people.

    score: function of sums (..., *shape) to shares (...). Frames of one subject are one person, as in
    ``evaluate``. One person gives no interval.
    """
    people = _people(subjects)
    value, ends = intervals.frames_interval(np.asarray(counts, np.int64), people, score)
    sums = intervals.cluster_sums(counts.reshape(len(counts), -1).astype(np.int64), people)
    return Figure(float(value), *map(float, ends), without_each(sums.reshape(-1, *counts.shape[1:]), score))


def without_each(sums: Int64, score: Callable[[Int64], Float64]) -> tuple[float, ...]:
    """Return the score without each person, from the sums (P, ...) of people."""
    if len(sums) < 2:
        return ()
    return tuple(np.asarray(score(sums.sum(0) - sums), np.float64).tolist())


Statistic: TypeAlias = Callable[[Float64, Int64], Float64]
"""Function of values (F,) and of numbers of copies (R, F) of each, to numbers (R,)."""


def of_values(
    values: Sequence[float],
    subjects: Sequence[str],
    statistic: Statistic,
    resamples: int = intervals.RESAMPLES,
) -> Figure:
    """Return a statistic of the frames' values (F,), with its interval over people.

    The interval is Student's, from a bootstrap of people. One person, or people who do not differ, give no
    interval.
    """
    numbers, people = np.asarray(values, np.float64), _people(subjects)
    n = int(people.max()) + 1
    found = float(statistic(numbers, np.ones((1, len(numbers)), np.int64))[0])
    if n < 2:
        return Figure(found)
    rng = np.random.default_rng(intervals.SEED)
    drawn = rng.multinomial(n, np.full(n, 1 / n), size=resamples)
    error = intervals.standard_error(statistic(numbers, drawn[:, people]), n)
    half = float(error * intervals.quantile(n - 1))
    without = tuple(statistic(numbers, (1 - np.eye(n, dtype=np.int64))[:, people]).tolist())
    if half <= intervals.ROUNDING * max(1.0, abs(found)):
        return Figure(found, without=without)
    least = min(0.0, float(numbers.min()))  # errors and times are never negative
    return Figure(found, max(least, found - half), found + half, without)


def average(values: Float64, copies: Int64) -> Float64:
    """Return the means (R,) of values (F,) with copies (R, F) of each."""
    return np.asarray(copies @ values / copies.sum(1), np.float64)


def median(values: Float64, copies: Int64) -> Float64:
    """Return the medians (R,) of values (F,) with copies (R, F) of each."""
    order = np.argsort(values, kind="stable")
    up_to = np.cumsum(copies[:, order], axis=1)
    half = up_to[:, -1:] / 2
    middle = ((up_to >= half).argmax(1), (up_to > half).argmax(1))
    return np.asarray(np.mean([values[order][index] for index in middle], axis=0), np.float64)


def _people(subjects: Sequence[str]) -> Int64:
    return np.unique(intervals.persons_of(subjects), return_inverse=True)[1].astype(np.int64)
