"""Viewpoints: places of the camera, drawn at random; world frame, metres.

Constants are untuned unless a source is given.
"""

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
    """Place (3,) and pose of a camera in the world."""

    eye_m: Float64
    camera_from_world: Pose


Viewpoint = Callable[[np.random.Generator, Float32, Float64, Intrinsics], Shot]
"""Sampler of a camera for posed vertices (V, 3), joints (J, 3) and the pinhole of the whole image."""
PlaceSampler = Callable[[np.random.Generator, Float64], tuple[Float64, Float64]]
"""Sampler of a camera's eye and target (3,) for a person's middle (3,)."""

PERSON_PX = (90.0, 420.0)  # extent of a whole person in the image, log-uniform
DISTANCE_M = (0.75, 4.3)  # from camera to the person's middle: the range of depth cameras
NEAREST_M = 0.6  # of a visible point: depth cameras are blind nearer
HEIGHT_M = (0.4, 2.6)  # of the camera over the floor
COMMON_HEIGHT_M = (1.2, 0.35)  # mean and deviation of half of the heights: tables, tripods, robots
CUT_SHARE = 0.15  # of images whose border cuts the person
PORTRAIT, HALF = 0.3, 0.35  # of these, head and shoulders, and half figures
PORTRAIT_M, HALF_M = (0.45, 0.9), (0.9, 1.5)  # vertical span of the image at such a person
LEAST_IN_VIEW, MOST_IN_VIEW = 0.12, 0.97  # share of a cut person's skin inside the image
STEEPEST = (-0.35, 0.9)  # sine of the camera's elevation over the person's middle
ROLL_DEG = 2.0  # standard deviation of the camera's roll
ATTEMPTS = 30  # views drawn at most
EVERY = 19  # stride of the skin's vertices by which a view is planned


def unplanned(place: PlaceSampler) -> Viewpoint:
    """Return a sampler of viewpoints from ``place``, with random roll; the image may cut the person."""

    def view(rng: np.random.Generator, vertices_m: Float32, joints_m: Float64, camera: Intrinsics) -> Shot:
        eye, target = place(rng, joints_m.mean(axis=0))
        return Shot(eye, look_at(eye, target, np.radians(rng.normal(0, ROLL_DEG))))

    return view


def frontal_place(rng: np.random.Generator, centre_m: Float64) -> tuple[Float64, Float64]:
    """Draw eye and target (3,) within 65 degrees of the front, the eye at a robot's chest to head height."""
    azimuth, distance, height = np.radians(rng.uniform(-65, 65)), rng.uniform(1.3, 3.0), rng.uniform(0.6, 1.7)
    return beside(centre_m, azimuth, distance, height), centre_m + rng.normal(0, (0.12, 0.12, 0.10))


def surrounding_place(rng: np.random.Generator, centre_m: Float64) -> tuple[Float64, Float64]:
    """Draw eye and target (3,) anywhere around an upright person."""
    azimuth, distance, height = rng.uniform(-np.pi, np.pi), rng.uniform(1.4, 3.5), rng.uniform(0.6, 1.8)
    return beside(centre_m, azimuth, distance, height), centre_m + rng.normal(0, (0.12, 0.12, 0.10))


def overhead_place(rng: np.random.Generator, centre_m: Float64) -> tuple[Float64, Float64]:
    """Draw eye and target (3,) around a lying person, from bumper to ceiling height, as in the paper."""
    azimuth = rng.uniform(-np.pi, np.pi)
    level = rng.choice((0.7, 1.1, 1.5, 2.1)) + rng.uniform(-0.2, 0.2)
    distance = rng.uniform(1.2, 2.6)
    eye = beside(centre_m, azimuth, distance, max(centre_m[2] + 0.3, level))
    return eye, centre_m + rng.normal(0, (0.12, 0.12, 0.05))


@dataclass(frozen=True)
class PlannedViewpoint:
    """Sampler of viewpoints chosen by the image: whole people of any size, some cut by the borders.

    front, side: shares of views within 45 degrees of the front, and from 45 to 135. over_m: least height of
    the camera above the person's middle.
    """

    front: float = 0.55
    side: float = 0.25
    over_m: float = -10.0

    def __call__(
        self, rng: np.random.Generator, vertices_m: Float32, joints_m: Float64, camera: Intrinsics
    ) -> Shot:
        """Draw shots until one shows the person; return it, or the last of ``ATTEMPTS``."""
        points, c = vertices_m[::EVERY].astype(np.float64), camera
        pinhole = np.array([c.width, c.height, c.fx, c.fy, c.cx, c.cy])
        is_cut = rng.random() < CUT_SHARE
        for _ in range(ATTEMPTS):
            azimuth, height = self._azimuth(rng), self._height(rng, points)
            if is_cut:
                eye, target = _cut(rng, (points, joints_m), camera, azimuth, height)
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
    """Return a camera position (3,) at a distance from a point (3,), at the wanted height if possible; see
    ``beside``.
    """
    sine = min(max((height - middle[2]) / distance, STEEPEST[0]), STEEPEST[1])
    level = distance * np.sqrt(1 - sine * sine)
    eye: Float64 = middle + level * np.array([np.sin(azimuth), -np.cos(azimuth), 0.0])
    eye[2] = max(middle[2] + distance * sine, 0.2)
    return eye


@numba.njit(cache=True)
def _axes(eye: Float64, target: Float64) -> Float64:
    """Return the unit vectors (3, 3) across, down and along the view of a level camera; see ``look_at``."""
    axes = np.zeros((3, 3))
    axes[2] = (target - eye) / np.sqrt(np.sum((target - eye) ** 2))
    axes[0, 0], axes[0, 1] = axes[2, 1], -axes[2, 0]
    axes[0] /= np.sqrt(np.sum(axes[0] ** 2)) + 1e-9
    axes[1] = np.cross(axes[2], axes[0])
    return axes


@numba.njit(cache=True)
def _extent(points: Float64, middle: Float64, axes: Float64) -> tuple[Float64, Float64]:
    """Return the least and greatest coordinates (2,) of points (n, 3), across and down a view."""
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
    """Return eye and target (3,) of a camera with the whole person in its image.

    shares: (3,) in [0, 1): relative size, and position in the free room across and down.
    """
    middle = _middle(points)
    size, focal, centre = pinhole[:2], pinhole[2], pinhole[4:]
    low, high = _extent(points, middle, _axes(_eye(middle, azimuth, 3.0, height), middle))
    # Sizes that fit into the image and the sensor's range.
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
    return np.array([(points[:, a].min() + points[:, a].max()) / 2 for a in range(3)])


def _cut(
    rng: np.random.Generator,
    person: tuple[Float64, Float64],
    camera: Intrinsics,
    azimuth: float,
    height: float,
) -> tuple[Float64, Float64]:
    """Draw eye and target (3,) of an image that cuts the person: a portrait, a half figure, any border.

    person: points (n, 3) and joints (J, 3).
    """
    kind, (points, joints_m) = rng.random(), person
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
    # The border lies at this quantile of the skin; on the other axis the person is near the middle.
    lost = rng.uniform(0.08, 0.6)
    aim = np.median(off, axis=0) + rng.normal(0, 0.15, 2)
    aim[side] = sign * (np.quantile(sign * off[:, side], 1 - lost) - half[side])
    return eye, middle + aim @ axes


@numba.njit(cache=True)
def _in_view(points: Float64, eye: Float64, target: Float64, pinhole: Float64) -> tuple[float, float]:
    """Return the share of points (n, 3) inside a level camera's image, and their least distance along z.

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
    """Return flags (n,) of points (n, 3), camera frame, inside the whole image."""
    x, y, z = points_m.T
    near = np.maximum(z, NEAR_M)
    u, v = camera.fx * x / near + camera.cx, camera.fy * y / near + camera.cy
    return np.asarray((z > NEAR_M) & (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height))
