"""Measured numbers with intervals."""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple, TypeAlias

import numpy as np
from scipy.stats import binomtest, t


class Figure(NamedTuple):
    """A measured number and its 95 % interval; NaN for an end that is not known."""

    value: float
    low: float = math.nan
    high: float = math.nan

    @property
    def certain(self) -> bool:
        """True without an interval: a count, or a figure of the same recordings."""
        return math.isnan(self.low) or math.isnan(self.high)

    def text(self, spec: str) -> str:
        """Return the number and its interval by a format such as ``.3f`` or ``.1%``; "-" if not measured."""
        if math.isnan(self.value):
            return "-"
        value, low, high = (format(number, spec).replace("%", " %") for number in self)
        return value if self.certain else f"{value} ({low.removesuffix(' %')}\u2013{high})"


Rows: TypeAlias = Mapping[str, Mapping[str, Figure]]
"""Figures by row and column."""


def moved(old: Figure, new: Figure, spec: str) -> bool:
    """Return whether 0 lies outside the interval of the difference of two measurements.

    Method: MOVER (Zou & Donner, Statistics in Medicine 27, 2008). Without intervals: whether the printed
    numbers differ.
    """
    if math.isnan(old.value) or math.isnan(new.value):
        return False
    lower, upper = sorted((old, new), key=lambda figure: figure.value)
    above, below = (0.0 if one.certain else abs(end - one.value)
                    for one, end in ((lower, lower.high), (upper, upper.low)))  # fmt: skip
    if lower.certain and upper.certain:
        return format(old.value, spec) != format(new.value, spec)
    return upper.value - lower.value > math.hypot(above, below)


def share(right: int, n: int) -> Figure:
    """Return a share with Wilson's interval."""
    if not n:
        return Figure(math.nan)
    ends = binomtest(right, n).proportion_ci(method="wilson")
    return Figure(right / n, float(ends.low), float(ends.high))


def median(values: Sequence[float]) -> Figure:
    """Return a median with the interval by order statistics, for any distribution."""
    n, ordered = len(values), np.sort(np.asarray(values, float))
    if n < 6:
        return Figure(float(np.median(ordered))) if n else Figure(math.nan)
    reach = 1.959964 * math.sqrt(n) / 2
    first, last = max(0, math.floor(n / 2 - reach)), min(n - 1, math.ceil(n / 2 + reach))
    return Figure(float(np.median(ordered)), float(ordered[first]), float(ordered[last]))


def mean(values: Sequence[float]) -> Figure:
    """Return a mean with Student's interval."""
    n, found = len(values), float(np.mean(values))
    if n < 2:
        return Figure(found)
    half = float(t.ppf(0.975, n - 1) * np.std(values, ddof=1) / math.sqrt(n))
    return Figure(found, found - half, found + half)
