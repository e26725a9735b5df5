"""Comparison of a dataset's statistics with a real recording's: ranges for a table, histograms for charts."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from annotate.array_types import Float64
from synth.images.distributions import Distributions
from synth.images.silhouette_statistics import LEVELS

OWN, REAL = (2.0, 50.0, 98.0), (10.0, 50.0, 90.0)  # percentiles that compare
BINS = 24


class Quantity(NamedTuple):
    """Display settings of an entry of ``Distributions``; a value times ``factor`` is in ``unit``."""

    title: str
    unit: str
    factor: float
    decimals: int


QUANTITIES = {
    "ankles_m": Quantity("Ankles apart, knees straight", "cm", 100, 1),
    "arms_deg": Quantity("Upper arms off the trunk", "degrees", 1, 1),
    "facing_deg": Quantity("Azimuth of the camera about the trunk", "degrees", 1, 0),
    "height_px": Quantity("Height in the image, of whole persons", "px", 1, 0),
    "holes": Quantity("Holes inside the outline", "%", 100, 2),
    "roughness": Quantity("Roughness of the rim", "", 1, 3),
    "height_cm": Quantity("Stature", "cm", 1, 0),
    "bmi": Quantity("Body mass index", "kg/m²", 1, 1),
}


@dataclass(frozen=True)
class Range:
    """Percentiles of a quantity, in its unit: ``own`` (``OWN``) of the dataset, ``real`` (``REAL``) of the
    recording, if any.
    """

    figure: Quantity
    own: Float64
    real: Float64 | None

    @property
    def inside(self) -> bool | None:
        """Return True if the recording's range lies within the dataset's; None without a recording."""
        if self.real is None:
            return None
        return bool(self.own[0] <= self.real[0] and self.real[2] <= self.own[2])


@dataclass(frozen=True)
class Chart:
    """Histograms (BINS,) over the same bins, normalised by the highest bar of both; edges (BINS + 1,)."""

    figure: Quantity
    edges: Float64
    own: Float64
    real: Float64 | None


def ranges(dataset: Distributions, recording: Distributions | None) -> list[Range]:
    """Return the percentiles of dataset and recording for every quantity that the dataset has.

    The silhouette's widths are in ``profile``. The recording's percentiles are None where it has no values.
    """
    return [_range(*row) for row in _rows(dataset, recording)]


def profile(dataset: Distributions, recording: Distributions | None) -> list[Range]:
    """Return the range of the silhouette's width at each of ``LEVELS`` heights, from the top downwards."""
    rows = []
    for level in range(LEVELS):
        title = f"Width at {(level + 0.5) / LEVELS:.0%} from the top"
        values = [_known(people, "widths", level) for people in (dataset, recording)]
        rows.append(_range(Quantity(title, "% of the height", 100, 1), *values))
    return rows


def charts(dataset: Distributions, recording: Distributions | None) -> list[Chart]:
    """Return a chart of every quantity in ``ranges``, without the lowest and highest 0.5 % of its values."""
    return [
        _chart(figure, *(f * figure.factor for f in values)) for figure, *values in _rows(dataset, recording)
    ]


def _rows(
    dataset: Distributions, recording: Distributions | None
) -> Iterator[tuple[Quantity, Float64, Float64]]:
    for name, quantity in QUANTITIES.items():
        if (own := _known(dataset, name)).size:
            yield quantity, own, _known(recording, name)


def _range(figure: Quantity, own: Float64, real: Float64) -> Range:
    other = np.percentile(real, REAL) * figure.factor if real.size else None
    return Range(figure, np.percentile(own, OWN) * figure.factor, other)


def _chart(figure: Quantity, own: Float64, real: Float64) -> Chart:
    ends = np.array([np.percentile(values, (0.5, 99.5)) for values in (own, real) if values.size])
    low, high = float(ends[:, 0].min()), float(ends[:, 1].max())
    edges = np.linspace(low, high if high > low else low + 1, BINS + 1)
    bars, others = (np.histogram(values, edges)[0] / max(values.size, 1) for values in (own, real))
    top = max(bars.max(), others.max()) or 1.0  # because of two images both can lie outside
    return Chart(figure, edges, bars / top, others / top if real.size else None)


def _known(people: Distributions | None, name: str, column: int | None = None) -> Float64:
    if people is None:
        return np.empty(0)
    values = people.figures[name] if column is None else people.figures[name][:, column]
    return np.asarray(values[~np.isnan(values)], np.float64)
