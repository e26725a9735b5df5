"""Flesh of a body for collision tests: chains of spheres about the bones, fitted in about a millisecond.

A chain is a row of stations (centre, radius); the flesh between two neighbours is the round cone over them.
Limbs are chains along a bone. The trunk is a stack of short chains from right to left, one for each height.
"""

from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numba
import numpy as np

from annotate.array_types import Float32, Float64, Int64
from synth.body.body import Body
from synth.body.skeleton import JOINT_ID, N_JOINTS, alignment

_TRUNK_SLICES = 7  # chains from the hips up to the neck; untuned
# Stations of a limb's chain, its joint, and the joint at its other end, if there is one.
_LIMBS = {
    "upper_arm": (4, "shoulder", "elbow"),
    "forearm": (4, "elbow", "wrist"),
    "hand": (3, "wrist", ""),
    "thumb_side": (3, "wrist", ""),
    "thigh": (5, "hip", "knee"),
    "shank": (5, "knee", "ankle"),
    "foot": (4, "ankle", ""),
    "foot_outside": (4, "ankle", ""),
}
_HEAD_STATIONS = 3
SOLE_M = 0.008  # m; the edge of a rolling sole stands out from the spheres under it
FINGERS_M = 0.007  # m; fingers stand out from the mean of a hand


def _chains() -> dict[str, slice]:
    sizes = {f"slice_{i}": 3 for i in range(_TRUNK_SLICES)}
    sizes |= {"neck": 2, "head": _HEAD_STATIONS}
    sizes |= {f"{side}_{limb}": n for side in ("left", "right") for limb, (n, _, _) in _LIMBS.items()}
    ends = np.cumsum([0, *sizes.values()])
    return {name: slice(int(ends[i]), int(ends[i + 1])) for i, name in enumerate(sizes)}


CHAINS = _chains()  # Stations of each part of the body.
N_STATIONS = max(chain.stop for chain in CHAINS.values())


class Flesh(NamedTuple):
    """Flesh of a body, the same in every posture; a named tuple because compiled code takes it.

    rest_joints_m, aligned: arguments of ``kinematics``. centres_m: (S, 3) stations at rest; radii_m: (S,);
    joints: (S,) the joint that each station follows. trunk: indices of the vertices that a seat or bed
    carries.
    """

    rest_joints_m: Float64
    aligned: Float64
    centres_m: Float64
    radii_m: Float64
    joints: Int64
    trunk: Int64


@lru_cache(maxsize=16)
def flesh_of(body: Body) -> Flesh:
    """Fit the chains of spheres to a body, or to the firm surface under loose clothes.

    The last few results are cached.
    """
    if body.firm_m is not None:
        return flesh_of(replace(body, vertices_m=body.firm_m, firm_m=None))
    centres, radii, joints = np.zeros((N_STATIONS, 3)), np.zeros(N_STATIONS), np.zeros(N_STATIONS, np.int64)
    owned = _vertices_of_joints(body)
    _fit_trunk(body, owned, centres, radii, joints)
    for side in ("left", "right"):
        for limb, (_, start, _) in _LIMBS.items():
            j = JOINT_ID[f"{side}_{start}"]
            s = CHAINS[f"{side}_{limb}"]
            own, axis = _limb(body, owned, limb, side)
            _fit_chain(own, axis, centres[s], radii[s])
            joints[s] = j
            if start == "wrist":
                radii[s] += FINGERS_M
            if start == "ankle":
                # A sole is flat: the sphere reaches down to it and no further.
                radii[s] = np.minimum(radii[s], 0.8 * centres[s, 2])
                centres[s, 2] = radii[s]
                radii[s] += SOLE_M
    return Flesh(body.joints_m, alignment(body.joints_m), centres, radii, joints, _carried(body, owned))


def _carried(body: Body, owned: list[Int64]) -> Int64:
    """Return indices of the vertices that first touch a seat or bed: pelvis, spine, buttocks, bulk of the
    shoulders. owned: vertices of each joint.
    """
    parts = [owned[j] for name, j in JOINT_ID.items() if j <= JOINT_ID["spine_upper"] or "clavicle" in name]
    for side in ("left", "right"):
        shoulder, hip = JOINT_ID[f"{side}_shoulder"], JOINT_ID[f"{side}_hip"]
        arm, leg = body.vertices_m[owned[shoulder]], body.vertices_m[owned[hip], 2]
        parts.append(owned[shoulder][np.abs(arm - body.joints_m[shoulder]).max(axis=1) < 0.07])
        parts.append(owned[hip][leg > body.joints_m[hip, 2] - 0.11])
    return np.concatenate(parts)


_FRONT = np.array([0.0, -1.0, 0.0])


def _half(own: Float32, start: Float64, along: Float64, towards: Float64) -> Float32:
    """Return the vertices of a hand or foot on the side ``towards`` of its long axis."""
    line = along.astype(np.float32)
    off = own - start.astype(np.float32)
    off -= (off @ line)[:, None] * line
    across = np.linalg.eigh(off.T @ off)[1][:, -1]
    chosen: Float32 = own[(off @ across > 0) == (across @ towards > 0)]
    return chosen


def _limb(body: Body, owned: list[Int64], limb: str, side: str) -> tuple[Float32, Float64]:
    """Return the vertices (n, 3) of a limb, or half a hand or foot, and the two end stations (2, 3) of its
    axis.
    """
    _, origin, end = _LIMBS[limb]
    joint = JOINT_ID[f"{side}_{origin}"]
    own, start = body.vertices_m[owned[joint]], body.joints_m[joint]
    if end:
        along = body.joints_m[JOINT_ID[f"{side}_{end}"]] - start
        return own, np.stack([start + 0.08 * along, start + 0.94 * along])
    along = own.mean(axis=0, dtype=np.float64) - start
    if limb.startswith("foot"):
        along[2] = 0.0
    along /= np.linalg.norm(along)
    outside = np.array([1.0 if side == "left" else -1.0, 0.0, 0.0])
    # At rest the thumbs point forwards.
    towards = {"thumb_side": _FRONT, "hand": -_FRONT, "foot_outside": outside, "foot": -outside}[limb]
    own = _half(own, start, along, towards)
    reach = own @ along.astype(np.float32) - start @ along
    margin = 0.012 if limb.startswith("foot") else 0.015
    return own, np.stack([start + (reach.min() + margin) * along, start + (reach.max() - margin) * along])


def _fit_trunk(body: Body, owned: list[Int64], centres: Float64, radii: Float64, joints: Int64) -> None:
    rest = body.joints_m
    hip_z, neck_z = rest[JOINT_ID["left_hip"], 2], rest[JOINT_ID["neck"], 2]
    heights = np.linspace(hip_z - 0.02, neck_z - 0.06, _TRUNK_SLICES)
    trunk = ("pelvis", "spine_lower", "spine_middle", "spine_upper", "left_clavicle", "right_clavicle")
    own = np.concatenate([owned[JOINT_ID[name]] for name in (*trunk, "left_hip", "right_hip")])
    boxes = _slices(body.vertices_m[own], heights, 0.6 * (heights[1] - heights[0]))
    for i, (left, right, front, back) in enumerate(boxes):
        chain = CHAINS[f"slice_{i}"]
        radius = min((back - front) / 2, (left - right) / 2)
        half = (left - right) / 2 - radius
        centres[chain] = [(x, (front + back) / 2, heights[i]) for x in (-half, 0.0, half)]
        radii[chain] = radius
        below = [j for j in range(4) if rest[j, 2] <= heights[i]]
        joints[chain] = max(below, default=0)
    _fit_head(body, owned, centres, radii, joints)


def _fit_head(body: Body, owned: list[Int64], centres: Float64, radii: Float64, joints: Int64) -> None:
    neck, head = JOINT_ID["neck"], JOINT_ID["head"]
    low, high = body.joints_m[neck] + (0, 0, 0.02), body.joints_m[head]
    s = CHAINS["neck"]
    _fit_chain(body.vertices_m[owned[neck]], np.stack([low, high]), centres[s], radii[s])
    joints[s] = neck
    # Eyes and teeth weigh in a mean, so the head goes by its extents; the nose may stand out.
    s = CHAINS["head"]
    heights = np.linspace(high[2], body.vertices_m[:, 2].max() - 0.075, _HEAD_STATIONS)
    left, right, front, back = _slices(body.vertices_m[owned[head]], heights, 0.02).T
    radii[s] = (left - right + back - front) / 4
    centres[s] = np.stack([(left + right) / 2, back - (back - front) / 2 - 0.005, heights], axis=1)
    joints[s] = head


def _vertices_of_joints(body: Body) -> list[Int64]:
    """Return for each joint the indices of vertices that it moves most, without the dense rows on part
    borders.
    """
    parts, corners = body.vertex_parts, body.faces.ravel()
    inner = parts > 0
    inner[corners[parts[corners] != np.repeat(body.face_parts, 3)]] = False
    strongest = body.strongest_joints
    return [np.flatnonzero((strongest == j) & inner) for j in range(N_JOINTS)]


@numba.njit(cache=True, fastmath=True)
def _fit_chain(own: Float32, axis: Float64, centres: Float64, radii: Float64) -> None:
    """Write the centre and mean radius, at each station of an axis, of the vertices (n, 3) around it."""
    n = len(radii)
    along = axis[1] - axis[0]
    length = np.sqrt((along**2).sum())
    along /= length
    nearest = np.empty(len(own), np.int64)
    count = np.zeros(n)
    for v in range(len(own)):
        reach = 0.0
        for i in range(3):
            reach += (own[v, i] - axis[0, i]) * along[i]
        k = int(np.rint(reach * (n - 1) / length))
        nearest[v] = k if k < n else -1
        if 0 <= k < n:
            centres[k] += own[v]
            count[k] += 1
    for k in range(n):
        station = axis[0] + along * (length * k / (n - 1))
        if count[k] > 0:
            mean = centres[k] / count[k]
            station = mean - along * ((mean - station) * along).sum()
        centres[k] = station
    for v in range(len(own)):
        k = nearest[v]
        if k >= 0:
            squared, reach = 0.0, 0.0
            for i in range(3):
                off = own[v, i] - centres[k, i]
                squared += off * off
                reach += off * along[i]
            radii[k] += np.sqrt(max(squared - reach * reach, 0.0)) / count[k]


def _slices(own: Float32, heights: Float64, half: float) -> Float64:
    near = [own[np.abs(own[:, 2] - height) < half, :2].T for height in heights]
    return np.array(
        [(x.max(initial=-1e3), x.min(initial=1e3), y.min(initial=1e3), y.max(initial=-1e3)) for x, y in near],
        np.float64,
    )
