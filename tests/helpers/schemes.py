"""Random schemes drawn by hypothesis, and a naive check whether one scheme is coarser than another."""

import itertools

import numpy as np
from hypothesis import strategies as st

from annotate.scheme.colours import with_proposed_colors
from annotate.scheme.merging import joined_classes
from annotate.scheme.regions import Region
from annotate.scheme.scheme import Part, Scheme, scheme_of

BLACK = (0, 0, 0)
BODY = np.arange(1, 1 + len(Region), dtype=np.uint8)
"""Ids of all regions."""


@st.composite
def schemes(draw, colored: bool = False) -> Scheme:
    """Draw a scheme: regions joined at random, both sides alike, and up to three things."""
    region = st.sampled_from(Region)
    joined = draw(st.lists(st.tuples(region, region), max_size=20))
    sets = [*({one} for one in Region), *map(set, joined), *({a.twin, b.twin} for a, b in joined)]
    classes = joined_classes(map(frozenset, sets))
    things = draw(st.lists(st.sampled_from(["left_wheel", "right_wheel", "blanket"]), unique=True))
    ids = draw(st.permutations(range(1, 1 + len(classes) + len(things))))
    parts = [
        *(Part(i, f"p{i}", f"Part {i}", BLACK, "", one) for i, one in zip(ids, classes, strict=False)),
        *(Part(i, name, name, BLACK) for i, name in zip(ids[len(classes) :], things, strict=True)),
    ]
    by_name = {part.name: part.id for part in parts}
    both = {"left_wheel", "right_wheel"} <= {*things}
    wheels = [(by_name["left_wheel"], by_name["right_wheel"])] if both else []
    beside = [frozenset((by_name[one], ids[0])) for one in things]
    scheme = scheme_of("drawn", parts, wheels, beside)
    return with_proposed_colors(scheme, ids) if colored else scheme


def is_coarser(coarse: Scheme, fine: Scheme) -> bool:
    """Return whether regions that share a part of ``fine`` share a part of ``coarse``, pair by pair."""
    return all(
        coarse.table[a] == coarse.table[b]
        for a, b in itertools.combinations(BODY, 2)
        if fine.table[a] == fine.table[b]
    )
