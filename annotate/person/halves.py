"""Halves of one person joined: what is seen above and below a laptop or a table before the body."""

from collections.abc import Sequence

import numpy as np

from annotate.array_types import Float32
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.person.persons import CLOSE_EVERY, PAIRS, Person, line
from annotate.person.pieces import MAX_PERSON_M2
from sensors.rig.nearest import Nearest

MIDDLES_M, GAP_M = 1.1, 0.4
"""The most between the middles of two halves, and between their nearest points."""
NEARER_M, COVERED_SHARE, NEAREST = 0.02, 0.5, 200
"""Something nearer than both by the first, over more than that share of the way, looked at between so many of
the nearest points. Beside somebody else the room is seen between, which is farther."""


def whole(cloud: ThermalCloud, persons: Sequence[Person]) -> list[Person]:
    """The persons of a cloud, halves joined."""
    joined: list[Person] = []
    for person in persons:
        apart = [_halves(cloud, one, person) for one in joined]
        parts = [person, *(one for one, half in zip(joined, apart, strict=True) if half)]
        joined = [one for one, half in zip(joined, apart, strict=True) if not half] + [_sum(parts)]
    return joined


def _sum(parts: Sequence[Person]) -> Person:
    area_m2 = sum(part.area_m2 for part in parts)
    centre_m = np.sum([part.area_m2 * part.centre_m for part in parts], axis=0) / area_m2
    return Person(np.logical_or.reduce([part.mask for part in parts]), area_m2, centre_m)


def _halves(cloud: ThermalCloud, one: Person, other: Person) -> bool:
    """Whether two may be one: near to each other, together of human size, and what is between is nearer."""
    if np.linalg.norm(one.centre_m - other.centre_m) > MIDDLES_M:
        return False
    if one.area_m2 + other.area_m2 > MAX_PERSON_M2:
        return False
    points_m, depth_m = cloud.points_m.reshape(-1, 3), cloud.points_m[..., 2]
    there, here = (np.flatnonzero(person.mask)[::CLOSE_EVERY] for person in (one, other))
    gap_m, nearest = Nearest(points_m[there]).query(points_m[here])
    order = np.argsort(gap_m)[:NEAREST]
    if gap_m[order[0]] > GAP_M:
        return False
    pairs = [(int(here[i]), int(there[nearest[i]])) for i in order[:: 1 + NEAREST // PAIRS]]
    return bool(np.mean([_covered(depth_m, *pair) for pair in pairs]) > COVERED_SHARE)


def _covered(depth_m: Float32, one: int, other: int) -> float:
    """Share of the readings between two pixels that are nearer than both."""
    between = depth_m[line(depth_m.shape, one, other)]
    between, nearest = between[1:-1], min(between[0], between[-1])
    known = between[np.isfinite(between)]
    return float((known < nearest - NEARER_M).mean()) if known.size else 0.0
