"""Random depth sensor, drawn by the frequencies in ``synth/data/sensors.toml``."""

from collections.abc import Callable
from typing import Any

import numpy as np

from synth.cameras.maker_filters import Filtered
from synth.cameras.recorded_stereo import RecordedStereo
from synth.cameras.sensor import Sensor
from synth.cameras.smoothed_lidar import SmoothedLidar
from synth.cameras.structured_light import StructuredLight
from synth.cameras.time_of_flight import TimeOfFlight
from synth.data_files import table

KINDS: dict[str, Callable[[np.random.Generator, dict[str, Any]], Sensor]] = {
    "filtered": Filtered.sample,
    "structured_light": StructuredLight.sample,
    "time_of_flight": TimeOfFlight.sample,
    "azure_kinect": TimeOfFlight.azure_kinect,
    "stereo": RecordedStereo.sample,
    "lidar": SmoothedLidar.sample,
}


def draw_sensor(rng: np.random.Generator) -> Sensor:
    """Draw kind, model, camera and faults of a sensor."""
    kinds: dict[str, Any] = table("sensors")
    shares = np.array([entry["share"] for entry in kinds.values()])
    kind = list(kinds)[int(rng.choice(len(kinds), p=shares / shares.sum()))]
    models = kinds[kind]["models"]
    return KINDS[kind](rng, models[int(rng.integers(len(models)))])
