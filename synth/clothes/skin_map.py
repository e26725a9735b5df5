"""Cylindrical coordinates of a skin's vertices about limbs and trunk."""

from enum import IntEnum
from typing import NamedTuple

import numba
import numpy as np

from annotate.array_types import Float32, Float64, UInt8
from synth.body.body import Body
from synth.body.skeleton import JOINT_ID, JOINTS
from synth.surface.rasterize import EXACT

Limb = IntEnum("Limb", "TRUNK HEAD LEFT_ARM RIGHT_ARM LEFT_LEG RIGHT_LEG", start=0)
ARMS, LEGS = (Limb.LEFT_ARM, Limb.RIGHT_ARM), (Limb.LEFT_LEG, Limb.RIGHT_LEG)
_BONES = {"arm": ("shoulder", "elbow", "wrist"), "leg": ("hip", "knee", "ankle")}
_SPINE = ("pelvis", "spine_lower", "spine_middle", "spine_upper", "neck")
TRUNK_FORWARD_M = 0.02  # from the spine to the trunk's middle; untuned


def _limb_of(name: str) -> Limb:
    side, _, kind = name.partition("_")
    for limb, bones in _BONES.items():
        if kind in bones:
            return Limb[f"{side}_{limb}".upper()]
    return Limb.HEAD if name in ("neck", "head") else Limb.TRUNK


_LIMB_OF_JOINT = np.array([_limb_of(joint.name) for joint in JOINTS], np.uint8)


class Cylindrical(NamedTuple):
    """Cylindrical coordinates of vertices (V,) about an axis: distance, direction (V, 3), and angle.

    around_rad: 0 in front, a quarter turn on the person's left.
    """

    away_m: Float32
    out: Float32
    around_rad: Float32


class SkinMap(NamedTuple):
    """Coordinates of a body's vertices (V,) on its limbs and trunk at rest.

    limb: limb of the joint with the largest weight. along: 0 at shoulder or hip, 1 at elbow or knee, 2 at
    wrist or ankle; on the trunk equal to level. level: height, 0 at the hips, 1 at the neck. limbs:
    cylindrical about the bones of arms and legs, elsewhere as trunk. trunk: cylindrical about the trunk, for
    all vertices.
    """

    limb: UInt8
    along: Float32
    level: Float32
    limbs: Cylindrical
    trunk: Cylindrical


def skin_map(body: Body) -> SkinMap:
    """Return the coordinates of a body's skin."""
    limb, at = _LIMB_OF_JOINT[body.strongest_joints], {n: body.joints_m[i] for n, i in JOINT_ID.items()}
    points, hip_z = body.vertices_m, at["left_hip"][2]
    level = (points[:, 2] - np.float32(hip_z)) / np.float32(at["neck"][2] - hip_z)
    spine = np.array([at[name] for name in _SPINE])
    middle = np.interp(points[:, 2], spine[:, 2], spine[:, 1]) - TRUNK_FORWARD_M
    trunk = _about_upright(points, middle)
    chains = np.zeros((len(Limb), 3, 3))
    for one in (*ARMS, *LEGS):
        side, _, which = one.name.lower().partition("_")
        chains[one] = [at[f"{side}_{bone}"] for bone in _BONES[which]]
    along = level.copy()
    limbs = Cylindrical(*(a.copy() for a in trunk))
    _about_limbs(points, limb, chains, along, limbs)
    return SkinMap(limb, along, level, limbs, trunk)


def _about_upright(points: Float32, middle_y: Float64) -> Cylindrical:
    x, y = points[:, 0], (points[:, 1] - middle_y).astype(np.float32)
    away = np.hypot(x, y)
    near = np.maximum(away, np.float32(1e-6))
    return Cylindrical(away, np.stack([x / near, y / near, np.zeros_like(x)], axis=1), np.arctan2(x, -y))


@numba.njit(cache=True, fastmath=EXACT)
def _about_limbs(points: Float32, limb: UInt8, chains: Float64, along: Float32, limbs: Cylindrical) -> None:
    """Write the coordinates of the vertices of arms and legs into ``along`` and ``limbs``."""
    away, out, around = limbs
    bones, lengths = np.empty((len(chains), 2, 3)), np.empty((len(chains), 2))
    for c in range(2, len(chains)):
        for k in range(2):
            bone = chains[c, k + 1] - chains[c, k]
            lengths[c, k] = np.sqrt((bone**2).sum())
            bones[c, k] = bone / lengths[c, k]
    for i in range(len(points)):
        c = limb[i]
        if c < 2:
            continue
        k, beyond = 0, 0.0
        for a in range(3):
            beyond += (points[i, a] - chains[c, 1, a]) * (bones[c, 0, a] + bones[c, 1, a])
        if beyond > 0:
            k = 1
        bx, by, bz = bones[c, k]
        joint = chains[c, k]
        x, y, z = points[i, 0] - joint[0], points[i, 1] - joint[1], points[i, 2] - joint[2]
        reach = x * bx + y * by + z * bz
        x, y, z = x - reach * bx, y - reach * by, z - reach * bz
        length = np.sqrt(x * x + y * y + z * z) + 1e-9
        along[i], away[i] = k + reach / lengths[c, k], length
        out[i, 0], out[i, 1], out[i, 2] = x / length, y / length, z / length
        # Axes to the left and in front, across the bone (limbs point down).
        sx, sy, sz = 1 - bx * bx, -bx * by, -bx * bz
        fx, fy, fz = by * sz - bz * sy, bz * sx - bx * sz, bx * sy - by * sx
        around[i] = np.arctan2(x * sx + y * sy + z * sz, x * fx + y * fy + z * fz)
