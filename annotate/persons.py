"""Warm surface -> persons: whose torso it is, and which loose piece is whose limb."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from annotate.cloud import ThermalCloud
from annotate.grid import NO_PIXEL, components, flood
from annotate.pieces import MAX_PERSON_M2, MIN_PERSON_M2, Piece, pieces_of

SPECK_M2 = 0.001
"""Visible surface of what is too small to be anything."""
TRUNK_M, CORE_M = 0.095, 0.08
"""A disc of the first radius fits on a trunk or a pelvis and on no head, arm or thigh; where one of the
second fits is the trunk's core."""
TRUNK_JUMP = 0.08
"""Depth step, as a share of the depth, within one trunk: an arm before it; another person is farther."""
LEAST_CORE_M2 = 0.015
"""Of a trunk; two knees side by side are as wide, but not for long."""
ONE_PERSON_M = 0.5
"""Trunk and pelvis are nearer to each other than that, two people's trunks are not."""
NEAR_M, NEAR_SIZES = 0.40, 3.0
"""A loose warm piece is a limb of the person within this distance, and this many times its own size."""
PANEL_M = 0.006
"""Loose pieces flatter than this (standard deviation) are screens or panels, not limbs."""
TOUCH_M = 0.05
"""A gap that pixels without a reading make."""
PAIRS = 12
"""Pairs of nearest pixels tried: a body bends out of sight somewhere along the gap."""
OPEN_SHARE = 0.25
"""Of the pixels between two parts of a body: more with something farther than both, and nothing joins them."""
MAX_PERSONS = 250


@dataclass(frozen=True)
class Person:
    """One person found. mask: bool (h, w). area_m2: visible surface. centre_m: mean of its points (3,)."""

    mask: NDArray[np.bool_]
    area_m2: float
    centre_m: NDArray[np.float64]


def persons_of(cloud: ThermalCloud, mask: NDArray[np.bool_]) -> list[Person]:
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


def _trunks(
    cloud: ThermalCloud, mask: NDArray[np.bool_], labels: NDArray[np.int32], pieces: Sequence[Piece]
) -> list[NDArray[np.bool_]]:
    """Cores (h, w) of the trunks, one for each person; without any the widest piece, if there is one."""
    solid = np.isin(labels, [piece.label for piece in pieces if piece.thickness_m >= PANEL_M])
    # Closed, because the pixels between an arm and the trunk behind it often have no reading.
    closed = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((7, 7), np.uint8))
    depth_m = cloud.points_m[..., 2]
    radius_m = np.where(solid, cv2.distanceTransform(closed, cv2.DIST_L2, 3) * depth_m / cloud.camera.fx, 0)
    cores, count = components(radius_m >= CORE_M, depth_m, TRUNK_JUMP)
    surface_m2 = depth_m**2 / (cloud.camera.fx * cloud.camera.fy)
    trunks: list[NDArray[np.bool_]] = []
    centres: list[NDArray[np.float32]] = []
    for label in range(1, count + 1):
        core = cores == label
        if radius_m[core].max() < TRUNK_M or surface_m2[core].sum() < LEAST_CORE_M2:
            continue
        centre = np.median(cloud.points_m[core], axis=0)
        near = [i for i, other in enumerate(centres) if np.linalg.norm(other - centre) < ONE_PERSON_M]
        if near:
            trunks[near[0]] |= core
        elif len(trunks) < MAX_PERSONS:
            trunks.append(core)
            centres.append(centre)
    if not trunks and solid.any():
        trunks = [labels == labels.ravel()[int(radius_m.argmax())]]
    return trunks


def _owners(
    cloud: ThermalCloud,
    labels: NDArray[np.int32],
    pieces: Sequence[Piece],
    trunks: Sequence[NDArray[np.bool_]],
) -> NDArray[np.uint8]:
    """Whose each pixel (h, w) is: 1 and on for the trunks in their order, 0 for nobody."""
    marks = np.where(np.isin(labels, [piece.label for piece in pieces]), 0, NO_PIXEL).astype(np.uint8)
    for number, trunk in enumerate(trunks, 1):
        marks[trunk] = number
    owner = flood(marks, np.nan_to_num(cloud.points_m[..., 2]), float(labels.size))
    owner[owner == NO_PIXEL] = 0
    seeds = [np.flatnonzero(owner == number)[::7] for number in range(1, len(trunks) + 1)]
    points, depth_m = cloud.points_m.reshape(-1, 3), cloud.points_m[..., 2]
    trees = [cKDTree(points[seed]) for seed in seeds]
    for piece in pieces:
        own = np.flatnonzero(labels == piece.label)[::3]
        if owner.ravel()[own].any() or piece.thickness_m < PANEL_M:
            continue
        near_m = min(NEAR_M, NEAR_SIZES * np.sqrt(piece.area_m2))
        found = [tree.query(points[own], distance_upper_bound=near_m) for tree in trees]
        whose = int(np.argmin([gap.min() for gap, _ in found]))
        gap, nearest = found[whose]
        order = np.argsort(gap)[: np.count_nonzero(gap <= min(near_m, 2 * gap.min() + TOUCH_M))]
        if any(
            _hidden_between(depth_m, int(own[i]), int(seeds[whose][nearest[i]]), float(gap[i]))
            for i in order[:: max(1, order.size // PAIRS)]
        ):
            owner[labels == piece.label] = whose + 1
    return owner


def _hidden_between(depth_m: NDArray[np.float32], one: int, other: int, gap_m: float) -> bool:
    """Whether what joins two pixels can be out of sight: a limb's middle is never behind what is seen there."""
    if gap_m <= TOUCH_M:
        return True
    (v0, u0), (v1, u1) = (divmod(pixel, depth_m.shape[1]) for pixel in (one, other))
    steps = max(abs(v1 - v0), abs(u1 - u0)) + 1
    v, u = (np.rint(np.linspace(a, b, steps)).astype(np.intp) for a, b in ((v0, v1), (u0, u1)))
    farther = depth_m[v, u] > np.linspace(depth_m[v0, u0], depth_m[v1, u1], steps) + TOUCH_M
    return bool(farther.mean() <= OPEN_SHARE)
