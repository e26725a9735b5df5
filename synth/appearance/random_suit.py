"""Colour-coded suits drawn at random, to measure and to train labelling on palettes that it has not seen."""

import colorsys

import numpy as np

from annotate.array_types import Float64, UInt8
from annotate.parts import BODY_PARTS, NEIGHBOURS, PART_ID
from annotate.suit.palette import Suit, chromaticity

COLORS = (8, 11)
"""Fewest and most cloths of a suit; with fewer than eleven some parts share one. Chosen by eye."""
APART = (0.03, 0.09)
"""Range of the least distance in chromaticity between two cloths of a suit: 0.06 looks alike in a shaded
image (`annotate.suit.palette.MIN_CHROMA_DISTANCE`). Chosen by eye."""
GREY, SKIN_NAMED = 0.25, 0.5
"""Chance that one of the cloths is grey, and that a palette names the colour of skin for the head. Chosen by
eye."""
SKIN_RGB = (201, 143, 115)
"""The skin that a palette names, as ``DEFAULT_SUIT`` does."""
DRAWS = 60
"""Colours drawn at most before the least distance is halved; chosen by eye."""
DOMAIN = 40
"""Sets a seed's palette apart from what else is drawn by that seed."""


def random_suit(seed: int) -> Suit:
    """A palette of 8 to 11 cloths of any hues, some look-alikes; neighbouring parts never share one."""
    rng = np.random.default_rng((seed, DOMAIN))
    count = int(rng.integers(COLORS[0], COLORS[1] + 1))
    colors = _cloths(count, float(rng.uniform(*APART)), rng)
    cloths = np.concatenate([np.arange(count), rng.choice(count, len(BODY_PARTS) - count, replace=False)])
    cloth = rng.permutation(cloths)
    while any(cloth[a - 1] == cloth[b - 1] for a, b in map(tuple, NEIGHBOURS)):
        cloth = rng.permutation(cloths)
    worn, parts = colors[cloth], np.array([part.id for part in BODY_PARTS], np.uint8)
    if rng.random() < SKIN_NAMED:
        worn = np.concatenate([worn, np.array([SKIN_RGB], np.uint8)])
        parts = np.append(parts, np.uint8(PART_ID["head"]))
    return Suit(f"random suit {seed}", worn, parts)


def _cloths(count: int, apart: float, rng: np.random.Generator) -> UInt8:
    """Colours uint8 (count, 3), in chromaticity as far apart as there is room for."""
    found: list[Float64] = [np.full(3, rng.uniform(90, 220))] if rng.random() < GREY else []
    tries = 0
    while len(found) < count:
        tries += 1
        if tries % DRAWS == 0:
            apart /= 2
        hue, saturation, value = rng.random(), rng.uniform(0.35, 0.95), rng.uniform(0.35, 0.95)
        rgb = np.array(colorsys.hsv_to_rgb(hue, saturation, value)) * 255
        gaps = np.linalg.norm(chromaticity(np.array([*found, rgb]))[:-1] - chromaticity(rgb), axis=1)
        if (gaps >= apart).all():
            found.append(rgb)
    return np.rint(found).astype(np.uint8)
