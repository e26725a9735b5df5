"""Calibrated odds that pixels whose votes agree are a person: logistic regression on what the finder gives.

``python -m tools.fit.person_odds`` fits the weights; a new finder needs it.
"""

import json
from functools import cache
from importlib.resources import files
from typing import NamedTuple

import numpy as np

from annotate.array_types import Float64

KEPT_ODDS = -1.4  # log odds of the weakest detection; one in five is a person, and only a track shows it
LIKELY_ODDS, SURE_ODDS = 0.0, 2.2  # log odds of detections that two frames, and one frame, establish


class Evidence(NamedTuple):
    """Evidence of some pixels for a person: mean log odds, weighted by surface; visible surface in m2."""

    mean_odds: float
    area_m2: float

    @property
    def features(self) -> Float64:
        """Return the inputs (F,) of the model by ``FEATURES``."""
        log_area = np.log(max(self.area_m2, 1e-6))
        return np.array([1.0, self.mean_odds, log_area, self.mean_odds * log_area])

    @property
    def odds(self) -> float:
        """Return the log odds of being a person."""
        return float(self.features @ _weights())


FEATURES = ("constant", "mean log odds", "log area", "mean log odds x log area")


@cache
def _weights() -> Float64:
    row = json.loads(files("annotate").joinpath("person", "odds.json").read_text())
    return np.array([row[name] for name in FEATURES])
