"""Things near a low camera, or on its desk: cartons, bags, planks, tubs, screens. Constants are untuned.

A function returns a mesh that stands on the floor, or on the desk, at the origin, z up, metres.
"""

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from annotate.array_types import Float64
from eval.training.rooms.soft import blob
from eval.training.rooms.things import BLACK, Draw, draw_thing
from synth.data_files import Cast
from synth.surface.furniture import Surface
from synth.surface.judge_furniture import draw_chair
from synth.surface.rasterize import Mesh, box, merge

CELL_M = 0.2  # longest edge of a face near the camera, because a face that reaches behind it is not drawn
CHAIR, FURNITURE = 0.15, 0.45  # cumulative shares of things on the floor; the rest are clutter
WALL_M = 0.008  # thickness of a tub's sides


def draw_floor_clutter(rng: np.random.Generator, cast: Cast) -> Mesh:
    """Draw a chair of a cast, a thing of a room, or a carton, bag, plank or tub."""
    kind = rng.random()
    if kind < CHAIR:
        return draw_chair(cast, rng).mesh()
    return draw_thing(rng, cast) if kind < FURNITURE else _one_of(_ON_FLOOR, rng)


def draw_desk_clutter(rng: np.random.Generator) -> Mesh:
    """Draw a screen, a keyboard, a pile of books, a carton or a mug."""
    return _one_of(_ON_DESK, rng)


def in_cells(mesh: Mesh) -> Mesh:
    """Return a mesh whose faces with an edge longer than ``CELL_M`` are split in four, repeatedly."""
    vertices, faces, tags = mesh.vertices_m, mesh.faces, mesh.tags
    while True:
        corners = vertices[faces]
        long = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1) > CELL_M
        if not long.any():
            return Mesh(vertices, faces, tags)
        a, b, c = corners[long].transpose(1, 0, 2)
        d, e, f = (a + b) / 2, (b + c) / 2, (c + a) / 2
        quarters = np.stack([a, d, f, d, b, e, f, e, c, d, e, f], axis=1).reshape(-1, 3)
        own = np.arange(len(quarters), dtype=np.int32).reshape(-1, 3) + np.int32(len(vertices))
        vertices = np.concatenate([vertices, quarters.astype(np.float32)])
        faces = np.concatenate([faces[~long], own])
        tags = np.concatenate([tags[~long], np.repeat(tags[long], 4)])


def _one_of(shapes: Sequence[Draw], rng: np.random.Generator) -> Mesh:
    return shapes[int(rng.integers(len(shapes)))](rng)


def _carton(rng: np.random.Generator) -> Mesh:
    """Draw a carton, closed or with open flaps."""
    x, y, z = np.exp(rng.uniform(np.log((0.08, 0.06, 0.12)), np.log((0.35, 0.3, 0.7))))
    meshes = [box((-x, -y, 0), (x, y, z), Surface.TABLE)]
    if rng.random() < 0.3:
        for side in (-1, 1):
            turn = Rotation.from_euler("y", side * rng.uniform(-1.2, 1.2)).as_matrix()
            meshes.append(
                box((0, -y, 0), (0.004, y, x), Surface.TABLE).placed(turn, np.array([side * x, 0, z]))
            )
    return merge(meshes)


def _stack(rng: np.random.Generator) -> Mesh:
    """Draw two to four cartons on one another."""
    meshes, high = [], 0.0
    for _ in range(int(rng.integers(2, 5))):
        turn = Rotation.from_euler("z", rng.normal(0, 0.3)).as_matrix()
        carton = _carton(rng)
        meshes.append(carton.placed(turn, np.array([*rng.normal(0, 0.04, 2), high])))
        high += float(carton.vertices_m[:8, 2].max())
    return merge(meshes)


def _bags(rng: np.random.Generator) -> Mesh:
    """Draw bags or heaps of clothes on the floor, on a carton or alone."""
    carton = _carton(rng)
    under = [carton] if rng.random() < 0.4 else []
    high = float(carton.vertices_m[:8, 2].max()) if under else 0.0
    places = [
        np.array([*rng.normal(0, 0.12, 2), high + rng.uniform(0.05, 0.2)]) for _ in range(rng.integers(1, 5))
    ]
    return merge([*under, *(blob(rng, 0.06, 0.25, at) for at in places)])


def _plank(rng: np.random.Generator) -> Mesh:
    """Draw a long carton or a board that leans, or lies."""
    x, y, z = np.exp(rng.uniform(np.log((0.06, 0.01, 0.8)), np.log((0.3, 0.1, 2.0))))
    lean = rng.uniform(-0.35, 0.35, 2) if rng.random() < 0.8 else np.array([np.pi / 2, 0.0])
    turn = Rotation.from_euler("xy", lean).as_matrix()
    return _lifted(box((-x, -y, 0), (x, y, z), Surface.TABLE).placed(turn, np.zeros(3)))


def _tub(rng: np.random.Generator) -> Mesh:
    """Draw an open tub, drawer or waste bin, empty or full."""
    x, y, z = rng.uniform((0.1, 0.1, 0.1), (0.35, 0.25, 0.4))
    t = WALL_M
    sides = [((-x, -y), (x, t - y)), ((-x, y - t), (x, y)), ((-x, -y), (t - x, y)), ((x - t, -y), (x, y))]
    meshes = [box((*low, 0), (*high, z), Surface.TABLE) for low, high in sides]
    meshes.append(box((-x, -y, 0), (x, y, t), Surface.TABLE))
    if rng.random() < 0.5:
        meshes += [blob(rng, 0.05, 0.2, np.array([*rng.normal(0, 0.06, 2), z * 0.8])) for _ in range(3)]
    return merge(meshes)


def _shoes(rng: np.random.Generator) -> Mesh:
    """Draw two shoes or slippers without a person."""
    shoe = merge([box((-0.045, -0.14, 0), (0.045, 0.14, 0.05), Surface.TABLE), _hump(rng)])
    apart = rng.uniform(0.06, 0.2)
    turns = (Rotation.from_euler("z", rng.normal(0, 0.4)).as_matrix() for _ in range(2))
    return merge(
        [shoe.placed(turn, np.array([x, 0, 0])) for x, turn in zip((-apart, apart), turns, strict=True)]
    )


def _hump(rng: np.random.Generator) -> Mesh:
    return blob(rng, 0.035, 0.07, np.array([0.0, rng.uniform(-0.08, 0.08), 0.05]))


def _screen(rng: np.random.Generator) -> Mesh:
    """Draw a monitor on its foot."""
    x, z, low = rng.uniform((0.15, 0.1, 0.05), (0.4, 0.25, 0.2))
    panel = box((-x, -0.015, low), (x, 0.015, low + 2 * z), BLACK)
    return merge(
        [
            panel,
            box((-0.03, 0, 0), (0.03, 0.04, low + z), BLACK),
            box((-0.12, -0.1, 0), (0.12, 0.1, 0.01), BLACK),
        ]
    )


def _keyboard(rng: np.random.Generator) -> Mesh:
    x, y, z = rng.uniform((0.14, 0.06, 0.015), (0.23, 0.09, 0.04))
    return box((-x, -y, 0), (x, y, z), Surface.TABLE)


def _books(rng: np.random.Generator) -> Mesh:
    """Draw a pile of books, or a row of upright ones."""
    count = int(rng.integers(2, 9))
    thick = rng.uniform(0.01, 0.05, count)
    lows = np.cumsum(thick) - thick
    meshes = [
        box((-0.1, -0.14, a), (0.1, rng.uniform(0.08, 0.14), a + t), Surface.TABLE)
        for a, t in zip(lows, thick, strict=True)
    ]
    pile = merge(meshes)
    if rng.random() < 0.5:
        return pile
    return _lifted(pile.placed(Rotation.from_euler("y", np.pi / 2).as_matrix(), np.zeros(3)))


def _mug(rng: np.random.Generator) -> Mesh:
    return blob(rng, 0.03, 0.12, np.array([0.0, 0.0, 0.06]))


def _lifted(mesh: Mesh) -> Mesh:
    low: Float64 = np.array([0.0, 0.0, -float(mesh.vertices_m[:, 2].min())])
    return mesh.placed(np.eye(3), low)


_ON_FLOOR: tuple[Draw, ...] = (_carton, _carton, _stack, _bags, _plank, _tub, _shoes)
_ON_DESK: tuple[Draw, ...] = (_screen, _screen, _keyboard, _books, _carton, _mug, _mug)
