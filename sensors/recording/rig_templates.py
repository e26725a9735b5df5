"""Common rigs by name (``sensors/data/rig_templates.toml``): cameras by data sheet, poses and hole plate.

The calibrations are initial guesses; calibrate with the hole plate before labelling.
"""

import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sensors.calibrate.hole_plate import HolePlate
from sensors.calibration_files.kinect2_factory import KINECT2_DEPTH
from sensors.errors import DeviceError
from sensors.rig.camera import Intrinsics
from sensors.rig.rig_calibration import Pose, RigCalibration

REFERENCE = "kinect2-optris"  # rig of all figures of the documentation
TABLE: dict[str, Any] = tomllib.loads(
    (Path(__file__).parents[1] / "data" / "rig_templates.toml").read_text(encoding="utf-8")
)
CAMERAS = {"kinect2": KINECT2_DEPTH} | {name: Intrinsics(*row) for name, row in TABLE["cameras"].items()}
KINECT_COLOR_FROM_DEPTH = Pose(*(np.array(part) for part in TABLE["kinect_color_from_depth"].values()))


@dataclass(frozen=True)
class RigTemplate:
    """Common rig; the TOML table documents the fields. devices: addresses, depth camera first."""

    name: str
    title: str
    devices: tuple[str, ...]
    calibration: RigCalibration
    plate: HolePlate
    plate_m: tuple[float, float]
    depth_sd_mm: float
    remark: str


def _pose(right_m: float, down_m: float, forward_m: float, tilt_deg: float = 0.0) -> Pose:
    """Return camera_from_depth of a camera that looks ``tilt_deg`` down."""
    cosine, sine = np.cos(np.radians(tilt_deg)), np.sin(np.radians(tilt_deg))
    turn = np.array([[1, 0, 0], [0, cosine, -sine], [0, sine, cosine]])
    return Pose(turn, np.array([right_m, down_m, forward_m]))


def _template(name: str, row: dict[str, Any]) -> RigTemplate:
    depth = CAMERAS[row.get("depth", "kinect2")]
    color_pose = _pose(*row["color_pose"]) if "color_pose" in row else KINECT_COLOR_FROM_DEPTH
    thermal_pose = _pose(*row["thermal_pose"])
    color, thermal = CAMERAS[row["color"]], CAMERAS[row["thermal"]]
    calibration = RigCalibration(depth, color, color_pose, thermal, thermal_pose)
    plate, plate_m = HolePlate(**row.get("plate", {})), (row["plate_m"][0], row["plate_m"][1])
    devices, sd_mm = tuple(row["devices"]), row["depth_sd_mm"]
    return RigTemplate(name, row["title"], devices, calibration, plate, plate_m, sd_mm, row["remark"])


TEMPLATES = {name: _template(name, row) for name, row in TABLE["rigs"].items()}


def template_named(name: str) -> RigTemplate:
    """Return the rig of that name. Raises DeviceError for an unknown name."""
    if name not in TEMPLATES:
        raise DeviceError(f"no rig is named {name!r}; use {', '.join(TEMPLATES)}")
    return TEMPLATES[name]
