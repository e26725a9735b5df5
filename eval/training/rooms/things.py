"""Things of random rooms: furniture, plants, bags, screens, aids to walk. Constants are untuned.

A function returns a mesh that stands on the floor at the origin, z up, metres; its front faces -y.
"""

from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import Rotation

from annotate.array_types import Float64
from eval.training.rooms.soft import HANGING, blob, hung, laid
from synth.data_files import Cast
from synth.surface.furniture import Bed, Surface
from synth.surface.judge_furniture import draw_bed, draw_chair, draw_sofa
from synth.surface.rasterize import Mesh, box, grid_faces, merge, tagged
from synth.surface.wheelchair import draw_wheelchair

Draw = Callable[[np.random.Generator], Mesh]
BLACK = 1000 - 1  # tag of screens, which absorb infrared


def draw_thing(rng: np.random.Generator, cast: Cast) -> Mesh:
    """Draw a piece of furniture of a cast, or an object of random shape."""
    kind = int(rng.integers(len(SHAPES) + 5))
    if kind < len(SHAPES):
        return SHAPES[kind](rng)
    kind -= len(SHAPES)
    if kind == 4:
        return railed(draw_bed(cast, rng), rng)
    seat = (draw_sofa, draw_chair, draw_wheelchair, draw_sofa)[kind](cast, rng)
    mesh = seat.mesh()
    if kind == 3 or rng.random() < 0.3:  # clothes, cushions, a coat over the back
        places = [
            (rng.uniform(-0.5, 0.5) * seat.width, rng.uniform(0.1, 0.9) * seat.depth, seat.height)
            for _ in range(int(rng.integers(1, 5)))
        ]
        soft = [laid(rng, np.array(at), above_m=0.5) for at in places]
        if rng.random() < HANGING:
            soft.append(hung(rng, np.array([0.0, seat.depth, seat.height + rng.uniform(0.2, 0.6)])))
        mesh = merge([mesh, *soft])
    return mesh


def table(rng: np.random.Generator, high_m: tuple[float, float] = (0.4, 1.05)) -> Mesh:
    """Draw a table with things on it. high_m: range of its height."""
    x, y, z = rng.uniform((0.3, 0.25, high_m[0]), (0.9, 0.5, high_m[1]))
    legs = [
        box((dx * x - 0.03, dy * y - 0.03, 0), (dx * x + 0.03, dy * y + 0.03, z), Surface.TABLE)
        for dx in (-0.95, 0.95)
        for dy in (-0.95, 0.95)
    ]
    places = [np.array([rng.uniform(-x, x), rng.uniform(-y, y), z + 0.1]) for _ in range(rng.integers(5))]
    things = [blob(rng, 0.04, 0.2, at) for at in places]
    return merge([box((-x, -y, z - 0.04), (x, y, z), Surface.TABLE), *legs, *things])


def desk(rng: np.random.Generator) -> Mesh:
    """Draw a desk with one or two screens."""
    top = table(rng, (0.68, 0.78))
    z = 0.7
    screens = [
        merge([_box(rng.uniform(0.2, 0.4), 0.02, rng.uniform(0.12, 0.25), BLACK), _box(0.03, 0.03, 0.2)])
        .placed(_turned(rng.normal(0, 0.4)), np.array([x, rng.uniform(-0.2, 0.2), z + 0.35]))
        for x in rng.uniform(-0.5, 0.5, int(rng.integers(1, 3)))
    ]  # fmt: skip
    return merge([top, *screens])


def railed(bed: Bed, rng: np.random.Generator) -> Mesh:
    """Draw rails at one or both sides of a bed, and a heap of bedclothes on some."""
    half, y, top = bed.width / 2 + 0.03, rng.uniform(0.4, 0.95), bed.height + rng.uniform(0.2, 0.45)
    meshes = [bed.mesh()]
    for x in (-half, half)[int(rng.integers(2)) :]:
        heights = np.linspace(bed.height, top, int(rng.integers(2, 5)))
        meshes += [_bar((x, -y, z), (x, y, z)) for z in heights]
        meshes += [_bar((x, at, 0.2), (x, at, top)) for at in np.linspace(-y, y, int(rng.integers(2, 6)))]
    if rng.random() < 0.4:
        places = rng.uniform((-half, -1, bed.height), (half, 1, bed.height + 0.1), (3, 3))
        meshes += [laid(rng, at, 0.4) for at in places]
    return merge(meshes)


def walker(rng: np.random.Generator) -> Mesh:
    """Draw a walking frame: four posts, grips, a bar across."""
    x, y, z = rng.uniform((0.25, 0.2, 0.75), (0.34, 0.3, 0.95))
    posts = [_bar((a, b, 0), (a, 0.6 * b, z)) for a in (-x, x) for b in (-y, y)]
    grips = [_bar((a, -0.6 * y, z), (a, 0.6 * y, z)) for a in (-x, x)]
    across = [_bar((-x, -0.8 * y, h), (x, -0.8 * y, h)) for h in (0.5 * z, 0.9 * z)]
    return merge([*posts, *grips, *across])


def _shelf(rng: np.random.Generator) -> Mesh:
    x, y, z = rng.uniform((0.2, 0.12, 0.8), (0.8, 0.22, 2.1))
    boards = np.arange(0.05, z, rng.uniform(0.25, 0.45))
    meshes = [box((a - 0.01, -y, 0), (a + 0.01, y, z), Surface.TABLE) for a in (-x, x)]
    meshes += [box((-x, -y, h), (x, y, h + 0.02), Surface.TABLE) for h in boards]
    if rng.random() < 0.6:
        meshes.append(box((-x, y, 0), (x, y + 0.01, z), Surface.TABLE))
    for h in boards:
        for left in rng.uniform(-x, 0.8 * x, int(rng.integers(0, 4))):
            wide, deep, high = rng.uniform((0.03, 0.05, 0.08), (0.25, y, 0.24))
            right = min(left + wide, x)
            meshes.append(box((left, -deep, h), (right, deep, h + high), Surface.TABLE))
    return merge(meshes)


def _cupboard(rng: np.random.Generator) -> Mesh:
    x, y, z = np.exp(rng.uniform(*np.log(((0.1, 0.02, 0.3), (0.8, 0.4, 2.2)))))
    return box((-x, -y, 0), (x, y, z), Surface.TABLE)


def _door(rng: np.random.Generator) -> Mesh:
    """Draw an open door with a handle."""
    wide, high = rng.uniform((0.35, 1.9), (0.5, 2.1))
    return merge(
        [box((-wide, -0.02, 0), (wide, 0.02, high), Surface.WALL), _bar((0.3, -0.06, 1), (0.42, -0.06, 1))]
    )


def _any_box(rng: np.random.Generator) -> Mesh:
    """Draw a box at a random height and angle."""
    x, y, z = np.exp(rng.uniform(np.log(0.04), np.log(0.6), 3))
    turn = Rotation.random(rng=rng).as_matrix()
    return box((-x, -y, -z), (x, y, z), Surface.TABLE).placed(turn, np.array([0, 0, rng.uniform(0, 2)]))


def _heap(rng: np.random.Generator) -> Mesh:
    """Draw a cluster of blobs: bags, a heap of clothes, a shrub."""
    places = [np.array([*rng.normal(0, 0.2, 2), rng.uniform(0, 1.6)]) for _ in range(rng.integers(2, 12))]
    return merge([blob(rng, 0.05, 0.3, at) for at in places])


def _clothes(rng: np.random.Generator) -> Mesh:
    """Draw cloths in a heap on the floor, or on a box."""
    high = rng.uniform(0.2, 0.8) if rng.random() < 0.5 else 0.0
    under = [box((-0.4, -0.25, 0), (0.4, 0.25, high), Surface.TABLE)] if high else []
    places = rng.normal((0, 0, high), (0.2, 0.2, 0), (int(rng.integers(1, 4)), 3))
    return merge([*under, *(laid(rng, at) for at in places)])


def _plant(rng: np.random.Generator) -> Mesh:
    """Draw thin leaves around a stem in a pot."""
    high = rng.uniform(0.4, 1.9)
    meshes = [_post(rng.uniform(0.1, 0.2), rng.uniform(0.15, 0.45)), _post(0.015, high)]
    for _ in range(int(rng.integers(8, 30))):
        long, wide = rng.uniform((0.08, 0.01), (0.3, 0.05))
        leaf = box((0, -wide, -0.003), (long, wide, 0.003), Surface.TABLE)
        turn = Rotation.from_euler("zyx", rng.uniform((-np.pi, -1, -1), (np.pi, 1, 1))).as_matrix()
        meshes.append(leaf.placed(turn, np.array([0, 0, high * rng.uniform(0.4, 1)])))
    return merge(meshes)


def _lamp(rng: np.random.Generator) -> Mesh:
    """Draw a post or a column with a head: a floor lamp, a coat stand, a barrel."""
    radius, height = rng.uniform(0.01, 0.3), rng.uniform(0.6, 1.8)
    return merge([_post(radius, height), blob(rng, 0.08, 0.3, np.array([0, 0, height]))])


def _curtain(rng: np.random.Generator) -> Mesh:
    u, v = np.meshgrid(np.linspace(-1, 1, 60), np.linspace(0, 1, 12), indexing="ij")
    width, wave, deep, height = rng.uniform((0.3, 3, 0.01, 1.5), (1.5, 20, 0.08, 2.5))
    folds = np.stack([width * u, deep * np.sin(wave * u + 0.6 * np.sin(3 * v)), height * v], -1)
    return tagged(folds.reshape(-1, 3).astype(np.float32), grid_faces(60, 12), Surface.WALL)


def _post(radius: float, height: float) -> Mesh:
    z, turn = np.meshgrid(np.linspace(0, height, 6), np.linspace(0, 2 * np.pi, 16), indexing="ij")
    post = np.stack([radius * np.cos(turn), radius * np.sin(turn), z], -1).reshape(-1, 3)
    return tagged(post.astype(np.float32), grid_faces(6, 16), Surface.TABLE)


def _box(x: float, y: float, z: float, tag: int = Surface.TABLE) -> Mesh:
    """Return a box of half sides x, y, z about the origin."""
    return box((-x, -y, -z), (x, y, z), tag)


def _bar(start: tuple[float, float, float], end: tuple[float, float, float], thick_m: float = 0.03) -> Mesh:
    """Return a square bar between two points (3,)."""
    along = np.subtract(end, start)
    turn, _ = Rotation.align_vectors([along], [[0, 0, 1]])
    half = thick_m / 2
    mesh = box((-half, -half, 0), (half, half, float(np.linalg.norm(along))), Surface.TABLE)
    return mesh.placed(turn.as_matrix(), np.array(start, np.float64))


def _turned(angle_rad: float) -> Float64:
    return np.asarray(Rotation.from_euler("z", angle_rad).as_matrix(), np.float64)


SHAPES: tuple[Draw, ...] = (
    table, desk, walker, _shelf, _shelf, _cupboard, _door, _any_box, _heap, _clothes, _plant, _lamp, _curtain
)  # fmt: skip
