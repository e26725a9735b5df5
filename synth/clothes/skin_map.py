"""Where each vertex of a skin lies: on which limb, how far along it, around it, away from its axis."""

from enum import IntEnum
from typing import NamedTuple

import numpy as np

from annotate.array_types import Float32, Float64, UInt8
from synth.body.body import Body
from synth.body.skeleton import JOINT_ID, JOINTS

Limb = IntEnum("Limb", "TRUNK HEAD LEFT_ARM RIGHT_ARM LEFT_LEG RIGHT_LEG", start=0)
LEGS, ARMS = (Limb.LEFT_LEG, Limb.RIGHT_LEG), (Limb.LEFT_ARM, Limb.RIGHT_ARM)


def _limb_of(name: str) -> Limb:
    side, _, kind = name.partition("_")
    if kind in ("shoulder", "elbow", "wrist"):
        return Limb[f"{side}_arm".upper()]
    if kind in ("hip", "knee", "ankle"):
        return Limb[f"{side}_leg".upper()]
    return Limb.HEAD if name in ("neck", "head") else Limb.TRUNK


_LIMB_OF_JOINT = np.array([_limb_of(joint.name) for joint in JOINTS], np.uint8)


class SkinMap(NamedTuple):
    """Places of a body's vertices at rest.

    limb: uint8 (V,) ``Limb`` of the joint that moves it most. along: float32 (V,), on an arm 0 at the
    shoulder, 1 at the elbow, 2 at the wrist; on a leg 0 at the hip, 1 at the knee, 2 at the ankle; on trunk
    and head 0 at the hip joints' height, 1 at the neck's. level: float32 (V,) the latter for all. away_m:
    float32 (V,) distance from the axis; out: float32 (V, 3) unit vectors away from it; around_rad: float32
    (V,), 0 in front, a quarter turn to the person's left.
    """

    limb: UInt8
    along: Float32
    level: Float32
    away_m: Float32
    out: Float32
    around_rad: Float32


def skin_map(body: Body) -> SkinMap:
    """The places of a body's skin."""
    limb = _LIMB_OF_JOINT[body.strongest_joints]
    points = body.vertices_m.astype(np.float64)
    hip_z, neck_z = (body.joints_m[JOINT_ID[name], 2] for name in ("left_hip", "neck"))
    level = (points[:, 2] - hip_z) / (neck_z - hip_z)
    along, axis = level.copy(), _trunk_axis(body, points)
    sideways = np.tile([1.0, 0.0, 0.0], (len(points), 1))
    forwards = np.tile([0.0, -1.0, 0.0], (len(points), 1))
    for which, names in (
        (ARMS, ("shoulder", "elbow", "wrist")),
        (LEGS, ("hip", "knee", "ankle")),
    ):
        for one in which:
            own = np.flatnonzero(limb == one)
            side = "left" if one.name.startswith("LEFT") else "right"
            chain = body.joints_m[[JOINT_ID[f"{side}_{name}"] for name in names]]
            along[own], axis[own], bone = _on_chain(points[own], chain)
            sideways[own] -= np.einsum("ij,ij->i", sideways[own], bone)[:, None] * bone
            forwards[own] = np.cross(sideways[own], bone) * -1.0
    out = points - axis
    away = np.linalg.norm(out, axis=1)
    around = np.arctan2(np.einsum("ij,ij->i", out, sideways), np.einsum("ij,ij->i", out, forwards))
    out /= np.maximum(away, 1e-6)[:, None]
    return SkinMap(limb, *(np.asarray(a, np.float32) for a in (along, level, away, out, around)))


def _trunk_axis(body: Body, points: Float64) -> Float64:
    """Points (V, 3) on the vertical through the middle of the trunk at each height."""
    spine = body.joints_m[
        [JOINT_ID[n] for n in ("pelvis", "spine_lower", "spine_middle", "spine_upper", "neck")]
    ]
    middle = np.interp(points[:, 2], spine[:, 2], spine[:, 1]) - 0.02
    return np.stack([np.zeros(len(points)), middle, points[:, 2]], axis=1)


def _on_chain(points: Float64, chain: Float64) -> tuple[Float64, Float64, Float64]:
    """Place along a chain of three joints (n,), the nearest point of its bone (n, 3), the bone's direction
    (n, 3)."""
    first, second = chain[1] - chain[0], chain[2] - chain[1]
    lengths = np.linalg.norm([first, second], axis=1)
    first, second = first / lengths[0], second / lengths[1]
    beyond = (points - chain[1]) @ (first + second) > 0
    bone = np.where(beyond[:, None], second, first)
    start = np.where(beyond[:, None], chain[1], chain[0])
    reach = np.einsum("ij,ij->i", points - start, bone)
    along = reach / np.where(beyond, lengths[1], lengths[0]) + beyond
    return along, start + reach[:, None] * bone, bone
