"""Calibrated odds that pixels whose votes agree are a person: logistic regression on what the stages give.

``python -m tools.finder.person_odds`` fits the weights. Fit them again for a new finder or verifier.
"""

import json
from functools import cache
from importlib.resources import files
from typing import NamedTuple

import numpy as np

from annotate.array_types import Float64

KEPT_ODDS = -1.4  # log odds of the weakest detection; one in five is a person, and only a track shows it
# Log odds of detections that two frames, and one frame, establish. Of people in crowds 0.85 are found; with
# 0.7 in place of 1.0 0.86 and a third more phantoms, with 1.4 0.82 (development).
LIKELY_ODDS, SURE_ODDS = 1.0, 4.0


class Evidence(NamedTuple):
    """Evidence of some pixels for a person: mean log odds, weighted by surface; visible surface in m2; log
    odds by the second stage, None = not rated.
    """

    mean_odds: float
    area_m2: float
    shape_odds: float | None = None

    @property
    def features(self) -> Float64:
        """Return the inputs (F,) of the model by ``FEATURES``, the last one only if rated."""
        log_area = np.log(max(self.area_m2, 1e-6))
        first = np.array([1.0, self.mean_odds, log_area, self.mean_odds * log_area])
        return first if self.shape_odds is None else np.append(first, self.shape_odds)

    @property
    def odds(self) -> float:
        """Return the log odds of being a person."""
        return float(self.features @ _weights(ONE_STAGE if self.shape_odds is None else TWO_STAGES))


FEATURES = ("constant", "mean log odds", "log area", "mean log odds x log area", "log odds by shape")
ONE_STAGE, TWO_STAGES = "one stage", "two stages"


@cache
def _weights(model: str) -> Float64:
    models = json.loads(files("annotate").joinpath("person", "detection", "odds.json").read_text())
    return np.array(list(models[model].values()))
