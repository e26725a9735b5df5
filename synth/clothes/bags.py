"""Bags: a backpack behind the trunk, a shoulder bag beside the hip; rounded boxes that follow the body."""

from dataclasses import dataclass

import numpy as np

from annotate.array_types import Float32, Float64, Int32, UInt8
from annotate.parts import PAPER
from annotate.scheme.regions import Region
from synth.body.body import Body
from synth.body.skeleton import JOINT_ID
from synth.clothes.skin_map import Limb, SkinMap
from synth.surface.rasterize import grid_faces

ROUND = 5  # cells of a box's side
POWER = 6.0  # of the superellipsoid that rounds the box (Barr 1981): 2 is an ellipsoid; untuned
BACKPACK_M = ((0.24, 0.32), (0.10, 0.24), (0.36, 0.52))  # ranges of breadth, depth and height
SHOULDER_BAG_M = ((0.08, 0.16), (0.24, 0.38), (0.20, 0.34))


@dataclass(frozen=True, eq=False)
class Bag:
    """Stiff bag that follows three sets of vertices of the trunk, the anchors: left, right and below.

    nodes_m: (v, 3) coordinates left, back and up, from the middle of the left and right anchors.
    """

    anchors: tuple[Int32, Int32, Int32]
    nodes_m: Float64
    faces: Int32
    face_parts: UInt8
    dark: Float32

    def place(self, vertices_m: Float32, joints_m: Float64) -> Float32:
        """Return the bag's vertices (v, 3) on a posed body (V, 3), world, metres."""
        origin, axes = _frame(vertices_m, self.anchors)
        return (origin + self.nodes_m @ axes).astype(np.float32)


def backpack(naked: Body, worn: Body, places: SkinMap, dark: float, rng: np.random.Generator) -> Bag:
    """Return a backpack on the body ``worn``; naked: the same body without clothes."""
    size = np.array([rng.uniform(*span) for span in BACKPACK_M])
    behind = (places.limb == Limb.TRUNK) & (np.abs(places.trunk.around_rad) > 2.0)
    x = naked.vertices_m[:, 0]
    high, low = behind & (np.abs(places.level - 0.85) < 0.1), behind & (np.abs(places.level - 0.45) < 0.1)
    anchors = _indices(high & (x > 0.02), high & (x < -0.02), low)
    back = behind & (places.level > 0.3) & (places.level < 0.95) & (np.abs(x) < size[0] / 2)
    top = worn.joints_m[JOINT_ID["neck"], 2] - rng.uniform(0.0, 0.06)
    rear = np.percentile(worn.vertices_m[back, 1], 80)
    middle = np.array([0.0, rear + 0.4 * size[1], top - size[2] / 2])
    return _bag((naked, worn), anchors, middle, size, dark)


def shoulder_bag(naked: Body, worn: Body, places: SkinMap, dark: float, rng: np.random.Generator) -> Bag:
    """Return a bag behind one hip of the body ``worn``; naked: the same body without clothes."""
    size = np.array([rng.uniform(*span) for span in SHOULDER_BAG_M])
    sign = 1.0 if rng.random() < 0.5 else -1.0
    trunk, x = places.limb == Limb.TRUNK, naked.vertices_m[:, 0]
    hips, waist = trunk & (np.abs(places.level) < 0.12), trunk & (np.abs(places.level - 0.35) < 0.1)
    anchors = _indices(waist & (x > 0.05), waist & (x < -0.05), hips)
    beside = worn.vertices_m[hips & (sign * x > 0)]
    hip = worn.joints_m[JOINT_ID["left_hip"]]
    outside = sign * (np.abs(beside[:, 0]).max() - 0.02)
    middle = np.array([outside, float(beside[:, 1].mean()) + 0.3 * size[1], hip[2] + rng.uniform(-0.05, 0.1)])
    return _bag((naked, worn), anchors, middle, size, dark)


def _indices(*masks: np.ndarray) -> tuple[Int32, Int32, Int32]:
    left, right, below = (np.flatnonzero(mask).astype(np.int32) for mask in masks)
    return left, right, below


def _bag(
    bodies: tuple[Body, Body],
    anchors: tuple[Int32, Int32, Int32],
    middle_m: Float64,
    size_m: Float64,
    dark: float,
) -> Bag:
    (naked, worn), (nodes, faces) = bodies, _rounded_box()
    at_rest = middle_m + nodes * size_m / 2
    origin, axes = _frame(worn.vertices_m, anchors)
    parts = _parts_beneath(naked, at_rest[faces].mean(axis=1))
    return Bag(anchors, (at_rest - origin) @ axes.T, faces, parts, np.full(len(faces), dark, np.float32))


def _frame(vertices_m: Float32, anchors: tuple[Int32, Int32, Int32]) -> tuple[Float64, Float64]:
    """Return origin (3,) and axes (3, 3) of the anchors' frame; rows point left, back and up."""
    left, right, below = (vertices_m[own].mean(axis=0, dtype=np.float64) for own in anchors)
    origin = (left + right) / 2
    across = left - right
    back = np.cross(origin - below, across)
    axes = np.stack([across, back, np.cross(across, back)])
    return origin, axes / np.linalg.norm(axes, axis=1, keepdims=True)


def _rounded_box() -> tuple[Float64, Int32]:
    """Return nodes (v, 3) and faces (f, 3) of a rounded box of side 2 about the origin."""
    line = np.linspace(-1, 1, ROUND + 1)
    u, v = (grid.ravel() for grid in np.meshgrid(line, line, indexing="ij"))
    ends = [(axis, np.full_like(u, end)) for axis in range(3) for end in (1.0, -1.0)]
    box = np.concatenate([np.roll(np.stack([w, w * u, v]), axis, axis=0).T for axis, w in ends])
    box /= (np.abs(box) ** POWER).sum(axis=1, keepdims=True) ** (1 / POWER)
    side = grid_faces(ROUND + 1, ROUND + 1)[:, ::-1]
    return box, np.concatenate([side + np.int32(n * len(u)) for n in range(len(ends))])


def _parts_beneath(naked: Body, middles_m: Float64) -> UInt8:
    trunk, thighs = (Region.CHEST, Region.HIP), (Region.LEFT_UPPER_LEG, Region.RIGHT_UPPER_LEG)
    torso, hips, left, right = (int(PAPER.table[region]) for region in (*trunk, *thighs))
    crest = naked.vertices_m[naked.faces[naked.face_parts == hips], 2].max()
    thigh = naked.joints_m[JOINT_ID["left_hip"], 2] - 0.04
    parts = np.where(middles_m[:, 2] > thigh, hips, np.where(middles_m[:, 0] > 0, left, right))
    return np.where(middles_m[:, 2] > crest, torso, parts).astype(np.uint8)
