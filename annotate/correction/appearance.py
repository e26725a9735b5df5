"""Colours and temperatures of points, by which cloth, skin and room are recognised a moment later."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Self

import cv2
import numpy as np
from numpy.typing import NDArray

from annotate.array_types import Bool, Float32, Index, Int32, UInt8
from annotate.cloud.color_odds import color_bins, frequencies, lab_of
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.parts import N_CLASSES

N_COLORS = 8 * 32 * 32
"""Number of colour bins of ``color_bins``."""
LAB_SD = np.array([30, 10, 10], np.float32)
"""Standard deviation of one surface's colour in Lab (8 bit): shadow changes lightness most. Untuned."""
AVERAGED_PX = 3
"""Side of the square over which colours are averaged, in pixels: evens out camera noise. Untuned."""
COLDEST_C, HOTTEST_C = 10, 45
"""Range of distinguished temperatures in degrees Celsius. Untuned."""
UNSEEN_COLOR, UNSEEN_WARMTH = 2e-3, 0.01
"""Share added to every colour and every degree of a part: a colour that the corrected frames did not show is
weak evidence against any part. Untuned."""
WARMTH_WEIGHT = 0.8
"""Weight of temperature against colour: the thermal lens blurs over half a hand. Untuned."""


@dataclass(frozen=True)
class Appearance:
    """Colours and temperatures of points. lab: uint8 (n, 3), 0 = none; celsius: float32 (n,), NaN = none."""

    lab: UInt8
    celsius: Float32

    @classmethod
    def of(cls, cloud: ThermalCloud | None, mask: Bool) -> Self:
        """Appearance of the masked points (h, w) of a frame; unknown without its cloud."""
        if cloud is None:
            count = int(mask.sum())
            return cls(np.zeros((count, 3), np.uint8), np.full(count, np.nan, np.float32))
        seen = cloud.color_valid.astype(np.float32)
        size = (AVERAGED_PX, AVERAGED_PX)
        total = cv2.blur(cloud.color_rgb.astype(np.float32) * seen[..., None], size)
        mean = total / np.maximum(cv2.blur(seen, size), np.float32(1e-3))[..., None]
        return cls(lab_of(mean.astype(np.uint8), cloud.color_valid)[mask], cloud.temperature_c[mask])

    @classmethod
    def joined(cls, several: "Sequence[Appearance]") -> Self:
        """Appearance of all points of several, in order."""
        return cls(np.concatenate([x.lab for x in several]), np.concatenate([x.celsius for x in several]))

    @property
    def colored(self) -> Bool:
        """Whether the colour of each point (n,) is known."""
        return self.lab[:, 0] > 0

    @property
    def bins(self) -> Int32:
        """Colour bin of each point (n,); 0 also where the colour is unknown."""
        return color_bins(self.lab)

    def resemblance(self, others: "Appearance", index: Index) -> Float32:
        """Similarity (n, k) of the colours of each point and of ``others`` at ``index`` (n, k), from 0 to 1.

        1 for equal colours, and where one of the two is unknown.
        """
        away = (others.lab.astype(np.float32)[index] - self.lab.astype(np.float32)[:, None]) / LAB_SD
        known = others.colored[index] & self.colored[:, None]
        return np.where(known, np.exp(-0.5 * (away**2).sum(axis=2)), np.float32(1))

    def likelihood(self, others: "Appearance", parts: UInt8) -> Float32:
        """Log likelihood (n, classes) of each point's appearance, given others (m,) of known parts."""
        colors, warmths = [], []
        degrees, felt = _degrees(others.celsius), np.isfinite(others.celsius)
        for part in range(N_CLASSES):
            own = parts == part
            colors.append(frequencies(others.bins[own & others.colored]))
            warmths.append(_degree_shares(degrees[own & felt]))
        by_color = np.where(self.colored, np.log(np.stack(colors) + UNSEEN_COLOR)[:, self.bins], 0)
        by_warmth = np.log(np.stack(warmths))[:, _degrees(self.celsius)]
        by_warmth = np.where(np.isfinite(self.celsius), by_warmth, 0)
        return np.asarray((by_color + WARMTH_WEIGHT * by_warmth).T, np.float32)


def _degrees(celsius: Float32) -> Index:
    """Whole degrees (n,) above COLDEST_C; 0 also where the temperature is unknown."""
    return np.clip(np.nan_to_num(celsius), COLDEST_C, HOTTEST_C).astype(np.intp) - COLDEST_C


def _degree_shares(degrees: Index) -> NDArray[Any]:
    """Share of each degree among whole degrees (n,), smoothed over its neighbours and never zero."""
    count = np.convolve(np.bincount(degrees, minlength=HOTTEST_C - COLDEST_C + 1), (0.25, 0.5, 0.25), "same")
    return (count + UNSEEN_WARMTH * max(len(degrees), 1)) / max(len(degrees), 1)
