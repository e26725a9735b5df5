"""A dataset's distributions beside those of a real recording: ranges for a table, bars for charts."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from annotate.array_types import Float64
from synth.images.distributions import Distributions
from synth.images.silhouette_statistics import LEVELS

OWN, REAL = (2.0, 50.0, 98.0), (10.0, 50.0, 90.0)
"""Percentiles that compare: the middle eight tenths of real people are to lie within what is synthesised."""
BINS = 24
"""Of a chart."""


class Figure(NamedTuple):
    """Display of a figure of ``Distributions``; times ``factor`` it is in its unit."""

    title: str
    unit: str
    factor: float
    decimals: int


FIGURES = {
    "ankles_m": Figure("Ankles apart, knees straight", "cm", 100, 1),
    "arms_deg": Figure("Upper arms off the trunk", "degrees", 1, 1),
    "facing_deg": Figure("Azimuth of the camera about the trunk", "degrees", 1, 0),
    "height_px": Figure("Height in the image, of whole persons", "px", 1, 0),
    "holes": Figure("Holes inside the outline", "%", 100, 2),
    "roughness": Figure("Roughness of the rim", "", 1, 3),
    "height_cm": Figure("Stature", "cm", 1, 0),
    "bmi": Figure("Body mass index", "kg/m²", 1, 1),
}


@dataclass(frozen=True)
class Range:
    """Percentiles of a figure, in its unit: ``OWN`` of the dataset, ``REAL`` of the recording where known."""

    figure: Figure
    own: Float64
    real: Float64 | None

    @property
    def inside(self) -> bool | None:
        """Whether the recording's range lies within the dataset's; None where nothing compares."""
        if self.real is None:
            return None
        return bool(self.own[0] <= self.real[0] and self.real[2] <= self.own[2])


@dataclass(frozen=True)
class Chart:
    """Histograms over the same bins, as shares of the highest bar of both.

    edges: (BINS + 1,) in the figure's unit. real: the recording's bars, None where unknown.
    """

    figure: Figure
    edges: Float64
    own: Float64
    real: Float64 | None


def ranges(dataset: Distributions, recording: Distributions | None) -> list[Range]:
    """A row for every figure that the dataset has; the widths are those of ``profile``."""
    return [
        _range(figure, own, _known(recording, name))
        for name, figure in FIGURES.items()
        if (own := _known(dataset, name)).size
    ]


def profile(dataset: Distributions, recording: Distributions | None) -> list[Range]:
    """A row for each of the ``LEVELS`` widths, from the top of the silhouette downwards."""
    return [
        _range(
            Figure(f"Width at {(level + 0.5) / LEVELS:.0%} from the top", "% of the height", 100, 1),
            *(_known(people, "widths", level) for people in (dataset, recording)),
        )
        for level in range(LEVELS)
    ]


def _range(figure: Figure, own: Float64, real: Float64) -> Range:
    theirs = np.percentile(real, REAL) * figure.factor if real.size else None
    return Range(figure, np.percentile(own, OWN) * figure.factor, theirs)


def charts(dataset: Distributions, recording: Distributions | None) -> list[Chart]:
    """A chart for every row of ``ranges``, without the outermost half percents."""
    return [
        _chart(figure, own * figure.factor, _known(recording, name) * figure.factor)
        for name, figure in FIGURES.items()
        if (own := _known(dataset, name)).size
    ]


def _chart(figure: Figure, own: Float64, real: Float64) -> Chart:
    ends = np.array([np.percentile(values, (0.5, 99.5)) for values in (own, real) if values.size])
    low, high = float(ends[:, 0].min()), float(ends[:, 1].max())
    edges = np.linspace(low, high if high > low else low + 1, BINS + 1)
    bars, others = (np.histogram(values, edges)[0] / max(values.size, 1) for values in (own, real))
    top = max(bars.max(), others.max()) or 1.0  # of two images both may lie outside
    return Chart(figure, edges, bars / top, others / top if real.size else None)


def _known(people: Distributions | None, name: str, column: int | None = None) -> Float64:
    """Known values (n,) of a figure, or of one of its columns."""
    if people is None:
        return np.empty(0)
    values = people.figures[name] if column is None else people.figures[name][:, column]
    return np.asarray(values[~np.isnan(values)], np.float64)
