"""Objects near a person: tables, a mug, a laptop, a radiator, a window; world frame, metres."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from annotate.array_types import Float32, Float64
from annotate.parts import PAPER
from annotate.scheme.regions import Region
from synth.body.body import Body
from synth.body.skeleton import JOINT_ID
from synth.surface.furniture import Surface
from synth.surface.rasterize import Mesh, box, merge, tagged

ThingPose = Callable[[Float32, Float64], Float32]
"""Function of a person's vertices and joints that returns the vertices of a thing."""

LAPTOP_M = (0.34, 0.24, 0.022)  # width, depth and thickness of a 15 inch laptop
LID_RAD = np.radians(110.0)  # between keys and lid
LID_BEYOND_M = 0.03  # between the foremost finger and the lid's hinge
MUG_RADIUS_M, MUG_HEIGHT_M = 0.042, 0.095  # as sold
TO_MOUTH_M = 0.30  # distance of wrist and head joint of a drinking person; untuned
TABLE_THICK_M = 0.035
_LEGS = [Region.on(side, name) for side in ("left", "right") for name in ("upper_leg", "lower_leg")]
# Boxes about a place of the back wall; panel radiators are 45 to 75 cm high, as sold.
_ON_WALL = {
    "radiator": (Surface.RADIATOR, (-0.45, -0.12, 0.12), (0.45, -0.03, 0.70)),
    "window": (Surface.WINDOW, (-0.5, -0.02, 0.95), (0.5, 0.0, 2.1)),
    "sunlit wall": (Surface.SUNLIT, (-0.35, -0.004, 0.5), (0.35, 0.0, 1.5)),
}


@dataclass(frozen=True)
class Thing:
    """Object near a person. mesh: tagged, at rest. where: function that returns its vertices for the person's
    pose; None for a fixed object.
    """

    name: str
    mesh: Mesh
    where: ThingPose | None = None

    def vertices(self, person_m: Float32, joints_m: Float64) -> Float32:
        """Return the object's vertices for a posed person, world, metres."""
        return self.mesh.vertices_m if self.where is None else self.where(person_m, joints_m)


def moved(mesh: Mesh, translation_m: Float64, turn_rad: float = 0.0) -> Mesh:
    """Return the mesh rotated about the vertical, then translated."""
    return mesh.placed(Rotation.from_euler("z", turn_rad).as_matrix(), translation_m)


def table(centre_m: Float64, size_m: tuple[float, float]) -> Thing:
    """Return a table on four legs with the middle of its top at centre_m."""
    x, y = size_m[0] / 2, size_m[1] / 2
    leg, z = 0.04, float(centre_m[2])
    legs = [
        box((a, b, -z), (a + leg, b + leg, -TABLE_THICK_M), Surface.TABLE)
        for a in (-x, x - leg)
        for b in (-y, y - leg)
    ]
    top = box((-x, -y, -TABLE_THICK_M), (x, y, 0), Surface.TABLE)
    return Thing("table", moved(merge([top, *legs]), centre_m))


def mug(stands_m: Float64, body: Body, held: bool) -> Thing:
    """Return a mug at stands_m or, if ``held``, in a hand at the mouth."""
    turn = np.linspace(0, 2 * np.pi, 13)[:-1]
    ring = MUG_RADIUS_M * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    low, high = (np.column_stack([ring, np.full(12, z)]) for z in (0.0, MUG_HEIGHT_M))
    local = np.concatenate([low, high, [(0, 0, MUG_HEIGHT_M - 0.01)]]).astype(np.float32)
    i, j = np.arange(12), (np.arange(12) + 1) % 12
    sides = np.concatenate([np.stack([i, j, j + 12], 1), np.stack([i, j + 12, i + 12], 1)])
    fill = np.stack([i + 12, j + 12, np.full(12, 24)], 1)
    faces = np.concatenate([sides, fill]).astype(np.int32)
    hands = {
        side: np.flatnonzero(body.strongest_joints == JOINT_ID[f"{side}_wrist"]) for side in ("left", "right")
    }

    def where(person_m: Float32, joints_m: Float64) -> Float32:
        place = stands_m
        for side, own in hands.items():
            if np.linalg.norm(joints_m[JOINT_ID[f"{side}_wrist"]] - joints_m[JOINT_ID["head"]]) < TO_MOUTH_M:
                hand, head = person_m[own].mean(axis=0), joints_m[JOINT_ID["head"]]
                towards = (head - hand) * (1, 1, 0)
                place = hand + 0.06 * towards / (np.linalg.norm(towards) + 1e-9) - (0, 0, MUG_HEIGHT_M / 2)
        return (local + place).astype(np.float32)

    still = (local + stands_m).astype(np.float32)
    return Thing("mug", tagged(still, faces, Surface.MUG), where if held else None)


def laptop_mesh() -> Mesh:
    """Return an open laptop on the plane z = 0, its lid at -y."""
    w, d, h = LAPTOP_M
    base = box((-w / 2, -d / 2, 0), (w / 2, d / 2, h - 0.002), Surface.LAPTOP)
    keys = box((-w / 2 + 0.02, -d / 2 + 0.09, h - 0.002), (w / 2 - 0.02, d / 2 - 0.01, h), Surface.KEYBOARD)
    lid = box((-w / 2, 0, 0), (w / 2, 0.006, d), Surface.LAPTOP)
    panel = box((-w / 2 + 0.01, 0.006, 0.01), (w / 2 - 0.01, 0.008, d - 0.01), Surface.SCREEN)
    tilt = Rotation.from_euler("x", LID_RAD - np.pi / 2).as_matrix()
    return merge([base, keys, merge([lid, panel]).placed(tilt, np.array([0, -d / 2, h]))])


def laptop(aside_m: Float64, body: Body, on_lap: bool) -> Thing:
    """Return a laptop at aside_m or, if ``on_lap``, on the thighs."""
    (w, d, h), mesh = LAPTOP_M, laptop_mesh()
    still = moved(mesh, aside_m)
    legs = np.isin(body.vertex_parts, PAPER.ids_of(_LEGS))

    def where(person_m: Float32, joints_m: Float64) -> Float32:
        hips, knees = (
            joints_m[[JOINT_ID[f"left_{name}"], JOINT_ID[f"right_{name}"]]].mean(axis=0)
            for name in ("hip", "knee")
        )
        place = 0.36 * hips + 0.64 * knees
        across = np.abs(person_m[:, 0] - place[0]) < w / 2 + 0.01
        above = across & ~legs & (person_m[:, 1] < place[1] + d / 2)
        low = person_m[:, 2] < knees[2] + 0.12 + d
        # The lid is beyond the hands, the base on the knees.
        place[1] = min(place[1], person_m[above & low, 1].min(initial=1.0) - LID_BEYOND_M + d / 2)
        under = across & legs & (np.abs(person_m[:, 1] - place[1]) < d / 2 + 0.01)
        if not under.any() or place[1] < knees[1] - 0.03 or abs(hips[2] - knees[2]) > 0.12:
            return still.vertices_m
        place[2] = person_m[under, 2].max() + 0.004
        on_it = above & (np.abs(person_m[:, 1] - place[1]) < d / 2 + 0.01)
        if (person_m[on_it, 2] < place[2] + h + 0.01).any():
            return still.vertices_m
        return np.asarray(mesh.vertices_m + place, np.float32)

    return Thing("laptop", still, where if on_lap else None)


def on_wall(name: str, x: float, wall_y: float) -> Thing:
    """Return a radiator, a window or a sunlit patch at the back wall."""
    tag, (x0, y0, z0), (x1, y1, z1) = _ON_WALL[name]
    return Thing(name, box((x + x0, wall_y + y0, z0), (x + x1, wall_y + y1, z1), tag))
