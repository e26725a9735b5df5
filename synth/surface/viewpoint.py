"""Where a camera stands and what it looks at. World frame: z up, metres; the person faces -y."""

import numpy as np
from scipy.spatial.transform import Rotation

from annotate.array_types import Float64
from sensors.rig.rig_calibration import Pose


def look_at(eye_m: Float64, target_m: Float64, roll_rad: float = 0.0) -> Pose:
    """``camera_from_world`` of a camera at ``eye_m`` looking at ``target_m``; x is level but for roll."""
    forward = (target_m - eye_m) / np.linalg.norm(target_m - eye_m)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    if np.linalg.norm(right) < 1e-6:
        right = np.array([1.0, 0.0, 0.0])
    right = right / np.linalg.norm(right)
    level = np.stack([right, np.cross(forward, right), forward])
    rotation = Rotation.from_euler("z", roll_rad).as_matrix() @ level
    return Pose(rotation, -rotation @ eye_m)


def beside(centre_m: Float64, azimuth_rad: float, distance_m: float, height_m: float) -> Float64:
    """A place (3,) so far from a centre (3,) on the level, at a height; azimuth 0 is before the person."""
    place = centre_m + distance_m * np.array([np.sin(azimuth_rad), -np.cos(azimuth_rad), 0.0])
    place[2] = height_m
    return place
