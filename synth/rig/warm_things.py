"""Warm things that lie beside a person: a laptop, a heating pad, a pet; world frame, metres.

Constants are untuned.
"""

from collections.abc import Callable

import numpy as np

from annotate.array_types import Float32, Float64
from synth.rig.locations import Location
from synth.rig.objects_nearby import LAPTOP_M, Thing, laptop_mesh, moved, table
from synth.surface.furniture import Seat, Sofa, Surface
from synth.surface.rasterize import Mesh, box, grid_faces, merge, tagged

APART_M = (0.02, 0.4)  # least and greatest distance from the thing's edge to the person
KEEP_M = 0.5  # height above the support below which the person counts as beside the thing
TRIES = 60  # places drawn for a thing
STOOL_M, STOOL_ASIDE_M = (0.42, 0.42), 0.03  # a stool beside a seat that has no room
AWAY_M = np.array([0.0, 0.0, -20.0], np.float32)  # where a thing is while a limb is in its place


def lay_warm_things(location: Location, prior: list[Float32], rng: np.random.Generator) -> list[Thing]:
    """Draw one or two warm things beside a person.

    prior: earlier postures (V, 3) of the person, whose space is kept free. A thing is absent in frames in
    which the person enters its place.
    """
    things = list[Thing]()
    taken = np.concatenate([points[::7] for points in prior])
    for kind in rng.choice(list(KINDS), 1 + int(rng.random() < 0.4), replace=False):
        mesh = KINDS[kind](rng)
        supports, stool = _supports(location, rng)
        placed = _placed(mesh, supports, taken, rng)
        if placed is None and stool is not None:
            things.append(stool[0])
            placed = moved(mesh, stool[1], rng.uniform(-np.pi, np.pi))
        if placed is not None:
            things.append(Thing(str(kind), placed, _unless_entered(placed)))
            taken = np.concatenate([taken, placed.vertices_m])
    return things


def _laptop(rng: np.random.Generator) -> Mesh:
    """Return a laptop, open in two of three cases."""
    w, d, h = LAPTOP_M
    if rng.random() < 2 / 3:
        return laptop_mesh()
    return box((-w / 2, -d / 2, 0), (w / 2, d / 2, h), Surface.LAPTOP)


def _pad(rng: np.random.Generator) -> Mesh:
    """Return a heating pad or a hot-water bottle."""
    x, y, z = rng.uniform((0.18, 0.12, 0.02), (0.42, 0.3, 0.06)) / (2, 2, 1)
    return box((-x, -y, 0), (x, y, z), Surface.PAD)


def _pet(rng: np.random.Generator) -> Mesh:
    """Return a lying cat or small dog: trunk, head, hind leg."""
    long, wide, high = rng.uniform((0.18, 0.08, 0.07), (0.32, 0.14, 0.13))
    head = rng.uniform(0.045, 0.075)
    aside = rng.uniform(-0.6, 0.6) * wide
    return merge(
        [
            _ellipsoid((0, 0, high), (long, wide, high)),
            _ellipsoid((long + 0.5 * head, aside, high + head), (1.2 * head, head, head)),
            _ellipsoid((-0.7 * long, 0.8 * wide, 0.5 * high), (0.4 * long, 0.4 * wide, 0.5 * high)),
        ]
    )


KINDS: dict[str, Callable[[np.random.Generator], Mesh]] = {"laptop": _laptop, "pad": _pad, "pet": _pet}
"""Functions that draw a thing on the plane z = 0, by name."""


def _ellipsoid(centre: tuple[float, float, float], radii: tuple[float, float, float]) -> Mesh:
    polar, turn = np.meshgrid(np.linspace(0, np.pi, 9), np.linspace(0, 2 * np.pi, 17), indexing="ij")
    unit = np.stack([np.sin(polar) * np.cos(turn), np.sin(polar) * np.sin(turn), np.cos(polar)], axis=-1)
    points = (unit.reshape(-1, 3) * radii + centre).astype(np.float32)
    return tagged(points, grid_faces(9, 17), Surface.PET)


def _supports(
    location: Location, rng: np.random.Generator
) -> tuple[list[tuple[Float64, Float64]], tuple[Thing, Float64] | None]:
    """Return the rectangles that carry things, each as two corners (3,) of one height.

    A seat also has a stool: it follows with the middle of its top.
    """
    furniture = location.furniture
    z = furniture.height
    if not isinstance(furniture, Seat):
        x, front, back = furniture.top
        return [(np.array([-x, front, z]), np.array([x, back, z]))], None
    x = furniture.width / 2
    found = [(np.array([-x, 0.0, z]), np.array([x, furniture.depth, z]))]
    if isinstance(furniture, Sofa):
        top, ends = z + furniture.arm_height, ((-x - furniture.arm_width, -x), (x, x + furniture.arm_width))
        found += [(np.array([a, 0.0, top]), np.array([b, furniture.depth, top])) for a, b in ends]
    side = rng.choice((-1, 1)) * (furniture.footprint.half_width_m + STOOL_M[0] / 2 + STOOL_ASIDE_M)
    middle = np.array([side, rng.uniform(0.0, 0.3), rng.uniform(0.4, 0.65)])
    return found, (table(middle, STOOL_M), middle)


def _placed(
    mesh: Mesh, supports: list[tuple[Float64, Float64]], taken: Float32, rng: np.random.Generator
) -> Mesh | None:
    """Return the mesh on a free place near the person, or None. taken: (n, 3), points to keep free."""
    for _ in range(TRIES):
        low, high = supports[int(rng.integers(len(supports)))]
        placed = moved(mesh, rng.uniform(low, high), rng.uniform(-np.pi, np.pi))
        middle = placed.vertices_m.mean(axis=0)
        beside = taken[np.abs(taken[:, 2] - low[2]) < KEEP_M]
        out = np.abs(middle[:2] - (low + high)[:2] / 2) > (high - low)[:2] / 2 + 0.02
        if out.any() or not len(beside):
            continue
        gap = _gap_m(placed.vertices_m, beside)
        if APART_M[0] <= gap <= APART_M[1]:
            return placed
    return None


def _gap_m(thing_m: Float32, points_m: Float32) -> float:
    """Return the least distance on the floor plan from a thing's bounding rectangle to points (n, 3)."""
    low, high = thing_m[:, :2].min(axis=0), thing_m[:, :2].max(axis=0)
    outside = np.maximum(np.maximum(low - points_m[:, :2], points_m[:, :2] - high), 0)
    return float(np.hypot(*outside.T).min())


def _unless_entered(placed: Mesh) -> Callable[[Float32, Float64], Float32]:
    low, high = placed.vertices_m.min(axis=0), placed.vertices_m.max(axis=0)

    def where(person_m: Float32, joints_m: Float64) -> Float32:
        entered = ((person_m > low) & (person_m < high)).all(axis=1).any()
        return placed.vertices_m + AWAY_M if entered else placed.vertices_m

    return where
