"""Pyrometer beside the thermal camera: temperature of a round spot, without drift."""

from dataclasses import dataclass

import numpy as np

from annotate.array_types import Float32
from sensors.rig.camera import Intrinsics
from sensors.rig.thermal_reference import SPOT_RAD

ASIDE = 0.08  # of the spot from the image's middle, share of its sides, standard deviation; untuned
UNIT_C, NOISE_C = 0.2, 0.05  # standard deviations of unit and reading; untuned
STEP_C = 0.1  # resolution of an Optris CT (data sheet)


@dataclass(frozen=True)
class Pyrometer:
    """Spot of a pyrometer in the thermal image, in pixels; off_c: constant error of the device, in kelvin."""

    column: float
    row: float
    diameter_px: float
    off_c: float

    @staticmethod
    def drawn(thermal: Intrinsics, rng: np.random.Generator) -> "Pyrometer":
        """Draw the spot and error of a pyrometer mounted by hand beside a thermal camera."""
        height, width = thermal.shape
        aside = rng.normal(0, ASIDE, 2).clip(-2 * ASIDE, 2 * ASIDE)
        column, row = (0.5 + aside[0]) * width, (0.5 + aside[1]) * height
        return Pyrometer(column, row, thermal.fx * SPOT_RAD, float(rng.normal(0, UNIT_C)))

    def read_c(self, true_c: Float32, rng: np.random.Generator) -> float:
        """Return the reading, degrees Celsius, for true temperatures (h, w) of the thermal image."""
        row, column = np.indices(true_c.shape)
        inside = np.hypot(row - self.row, column - self.column) <= self.diameter_px / 2
        mean_c = float(true_c[inside].mean()) + self.off_c + rng.normal(0, NOISE_C)
        return round(mean_c / STEP_C) * STEP_C
