"""Borders between the parts of a body: smooth curves on the skin, along which faces are cut.

Skinning weights give the approximate part of each face; skeleton landmarks give the exact curve of a border.
The cut is computed on one body and repeated on all others, so that all have the same topology.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array, eye_array, vstack

from annotate.array_types import Float32, Float64, Int32, Int64, UInt8
from annotate.parts import PAPER
from annotate.scheme.regions import Region
from synth.body.skeleton import JOINT_ID, JOINTS
from synth.data_files import table

Level = Callable[[Float64], Float64]
SNAP_M = 0.001  # m; a border that passes a vertex nearer than this goes through it: no slivers
_BISECTIONS = 24

# Share of the femur's length by which the iliac crest lies above the hip joint.
_CREST = 0.24
# The joint line of the knee lies below its axis (share of the shank's length), and the border on from
# it rises backwards from under the kneecap to the hollow.
_JOINT_LINE = 0.04
_KNEE_SLOPE = 0.25
# The elbow's crease and tip lie above its axis (share of the upper arm's length).
_CREASE = 0.03
# The armpit lies inwards of the shoulder's axis (share of the clavicle's length), and reaches back.
_ARMPIT = 0.05
_ARMPIT_SLOPE = (0.05, 0.07)
# The collar rises from the notch of the breastbone to the seventh neck vertebra.
_COLLAR_SLOPE = 0.32
# The gluteal fold turns into the groin over this depth about the hip joint.
_SIDE_M = 0.12
_CROTCH_M = 0.006


class PartSkin(NamedTuple):
    """Skin with faces cut at the borders of the parts.

    recipe: sparse (W, V), rows sum to 1: each vertex of the cut skin as a mixture of the model's V vertices,
    which come first. faces: int32 (F, 3) among the W. face_parts: uint8 (F,) part ids.
    """

    recipe: csr_array
    faces: Int32
    face_parts: UInt8


class Border(NamedTuple):
    """Border between two parts (ids): zero set of a level function over points (n, 3), positive in
    ``beyond``.
    """

    before: int
    beyond: int
    level: Level


def cut_into_parts(vertices_m: Float64, faces: Int32, joints_m: Float64, by_joint: Float32) -> PartSkin:
    """Cut a skin at rest along every border.

    vertices_m: (V, 3); faces: int32 (F, 3); joints_m: (J, 3); by_joint: (V, J) skinning weight of every
    joint.
    """
    skin = PartSkin(csr_array(eye_array(len(vertices_m))), faces, _roughly(faces, by_joint))
    for border in borders(vertices_m, joints_m):
        skin = _cut(skin, vertices_m, border)
    return skin


def borders(vertices_m: Float64, joints_m: Float64) -> tuple[Border, ...]:
    """Return the ten borders of a body at rest.

    The borders follow from the joints (J, 3) and the lowest skin vertex in the middle plane.
    """
    at = {name: joints_m[i] for name, i in JOINT_ID.items()}
    up = np.array([0.0, 0.0, 1.0])
    crest = at["left_hip"] + _CREST * (at["left_hip"][2] - at["left_knee"][2]) * up
    torso, head, hips = PAPER.table[[Region.CHEST, Region.HEAD, Region.HIP]].tolist()
    made = [
        Border(torso, head, _plane(at["neck"], np.array([0.0, -_COLLAR_SLOPE, 1.0]))),
        Border(torso, hips, _plane(crest, -up)),
    ]
    for side, sign in (("left", 1), ("right", -1)):
        shoulder, elbow, wrist = (at[f"{side}_{joint}"] for joint in ("shoulder", "elbow", "wrist"))
        hip, knee, ankle = (at[f"{side}_{joint}"] for joint in ("hip", "knee", "ankle"))
        limbs = [Region.on(side, name) for name in ("upper_arm", "forearm", "upper_leg", "lower_leg")]
        arm, forearm, thigh, shank = PAPER.table[limbs].tolist()
        # From the acromion down into the armpit, front and back.
        across = np.array([sign, -_ARMPIT_SLOPE[0], _ARMPIT_SLOPE[1]])
        armpit = shoulder + _ARMPIT * (at[f"{side}_clavicle"] - shoulder)
        fold = _bisector(shoulder, elbow, wrist)
        below_knee = _bisector(hip, knee, ankle) + np.array([0.0, 2 * _KNEE_SLOPE, 0.0])
        groin = partial(_groin, hip, sign, _crotch_z(vertices_m, hip[2]), _thigh_m(vertices_m, hip))
        made += [
            Border(torso, arm, _plane(armpit, across)),
            Border(arm, forearm, _plane(elbow + _CREASE * (shoulder - elbow), fold)),
            Border(hips, thigh, groin),
            Border(thigh, shank, _plane(knee + _JOINT_LINE * (ankle - knee), below_knee)),
        ]
    return tuple(made)


def _plane(point_m: Float64, normal: Float64) -> Level:
    unit = normal / np.linalg.norm(normal)
    return lambda points: (points - point_m) @ unit


def _bisector(start: Float64, bend: Float64, end: Float64) -> Float64:
    first, second = bend - start, end - bend
    return np.asarray(first / np.linalg.norm(first) + second / np.linalg.norm(second))


def _crotch_z(vertices_m: Float64, hip_z: float) -> float:
    x, z = np.abs(vertices_m[:, 0]), vertices_m[:, 2]
    return float(z[(x < 0.002) & (z < hip_z)].min())


def _thigh_m(vertices_m: Float64, hip: Float64) -> float:
    beside = np.abs(vertices_m[:, 2] - (hip[2] - 0.08)) < 0.02
    x = np.abs(vertices_m[beside, 0])
    return float(x[x < 2.5 * abs(hip[0])].max())


def _groin(hip: Float64, sign: int, crotch_z: float, thigh_m: float, points: Float64) -> Float64:
    """Return the level (n,) of the groin: a line from the crotch up to the trochanter in front, horizontal at
    the back.
    """
    x, y, z = points.T
    outwards = np.clip(sign * x / thigh_m, 0, 1)
    front = np.clip(0.5 - (y - hip[1]) / _SIDE_M, 0, 1)
    front = front * front * (3 - 2 * front)
    groin_z = crotch_z - _CROTCH_M + front * (hip[2] - crotch_z) * outwards
    return np.asarray(np.minimum(groin_z - z, sign * x))


def _roughly(faces: Int32, by_joint: Float32) -> UInt8:
    by_part = np.zeros((len(by_joint), PAPER.n_classes), np.float32)
    for joint, weights in zip(JOINTS, by_joint.T, strict=True):
        region = table("joints")[joint.kind]["region"].upper()
        sided = joint.name.upper().replace(joint.kind.upper(), region)
        by_part[:, PAPER.table[Region[sided if sided in Region.__members__ else region]]] += weights
    return np.asarray(by_part[faces].mean(axis=1).argmax(axis=1), np.uint8)


def _cut(skin: PartSkin, vertices_m: Float64, border: Border) -> PartSkin:
    """Return the skin with faces of the border's two parts split where its level is zero, and assigned to
    parts.
    """
    points = skin.recipe @ vertices_m
    ours = np.isin(skin.face_parts, (border.before, border.beyond))
    inside = np.ones(len(points), bool)
    inside[skin.faces[~ours]] = False
    edges = np.unique(np.sort(skin.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)
    edges = edges[inside[edges].all(axis=1)]
    level = border.level(points)
    edges = edges[np.prod(np.sign(level[edges]), axis=1) < 0]
    share = _zero(border.level, points[edges[:, 0]], points[edges[:, 1]])
    length = np.linalg.norm(points[edges[:, 1]] - points[edges[:, 0]], axis=1)
    level[edges[share * length < SNAP_M, 0]] = 0
    level[edges[(1 - share) * length < SNAP_M, 1]] = 0
    crossing = (level[edges] != 0).all(axis=1)
    edges, share = edges[crossing], share[crossing]
    rows = np.arange(len(edges))
    mix = csr_array(
        (np.concatenate([1 - share, share]), (np.tile(rows, 2), edges.T.ravel())), (len(edges), len(points))
    )
    recipe = csr_array(vstack([skin.recipe, mix @ skin.recipe]))
    faces, parents = _split(skin.faces, edges, recipe @ vertices_m)
    parts = skin.face_parts[parents]
    level = np.append(level, np.zeros(len(edges)))[faces].sum(axis=1)
    level = np.where(level == 0, border.level((recipe @ vertices_m)[faces].mean(axis=1)), level)
    ours = ours[parents]
    parts[ours] = np.where(level[ours] > 0, border.beyond, border.before)
    return PartSkin(recipe, faces, parts)


def _zero(level: Level, start: Float64, end: Float64) -> Float64:
    """Return the share (n,) of the way from start to end points (n, 3) at which the level is zero."""
    low, high = np.zeros(len(start)), np.ones(len(start))
    first = level(start) > 0
    for _ in range(_BISECTIONS):
        middle = (low + high) / 2
        same = (level(start + middle[:, None] * (end - start)) > 0) == first
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    return (low + high) / 2


def _split(faces: Int32, edges: Int64, points: Float64) -> tuple[Int32, Int64]:
    """Split faces at new vertices on some edges; return the faces, and for each the index of its old face.

    edges: (n, 2) sorted rows, low vertex first; their new vertices are the last n of the points. A face has
    at most two such edges.
    """
    n = len(points)
    keys = edges[:, 0].astype(np.int64) * n + edges[:, 1]
    ends = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]], axis=2).astype(np.int64)
    wanted = ends[..., 0] * n + ends[..., 1]
    place = np.minimum(np.searchsorted(keys, wanted), max(len(keys) - 1, 0))
    on = keys[place] == wanted if len(keys) else np.zeros(wanted.shape, bool)
    new = np.where(on, n - len(keys) + place, -1)
    cuts = on.sum(axis=1)
    once, twice = np.flatnonzero(cuts == 1), np.flatnonzero(cuts == 2)
    # Turned so that the first edge is the only one cut, or the second edge the only one whole.
    a, b, c, m, _ = _turned(faces, new, once, on[once].argmax(axis=1))
    ones = np.stack([np.stack([a, m, c], 1), np.stack([m, b, c], 1)], 1).reshape(-1, 3)
    a, b, c, m, k = _turned(faces, new, twice, (on[twice].argmin(axis=1) + 2) % 3)
    slant = np.linalg.norm(points[m] - points[c], axis=1) < np.linalg.norm(points[b] - points[k], axis=1)
    corners = ((a, m, k), (m, b, np.where(slant, c, k)), (np.where(slant, m, b), c, k))
    twos = np.stack([np.stack(corner, 1) for corner in corners], 1).reshape(-1, 3)
    whole = np.flatnonzero(cuts == 0)
    parents = np.concatenate([whole, np.repeat(once, 2), np.repeat(twice, 3)])
    split = np.concatenate([faces[whole], ones, twos]).astype(np.int32)
    order = np.argsort(parents, kind="stable")
    return split[order], parents[order]


def _turned(faces: Int32, new: Int64, chosen: Int64, first: Int64) -> tuple[Int64, ...]:
    """Return the corners of the ``chosen`` faces from corner ``first`` on, and the new vertices on their
    first and last edges.
    """
    turn = (first[:, None] + np.arange(3)) % 3
    a, b, c = np.take_along_axis(faces[chosen].astype(np.int64), turn, axis=1).T
    m, _, k = np.take_along_axis(new[chosen], turn, axis=1).T
    return a, b, c, m, k
