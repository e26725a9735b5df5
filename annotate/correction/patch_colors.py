"""What points look like, colour and temperature: the same cloth, skin and room a moment later."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Self

import cv2
import numpy as np
from numpy.typing import NDArray

from annotate.cloud.color_odds import color_bins, frequencies, lab_of
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.parts import N_CLASSES

N_COLORS = 8 * 32 * 32
"""Bins of colour that ``color_bins`` tells apart."""
ALIKE = np.array([30, 10, 10], np.float32)
"""Differences in Lab (8 bit) by which colours look another: shadow changes lightness most."""
AVERAGED_PX = 3
"""Colours are means over so many pixels: the camera's noise is not the cloth's."""
COLDEST_C, HOTTEST_C = 10, 45
UNSEEN, LEAST_WARMTH = 2e-3, 0.01
"""Share of a part's pixels that every colour, and every degree, is taken to have more than was seen: what the
corrected frames did not show says little against any part."""
BY_WARMTH = 0.8
"""What temperature counts beside colour: the thermal lens blurs it over half a hand."""


@dataclass(frozen=True)
class Looks:
    """Looks of points. lab: uint8 (n, 3), zero = no colour; celsius: float32 (n,), NaN = unknown."""

    lab: NDArray[np.uint8]
    celsius: NDArray[np.float32]

    @classmethod
    def of(cls, cloud: ThermalCloud | None, mask: NDArray[np.bool_]) -> Self:
        """Looks of the masked points (h, w) of a frame; unknown without its cloud."""
        if cloud is None:
            count = int(mask.sum())
            return cls(np.zeros((count, 3), np.uint8), np.full(count, np.nan, np.float32))
        seen = cloud.color_valid.astype(np.float32)
        size = (AVERAGED_PX, AVERAGED_PX)
        total = cv2.blur(cloud.color_rgb.astype(np.float32) * seen[..., None], size)
        mean = total / np.maximum(cv2.blur(seen, size), np.float32(1e-3))[..., None]
        return cls(lab_of(mean.astype(np.uint8), cloud.color_valid)[mask], cloud.temperature_c[mask])

    @classmethod
    def joined(cls, several: "Sequence[Looks]") -> Self:
        """All points in turn."""
        return cls(np.concatenate([x.lab for x in several]), np.concatenate([x.celsius for x in several]))

    @property
    def colored(self) -> NDArray[np.bool_]:
        """Points (n,) whose colour is known."""
        return self.lab[:, 0] > 0

    @property
    def bins(self) -> NDArray[np.int32]:
        """The bin of colours (n,) each is in; 0 also where none is known."""
        return color_bins(self.lab)

    def resemblance(self, others: "Looks", index: NDArray[np.intp]) -> NDArray[np.float32]:
        """How much alike (n, k) each point and those of ``others`` at ``index`` (n, k) are, 1 = as one;
        also 1 where a colour is not known."""
        away = (others.lab.astype(np.float32)[index] - self.lab.astype(np.float32)[:, None]) / ALIKE
        known = others.colored[index] & self.colored[:, None]
        return np.where(known, np.exp(-0.5 * (away**2).sum(axis=2)), np.float32(1))

    def likelihood(self, others: "Looks", parts: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Log likelihood (n, classes) of each point's looks, were it what others (m,) of these parts are."""
        colors, warmths = [], []
        degrees = np.clip(np.nan_to_num(others.celsius), COLDEST_C, HOTTEST_C).astype(np.intp) - COLDEST_C
        felt = np.isfinite(others.celsius)
        for part in range(N_CLASSES):
            own = parts == part
            colors.append(frequencies(others.bins[own & others.colored]))
            warmths.append(_of_degrees(degrees[own & felt]))
        at = np.clip(np.nan_to_num(self.celsius), COLDEST_C, HOTTEST_C).astype(np.intp) - COLDEST_C
        by_color = np.where(self.colored, np.log(np.stack(colors) + UNSEEN)[:, self.bins], 0)
        by_warmth = np.where(np.isfinite(self.celsius), np.log(np.stack(warmths))[:, at], 0)
        return np.asarray((by_color + BY_WARMTH * by_warmth).T, np.float32)


def _of_degrees(degrees: NDArray[np.intp]) -> NDArray[Any]:
    """Share of each degree, smoothed over the next ones, all a little more than zero."""
    count = np.convolve(np.bincount(degrees, minlength=HOTTEST_C - COLDEST_C + 1), (0.25, 0.5, 0.25), "same")
    return (count + LEAST_WARMTH * max(len(degrees), 1)) / max(len(degrees), 1)
