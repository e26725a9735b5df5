"""Random depth sensor, drawn by the frequencies in ``synth/data/sensors.toml``."""

from collections.abc import Callable
from typing import Any

import numpy as np

from sensors.rig.camera import Intrinsics
from synth.cameras.maker_filters import Filtered
from synth.cameras.recorded_stereo import RecordedStereo
from synth.cameras.sensor import Sensor
from synth.cameras.smoothed_lidar import SmoothedLidar
from synth.cameras.stereo import Stereo
from synth.cameras.structured_light import StructuredLight
from synth.cameras.time_of_flight import TimeOfFlight
from synth.data_files import table

KINDS: dict[str, Callable[[np.random.Generator, dict[str, Any]], Sensor]] = {
    "filtered": Filtered.sample,
    "structured_light": StructuredLight.sample,
    "time_of_flight": TimeOfFlight.sample,
    "azure_kinect": TimeOfFlight.azure_kinect,
    "stereo": Stereo.sample,
    "recorded_stereo": RecordedStereo.sample,
    "lidar": SmoothedLidar.sample,
}


def sensor_names() -> list[str]:
    """Return the names of all kinds, then of all models."""
    kinds: dict[str, Any] = table("sensors")
    return [*kinds, *(entry["model"] for kind in kinds.values() for entry in kind["models"])]


def draw_sensor(
    rng: np.random.Generator, name: str | None = None, camera: Intrinsics | None = None
) -> Sensor:
    """Draw kind, model, camera and faults of a sensor.

    name: kind or model to draw; None = all. camera: pinhole in place of the model's.
    """
    kinds: dict[str, Any] = table("sensors")
    chosen = [kind for kind, entry in kinds.items() if name is None or _is_named(kind, entry, name)]
    shares = np.array([kinds[kind]["share"] for kind in chosen])
    kind = chosen[int(rng.choice(len(chosen), p=shares / shares.sum()))]
    models = kinds[kind]["models"]
    models = [entry for entry in models if entry["model"] == name] or models
    entry = models[int(rng.integers(len(models)))]
    return KINDS[kind](rng, entry if camera is None else {**entry, "camera": camera})


def _is_named(kind: str, entry: dict[str, Any], name: str) -> bool:
    return name in (kind, *(model["model"] for model in entry["models"]))
