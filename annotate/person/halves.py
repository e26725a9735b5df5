"""Persons whose two halves, above and below a laptop or a table before the body, are joined."""

from collections.abc import Sequence

import numpy as np

from annotate.array_types import Float32
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.person.persons import CLOSE_EVERY, PAIRS, Person, line
from annotate.person.pieces import MOST_PERSON_M2
from sensors.rig.nearest import Nearest

MIDDLES_M = 1.1
"""Most metres between the middles of two halves of one person. Chosen by eye."""
GAP_M = 0.4
"""Most metres between their nearest points. Chosen by eye."""
NEARER_M = 0.02
"""Metres by which a thing before the gap is nearer than both halves. Chosen by eye."""
COVERED_SHARE = 0.5
"""Least share of the way between the halves with such a thing before it; beside somebody else the room is
seen between, which is farther. Chosen by eye."""
NEAREST_PIXELS = 200
"""Nearest pixels of the two halves considered. Chosen by eye."""


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
    if np.linalg.norm(one.centre_m - other.centre_m) > MIDDLES_M:
        return False
    if one.area_m2 + other.area_m2 > MOST_PERSON_M2:
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
