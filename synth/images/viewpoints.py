"""Viewpoints: where the camera stands that sees a person, drawn at random; world frame, metres."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numba
import numpy as np

from annotate.array_types import Bool, Float32, Float64
from sensors.rig.camera import Intrinsics
from sensors.rig.rig_calibration import Pose
from synth.body.skeleton import JOINT_ID, turn
from synth.surface.rasterize import NEAR_M, beside, look_at


class Shot(NamedTuple):
    """A camera in the world. eye_m: (3,) its place."""

    eye_m: Float64
    camera_from_world: Pose


Viewpoint = Callable[[np.random.Generator, Float32, Float64, Intrinsics], Shot]
"""Draws a camera's place for posed vertices (V, 3), joints (J, 3) and the pinhole of the whole image."""
Place = Callable[[np.random.Generator, Float64], tuple[Float64, Float64]]
"""Draws a camera's eye and target (3,) each about a person's middle (3,)."""


def looking(place: Place) -> Viewpoint:
    """The viewpoint of a camera at a drawn place, its roll drawn too; its image does not matter."""

    def view(rng: np.random.Generator, vertices_m: Float32, joints_m: Float64, camera: Intrinsics) -> Shot:
        eye, target = place(rng, joints_m.mean(axis=0))
        return Shot(eye, look_at(eye, target, np.radians(rng.normal(0, ROLL_DEG))))

    return view


def before(rng: np.random.Generator, centre_m: Float64) -> tuple[Float64, Float64]:
    """Eye and target of a camera within 65 degrees of the front, at a robot's chest to head height."""
    azimuth, distance, height = np.radians(rng.uniform(-65, 65)), rng.uniform(1.3, 3.0), rng.uniform(0.6, 1.7)
    return beside(centre_m, azimuth, distance, height), centre_m + rng.normal(0, (0.12, 0.12, 0.10))


def all_round(rng: np.random.Generator, centre_m: Float64) -> tuple[Float64, Float64]:
    """Eye and target of a camera anywhere around somebody upright."""
    azimuth, distance, height = rng.uniform(-np.pi, np.pi), rng.uniform(1.4, 3.5), rng.uniform(0.6, 1.8)
    return beside(centre_m, azimuth, distance, height), centre_m + rng.normal(0, (0.12, 0.12, 0.10))


def above(rng: np.random.Generator, centre_m: Float64) -> tuple[Float64, Float64]:
    """Eye and target of a camera anywhere around a lying person (the paper's 360 degrees).

    Heights from a robot's bumper camera (0.4 m over the person) to a ceiling's (2.6 m over the floor).
    """
    azimuth = rng.uniform(-np.pi, np.pi)
    level = rng.choice((0.7, 1.1, 1.5, 2.1)) + rng.uniform(-0.2, 0.2)
    distance = rng.uniform(1.2, 2.6)
    eye = beside(centre_m, azimuth, distance, max(centre_m[2] + 0.3, level))
    return eye, centre_m + rng.normal(0, (0.12, 0.12, 0.05))


PERSON_PX = (90.0, 420.0)
"""Least and greatest extent of a whole person in the image, log-uniform."""
DISTANCE_M = (0.75, 4.3)
"""Between camera and the person's middle: what depth cameras read."""
NEAREST_M = 0.6
"""Nothing of a person in view is nearer: depth cameras are blind there."""
HEIGHT_M = (0.4, 2.6)
"""Of the camera over the floor."""
COMMON_HEIGHT_M = (1.2, 0.35)
"""Mean and deviation of half of the cameras' heights: tables, tripods, robots. Chosen by eye."""
CUT_SHARE = 0.15
"""Of images whose border cuts the person."""
PORTRAIT, HALF = 0.3, 0.35
"""Of these, head and shoulders, and half figures; the others are cut by any border. Chosen by eye."""
PORTRAIT_M, HALF_M = (0.45, 0.9), (0.9, 1.5)
"""What the image spans vertically at such a person. Chosen by eye."""
LEAST_IN_VIEW, MOST_IN_VIEW = 0.12, 0.97
"""Share of a cut person's skin inside the image."""
STEEPEST = (-0.35, 0.9)
"""Sine of the camera's elevation over the person's middle, least and greatest. Chosen by eye."""
ROLL_DEG = 2.0
"""Standard deviation of the camera's roll."""
ATTEMPTS = 30
"""Views drawn at most until one shows what it should."""
EVERY = 19
"""Vertices of the skin by which a view is planned."""


@dataclass(frozen=True)
class Around:
    """A viewpoint that plans its image: whole people of any size in it, some cut by its borders.

    front, side: shares of the views within 45 degrees of the person's front and up to 135, the others are
    from behind. over_m: least height of the camera over the person's middle.
    """

    front: float = 0.55
    side: float = 0.25
    over_m: float = -10.0

    def __call__(
        self, rng: np.random.Generator, vertices_m: Float32, joints_m: Float64, camera: Intrinsics
    ) -> Shot:
        """A shot that shows the person, or the last of some attempts."""
        points, c = vertices_m[::EVERY].astype(np.float64), camera
        pinhole = np.array([c.width, c.height, c.fx, c.fy, c.cx, c.cy])
        is_cut = rng.random() < CUT_SHARE
        for _ in range(ATTEMPTS):
            azimuth, height = self._azimuth(rng), self._height(rng, points)
            if is_cut:
                eye, target = _cut(rng, points, joints_m, camera, azimuth, height)
            else:
                eye, target = _whole(rng.random(3), points, pinhole, azimuth, height)
            share, nearest = _in_view(points, eye, target, pinhole)
            if nearest > NEAREST_M and (LEAST_IN_VIEW < share < MOST_IN_VIEW if is_cut else share == 1.0):
                break
        rotation = turn(2, np.radians(rng.normal(0, ROLL_DEG))) @ _axes(eye, target)
        return Shot(eye, Pose(rotation, -rotation @ eye))

    def _azimuth(self, rng: np.random.Generator) -> float:
        kind, share, sign = rng.random(3).tolist()
        low, high = (135, 180)
        if kind < self.front + self.side:
            low, high = (0, 45) if kind < self.front else (45, 135)
        return math.radians(low + (high - low) * share) * (1 if sign < 0.5 else -1)

    def _height(self, rng: np.random.Generator, points: Float64) -> float:
        height = rng.normal(*COMMON_HEIGHT_M) if rng.random() < 0.5 else rng.uniform(*HEIGHT_M)
        least = max(HEIGHT_M[0], float(points[:, 2].mean()) + self.over_m)
        return float(min(max(height, least), max(HEIGHT_M[1], least)))


@numba.njit(cache=True)
def _eye(middle: Float64, azimuth: float, distance: float, height: float) -> Float64:
    """Place (3,) so far from a middle (3,), at the height where that is possible; see ``beside``."""
    sine = min(max((height - middle[2]) / distance, STEEPEST[0]), STEEPEST[1])
    level = distance * np.sqrt(1 - sine * sine)
    eye: Float64 = middle + level * np.array([np.sin(azimuth), -np.cos(azimuth), 0.0])
    eye[2] = max(middle[2] + distance * sine, 0.2)
    return eye


@numba.njit(cache=True)
def _axes(eye: Float64, target: Float64) -> Float64:
    """Directions (3, 3) across, down and along the view of a level camera at ``eye``; see ``look_at``."""
    axes = np.zeros((3, 3))
    axes[2] = (target - eye) / np.sqrt(np.sum((target - eye) ** 2))
    axes[0, 0], axes[0, 1] = axes[2, 1], -axes[2, 0]
    axes[0] /= np.sqrt(np.sum(axes[0] ** 2)) + 1e-9
    axes[1] = np.cross(axes[2], axes[0])
    return axes


@numba.njit(cache=True)
def _extent(points: Float64, middle: Float64, axes: Float64) -> tuple[Float64, Float64]:
    """Least and greatest coordinates (2,) of points (n, 3) across and down a view, from its middle."""
    low, high = np.full(2, np.inf), np.full(2, -np.inf)
    for i in range(len(points)):
        x, y, z = points[i, 0] - middle[0], points[i, 1] - middle[1], points[i, 2] - middle[2]
        for a in range(2):
            off = axes[a, 0] * x + axes[a, 1] * y + axes[a, 2] * z
            low[a], high[a] = min(low[a], off), max(high[a], off)
    return low, high


@numba.njit(cache=True)
def _whole(
    shares: Float64, points: Float64, pinhole: Float64, azimuth: float, height: float
) -> tuple[Float64, Float64]:
    """Eye and target (3,) of a camera with all of a person anywhere in its image.

    shares: (3,) random numbers in [0, 1): of the size, and of the free room across and down.
    """
    middle = _middle(points)
    size, focal, centre = pinhole[:2], pinhole[2], pinhole[4:]
    low, high = _extent(points, middle, _axes(_eye(middle, azimuth, 3.0, height), middle))
    # What fits into the image with a little room; and what the sensor can read.
    largest = np.max(high - low)
    fits = np.min(0.94 * size / (high - low)) * largest
    least = max(PERSON_PX[0], focal * largest / DISTANCE_M[1])
    most = max(least, min(PERSON_PX[1], fits, focal * largest / DISTANCE_M[0]))
    distance = focal * largest / (least * (most / least) ** shares[0])
    eye = _eye(middle, azimuth, distance, height)
    axes = _axes(eye, middle)
    low, high = _extent(points, middle, axes)
    room = np.minimum(centre, size - 1 - centre) * distance / focal - (high - low) / 2
    aim = (low + high) / 2 - 0.85 * (2 * shares[1:] - 1) * np.maximum(room, 0.0)
    return eye, middle + aim[0] * axes[0] + aim[1] * axes[1]


@numba.njit(cache=True)
def _middle(points: Float64) -> Float64:
    """Middle (3,) of the box about points (n, 3)."""
    return np.array([(points[:, a].min() + points[:, a].max()) / 2 for a in range(3)])


def _cut(
    rng: np.random.Generator,
    points: Float64,
    joints_m: Float64,
    camera: Intrinsics,
    azimuth: float,
    height: float,
) -> tuple[Float64, Float64]:
    """Eye and target (3,) of a camera whose image cuts the person: a portrait, a half figure, any border."""
    kind = rng.random()
    if kind < PORTRAIT + HALF:
        span = rng.uniform(*(PORTRAIT_M if kind < PORTRAIT else HALF_M))
        head, pelvis = joints_m[JOINT_ID["head"]], joints_m[JOINT_ID["pelvis"]]
        down = (pelvis - head) / np.linalg.norm(pelvis - head)
        target = head + down * (span * rng.uniform(0.1, 0.4)) + rng.normal(0, 0.12, 3) * span
        distance = max(camera.fy * span / camera.height, DISTANCE_M[0])
        return _eye(target, azimuth, distance, height), target
    middle = _middle(points)
    eye = _eye(middle, azimuth, rng.uniform(1.0, DISTANCE_M[1] - 0.3), height)
    axes = _axes(eye, middle)[:2]
    off = (points - middle) @ axes.T
    half = np.array([camera.width, camera.height]) / 2 * np.linalg.norm(eye - middle) / camera.fx
    side, sign = int(rng.integers(2)), rng.choice((-1.0, 1.0))
    # A border at this quantile of the skin; on the other axis the person is about the middle.
    lost = rng.uniform(0.08, 0.6)
    aim = np.median(off, axis=0) + rng.normal(0, 0.15, 2)
    aim[side] = sign * (np.quantile(sign * off[:, side], 1 - lost) - half[side])
    return eye, middle + aim @ axes


@numba.njit(cache=True)
def _in_view(points: Float64, eye: Float64, target: Float64, pinhole: Float64) -> tuple[float, float]:
    """Share of points (n, 3) inside the image of a level camera, and the nearest one's distance along z.

    pinhole: (6,) width, height, fx, fy, cx, cy.
    """
    axes, count, nearest = _axes(eye, target), 0, np.inf
    width, height, fx, fy, cx, cy = pinhole
    for i in range(len(points)):
        a, b, c = points[i, 0] - eye[0], points[i, 1] - eye[1], points[i, 2] - eye[2]
        z = axes[2, 0] * a + axes[2, 1] * b + axes[2, 2] * c
        if z <= NEAR_M:
            continue
        x = axes[0, 0] * a + axes[0, 1] * b + axes[0, 2] * c
        y = axes[1, 0] * a + axes[1, 1] * b + axes[1, 2] * c
        if 0 <= fx * x / z + cx < width and 0 <= fy * y / z + cy < height:
            count += 1
            nearest = min(nearest, z)
    return count / len(points), nearest


def inside_image(points_m: Float64, camera: Intrinsics) -> Bool:
    """Flags (n,) of the points (n, 3) of the camera frame that the whole image covers."""
    x, y, z = points_m.T
    near = np.maximum(z, NEAR_M)
    u, v = camera.fx * x / near + camera.cx, camera.fy * y / near + camera.cy
    return np.asarray((z > NEAR_M) & (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height))
