"""A scheme with things and frames in it, random schemes, and a naive check for coarser schemes."""

import itertools

import numpy as np
from hypothesis import strategies as st

from annotate.frame_labels import FrameLabels
from annotate.scheme.colours import with_proposed_colors
from annotate.scheme.merging import joined_classes
from annotate.scheme.regions import Region
from annotate.scheme.scheme import BACKGROUND, UNDEFINED, Part, Scheme, scheme_of
from annotate.scheme.scheme_file import load_scheme

BLACK = (0, 0, 0)
BODY = np.arange(1, 1 + len(Region), dtype=np.uint8)
"""Ids of all regions."""


def _ward() -> Scheme:
    things = {16: "wheelchair", 40: "left_wheel", 41: "right_wheel", 42: "blanket"}
    parts = [Part(i, name, name.capitalize(), BLACK, "") for i, name in things.items()]
    parts += load_scheme("hands-and-feet").parts
    beside = [frozenset((16, 7)), frozenset((16, 40)), frozenset((16, 41))]
    return with_proposed_colors(scheme_of("ward", parts, [(40, 41)], beside), things)


WARD = _ward()
"""Hands and feet, a wheelchair, its two wheels and a blanket; ids 17 to 39 are unused."""


def frame_in(scheme: Scheme, seed: int = 0, shape: tuple[int, int] = (24, 32)) -> FrameLabels:
    """Return a frame with every label of a scheme, undefined included, and depth at every part."""
    rng = np.random.default_rng(seed)
    ids = np.array([BACKGROUND, UNDEFINED, *(part.id for part in scheme.parts)], np.uint8)
    parts = rng.choice(ids, shape)
    parts.ravel()[: len(ids)] = ids
    depth = rng.integers(500, 4500, shape).astype(np.uint16)
    confidence = (rng.integers(0, 256, shape) / np.float32(255)).astype(np.float32)
    persons = scheme.on_person(parts).astype(np.uint8)
    notes = {"why": "half hidden"}
    return FrameLabels(
        f"{seed:06d}", depth, parts, confidence, "corrected", f"P{seed}", notes, persons, scheme
    )


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
