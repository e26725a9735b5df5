"""Inverse kinematics of two-bone limbs: arms that reach a target, legs that stand on a target."""

from typing import NamedTuple

import numba
import numpy as np

from annotate.array_types import Float64
from synth.body.flesh import Flesh
from synth.body.skeleton import DOWN, JOINT_ID, LIMITS_RAD, PARENTS, SIDES, SIGNS, Posture, clamp, kinematics

_SWIVELS_RAD = np.radians([0.0, 20.0, -20.0, 40.0, -40.0, 60.0, -60.0, 90.0, -90.0])  # tried in this order
_NEAR_M = 0.02  # m; a wrist this near to its place is there; untuned


class FootGoal(NamedTuple):
    """Goal of a leg in the world.

    rotation: (3, 3) of the foot, identity if flat with the toes as at rest. knee_out_rad: outward rotation of
    the knee from the foot's direction.
    """

    ankle_m: Float64
    rotation: Float64
    knee_out_rad: float


class _Limb(NamedTuple):
    """Posture, bent in place by changing ``angles_rad``. first: the bent limb's shoulder or hip."""

    angles_rad: Float64
    pelvis_m: Float64
    rest_joints_m: Float64
    aligned: Float64
    first: int


def reach(posture: Posture, flesh: Flesh, side: str, target_m: Float64, swivel_rad: float) -> Posture:
    """Bend one arm so that its wrist reaches ``target_m`` (world), or the nearest place within the limits.

    swivel_rad turns the elbow about the line from shoulder to wrist; 0 = elbow hanging straight down,
    positive = elbow away from the body. Two-bone closed form, then clamped.
    """
    limb = _limb(posture, flesh, f"{side}_shoulder")
    _reach(limb, target_m, swivel_rad)
    return Posture(clamp(limb.angles_rad), posture.pelvis_m)


def place_hand(posture: Posture, flesh: Flesh, side: str, target_m: Float64, swivel_rad: float) -> Posture:
    """Bend one arm as ``reach`` does, with a natural elbow, also for arms that hang or are raised.

    swivel_rad turns the elbow away from the body; 0 = behind an arm that hangs, below one stretched out, in
    front of one raised. Where the limits keep the wrist from its target, the nearest possible swivel is used.
    """
    limb = _limb(posture, flesh, f"{side}_shoulder")
    _place_hand(limb, target_m, swivel_rad)
    return Posture(clamp(limb.angles_rad), posture.pelvis_m)


def plant(posture: Posture, flesh: Flesh, side: str, goal: FootGoal) -> tuple[Posture, float]:
    """Bend one leg so that its foot reaches its goal, or the nearest place within the limits.

    Two-bone closed form, then clamped. Also returns the bend of the ankle (rad, at least 0) that the goal
    needs beyond the limit.
    """
    limb = _limb(posture, flesh, f"{side}_hip")
    beyond = _plant(limb, goal)
    return Posture(clamp(limb.angles_rad), posture.pelvis_m), beyond


def _limb(posture: Posture, flesh: Flesh, first: str) -> _Limb:
    angles = posture.angles_rad.copy()
    return _Limb(angles, posture.pelvis_m, flesh.rest_joints_m, flesh.aligned, JOINT_ID[first])


@numba.njit(cache=True)
def _reach(limb: _Limb, target_m: Float64, swivel_rad: float) -> None:
    _, frames, positions = kinematics(limb.angles_rad, limb.pelvis_m, limb.rest_joints_m, limb.aligned)
    line = target_m - positions[limb.first]
    along = line / np.linalg.norm(line)
    hinge = np.cross(DOWN, along)
    if np.linalg.norm(hinge) < 1e-6:
        hinge[0] = 1.0
    hinge = _about(along, SIDES[limb.first] * swivel_rad, hinge / np.linalg.norm(hinge))
    _bend(limb, frames, line, hinge)


@numba.njit(cache=True)
def _place_hand(limb: _Limb, target_m: Float64, swivel_rad: float) -> None:
    shoulder, rest, aligned = limb.first, limb.rest_joints_m, limb.aligned
    _, frames, positions = kinematics(limb.angles_rad, limb.pelvis_m, rest, aligned)
    side, parent = SIDES[shoulder], PARENTS[shoulder]
    line = target_m - positions[shoulder]
    along = line / np.linalg.norm(line)
    # The hinge lies across the trunk; the elbow of an arm stretched sideways points back and down.
    hinge = frames[parent] @ np.array([-1.0, -0.3 * side, -0.3 * side])
    hinge -= along * np.dot(along, hinge)
    hinge /= np.linalg.norm(hinge)
    best, least = limb.angles_rad.copy(), np.inf
    for more in _SWIVELS_RAD:
        tried = limb.angles_rad.copy()
        turned = _about(along, side * (swivel_rad + more), hinge)
        _bend(_Limb(tried, limb.pelvis_m, rest, aligned, shoulder), frames, line, turned)
        _clamp(tried, shoulder)
        _, _, joints = kinematics(tried, limb.pelvis_m, rest, aligned)
        off = float(np.linalg.norm(joints[shoulder + 2] - target_m))
        if off < least - 0.005:
            best, least = tried, off
        if least < _NEAR_M:
            break
    limb.angles_rad[:] = best


@numba.njit(cache=True)
def _bend(limb: _Limb, frames: Float64, line: Float64, hinge: Float64) -> None:
    """Turn shoulder and elbow so that the wrist reaches the end of ``line`` (3,), which starts at the
    shoulder. hinge: elbow axis.
    """
    along = line / np.linalg.norm(line)
    flexion, at_shoulder = _triangle(limb, line)
    upper_down = _about(hinge, -at_shoulder, along)
    # Columns: body x is the hinge reversed (flexion turns about -x), z points up the bone.
    turned = np.empty((3, 3))
    turned[:, 0], turned[:, 1], turned[:, 2] = -hinge, np.cross(upper_down, hinge), -upper_down
    _turn_first(limb, frames, turned)
    limb.angles_rad[limb.first + 1, 0] = flexion
    limb.angles_rad[limb.first + 1, 1] = 0.0


@numba.njit(cache=True)
def _plant(limb: _Limb, goal: FootGoal) -> float:
    angles, hip, knee, ankle = limb.angles_rad, limb.first, limb.first + 1, limb.first + 2
    _, frames, positions = kinematics(angles, limb.pelvis_m, limb.rest_joints_m, limb.aligned)
    line = goal.ankle_m - positions[hip]
    along = line / np.linalg.norm(line)
    flexion, at_hip = _triangle(limb, line)
    # The knee points with the toes and upwards, so that its direction stays defined for a raised leg.
    up = np.array([0.0, 0.0, 1.0])
    toes = _about(up, SIDES[hip] * goal.knee_out_rad, np.ascontiguousarray(-goal.rotation[:, 1]))
    hinge = np.cross(toes - toes[2] * up + up, along)
    hinge /= np.linalg.norm(hinge)
    thigh_down = _about(hinge, -at_hip, along)
    turned = np.empty((3, 3))
    turned[:, 0], turned[:, 1], turned[:, 2] = hinge, np.cross(hinge, thigh_down), -thigh_down
    _turn_first(limb, frames, turned)
    _clamp(angles, hip)
    angles[knee, 0] = -flexion
    angles[ankle] = 0.0
    _, frames, _ = kinematics(angles, limb.pelvis_m, limb.rest_joints_m, limb.aligned)
    level = np.ascontiguousarray(frames[ankle].T) @ goal.rotation
    angles[ankle] = _euler_inside(level, SIGNS[ankle], LIMITS_RAD[ankle])
    return float(max(angles[ankle, 0] - LIMITS_RAD[ankle, 0, 1], 0.0))


@numba.njit(cache=True)
def _triangle(limb: _Limb, line: Float64) -> tuple[float, float]:
    """Return the middle joint's flexion, and the angle of first bone and line (law of cosines), rad."""
    rest, first = limb.rest_joints_m, limb.first
    upper = np.linalg.norm(rest[first + 1] - rest[first])
    lower = np.linalg.norm(rest[first + 2] - rest[first + 1])
    distance = min(max(np.linalg.norm(line), abs(upper - lower) + 1e-3), 0.999 * (upper + lower))
    flexion = np.pi - np.arccos((upper**2 + lower**2 - distance**2) / (2 * upper * lower))
    return flexion, np.arctan2(lower * np.sin(flexion), upper + lower * np.cos(flexion))


@numba.njit(cache=True)
def _turn_first(limb: _Limb, frames: Float64, turned: Float64) -> None:
    parent = PARENTS[limb.first]
    before = frames[parent] @ np.ascontiguousarray(limb.aligned[parent].T)
    local = np.ascontiguousarray(before.T) @ turned
    limb.angles_rad[limb.first] = _euler_inside(local, SIGNS[limb.first], LIMITS_RAD[limb.first])


@numba.njit(cache=True)
def _clamp(angles_rad: Float64, joint: int) -> None:
    for a in range(3):
        low, high = LIMITS_RAD[joint, a]
        angles_rad[joint, a] = min(max(angles_rad[joint, a], low), high)


@numba.njit(cache=True)
def _about(axis: Float64, angle: float, vector: Float64) -> Float64:
    turned: Float64 = (
        vector * np.cos(angle)
        + np.cross(axis, vector) * np.sin(angle)
        + axis * np.dot(axis, vector) * (1 - np.cos(angle))
    )
    return turned


@numba.njit(cache=True)
def _euler_inside(rotation: Float64, signs: Float64, limits_rad: Float64) -> Float64:
    """Return, of a rotation's two XYZ angle triples, the triple that exceeds the limits least."""
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
