"""Random rooms to train the person finder: floor, walls, furniture, objects of any shape. Constants are
untuned.
"""

import numpy as np
from scipy.spatial.transform import Rotation

from annotate.array_types import Float64
from synth.surface.furniture import Bed, Chair, Sofa, Surface
from synth.surface.rasterize import Mesh, box, grid_faces, merge, sheet, tagged

EMPTY, WALLS, WALL, CEILING = 0.1, 0.85, 0.8, 0.2  # shares: no room; rooms with walls; each wall; ceilings
BEYOND_M, ROOM_HEIGHT_M = (0.4, 4.0), (2.2, 3.2)  # walls beyond camera and people; height of the room
MOST_THINGS = 11  # in a room
CLEAR_M, IN_THE_WAY = 0.45, 0.12  # distance from people and the way to them; share of things without it


def surroundings(
    rng: np.random.Generator, eye_m: Float64, middle_m: Float64, *, may_be_none: bool
) -> list[Mesh]:
    """Return meshes of a random room around a camera (3,) and a person's middle (3,), world frame, metres.

    may_be_none: allow an empty list.
    """
    if rng.random() < EMPTY and may_be_none:
        return []
    beyond = np.exp(rng.uniform(np.log(BEYOND_M[0]), np.log(BEYOND_M[1]), (2, 2)))
    low = np.minimum(np.minimum(eye_m, middle_m)[:2] - beyond[0], -0.4)
    high = np.maximum(np.maximum(eye_m, middle_m)[:2] + beyond[1], 0.4)
    corner, up = np.array([*low, 0.0]), np.array([0.0, 0.0, rng.uniform(*ROOM_HEIGHT_M)])
    along, across = np.array([high[0] - low[0], 0, 0]), np.array([0, high[1] - low[1], 0])
    meshes = [sheet(corner, along, across, Surface.FLOOR)]
    if rng.random() < WALLS:
        walls = [(corner, along), (corner, across), (corner + across, along), (corner + along, across)]
        meshes += [sheet(at, side, up, Surface.WALL) for at, side in walls if rng.random() < WALL]
    if rng.random() < CEILING:
        meshes.append(sheet(corner + up, along, across, Surface.WALL))
    for _ in range(int(rng.integers(MOST_THINGS + 1))):
        at = rng.uniform(low, high)
        clear = min(float(np.linalg.norm(at - middle_m[:2])), _off_way(at, eye_m[:2], middle_m[:2]) + 0.15)
        if clear > CLEAR_M or rng.random() < IN_THE_WAY:
            turn = Rotation.from_euler("z", rng.uniform(-np.pi, np.pi)).as_matrix()
            meshes.append(_thing(rng).placed(turn, np.array([*at, 0.0])))
    return meshes


def _off_way(point: Float64, one: Float64, other: Float64) -> float:
    """Return the distance of a point (2,) from the line segment between two others, metres."""
    way = other - one
    share = np.clip(np.dot(point - one, way) / max(np.dot(way, way), 1e-6), 0, 1)
    return float(np.linalg.norm(point - one - share * way))


def _thing(rng: np.random.Generator) -> Mesh:
    """Return a piece of furniture, or an object of random shape, at the origin."""
    shapes = (_table, _cupboard, _any_box, _heap, _lamp, _curtain)
    kind = int(rng.integers(3 + len(shapes)))
    return (Sofa, Chair, Bed)[kind].sample(rng).mesh() if kind < 3 else shapes[kind - 3](rng)


def _table(rng: np.random.Generator) -> Mesh:
    x, y, z = rng.uniform((0.3, 0.25, 0.4), (0.9, 0.5, 1.05))
    legs = [
        box((dx * x - 0.03, dy * y - 0.03, 0), (dx * x + 0.03, dy * y + 0.03, z), Surface.TABLE)
        for dx in (-0.95, 0.95)
        for dy in (-0.95, 0.95)
    ]
    places = [np.array([rng.uniform(-x, x), rng.uniform(-y, y), z + 0.1]) for _ in range(rng.integers(4))]
    things = [_blob(rng, 0.05, 0.25, at) for at in places]
    return merge([box((-x, -y, z - 0.04), (x, y, z), Surface.TABLE), *legs, *things])


def _cupboard(rng: np.random.Generator) -> Mesh:
    x, y, z = np.exp(rng.uniform(*np.log(((0.1, 0.02, 0.3), (0.8, 0.4, 2.2)))))
    return box((-x, -y, 0), (x, y, z), Surface.TABLE)


def _any_box(rng: np.random.Generator) -> Mesh:
    """Return a box at a random height and angle."""
    x, y, z = np.exp(rng.uniform(np.log(0.04), np.log(0.6), 3))
    turn = Rotation.random(rng=rng).as_matrix()
    return box((-x, -y, -z), (x, y, z), Surface.TABLE).placed(turn, np.array([0, 0, rng.uniform(0, 2)]))


def _heap(rng: np.random.Generator) -> Mesh:
    """Return a cluster of blobs: a plant, a heap of clothes."""
    places = [np.array([*rng.normal(0, 0.2, 2), rng.uniform(0, 1.6)]) for _ in range(rng.integers(2, 12))]
    return merge([_blob(rng, 0.05, 0.3, at) for at in places])


def _lamp(rng: np.random.Generator) -> Mesh:
    """Return a post or a column with a head: a floor lamp, a coat stand, a barrel."""
    radius, height = rng.uniform(0.01, 0.3), rng.uniform(0.6, 1.8)
    z, turn = np.meshgrid(np.linspace(0, height, 6), np.linspace(0, 2 * np.pi, 16), indexing="ij")
    post = np.stack([radius * np.cos(turn), radius * np.sin(turn), z], -1).reshape(-1, 3)
    head = _blob(rng, 0.08, 0.3, np.array([0, 0, height]))
    return merge([tagged(post.astype(np.float32), grid_faces(6, 16), Surface.TABLE), head])


def _curtain(rng: np.random.Generator) -> Mesh:
    u, v = np.meshgrid(np.linspace(-1, 1, 60), np.linspace(0, 1, 12), indexing="ij")
    width, wave, deep, height = rng.uniform((0.3, 3, 0.01, 1.5), (1.5, 20, 0.08, 2.5))
    folds = np.stack([width * u, deep * np.sin(wave * u + 0.6 * np.sin(3 * v)), height * v], -1)
    return tagged(folds.reshape(-1, 3).astype(np.float32), grid_faces(60, 12), Surface.WALL)


def _blob(rng: np.random.Generator, least_m: float, most_m: float, at_m: Float64) -> Mesh:
    """Return an ellipsoid at a random angle about a place (3,). least_m, most_m: range of its radii."""
    polar, turn = np.meshgrid(np.linspace(0, np.pi, 10), np.linspace(0, 2 * np.pi, 16), indexing="ij")
    ball = np.stack([np.sin(polar) * np.cos(turn), np.sin(polar) * np.sin(turn), np.cos(polar)], -1)
    axes = np.exp(rng.uniform(np.log(least_m), np.log(most_m), 3))
    mesh = tagged((ball.reshape(-1, 3) * axes).astype(np.float32), grid_faces(10, 16), Surface.TABLE)
    return mesh.placed(Rotation.random(rng=rng).as_matrix(), at_m)
