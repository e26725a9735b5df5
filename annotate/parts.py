"""The eleven body parts and the background: ids, names, colours, neighbours.

Left and right are the person's own. Hands belong to the forearms, feet to the lower legs, the neck to the
head (Nishi & Miura 2017, section 2.2).
"""

from dataclasses import dataclass

import numpy as np

from annotate.array_types import Bool, UInt8

BACKGROUND, UNDEFINED = 0, 255
N_CLASSES = 12


@dataclass(frozen=True)
class Part:
    """Class of a label image: a body part or the background."""

    id: int
    name: str
    title: str
    rgb: tuple[int, int, int]


PARTS = (
    Part(0, "background", "Background", (24, 24, 28)),
    Part(1, "head", "Head", (227, 57, 69)),
    Part(2, "torso", "Torso", (66, 95, 167)),
    Part(3, "left_upper_arm", "Left upper arm", (44, 156, 142)),
    Part(4, "right_upper_arm", "Right upper arm", (212, 114, 35)),
    Part(5, "left_forearm", "Left forearm", (151, 228, 183)),
    Part(6, "right_forearm", "Right forearm", (255, 206, 57)),
    Part(7, "hip", "Hip", (203, 176, 255)),
    Part(8, "left_upper_leg", "Left upper leg", (0, 120, 222)),
    Part(9, "right_upper_leg", "Right upper leg", (212, 50, 123)),
    Part(10, "left_lower_leg", "Left lower leg", (94, 203, 217)),
    Part(11, "right_lower_leg", "Right lower leg", (200, 148, 88)),
)
"""Classes by id; neighbours and twins are at least 23 apart in colour (CIE 1976), for all eyes."""

BODY_PARTS = PARTS[1:]
PART_ID = {part.name: part.id for part in PARTS}

LEFT_RIGHT = ((3, 4), (5, 6), (8, 9), (10, 11))

NEIGHBOURS = frozenset(
    frozenset(pair)
    for pair in ((1, 2), (2, 3), (2, 4), (3, 5), (4, 6), (2, 7), (7, 8), (7, 9), (8, 10), (9, 11))
)
"""Pairs of ids of parts joined by anatomy."""


def swap_left_right(labels: UInt8) -> UInt8:
    """Exchange left and right parts in labels uint8 of any shape."""
    table = np.arange(256, dtype=np.uint8)
    for left, right in LEFT_RIGHT:
        table[left], table[right] = right, left
    return table[labels]


TWIN_PARTS = swap_left_right(np.arange(N_CLASSES, dtype=np.uint8))
"""Part id (12,) of each part's other side; a middle part is its own."""


def on_body(labels: UInt8) -> Bool:
    """Return flags, True where a label (any shape) is a body part, not background or undefined."""
    return np.asarray((labels != BACKGROUND) & (labels != UNDEFINED))


def palette_rgb() -> UInt8:
    """Return RGB colours uint8 (256, 3) by part id; undefined is grey, unused ids black."""
    palette = np.zeros((256, 3), np.uint8)
    for part in PARTS:
        palette[part.id] = part.rgb
    palette[UNDEFINED] = (128, 128, 128)
    return palette
