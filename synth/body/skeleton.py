"""The paper's skeleton: joints, their limits and forward kinematics.

Body frame in anatomical zero (standing, arms hanging): x to the person's left, y back, z up, metres. A
joint's angle triple is (flexion, abduction, axial rotation), radians. A limb turns by Rx(-flexion) Ry(-side *
abduction) Rz(side * rotation), the trunk by Rx(+flexion). So flexion is forwards everywhere (a knee's is
negative), and equal numbers are equal movements on both sides. side is +1 left, -1 right; trunk joints count
as left.
"""

import warnings
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numba
import numpy as np

from annotate.array_types import Float64

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation


@dataclass(frozen=True)
class Joint:
    """Joint with its parent's index (-1 root), side, and limits in degrees of its three angles."""

    name: str
    parent: int
    side: int
    limits_deg: tuple[tuple[float, float], tuple[float, float], tuple[float, float]]

    @property
    def kind(self) -> str:
        """Return the joint's name without the side, a key of ``synth/data/joints.toml``."""
        return self.name.removeprefix("left_").removeprefix("right_")


_FREE = ((-180.0, 180.0), (-180.0, 180.0), (-180.0, 180.0))
# Norkin & White, Measurement of Joint Motion (2016), appendix of AAOS ranges; the trunk's ranges are
# shared out over three spine joints, the clavicle's over elevation and protraction.
_SPINE = ((-12.0, 30.0), (-14.0, 14.0), (-16.0, 16.0))
_NECK = ((-30.0, 30.0), (-23.0, 23.0), (-40.0, 40.0))
_CLAVICLE = ((-10.0, 20.0), (-10.0, 35.0), (-15.0, 15.0))
_SHOULDER = ((-60.0, 180.0), (-45.0, 180.0), (-90.0, 90.0))
_ELBOW = ((0.0, 150.0), (-8.0, 8.0), (-85.0, 85.0))
_WRIST = ((-70.0, 80.0), (-20.0, 30.0), (0.0, 0.0))
_HIP = ((-25.0, 125.0), (-30.0, 50.0), (-45.0, 45.0))
_KNEE = ((-145.0, 5.0), (-5.0, 5.0), (-25.0, 25.0))
# Bearing weight, the ankle bends 43 degrees and more (Bennell 1998, lunge test); AAOS measures it free.
_ANKLE = ((-50.0, 45.0), (-20.0, 35.0), (-10.0, 10.0))


def _build() -> tuple[Joint, ...]:
    joints = [
        Joint("pelvis", -1, 1, _FREE),
        Joint("spine_lower", 0, 1, _SPINE),
        Joint("spine_middle", 1, 1, _SPINE),
        Joint("spine_upper", 2, 1, _SPINE),
        Joint("neck", 3, 1, _NECK),
        Joint("head", 4, 1, _NECK),
    ]
    for side, sign in (("left", 1), ("right", -1)):
        first = len(joints)
        joints += [
            Joint(f"{side}_clavicle", 3, sign, _CLAVICLE),
            Joint(f"{side}_shoulder", first, sign, _SHOULDER),
            Joint(f"{side}_elbow", first + 1, sign, _ELBOW),
            Joint(f"{side}_wrist", first + 2, sign, _WRIST),
            Joint(f"{side}_hip", 0, sign, _HIP),
            Joint(f"{side}_knee", first + 4, sign, _KNEE),
            Joint(f"{side}_ankle", first + 5, sign, _ANKLE),
        ]
    return tuple(joints)


JOINTS = _build()
JOINT_ID = {joint.name: i for i, joint in enumerate(JOINTS)}
N_JOINTS = len(JOINTS)
PARENTS = np.array([joint.parent for joint in JOINTS])
SIDES = np.array([joint.side for joint in JOINTS])
LIMITS_RAD = np.radians([joint.limits_deg for joint in JOINTS])  # (J, 3, 2): low and high of each angle

_TRUNK = ("pelvis", "spine_lower", "spine_middle", "spine_upper", "neck", "head")
# (J, 3): the sense in which each angle of a joint turns about its axis
SIGNS = np.stack([np.where([j.name in _TRUNK for j in JOINTS], 1, -1), -SIDES, SIDES], axis=1)

DOWN = np.array([0.0, 0.0, -1.0])


_CHILD = np.array(
    [i + 1 if joint.kind in ("shoulder", "elbow", "hip", "knee") else -1 for i, joint in enumerate(JOINTS)]
)
_FOLLOWS = np.array([joint.name.endswith(("elbow", "knee", "wrist")) for joint in JOINTS])


@dataclass(frozen=True)
class Posture:
    """Joint angles float64 (J, 3), whose pelvis row is the body's orientation, and the pelvis' position
    float64 (3,), world, z up.
    """

    angles_rad: Float64
    pelvis_m: Float64

    @staticmethod
    def zero() -> "Posture":
        """Return the posture of anatomical zero with the pelvis at the origin."""
        return Posture(np.zeros((N_JOINTS, 3)), np.zeros(3))


def rotations(angles_rad: Float64) -> Float64:
    """Return joint rotation matrices (J, 3, 3) of intrinsic x-y-z Euler angles (J, 3), in radians.

    ``SIGNS`` gives each angle its direction, so that left and right joints take equal angles.
    """
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_euler("XYZ", angles_rad * SIGNS).as_matrix())


def clamp(angles_rad: Float64) -> Float64:
    """Clip angles (J, 3) to the joints' limits."""
    return np.clip(angles_rad, LIMITS_RAD[..., 0], LIMITS_RAD[..., 1])


@numba.njit(cache=True)
def alignment(rest_joints_m: Float64) -> Float64:
    """Return rotations (J, 3, 3) that bring a body's rest limbs to anatomical zero, limbs hanging down.

    rest_joints_m: (J, 3) joints in the rest pose. Feet and trunk stay as they rest. A forearm follows its
    upper arm first, so that the elbow straightens about its own hinge.
    """
    result = np.empty((N_JOINTS, 3, 3))
    for i in range(N_JOINTS):
        result[i] = result[PARENTS[i]] if _FOLLOWS[i] else np.eye(3)
        if _CHILD[i] >= 0:
            bone = result[i] @ (rest_joints_m[_CHILD[i]] - rest_joints_m[i])
            result[i] = shortest_arc(bone, DOWN) @ result[i]
    return result


def forward(posture: Posture, rest_joints_m: Float64, aligned: Float64) -> tuple[Float64, Float64]:
    """Place the skeleton of one body in the world.

    rest_joints_m: (J, 3); aligned: ``alignment`` of them. Returns frames (J, 3, 3), which turn rest-pose
    directions of a segment to the world, and the joints (J, 3), metres.
    """
    _, frames, positions = kinematics(posture.angles_rad, posture.pelvis_m, rest_joints_m, aligned)
    return frames, positions


@numba.njit(cache=True)
def kinematics(
    angles_rad: Float64, pelvis_m: Float64, rest_joints_m: Float64, aligned: Float64
) -> tuple[Float64, Float64, Float64]:
    """Return axes, and frames and positions as ``forward`` does, for calls from compiled code.

    axes (J, 3, 3): row a of a joint is the world axis of its angle a, which turns the whole chain beyond the
    joint.
    """
    turned = np.empty((N_JOINTS, 3, 3))
    frames = np.empty((N_JOINTS, 3, 3))
    axes = np.empty((N_JOINTS, 3, 3))
    positions = np.empty((N_JOINTS, 3))
    for i in range(N_JOINTS):
        parent, own = PARENTS[i], turned[i]
        if parent < 0:
            positions[i] = pelvis_m
            own[:] = np.eye(3)
        else:
            place(positions[i], positions[parent], frames[parent], rest_joints_m[i], rest_joints_m[parent])
            own[:] = turned[parent]
        for a in range(3):
            # The axes of XYZ Euler angles are columns of the frame turned so far.
            sign, b, c = SIGNS[i, a], (a + 1) % 3, (a + 2) % 3
            cosine, sine = np.cos(sign * angles_rad[i, a]), np.sin(sign * angles_rad[i, a])
            for r in range(3):
                axes[i, a, r] = sign * own[r, a]
                x, y = own[r, b], own[r, c]
                own[r, b], own[r, c] = x * cosine + y * sine, y * cosine - x * sine
        for r in range(3):
            x, y, z = own[r]
            for c in range(3):
                frames[i, r, c] = x * aligned[i, 0, c] + y * aligned[i, 1, c] + z * aligned[i, 2, c]
    return axes, frames, positions


@numba.njit(cache=True)
def place(where: Float64, origin: Float64, frame: Float64, point: Float64, rest: Float64) -> None:
    """Write into ``where`` (3,) the position of a rest point (3,) that follows a joint.

    origin: (3,) the joint's position; frame: (3, 3) its rotation; rest: (3,) its position at rest.
    """
    x, y, z = point[0] - rest[0], point[1] - rest[1], point[2] - rest[2]
    for r in range(3):
        where[r] = origin[r] + (frame[r, 0] * x + frame[r, 1] * y + frame[r, 2] * z)


@numba.njit(cache=True)
def turn(axis: int, angle: float) -> Float64:
    """Return the rotation matrix about one coordinate axis."""
    result = np.zeros((3, 3))
    b, c = (axis + 1) % 3, (axis + 2) % 3
    result[axis, axis] = 1.0
    result[b, b] = result[c, c] = np.cos(angle)
    result[c, b] = np.sin(angle)
    result[b, c] = -result[c, b]
    return result


@numba.njit(cache=True)
def shortest_arc(source: Float64, target: Float64) -> Float64:
    """Return the rotation matrix of least angle that turns ``source`` to ``target``."""
    a, b = source / np.linalg.norm(source), target / np.linalg.norm(target)
    cosine, axis = np.dot(a, b), np.cross(a, b)
    if cosine < -1 + 1e-9:
        # Half a turn about any direction across.
        other = np.zeros(3)
        other[0 if abs(a[0]) < 0.9 else 1] = 1.0
        axis = np.cross(a, other)
        axis /= np.linalg.norm(axis)
        turned: Float64 = 2 * axis.reshape(3, 1) * axis - np.eye(3)
        return turned
    skew = np.array([[0.0, -axis[2], axis[1]], [axis[2], 0.0, -axis[0]], [-axis[1], axis[0], 0.0]])
    matrix: Float64 = np.eye(3) + skew + skew @ skew / (1 + cosine)
    return matrix


def euler_rad(turn: "Rotation") -> Float64:
    """Return the XYZ angles (..., 3) of a rotation; the third is 0 where the second is a right angle."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        return np.asarray(turn.as_euler("XYZ"))
