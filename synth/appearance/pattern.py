"""Pattern of a suit: zones of one colour, the seams between zones, and openings for hands, feet and face.

The parts of the suit's scheme give the zones, region by region. Fields are distances in metres over the skin;
a zone ends where a field is 0.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from annotate.array_types import Float64, Int32, UInt8
from annotate.scheme.regions import N_REGIONS, REGION_NEIGHBOURS, Region
from annotate.scheme.scheme import Part, Scheme
from annotate.suit.palette import Suit, body_parts

SKIN, HAIR, SHOE, FIRST_CLOTH = range(4)  # zones
N_ZONES = FIRST_CLOTH + N_REGIONS  # because every cloth covers at least one region
HAND, FOOT, FACE, HAIRLINE, FIRST_SEAM = range(5)  # fields
_SIDES = ("LEFT", "RIGHT")


def _on_both_sides(*names: str) -> frozenset[Region]:
    return frozenset(Region[f"{side}_{name}"] for side in _SIDES for name in names)


_HANDS, _FEET = _on_both_sides("HAND", "FINGERS"), _on_both_sides("FOOT", "TOES")
_OPENINGS = (
    (HAND, _on_both_sides("FOREARM"), _HANDS),
    (FOOT, _on_both_sides("LOWER_LEG"), _FEET),
    (FACE, frozenset((Region.HEAD,)), frozenset((Region.HEAD, Region.NECK))),
)
"""Field of each opening, the regions where its cloth begins, and the regions that it may leave bare."""


@dataclass(frozen=True, eq=False)
class Pattern:
    """Zones of a suit on any body.

    parts: ids of the scheme's parts that have a cloth; ``parts[i]`` is zone ``FIRST_CLOTH + i``.
    zone_of_region: uint8 (25,). seams: pairs of zones; field ``FIRST_SEAM + i`` is negative in the first zone
    of ``seams[i]``. beside: int32 (N_ZONES, k, 2), the fields of a zone's seams and the zones beyond, -1 for
    none. side: (N_ZONES, k), signs of these fields. openings: int32 (N_ZONES, 25), the field that opens a
    zone on a region, -1 for none.
    """

    parts: tuple[int, ...]
    zone_of_region: UInt8
    seams: tuple[tuple[int, int], ...]
    beside: Int32
    side: Float64
    openings: Int32

    @property
    def n_fields(self) -> int:
        """Return the number of fields: openings, the hairline and seams."""
        return FIRST_SEAM + len(self.seams)


def pattern_of(suit: Suit) -> Pattern:
    """Return the pattern of a suit; a hand without a swatch is skin, a foot a shoe."""
    return _pattern(suit.scheme, frozenset(suit.parts.tolist()))


@lru_cache(maxsize=32)
def _pattern(scheme: Scheme, worn: frozenset[int]) -> Pattern:
    cloths = [part for part in body_parts(scheme) if part.id in worn]
    zone_of_region = np.zeros(1 + N_REGIONS, np.uint8)
    zone_of_region[list(_FEET)] = SHOE
    for zone, part in enumerate(cloths, FIRST_CLOTH):
        zone_of_region[list(part.regions)] = zone
    pairs = (sorted(zone_of_region[list(pair)].tolist()) for pair in REGION_NEIGHBOURS)
    seams = tuple(sorted({(one, other) for one, other in pairs if one != other}))
    beside, side = _seams_of_zones(seams)
    parts = tuple(part.id for part in cloths)
    return Pattern(parts, zone_of_region, seams, beside, side, _openings(cloths))


def _seams_of_zones(seams: tuple[tuple[int, int], ...]) -> tuple[Int32, Float64]:
    """Return ``beside`` and ``side`` of a pattern."""
    beside = np.full((N_ZONES, 1 + len(seams), 2), -1, np.int32)
    side = np.ones((N_ZONES, 1 + len(seams)))
    for n, pair in enumerate(seams, FIRST_SEAM):
        for (zone, other), sign in ((pair, 1), (pair[::-1], -1)):
            free = int(np.argmax(beside[zone, :, 0] < 0))
            beside[zone, free], side[zone, free] = (n, other), sign
    return beside, side


def _openings(cloths: list[Part]) -> Int32:
    """Return ``openings`` of a pattern: a cloth ends where it has its beginning and regions to leave bare."""
    openings = np.full((N_ZONES, 1 + N_REGIONS), -1, np.int32)
    for zone, part in enumerate(cloths, FIRST_CLOTH):
        for field, begins, bare in _OPENINGS:
            if part.regions & begins and part.regions & bare:
                # A larger zone opens only there, because the fields mean nothing elsewhere on the body.
                whole = part.regions <= begins | bare
                openings[zone, slice(None) if whole else sorted(begins | bare)] = field
    return openings
