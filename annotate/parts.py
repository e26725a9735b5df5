"""Scheme ``paper``: eleven body parts and the background, with ids, names, colours, neighbours.

Left and right are the person's own. Hands belong to the forearms, feet to the lower legs, the neck to the
head (Nishi & Miura 2017, section 2.2).
"""

from dataclasses import dataclass

import numpy as np

from annotate.array_types import Bool, UInt8
from annotate.scheme.regions import N_REGIONS
from annotate.scheme.scheme import BACKGROUND_PART
from annotate.scheme.scheme_file import load_scheme

PAPER = load_scheme("paper")
BACKGROUND, UNDEFINED = PAPER.background, PAPER.undefined
N_CLASSES = PAPER.n_classes


@dataclass(frozen=True)
class Part:
    """Class of a label image: a body part or the background."""

    id: int
    name: str
    title: str
    rgb: tuple[int, int, int]


PARTS = tuple(Part(one.id, one.name, one.title, one.rgb) for one in (BACKGROUND_PART, *PAPER.parts))
"""Classes by id; neighbours and twins are at least 23 apart in colour (CIE 1976), for all eyes."""

BODY_PARTS = PARTS[1:]
PART_ID = {part.name: part.id for part in PARTS}

LEFT_RIGHT = PAPER.twins

NEIGHBOURS = PAPER.neighbours
"""Pairs of ids of parts joined by anatomy."""

PAPER_PARTS = np.arange(256, dtype=np.uint8)
"""Part id (256,) of the paper by region id; other ids stay."""
PAPER_PARTS[: N_REGIONS + 1] = PAPER.table[: N_REGIONS + 1]


def swap_left_right(labels: UInt8) -> UInt8:
    """Exchange left and right parts in labels uint8 of any shape."""
    return PAPER.swap_left_right(labels)


TWIN_PARTS = swap_left_right(np.arange(N_CLASSES, dtype=np.uint8))
"""Part id (12,) of each part's other side; a middle part is its own."""


def on_body(labels: UInt8) -> Bool:
    """Return flags, True where a label (any shape) of the paper is a body part."""
    return PAPER.on_body(labels)


def palette_rgb() -> UInt8:
    """Return RGB colours uint8 (256, 3) by part id; undefined is grey, unused ids black."""
    return PAPER.palette_rgb()
