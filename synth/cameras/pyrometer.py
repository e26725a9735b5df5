"""A pyrometer beside the thermal camera: one temperature of a round spot, hardly noisy, without drift."""

from dataclasses import dataclass

import numpy as np

from annotate.array_types import Float32
from sensors.rig.camera import Intrinsics
from sensors.rig.thermal_reference import SPOT_RAD

ASIDE = 0.08
"""Where the spot lies: off the image's middle by this share of its sides, standard deviation. By eye."""
UNIT_C, NOISE_C, STEP_C = 0.2, 0.05, 0.1
"""Errors of a unit and of a reading (standard deviations) and its resolution, kelvin. Optris CT: accuracy
1 K, resolution 0.1 K (data sheet, from memory); the first two chosen by eye."""


@dataclass(frozen=True)
class Pyrometer:
    """Where its spot lies in the thermal image, pixels, and by how much the unit is off, kelvin."""

    column: float
    row: float
    diameter_px: float
    off_c: float

    @staticmethod
    def drawn(thermal: Intrinsics, rng: np.random.Generator) -> "Pyrometer":
        """One mounted by hand beside a thermal camera."""
        height, width = thermal.shape
        aside = rng.normal(0, ASIDE, 2).clip(-2 * ASIDE, 2 * ASIDE)
        column, row = (0.5 + aside[0]) * width, (0.5 + aside[1]) * height
        return Pyrometer(column, row, thermal.fx * SPOT_RAD, float(rng.normal(0, UNIT_C)))

    def read_c(self, true_c: Float32, rng: np.random.Generator) -> float:
        """Its reading of what the thermal camera's pixels (h, w) truly see, degrees Celsius."""
        row, column = np.indices(true_c.shape)
        inside = np.hypot(row - self.row, column - self.column) <= self.diameter_px / 2
        mean_c = float(true_c[inside].mean()) + self.off_c + rng.normal(0, NOISE_C)
        return round(mean_c / STEP_C) * STEP_C
