"""A user's own depth camera, from a file of intrinsics, for synthetic images."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sensors.calibration_files.intrinsics_file import read_intrinsics
from sensors.errors import CalibrationError
from sensors.files.bounded import read_bounded
from sensors.rig.camera import Intrinsics
from sensors.rig.rig_calibration import MAX_CALIBRATION_BYTES
from synth.cameras.random_sensor import draw_sensor, sensor_names
from synth.cameras.sensor import Sensor

SENSOR = "sensor"  # key of the file
MOST_PIXELS = 4_000_000  # of an image; depth cameras have up to 1 million


@dataclass(frozen=True)
class OwnCamera:
    """Depth camera of a file. sensor: kind or model of ``synth/data/sensors.toml``, None = not stated."""

    pinhole: Intrinsics
    sensor: str | None = None

    def __call__(self, rng: np.random.Generator) -> Sensor:
        """Draw faults of the sensor, or of any sensor, with the file's pinhole, undistorted."""
        return draw_sensor(rng, self.sensor, self.pinhole.undistorted())

    def manifest(self) -> dict[str, Any]:
        """Return the camera as JSON values."""
        return {"intrinsics": asdict(self.pinhole), SENSOR: self.sensor}

    def described(self, unnamed: str) -> str:
        """Return a line on the camera. unnamed: faults of a camera without ``sensor``."""
        c = self.pinhole
        faults = (
            f"faults of {self.sensor}" if self.sensor else f'{unnamed}, because the file has no "{SENSOR}"'
        )
        return f"camera: {c.width}x{c.height}, fx {c.fx:.1f}, fy {c.fy:.1f}; {faults}"


def read_own_camera(file: Path) -> OwnCamera:
    """Read intrinsics as ``import`` does, and the name of a sensor from the key ``sensor`` of a JSON file.

    Raises CalibrationError for malformed intrinsics, an unknown sensor and too large an image.
    """
    pinhole = read_intrinsics(file).depth
    if pinhole.width * pinhole.height > MOST_PIXELS:
        raise CalibrationError(
            f"{file} has an image of {pinhole.width}x{pinhole.height}; give at most {MOST_PIXELS} pixels"
        )
    return OwnCamera(pinhole, _sensor_of(file))


def _sensor_of(file: Path) -> str | None:
    data = read_bounded(file, MAX_CALIBRATION_BYTES, "give intrinsics", CalibrationError)
    try:
        fields = json.loads(data)
    except (ValueError, RecursionError):  # text of another program
        return None
    name = fields.get(SENSOR) if isinstance(fields, dict) else None
    if name is not None and name not in (known := sensor_names()):
        raise CalibrationError(f"{file} has the sensor {name!r:.60}; use {', '.join(known)}")
    return name
