"""Inverse kinematics of limbs of two bones: the reach of an arm, the stand of a leg."""

import numba
import numpy as np

from annotate.array_types import Float64
from synth.body.skeleton import DOWN, JOINT_ID, LIMITS_RAD, PARENTS, SIDES, SIGNS, Posture, clamp, kinematics


def reach(
    posture: Posture,
    rest_joints_m: Float64,
    aligned: Float64,
    side: str,
    target_m: Float64,
    swivel_rad: float,
) -> Posture:
    """Bend one arm so that its wrist comes to ``target_m`` (world), or as near as the limits allow.

    swivel_rad turns the elbow about the line from shoulder to wrist; 0 = elbow hanging straight down,
    positive = elbow away from the body. Two-bone closed form, then clamped.
    """
    angles = posture.angles_rad.copy()
    shoulder = JOINT_ID[f"{side}_shoulder"]
    _reach(angles, posture.pelvis_m, rest_joints_m, aligned, shoulder, target_m, swivel_rad)
    return Posture(clamp(angles), posture.pelvis_m)


@numba.njit(cache=True)
def _reach(
    angles_rad: Float64, pelvis_m: Float64, rest_joints_m: Float64, aligned: Float64,
    shoulder: int, target_m: Float64, swivel_rad: float,
) -> None:  # fmt: skip
    _, frames, positions = kinematics(angles_rad, pelvis_m, rest_joints_m, aligned)
    line = target_m - positions[shoulder]
    along = line / np.linalg.norm(line)
    hinge = np.cross(DOWN, along)
    if np.linalg.norm(hinge) < 1e-6:
        hinge[0] = 1.0
    hinge = _about(along, SIDES[shoulder] * swivel_rad, hinge / np.linalg.norm(hinge))
    _bend(angles_rad, rest_joints_m, frames, aligned, shoulder, line, hinge)


def place_hand(
    posture: Posture,
    rest_joints_m: Float64,
    aligned: Float64,
    side: str,
    target_m: Float64,
    swivel_rad: float,
) -> Posture:
    """Bend one arm as ``reach`` does, the elbow where it is natural: also for arms that hang or rise.

    swivel_rad turns the elbow away from the body; 0 = behind an arm that hangs, below one stretched out,
    before one raised. Where the limits keep the wrist from its place, the nearest swivel that lets it come.
    """
    angles = posture.angles_rad.copy()
    shoulder = JOINT_ID[f"{side}_shoulder"]
    _place_hand(angles, posture.pelvis_m, rest_joints_m, aligned, shoulder, target_m, swivel_rad)
    return Posture(clamp(angles), posture.pelvis_m)


_SWIVELS_RAD = np.radians([0.0, 20.0, -20.0, 40.0, -40.0, 60.0, -60.0, 90.0, -90.0])
"""Tried in this order. Chosen by eye."""
_NEAR_M = 0.02
"""Of its place, a wrist is there. Chosen by eye."""


@numba.njit(cache=True)
def _place_hand(
    angles_rad: Float64, pelvis_m: Float64, rest_joints_m: Float64, aligned: Float64,
    shoulder: int, target_m: Float64, swivel_rad: float,
) -> None:  # fmt: skip
    _, frames, positions = kinematics(angles_rad, pelvis_m, rest_joints_m, aligned)
    side, parent = SIDES[shoulder], PARENTS[shoulder]
    line = target_m - positions[shoulder]
    along = line / np.linalg.norm(line)
    # The hinge lies across the trunk; the elbow of an arm stretched sideways looks back and down.
    hinge = frames[parent] @ np.array([-1.0, -0.3 * side, -0.3 * side])
    hinge -= along * np.dot(along, hinge)
    hinge /= np.linalg.norm(hinge)
    best, least = angles_rad.copy(), np.inf
    for more in _SWIVELS_RAD:
        tried = angles_rad.copy()
        turned = _about(along, side * (swivel_rad + more), hinge)
        _bend(tried, rest_joints_m, frames, aligned, shoulder, line, turned)
        for a in range(3):
            low, high = LIMITS_RAD[shoulder, a]
            tried[shoulder, a] = min(max(tried[shoulder, a], low), high)
        _, _, joints = kinematics(tried, pelvis_m, rest_joints_m, aligned)
        off = float(np.linalg.norm(joints[shoulder + 2] - target_m))
        if off < least - 0.005:
            best, least = tried, off
        if least < _NEAR_M:
            break
    angles_rad[:] = best


@numba.njit(cache=True)
def _bend(
    angles_rad: Float64, rest_joints_m: Float64, frames: Float64, aligned: Float64,
    shoulder: int, line: Float64, hinge: Float64,
) -> None:  # fmt: skip
    """Turn shoulder and elbow so that the wrist comes along a line (3,) from the shoulder, about a hinge."""
    elbow, wrist, parent = shoulder + 1, shoulder + 2, PARENTS[shoulder]
    upper = np.linalg.norm(rest_joints_m[elbow] - rest_joints_m[shoulder])
    fore = np.linalg.norm(rest_joints_m[wrist] - rest_joints_m[elbow])
    along = line / np.linalg.norm(line)
    distance = min(max(np.linalg.norm(line), abs(upper - fore) + 1e-3), 0.999 * (upper + fore))
    flexion = np.pi - np.arccos((upper**2 + fore**2 - distance**2) / (2 * upper * fore))
    at_shoulder = np.arctan2(fore * np.sin(flexion), upper + fore * np.cos(flexion))
    upper_down = _about(hinge, -at_shoulder, along)
    # Columns: body x is the hinge reversed (flexion turns about -x), z points up the bone.
    turned = np.empty((3, 3))
    turned[:, 0], turned[:, 1], turned[:, 2] = -hinge, np.cross(upper_down, hinge), -upper_down
    before = frames[parent] @ np.ascontiguousarray(aligned[parent].T)
    local = np.ascontiguousarray(before.T) @ turned
    angles_rad[shoulder] = _euler_inside(local, SIGNS[shoulder], LIMITS_RAD[shoulder])
    angles_rad[elbow, 0] = flexion
    angles_rad[elbow, 1] = 0.0


def plant(
    posture: Posture,
    rest_joints_m: Float64,
    aligned: Float64,
    side: str,
    ankle_m: Float64,
    foot: Float64,
    knee_out_rad: float,
) -> tuple[Posture, float]:
    """Bend one leg so that its ankle comes to ``ankle_m`` (world), or as near as the limits allow.

    foot: rotation (3, 3) of the foot in the world, identity on a level floor with the toes as at rest.
    knee_out_rad turns the knee from the foot's direction outwards. Two-bone closed form, then clamped. Also
    returned: by how much (rad, at least 0) the ankle would have to bend beyond its limit for that.
    """
    angles = posture.angles_rad.copy()
    hip = JOINT_ID[f"{side}_hip"]
    beyond = _plant(angles, posture.pelvis_m, rest_joints_m, aligned, hip, ankle_m, foot, knee_out_rad)
    return Posture(clamp(angles), posture.pelvis_m), beyond


@numba.njit(cache=True)
def _plant(
    angles_rad: Float64, pelvis_m: Float64, rest_joints_m: Float64, aligned: Float64,
    hip: int, ankle_m: Float64, foot: Float64, knee_out_rad: float,
) -> float:  # fmt: skip
    knee, ankle, parent = hip + 1, hip + 2, PARENTS[hip]
    _, frames, positions = kinematics(angles_rad, pelvis_m, rest_joints_m, aligned)
    thigh = np.linalg.norm(rest_joints_m[knee] - rest_joints_m[hip])
    shank = np.linalg.norm(rest_joints_m[ankle] - rest_joints_m[knee])
    line = ankle_m - positions[hip]
    along = line / np.linalg.norm(line)
    distance = min(max(np.linalg.norm(line), abs(thigh - shank) + 1e-3), 0.999 * (thigh + shank))
    flexion = np.pi - np.arccos((thigh**2 + shank**2 - distance**2) / (2 * thigh * shank))
    at_hip = np.arctan2(shank * np.sin(flexion), thigh + shank * np.cos(flexion))
    # Where the knee points: with the toes and upwards, so that it stays defined for a raised leg.
    up = np.array([0.0, 0.0, 1.0])
    toes = _about(up, SIDES[hip] * knee_out_rad, np.ascontiguousarray(-foot[:, 1]))
    hinge = np.cross(toes - toes[2] * up + up, along)
    hinge /= np.linalg.norm(hinge)
    thigh_down = _about(hinge, -at_hip, along)
    turned = np.empty((3, 3))
    turned[:, 0], turned[:, 1], turned[:, 2] = hinge, np.cross(hinge, thigh_down), -thigh_down
    before = frames[parent] @ np.ascontiguousarray(aligned[parent].T)
    angles_rad[hip] = _euler_inside(np.ascontiguousarray(before.T) @ turned, SIGNS[hip], LIMITS_RAD[hip])
    for a in range(3):
        angles_rad[hip, a] = min(max(angles_rad[hip, a], LIMITS_RAD[hip, a, 0]), LIMITS_RAD[hip, a, 1])
    angles_rad[knee, 0] = -flexion
    angles_rad[ankle] = 0.0
    _, frames, _ = kinematics(angles_rad, pelvis_m, rest_joints_m, aligned)
    level = np.ascontiguousarray(frames[ankle].T) @ foot
    angles_rad[ankle] = _euler_inside(level, SIGNS[ankle], LIMITS_RAD[ankle])
    return float(max(angles_rad[ankle, 0] - LIMITS_RAD[ankle, 0, 1], 0.0))


@numba.njit(cache=True)
def _about(axis: Float64, angle: float, vector: Float64) -> Float64:
    """A vector turned about a unit axis (Rodrigues)."""
    turned: Float64 = (
        vector * np.cos(angle)
        + np.cross(axis, vector) * np.sin(angle)
        + axis * np.dot(axis, vector) * (1 - np.cos(angle))
    )
    return turned


@numba.njit(cache=True)
def _euler_inside(rotation: Float64, signs: Float64, limits_rad: Float64) -> Float64:
    """The one of a rotation's two XYZ angle triples that leaves the limits least."""
    best, least = np.zeros(3), np.inf
    y = np.arcsin(min(max(rotation[0, 2], -1.0), 1.0))
    x, z = np.arctan2(-rotation[1, 2], rotation[2, 2]), np.arctan2(-rotation[0, 1], rotation[0, 0])
    for other in range(2):
        triple = np.array([x + other * np.pi, (np.pi - y) if other else y, z + other * np.pi]) * signs
        triple -= 2 * np.pi * np.rint(triple / (2 * np.pi))
        beyond = np.maximum(limits_rad[:, 0] - triple, 0) + np.maximum(triple - limits_rad[:, 1], 0)
        if np.sum(beyond) < least - 1e-9:
            best, least = triple, np.sum(beyond)
    return best
