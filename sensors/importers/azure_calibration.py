"""The factory calibration of an Azure Kinect (JSON), brought to one depth and colour mode.

Formulas and tables: Azure-Kinect-Sensor-SDK, src/transformation/mode_specific_calibration.c (MIT).
"""

import json
from typing import Any

import numpy as np

from sensors.calibration_files.lens_models import intrinsics_from_rational
from sensors.errors import CalibrationError, fault_of
from sensors.rig.camera import Intrinsics
from sensors.rig.rig_calibration import Pose, RigCalibration

DEPTH_MODES = {
    (640, 576): (1024, 192, 180),
    (320, 288): (512, 96, 90),
    (1024, 1024): (1024, 0, 0),
    (512, 512): (512, 0, 0),
}
"""By image size: the side in pixels of the calibrated square image, and the mode's left and top in it."""


def calibration_from_factory(
    data: bytes, depth_size: tuple[int, int], color_size: tuple[int, int] | None, mode: str
) -> RigCalibration:
    """Return a rig's calibration for images of these sizes (width, height). Raises CalibrationError for an
    unknown mode or malformed data.
    """
    if depth_size not in DEPTH_MODES:
        size = "x".join(map(str, depth_size))
        raise CalibrationError(
            f"depth images have {size} pixels (mode {mode[:40]!r}), which no depth mode has; "
            "record with k4arecorder"
        )
    try:
        entries = json.loads(data.rstrip(b"\0"))["CalibrationInformation"]["Cameras"]
        cameras = {entry["Purpose"].removeprefix("CALIBRATION_CameraPurpose"): entry for entry in entries}
        side, left, top = DEPTH_MODES[depth_size]
        depth = _lens(cameras["Depth"], (side, side), (left, top), depth_size)
        if color_size is None:
            return RigCalibration(depth)
        color = _color_lens(cameras["PhotoVideo"], color_size)
        color_from_depth = _pose(cameras["PhotoVideo"]) @ _pose(cameras["Depth"]).inverse()
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError, OverflowError) as error:
        message = f"calibration.json of the recording is malformed ({fault_of(error)}); record it again"
        raise CalibrationError(message) from error
    return RigCalibration(depth, color, color_from_depth)


def _color_lens(entry: dict[str, Any], size: tuple[int, int]) -> Intrinsics:
    """Return the colour lens with the sensor's image width; a 16:9 image is the middle of the 4:3 image."""
    width, height = size
    full = round(width * 3 / 4)
    if not 0 < height <= full:
        raise ValueError(f"colour images of {width}x{height} are higher than 4:3")
    legacy = entry["SensorWidth"] * 9 == entry["SensorHeight"] * 16
    calibrated = round(width * 9 / 16) if legacy else full
    return _lens(entry, (width, calibrated), (0, (calibrated - height) // 2), size)


def _lens(
    entry: dict[str, Any], calibrated: tuple[int, int], crop: tuple[int, int], size: tuple[int, int]
) -> Intrinsics:
    """Convert intrinsics of a unit square to pixels of a cropped image, pixel centres at whole numbers."""
    lens = entry["Intrinsics"]
    if lens["ModelType"] != "CALIBRATION_LensDistortionModelBrownConrady":
        raise CalibrationError(
            f"calibration.json of the recording has lens model {str(lens['ModelType'])[:60]!r}, not "
            "Brown-Conrady; record with k4arecorder"
        )
    cx, cy, fx, fy, k1, k2, k3, k4, k5, k6, _, _, p2, p1 = (float(x) for x in lens["ModelParameters"][:14])
    (width, height), (left, top) = calibrated, crop
    fx, cx, fy, cy = fx * width, cx * width - left - 0.5, fy * height, cy * height - top - 0.5
    if not (np.isfinite([fx, cx, fy, cy]).all() and fx > 0 and fy > 0):
        raise ValueError(f"fx, cx, fy, cy are {fx:g}, {cx:g}, {fy:g}, {cy:g}")
    matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    return intrinsics_from_rational(size, matrix, np.array([k1, k2, p1, p2, k3, k4, k5, k6]))


def _pose(entry: dict[str, Any]) -> Pose:
    rotation, translation = (np.array(entry["Rt"][part], np.float64) for part in ("Rotation", "Translation"))
    return Pose(rotation.reshape(3, 3), translation)
