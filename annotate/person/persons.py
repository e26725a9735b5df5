"""Persons of a frame, from the warm surface: one for each trunk, with the loose limbs that belong to it.

Two halves of a person, above and below a laptop or a table before the body, are joined.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from annotate.array_types import Bool, Float32, Float64, Index, Int32, UInt8
from annotate.cloud.grid import NO_PIXEL, components, flood, grown
from annotate.cloud.supervoxels import clusters
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.person.pieces import MIN_PERSON_M2, MOST_PERSON_M2, Piece, pieces_of
from sensors.rig.nearest import Nearest

SPECK_M2 = 0.001
"""Visible surface in m2 below which a piece is noise. Chosen by eye."""
TRUNK_M, CORE_M = 0.095, 0.08
"""Metres: radius of a disc that fits on trunk or pelvis, not on head, arm or thigh, and of that whose centres
are a trunk's core. Chosen by eye."""
TRUNK_JUMP = 0.08
"""Depth step within one trunk as a share of the depth: another person is farther. Chosen by eye."""
LEAST_CORE_M2, PERSON_M2 = 0.015, 0.15
"""Least surface in m2 of a core, as two knees are as wide, but not for long, and of what is no loose limb.
Chosen by eye."""
CLOSE_M, CLOSE_EVERY = 0.2, 7
"""Metres within which pieces without a trunk belong to one body, as shadows lie between, and the step between
the pixels compared. Chosen by eye."""
ONE_PERSON_M, MOST_PERSONS = 0.7, 250
"""Metres between the middles of cores below which they are one person's; most persons of one frame. Chosen by
eye."""
LIMB_M, LIMB_SIZES = 0.40, 3.0
"""Most metres from a person to a loose warm limb of theirs, and most of its sizes (roots of its surface).
Chosen by eye."""
PANEL_M = 0.006
"""Standard deviation in metres below which a loose piece is a screen or a panel. Chosen by eye."""
TOUCH_M, TOUCHING_PX = 0.05, 4
"""Metres of a gap that pixels without a reading make; pixels beside a person that make a piece theirs. Chosen
by eye."""
PAIRS = 12
"""Pairs of nearest pixels tried: a body bends out of sight somewhere along the gap. Chosen by eye."""
BEHIND_M, OPEN_M, OPEN_SHARE = 0.05, 0.08, 0.25
"""Metres behind both ends of a gap of a reading that shows it open; length in metres, and share of the gap,
of such readings up to which the join may be hidden. Chosen by eye."""
MIDDLES_M, GAP_M = 1.1, 0.4
"""Most metres between the middles and between the nearest points of two halves of a person. Chosen by eye."""
NEARER_M, COVERED_SHARE = 0.02, 0.5
"""Metres by which a thing before the gap is nearer than both halves, and least share of the way covered so:
beside somebody else the room is seen between, which is farther. Chosen by eye."""
NEAREST_PIXELS = 200
"""Nearest pixels of the two halves considered. Chosen by eye."""


@dataclass(frozen=True)
class Person:
    """One person: mask (h, w), visible surface in m2, mean of the points (3,) in the depth camera's frame."""

    mask: Bool
    area_m2: float
    centre_m: Float64


def persons_of(cloud: ThermalCloud, mask: Bool) -> list[Person]:
    """Persons that the person-like pixels of a mask (h, w) belong to; pixels of none are left out."""
    labels, pieces = pieces_of(cloud, mask, SPECK_M2)
    persons, trunks = [], _trunks(cloud, mask, labels, pieces)
    owner = _owners(cloud, labels, pieces, trunks) if trunks else labels
    for number in range(1, len(trunks) + 1):
        own = owner == number
        points = cloud.points_m[own].astype(np.float64)
        area = float(np.sum(points[:, 2] ** 2)) / (cloud.camera.fx * cloud.camera.fy)
        if MIN_PERSON_M2 <= area <= MOST_PERSON_M2:
            persons.append(Person(own, area, points.mean(axis=0)))
    return persons


def _trunks(cloud: ThermalCloud, mask: Bool, labels: Int32, pieces: Sequence[Piece]) -> list[Bool]:
    """Cores (h, w) of the trunks, one a person; without any, the widest piece; labels: (h, w), of pieces."""
    solid = _of(labels, [piece for piece in pieces if piece.thickness_m >= PANEL_M])
    # Closed, because the pixels between an arm and the trunk behind it often have no reading.
    closed = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((7, 7), np.uint8))
    depth_m = cloud.points_m[..., 2]
    # Without any background OpenCV's distance is infinite.
    radius_px = np.minimum(cv2.distanceTransform(closed, cv2.DIST_L2, 3), max(mask.shape))
    radius_m = np.where(solid, radius_px * depth_m / cloud.camera.fx, 0)
    cores, count = components(radius_m >= CORE_M, depth_m, TRUNK_JUMP)
    surface_m2 = depth_m**2 / (cloud.camera.fx * cloud.camera.fy)
    every = (cores == label for label in range(1, count + 1))
    sure = [c for c in every if radius_m[c].max() >= TRUNK_M and surface_m2[c].sum() >= LEAST_CORE_M2]
    sure += _slender(cloud, labels, [p for p in pieces if p.thickness_m >= PANEL_M], sure)
    trunks = _apart(cloud, sure)
    if not trunks and solid.any():
        trunks = [labels == labels.ravel()[int(radius_m.argmax())]]
    return trunks


def _of(labels: Int32, pieces: Sequence[Piece]) -> Bool:
    """Flags (h, w) of the pixels of pieces; labels: (h, w)."""
    chosen = np.zeros(int(labels.max(initial=0)) + 1, np.bool_)
    chosen[[piece.label for piece in pieces]] = True
    return np.asarray(chosen[labels], np.bool_)


def _slender(
    cloud: ThermalCloud, labels: Int32, pieces: Sequence[Piece], cores: Sequence[Bool]
) -> list[Bool]:
    """Masks (h, w) of bodies without a wide trunk (lying): much surface in close pieces; cores: found."""
    taken = np.unique(np.concatenate([labels[core] for core in cores])) if cores else np.zeros(0, np.int32)
    loose = [piece for piece in pieces if piece.label not in taken]
    large = [labels == piece.label for piece in loose if piece.area_m2 >= PERSON_M2]
    loose = [piece for piece in loose if piece.area_m2 < PERSON_M2]
    if sum(piece.area_m2 for piece in loose) < PERSON_M2:
        return large
    is_loose = _of(labels, loose)
    index = np.flatnonzero(is_loose)[::CLOSE_EVERY]
    close = clusters(cloud.points_m.reshape(-1, 3)[index], tolerance_m=CLOSE_M)
    body = _joined(labels.ravel()[index], close, int(labels.max()) + 1)
    area = np.bincount([body[p.label] for p in loose], [p.area_m2 for p in loose])
    of_pixel = np.where(is_loose, body[labels], -1)
    bodies = [of_pixel == number for number in np.flatnonzero(area >= PERSON_M2)]
    known = [cloud.points_m[mask][::CLOSE_EVERY] for mask in (*cores, *large)]
    points = ((body, cloud.points_m[body][::CLOSE_EVERY]) for body in bodies)
    # What is near a known body is its limb.
    return large + [b for b, m in points if all(Nearest(o).query(m)[0].min() >= LIMB_M for o in known)]


def _joined(labels: Int32, close: Int32, count: int) -> Int32:
    """Lowest label (count,) joined with each label, directly or over others.

    labels, close: piece and cluster (n,) of points; pieces that share a cluster are joined.
    """
    body = np.arange(count, dtype=np.int32)
    while True:
        lowest = np.full(close.max() + 1, len(body), np.int32)
        np.minimum.at(lowest, close, body[labels])
        if (lowest[close] == body[labels]).all():
            return body
        np.minimum.at(body, labels, lowest[close])


def _apart(cloud: ThermalCloud, cores: Sequence[Bool]) -> list[Bool]:
    """Cores (h, w), one a person: those with near middles are joined."""
    joined: list[Bool] = []
    centres: list[Float32] = []
    for core in cores:
        centre = np.median(cloud.points_m[core], axis=0)
        near = [i for i, other in enumerate(centres) if np.linalg.norm(other - centre) < ONE_PERSON_M]
        if near:
            joined[near[0]] |= core
        elif len(joined) < MOST_PERSONS:
            joined.append(core)
            centres.append(centre)
    return joined


def _owners(cloud: ThermalCloud, labels: Int32, pieces: Sequence[Piece], trunks: Sequence[Bool]) -> UInt8:
    """Person (h, w) of each pixel: 1 and on for the trunks in their order, 0 for nobody."""
    marks = np.where(_of(labels, pieces), np.uint8(0), np.uint8(NO_PIXEL))
    for number, trunk in enumerate(trunks, 1):
        marks[trunk] = number
    owner = flood(marks, np.nan_to_num(cloud.points_m[..., 2]), float(labels.size))
    owner[owner == NO_PIXEL] = 0
    limbs = _Limbs(cloud, [np.flatnonzero(owner == number)[::7] for number in range(1, len(trunks) + 1)])
    for piece in pieces:
        own = labels == piece.label
        if not owner[own].any() and piece.thickness_m >= PANEL_M:
            owner[own] = limbs.owner(own, min(LIMB_M, LIMB_SIZES * float(np.sqrt(piece.area_m2))), owner)
    return owner


class _Limbs:
    """Owners of loose pieces. seeds: flat indices of some pixels of each person."""

    def __init__(self, cloud: ThermalCloud, seeds: Sequence[Index]) -> None:
        self._points, self._depth_m = cloud.points_m.reshape(-1, 3), cloud.points_m[..., 2]
        self._pixel_rad = 1 / cloud.camera.fx
        self._seeds = seeds
        self._trees = [Nearest(self._points[seed]) for seed in seeds]

    def owner(self, piece: Bool, near_m: float, owner: UInt8) -> int:
        """Number of the person within ``near_m`` metres that a piece (h, w) belongs to, 0 for nobody.

        They are beside it in the image, or the join can be out of sight. owner: (h, w), persons so far.
        """
        own = np.flatnonzero(piece)[::3]
        found = [tree.query(self._points[own], within=near_m) for tree in self._trees]
        whose = int(np.argmin([gap.min() for gap, _ in found]))
        gap, nearest = found[whose]
        order = np.argsort(gap)[: np.count_nonzero(gap <= min(near_m, 2 * gap.min() + TOUCH_M))]
        if not order.size:
            return 0
        if np.count_nonzero(owner[grown(piece, 2)] == whose + 1) >= TOUCHING_PX:
            return whose + 1
        tried = order[:: 1 + order.size // PAIRS]
        pairs = ((int(own[i]), int(self._seeds[whose][nearest[i]])) for i in tried)
        hidden = any(_hidden_between(self._depth_m, one, other, self._pixel_rad) for one, other in pairs)
        return whose + 1 if hidden else 0


def _hidden_between(depth_m: Float32, one: int, other: int, pixel_rad: float) -> bool:
    """Whether the join of two pixels (flat indices) can be out of sight: little between them is farther."""
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


def with_joined_halves(cloud: ThermalCloud, persons: Sequence[Person]) -> list[Person]:
    """Persons of a cloud, two halves of one body joined to one person."""
    joined: list[Person] = []
    for person in persons:
        apart = [_halves(cloud, one, person) for one in joined]
        parts = [person, *(one for one, half in zip(joined, apart, strict=True) if half)]
        joined = [one for one, half in zip(joined, apart, strict=True) if not half] + [_sum(parts)]
    return joined


def _sum(parts: Sequence[Person]) -> Person:
    """Person that all the parts make up."""
    area_m2 = sum(part.area_m2 for part in parts)
    centre_m = np.sum([part.area_m2 * part.centre_m for part in parts], axis=0) / area_m2
    return Person(np.logical_or.reduce([part.mask for part in parts]), area_m2, centre_m)


def _halves(cloud: ThermalCloud, one: Person, other: Person) -> bool:
    """Whether two are halves of one person: near, together of human size, with something nearer between."""
    too_far = np.linalg.norm(one.centre_m - other.centre_m) > MIDDLES_M
    if too_far or one.area_m2 + other.area_m2 > MOST_PERSON_M2:
        return False
    points_m, depth_m = cloud.points_m.reshape(-1, 3), cloud.points_m[..., 2]
    pixels, other_pixels = (np.flatnonzero(person.mask)[::CLOSE_EVERY] for person in (one, other))
    gap_m, nearest = Nearest(points_m[pixels]).query(points_m[other_pixels])
    order = np.argsort(gap_m)[:NEAREST_PIXELS]
    if gap_m[order[0]] > GAP_M:
        return False
    pairs = [(int(other_pixels[i]), int(pixels[nearest[i]])) for i in order[:: 1 + NEAREST_PIXELS // PAIRS]]
    return bool(np.mean([_covered(depth_m, *pair) for pair in pairs]) > COVERED_SHARE)


def _covered(depth_m: Float32, one: int, other: int) -> float:
    """Share of the readings between two pixels (flat indices) that are nearer than both."""
    between = depth_m[line(depth_m.shape, one, other)]
    between, nearest = between[1:-1], min(between[0], between[-1])
    known = between[np.isfinite(between)]
    return float((known < nearest - NEARER_M).mean()) if known.size else 0.0
