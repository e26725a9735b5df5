"""Statistics of a standing person's joints (J, 3) of ``synth.body.skeleton``, millimetres."""

import numpy as np

from annotate.array_types import Float64
from synth.body.skeleton import JOINT_ID
from synth.surface.facets import cross

STRAIGHT_DEG = 30.0  # knees bent less are straight; a tracker's noise reaches 20 degrees; untuned
_SIDES = ("left", "right")


def ankles_m(joints_mm: Float64) -> float:
    """Return the distance between the ankles, metres; NaN if a knee is bent by ``STRAIGHT_DEG`` or more."""
    for side in _SIDES:
        thigh, shank = _bone(joints_mm, f"{side}_hip", f"{side}_knee", f"{side}_ankle")
        if not _angle_deg(thigh, shank) < STRAIGHT_DEG:
            return float("nan")
    left, right = (joints_mm[JOINT_ID[f"{side}_ankle"]] for side in _SIDES)
    return float(np.linalg.norm(left - right)) / 1000


def arms_deg(joints_mm: Float64) -> Float64:
    """Return the angles (2,), degrees, of left and right upper arm with the line from neck to pelvis."""
    (trunk,) = _bone(joints_mm, "neck", "pelvis")
    arms = [_bone(joints_mm, f"{side}_shoulder", f"{side}_elbow")[0] for side in _SIDES]
    return np.array([_angle_deg(arm, trunk) for arm in arms])


def facing_deg(joints_mm: Float64, across: tuple[str, ...] = ("shoulder", "hip")) -> float:
    """Return the camera's azimuth about the trunk, degrees: 0 in front of the chest, 90 on the person's left.

    joints_mm: camera frame. across: pairs of joints that give the direction from right to left.
    """
    pelvis = joints_mm[JOINT_ID["pelvis"]]
    up = joints_mm[JOINT_ID["neck"]] - pelvis
    left = sum(joints_mm[JOINT_ID[f"left_{kind}"]] - joints_mm[JOINT_ID[f"right_{kind}"]] for kind in across)
    forward = np.array(cross(tuple(left), tuple(up)))
    leftward = left - up * (left @ up) / (up @ up)
    x, y = (-pelvis @ axis / np.sqrt(axis @ axis) for axis in (leftward, forward))
    return float(np.degrees(np.arctan2(x, y)))


def _bone(joints_mm: Float64, *names: str) -> Float64:
    return np.diff(joints_mm[[JOINT_ID[name] for name in names]], axis=0)


def _angle_deg(a: Float64, b: Float64) -> float:
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)))
