"""Furniture, room and cameras. World frame: z up, metres; the person faces -y towards the robot."""

from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sensors.rig.rig_calibration import Pose
from synth.surface.rasterize import Mesh, merge


class Surface(IntEnum):
    """Tags of rendered faces that are no body part (body faces carry their part id, 1 to 11)."""

    FLOOR = 16
    WALL = 17
    SOFA = 18
    BED = 19
    TABLE = 20
    RADIATOR = 21
    MUG = 22
    HAIR = 23
    LAPTOP = 24
    KEYBOARD = 25
    SCREEN = 26
    WINDOW = 27
    SUNLIT = 28
    BLANKET = 29
    PILLOW = 30
    OTHER_PERSON = 31


@dataclass(frozen=True)
class Solid:
    """A box that carries or stops a body. low, high: its corners, metres, before it is turned and moved.

    rotation: (3, 3), about the box's own origin, then translation: (3,), to the world. give_m: how deep a
    body sinks into it. tag: ``Surface`` of its faces. carries_m: a limb inside leaves by the top where that
    is no more than this much farther than by a side.
    """

    low: tuple[float, float, float]
    high: tuple[float, float, float]
    give_m: float
    tag: int
    rotation: NDArray[np.float64] = field(default_factory=lambda: np.eye(3))
    translation: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    carries_m: float = 0.0

    def mesh(self) -> Mesh:
        """Its twelve triangles in the world."""
        return box(self.low, self.high, self.tag).placed(self.rotation, self.translation)

    def packed(self) -> NDArray[np.float64]:
        """(17,) for compiled code: centre, half sizes, give, bias to the top, rotation row by row."""
        low, high = np.array(self.low), np.array(self.high)
        centre = self.rotation @ ((low + high) / 2) + self.translation
        return np.concatenate(
            [centre, (high - low) / 2, [self.give_m, self.carries_m], self.rotation.ravel()]
        )

    def depth_m(self, points_m: NDArray[np.float32]) -> NDArray[np.float64]:
        """(...,) how deep world points (..., 3) lie under its surface; 0 outside, give not yet taken off."""
        local = (points_m - self.translation) @ self.rotation
        inside = np.minimum(local - np.array(self.low), np.array(self.high) - local).min(axis=-1)
        return np.asarray(np.maximum(inside, 0.0), np.float64)


FLOOR = Solid((-10.0, -10.0, -1.0), (10.0, 10.0, 0.0), 0.005, Surface.FLOOR, carries_m=2.0)
"""The floor every piece of furniture stands on; half a centimetre for socks and carpet."""


@dataclass(frozen=True)
class Sofa:
    """Where a person sits. Metres; the seat's front edge is at y = 0, the back rest starts at y = depth."""

    seat_height: float = 0.42
    depth: float = 0.56
    width: float = 1.7
    back_height: float = 0.48
    back_tilt_rad: float = 0.26
    arm_height: float = 0.20
    arm_width: float = 0.18
    give_m: float = 0.02

    @staticmethod
    def sample(rng: np.random.Generator) -> "Sofa":
        """A sofa or arm-chair of common furniture dimensions."""
        return Sofa(
            seat_height=rng.uniform(0.38, 0.47),
            depth=rng.uniform(0.48, 0.62),
            width=rng.uniform(0.62, 2.0),
            back_height=rng.uniform(0.35, 0.75),
            back_tilt_rad=rng.uniform(0.12, 0.38),
            arm_height=rng.uniform(0.12, 0.26),
        )

    def back_y(self, z_m: NDArray[np.float32]) -> NDArray[np.float64]:
        """Where the back rest's front face lies at height z (world)."""
        above = np.maximum(z_m.astype(np.float64) - self.seat_height, 0)
        return np.asarray(self.depth + np.tan(self.back_tilt_rad) * above, np.float64)

    def solids(self) -> list[Solid]:
        """Seat, back rest and arm rests."""
        half, h = self.width / 2, self.seat_height
        tilt = Rotation.from_euler("x", -self.back_tilt_rad).as_matrix()
        place = np.array([0, self.depth, h])
        give, tag = self.give_m, Surface.SOFA
        arms = [
            Solid((x, 0, 0.05), (x + self.arm_width, self.depth + 0.1, h + self.arm_height), give, tag)
            for x in (-half - self.arm_width, half)
        ]
        return [
            Solid((-half, 0, 0.05), (half, self.depth + 0.16, h), give, tag, carries_m=0.1),
            Solid((-half, 0, 0), (half, 0.16, self.back_height), give, tag, tilt, place),
            *arms,
        ]

    def mesh(self) -> Mesh:
        """The solids' faces."""
        return merge([solid.mesh() for solid in self.solids()])


@dataclass(frozen=True)
class Chair:
    """A chair without arms. Metres; the seat's front edge is at y = 0, as a sofa's."""

    seat_height: float = 0.45
    depth: float = 0.42
    width: float = 0.44
    back_height: float = 0.45
    back_tilt_rad: float = 0.12
    give_m: float = 0.01

    @staticmethod
    def sample(rng: np.random.Generator) -> "Chair":
        """A kitchen or ward chair of common dimensions."""
        return Chair(
            seat_height=rng.uniform(0.42, 0.50),
            depth=rng.uniform(0.38, 0.46),
            width=rng.uniform(0.42, 0.52),
            back_height=rng.uniform(0.35, 0.55),
            back_tilt_rad=rng.uniform(0.05, 0.2),
        )

    def back_y(self, z_m: NDArray[np.float32]) -> NDArray[np.float64]:
        """Where the back rest's front face lies at height z (world)."""
        above = np.maximum(z_m.astype(np.float64) - self.seat_height, 0)
        return np.asarray(self.depth + np.tan(self.back_tilt_rad) * above, np.float64)

    def solids(self) -> list[Solid]:
        """Seat, back rest and four legs."""
        half, h, leg, tag = self.width / 2, self.seat_height, 0.04, Surface.SOFA
        tilt = Rotation.from_euler("x", -self.back_tilt_rad).as_matrix()
        place = np.array([0, self.depth, h])
        legs = [
            Solid((x, y, 0), (x + leg, y + leg, h - 0.05), 0.0, tag)
            for x in (-half, half - leg)
            for y in (0.01, self.depth - leg)
        ]
        return [
            Solid((-half, 0, h - 0.05), (half, self.depth, h), self.give_m, tag, carries_m=0.1),
            Solid((-half, 0, 0.08), (half, 0.03, self.back_height), self.give_m, tag, tilt, place),
            *legs,
        ]

    def mesh(self) -> Mesh:
        """The solids' faces."""
        return merge([solid.mesh() for solid in self.solids()])


@dataclass(frozen=True)
class Bed:
    """Where a person lies. Metres; centred on the world's z axis, its length along y, the pillow at +y.

    give_m: how deep a body sinks into mattress and pillow, 4 cm: between a firm and a soft foam mattress
    under a back (a stated simplification: the mattress is drawn flat).
    """

    height: float = 0.50
    length: float = 2.0
    width: float = 0.95
    pillow_height: float = 0.09
    board_height: float = 0.35
    give_m: float = 0.04

    @staticmethod
    def sample(rng: np.random.Generator) -> "Bed":
        """A single, double or nursing bed."""
        return Bed(
            height=rng.uniform(0.38, 0.70),
            length=rng.uniform(1.95, 2.15),
            width=rng.uniform(0.85, 1.6),
            pillow_height=rng.uniform(0.06, 0.13),
            board_height=rng.uniform(0.1, 0.55),
        )

    def solids(self) -> list[Solid]:
        """Mattress on its base, pillow and head board."""
        x, y, h, tag = self.width / 2, self.length / 2, self.height, Surface.BED
        pillow = min(0.33, x - 0.05)
        return [
            Solid((-x, -y, 0.12), (x, y, h), self.give_m, tag, carries_m=0.15),
            Solid(
                (-pillow, y - 0.37, h - 0.1),
                (pillow, y - 0.02, h + self.pillow_height),
                0.07,
                Surface.PILLOW,
                carries_m=0.2,
            ),
            Solid((-x, y, 0.0), (x, y + 0.05, h + self.board_height), 0.0, tag),
        ]

    def mesh(self) -> Mesh:
        """The solids' faces."""
        return merge([solid.mesh() for solid in self.solids()])


@dataclass(frozen=True)
class Ground:
    """The bare floor as a place to lie on; ``mesh`` is what a camera sees of it."""

    height: float = 0.0
    give_m: float = FLOOR.give_m

    def solids(self) -> list[Solid]:
        """None but the floor, which is always there."""
        return []

    def mesh(self) -> Mesh:
        """Three metres of floor to each side."""
        return sheet(np.array([-3.0, -3.0, 0.0]), np.array([6.0, 0, 0]), np.array([0, 6.0, 0]), Surface.FLOOR)


def box(low: tuple[float, float, float], high: tuple[float, float, float], tag: int) -> Mesh:
    """Axis-aligned box as 12 triangles."""
    x, y, z = zip(low, high, strict=True)
    corners = np.array([(a, b, c) for a in x for b in y for c in z], np.float32)
    quads = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    faces = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))], np.int32)
    return Mesh(corners, faces, np.full(len(faces), tag, np.int32))


def sheet(
    origin: NDArray[np.float64], along: NDArray[np.float64], across: NDArray[np.float64], tag: int
) -> Mesh:
    """Rectangle cut into quarter-metre cells, so that a cell behind the camera can be dropped alone."""
    n, m = (max(1, int(np.ceil(np.linalg.norm(side) / 0.25))) for side in (along, across))
    i, j = np.meshgrid(np.linspace(0, 1, n + 1), np.linspace(0, 1, m + 1), indexing="ij")
    vertices = (origin + i[..., None] * along + j[..., None] * across).reshape(-1, 3).astype(np.float32)
    faces = grid_faces(n + 1, m + 1)
    return Mesh(vertices, faces, np.full(len(faces), tag, np.int32))


def grid_faces(rows: int, columns: int) -> NDArray[np.int32]:
    """Triangles (2 (rows - 1) (columns - 1), 3) between the nodes of a grid, numbered row by row."""
    a = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    b = a + columns
    halves = [np.stack([a, a + 1, b + 1], axis=1), np.stack([a, b + 1, b], axis=1)]
    return np.concatenate(halves).astype(np.int32)


def room(back_wall_y: float, half_width: float = 2.5, front_y: float = -3.5, height: float = 2.5) -> Mesh:
    """Floor and four walls; sheets nearer to a camera than it can see are not drawn."""
    depth = np.array([0, back_wall_y - front_y, 0])
    width, up = np.array([2 * half_width, 0, 0]), np.array([0, 0, height])
    corner = np.array([-half_width, front_y, 0])
    return merge(
        [
            sheet(corner, width, depth, Surface.FLOOR),
            sheet(corner + depth, width, up, Surface.WALL),
            sheet(corner, width, up, Surface.WALL),
            sheet(corner, depth, up, Surface.WALL),
            sheet(corner + width, depth, up, Surface.WALL),
        ]
    )


def look_at(eye_m: NDArray[np.float64], target_m: NDArray[np.float64], roll_rad: float = 0.0) -> Pose:
    """``camera_from_world`` of a camera at ``eye_m`` looking at ``target_m``; x is level but for roll."""
    forward = (target_m - eye_m) / np.linalg.norm(target_m - eye_m)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    if np.linalg.norm(right) < 1e-6:
        right = np.array([1.0, 0.0, 0.0])
    right = right / np.linalg.norm(right)
    level = np.stack([right, np.cross(forward, right), forward])
    rotation = Rotation.from_euler("z", roll_rad).as_matrix() @ level
    return Pose(rotation, -rotation @ eye_m)


def beside(
    centre_m: NDArray[np.float64], azimuth_rad: float, distance_m: float, height_m: float
) -> NDArray[np.float64]:
    """A place (3,) so far from a centre (3,) on the level, at a height; azimuth 0 is before the person."""
    place = centre_m + distance_m * np.array([np.sin(azimuth_rad), -np.cos(azimuth_rad), 0.0])
    place[2] = height_m
    return place


def view_around(
    rng: np.random.Generator, centre_m: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Eye and target (3,) each of a camera anywhere around a lying person (the paper's 360 degrees).

    Heights from a robot's bumper camera (0.4 m over the person) to a ceiling's (2.6 m over the floor).
    """
    azimuth = rng.uniform(-np.pi, np.pi)
    level = rng.choice((0.7, 1.1, 1.5, 2.1)) + rng.uniform(-0.2, 0.2)
    distance = rng.uniform(1.2, 2.6)
    eye = beside(centre_m, azimuth, distance, max(centre_m[2] + 0.3, level))
    return eye, centre_m + rng.normal(0, (0.12, 0.12, 0.05))
