"""Warm surface -> persons: whose torso it is, and which loose piece is whose limb."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from annotate.array_types import Bool, Float32, Float64, Index, Int32, UInt8
from annotate.cloud.grid import NO_PIXEL, components, flood
from annotate.cloud.supervoxels import clusters
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.person.pieces import MAX_PERSON_M2, MIN_PERSON_M2, Piece, pieces_of
from sensors.rig.nearest import Nearest

SPECK_M2 = 0.001
"""Visible surface of what is too small to be anything."""
TRUNK_M, CORE_M = 0.095, 0.08
"""A disc of the first radius fits on a trunk or a pelvis and on no head, arm or thigh; where one of the
second fits is the trunk's core."""
TRUNK_JUMP = 0.08
"""Depth step, as a share of the depth, within one trunk: an arm before it; another person is farther."""
LEAST_CORE_M2 = 0.015
"""Of a trunk; two knees side by side are as wide, but not for long."""
PERSON_M2 = 0.15
"""A piece with more surface is no loose limb: two legs together have less."""
CLOSE_M, CLOSE_EVERY = 0.2, 7
"""So near to each other two pieces may be one body's, seen at every seventh pixel: shadows lie between."""
ONE_PERSON_M = 0.7
"""Trunk and legs are nearer to each other than that, two people's trunks are not."""
NEAR_M, NEAR_SIZES = 0.40, 3.0
"""A loose warm piece is a limb of the person within this distance, and this many times its own size."""
PANEL_M = 0.006
"""Loose pieces flatter than this (standard deviation) are screens or panels, not limbs."""
TOUCH_M = 0.05
"""A gap that pixels without a reading make."""
BESIDE_PX = 4
"""So many pixels next to the person's make a loose piece its neighbour in the image."""
PAIRS = 12
"""Pairs of nearest pixels tried: a body bends out of sight somewhere along the gap."""
BEHIND_M, OPEN_M, OPEN_SHARE = 0.05, 0.08, 0.25
"""Where something farther than both, by the first, is seen between two parts of a body, for longer than the
second and for more than this share of the way, nothing joins them."""
MAX_PERSONS = 250


@dataclass(frozen=True)
class Person:
    """One person found. mask: bool (h, w). area_m2: visible surface. centre_m: mean of its points (3,)."""

    mask: Bool
    area_m2: float
    centre_m: Float64


def persons_of(cloud: ThermalCloud, mask: Bool) -> list[Person]:
    """Part the person-like pixels (h, w) of a frame among persons; what belongs to none is left out."""
    labels, pieces = pieces_of(cloud, mask, SPECK_M2)
    trunks = _trunks(cloud, mask, labels, pieces)
    if not trunks:
        return []
    owner = _owners(cloud, labels, pieces, trunks)
    persons = []
    for number in range(1, len(trunks) + 1):
        own = owner == number
        points = cloud.points_m[own].astype(np.float64)
        area = float(np.sum(points[:, 2] ** 2)) / (cloud.camera.fx * cloud.camera.fy)
        if MIN_PERSON_M2 <= area <= MAX_PERSON_M2:
            persons.append(Person(own, area, points.mean(axis=0)))
    return persons


def _trunks(cloud: ThermalCloud, mask: Bool, labels: Int32, pieces: Sequence[Piece]) -> list[Bool]:
    """Cores (h, w) of the trunks, one for each person; without any the widest piece, if there is one."""
    solid = np.isin(labels, [piece.label for piece in pieces if piece.thickness_m >= PANEL_M])
    # Closed, because the pixels between an arm and the trunk behind it often have no reading.
    closed = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((7, 7), np.uint8))
    depth_m = cloud.points_m[..., 2]
    # Without any background OpenCV's distance is infinite.
    radius_px = np.minimum(cv2.distanceTransform(closed, cv2.DIST_L2, 3), max(mask.shape))
    radius_m = np.where(solid, radius_px * depth_m / cloud.camera.fx, 0)
    cores, count = components(radius_m >= CORE_M, depth_m, TRUNK_JUMP)
    surface_m2 = depth_m**2 / (cloud.camera.fx * cloud.camera.fy)
    sure = []
    for label in range(1, count + 1):
        core = cores == label
        if radius_m[core].max() >= TRUNK_M and surface_m2[core].sum() >= LEAST_CORE_M2:
            sure.append(core)
    sure += _slender(cloud, labels, [p for p in pieces if p.thickness_m >= PANEL_M], sure)
    trunks = _apart(cloud, sure)
    if not trunks and solid.any():
        trunks = [labels == labels.ravel()[int(radius_m.argmax())]]
    return trunks


def _slender(
    cloud: ThermalCloud, labels: Int32, pieces: Sequence[Piece], cores: Sequence[Bool]
) -> list[Bool]:
    """Who has no trunk of that width, from the side or lying: much surface in pieces close to each other."""
    taken = np.unique(np.concatenate([labels[core] for core in cores])) if cores else np.zeros(0, np.int32)
    loose = [piece for piece in pieces if piece.label not in taken]
    large = [labels == piece.label for piece in loose if piece.area_m2 >= PERSON_M2]
    loose = [piece for piece in loose if piece.area_m2 < PERSON_M2]
    if sum(piece.area_m2 for piece in loose) < PERSON_M2:
        return large
    index = np.flatnonzero(np.isin(labels, [piece.label for piece in loose]))[::CLOSE_EVERY]
    close = clusters(cloud.points_m.reshape(-1, 3)[index], tolerance_m=CLOSE_M)
    body = _joined(labels.ravel()[index], close, int(labels.max()) + 1)
    area = np.bincount([body[p.label] for p in loose], [p.area_m2 for p in loose])
    of_pixel = np.where(np.isin(labels, [piece.label for piece in loose]), body[labels], -1)
    bodies = [of_pixel == number for number in np.flatnonzero(area >= PERSON_M2)]
    known = [cloud.points_m[one][::CLOSE_EVERY] for one in (*cores, *large)]
    return large + [body for body in bodies if not _near(known, cloud.points_m[body][::CLOSE_EVERY])]


def _joined(labels: Int32, close: Int32, count: int) -> Int32:
    """The lowest label (count,) that each of them is joined with, over others or not.

    labels, close: piece and cluster (n,) of some points; pieces that share a cluster are joined.
    """
    body = np.arange(count, dtype=np.int32)
    while True:
        lowest = np.full(close.max() + 1, len(body), np.int32)
        np.minimum.at(lowest, close, body[labels])
        if (lowest[close] == body[labels]).all():
            return body
        np.minimum.at(body, labels, lowest[close])


def _near(known_m: Sequence[Float32], points_m: Float32) -> bool:
    """Whether points (n, 3) are so near to any of the known bodies' that they are its limbs."""
    near = (Nearest(body).query(points_m)[0].min() < NEAR_M for body in known_m)
    return any(near)


def _apart(cloud: ThermalCloud, cores: Sequence[Bool]) -> list[Bool]:
    """Cores of one person joined."""
    joined: list[Bool] = []
    centres: list[Float32] = []
    for core in cores:
        centre = np.median(cloud.points_m[core], axis=0)
        near = [i for i, other in enumerate(centres) if np.linalg.norm(other - centre) < ONE_PERSON_M]
        if near:
            joined[near[0]] |= core
        elif len(joined) < MAX_PERSONS:
            joined.append(core)
            centres.append(centre)
    return joined


def _owners(cloud: ThermalCloud, labels: Int32, pieces: Sequence[Piece], trunks: Sequence[Bool]) -> UInt8:
    """Whose each pixel (h, w) is: 1 and on for the trunks in their order, 0 for nobody."""
    marks = np.where(np.isin(labels, [piece.label for piece in pieces]), 0, NO_PIXEL).astype(np.uint8)
    for number, trunk in enumerate(trunks, 1):
        marks[trunk] = number
    owner = flood(marks, np.nan_to_num(cloud.points_m[..., 2]), float(labels.size))
    owner[owner == NO_PIXEL] = 0
    limbs = _Limbs(cloud, [np.flatnonzero(owner == number)[::7] for number in range(1, len(trunks) + 1)])
    for piece in pieces:
        own = labels == piece.label
        if not owner[own].any() and piece.thickness_m >= PANEL_M:
            owner[own] = limbs.owner(own, min(NEAR_M, NEAR_SIZES * float(np.sqrt(piece.area_m2))), owner)
    return owner


class _Limbs:
    """Whose limb a loose piece is. seeds: for each person some pixels, flat indices."""

    def __init__(self, cloud: ThermalCloud, seeds: Sequence[Index]) -> None:
        self._points, self._depth_m = cloud.points_m.reshape(-1, 3), cloud.points_m[..., 2]
        self._pixel_rad = 1 / cloud.camera.fx
        self._seeds = seeds
        self._trees = [Nearest(self._points[seed]) for seed in seeds]

    def owner(self, piece: Bool, near_m: float, owner: UInt8) -> int:
        """Number of the person within ``near_m`` that a piece (h, w) belongs to, 0 for nobody.

        Beside the person in the image it does, and where what joins them can be hidden.
        """
        own = np.flatnonzero(piece)[::3]
        found = [tree.query(self._points[own], within=near_m) for tree in self._trees]
        whose = int(np.argmin([gap.min() for gap, _ in found]))
        gap, nearest = found[whose]
        order = np.argsort(gap)[: np.count_nonzero(gap <= min(near_m, 2 * gap.min() + TOUCH_M))]
        if not order.size:
            return 0
        beside = cv2.dilate(piece.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
        if np.count_nonzero(owner[beside] == whose + 1) >= BESIDE_PX:
            return whose + 1
        tried = order[:: 1 + order.size // PAIRS]
        pairs = ((int(own[i]), int(self._seeds[whose][nearest[i]])) for i in tried)
        hidden = any(_hidden_between(self._depth_m, one, other, self._pixel_rad) for one, other in pairs)
        return whose + 1 if hidden else 0


def _hidden_between(depth_m: Float32, one: int, other: int, pixel_rad: float) -> bool:
    """Whether what joins two pixels can be out of sight: a limb is never behind what is seen there."""
    v, u = line(depth_m.shape, one, other)
    steps, v0, u0, v1, u1 = len(v), v[0], u[0], v[-1], u[-1]
    farther = depth_m[v, u] > np.linspace(depth_m[v0, u0], depth_m[v1, u1], steps) + BEHIND_M
    open_m = np.count_nonzero(farther) * depth_m[v0, u0] * pixel_rad
    return bool(open_m <= OPEN_M or farther.mean() <= OPEN_SHARE)


def line(shape: tuple[int, ...], one: int, other: int) -> tuple[Index, Index]:
    """Rows and columns (n,) of the straight line from one pixel to another, flat indices, ends included."""
    (v0, u0), (v1, u1) = divmod(one, shape[1]), divmod(other, shape[1])
    steps = max(abs(v1 - v0), abs(u1 - u0)) + 1
    v, u = (np.rint(np.linspace(a, b, steps)).astype(np.intp) for a, b in ((v0, v1), (u0, u1)))
    return v, u
