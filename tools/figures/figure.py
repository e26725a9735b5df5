"""Measured numbers, their intervals over people, and the test of a change."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple, TypeAlias

import numpy as np
from scipy.stats import t

from annotate.array_types import Bool, Float64, Int64
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
        return value if self.certain else f"{value} ({low.removesuffix(' %')}\u2013{high})"


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


def of_values(
    values: Sequence[float], subjects: Sequence[str], statistic: Callable[[Float64], float]
) -> Figure:
    """Return a statistic of the frames' values (F,), with Student's interval over people (jackknife).

    One person, or people without whom nothing changes, give no interval.
    """
    numbers, people = np.asarray(values, np.float64), _people(subjects)
    found = statistic(numbers)
    without = tuple(statistic(numbers[others]) for others in _others(people))
    half = _half_width(without)
    return Figure(found, found - half, found + half, without) if half > 0 else Figure(found, without=without)


def average(values: Float64) -> float:
    """Return the mean as a float."""
    return float(np.mean(values))


def median(values: Float64) -> float:
    """Return the median as a float."""
    return float(np.median(values))


def _people(subjects: Sequence[str]) -> Int64:
    return np.unique(intervals.persons_of(subjects), return_inverse=True)[1].astype(np.int64)


def _others(people: Int64) -> list[Bool]:
    """Return the flags (F,) of the frames without each person; [] for one person."""
    numbers = np.unique(people)
    return [people != number for number in numbers] if len(numbers) > 1 else []
