"""What colour a room's things have, and how their cloth or wood is grained."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from annotate.array_types import Float64, UInt8
from synth.appearance.outfit import GAMMA
from synth.surface.furniture import Surface
from synth.surface.texture import wavelength_cells

SURFACE_RGB = {
    Surface.FLOOR: (122, 104, 86),
    Surface.WALL: (206, 202, 190),
    Surface.SOFA: (92, 90, 96),
    Surface.BED: (214, 214, 220),
    Surface.TABLE: (140, 108, 78),
    Surface.RADIATOR: (228, 228, 224),
    Surface.MUG: (168, 58, 44),
    Surface.HAIR: (52, 38, 30),
    Surface.LAPTOP: (96, 98, 102),
    Surface.KEYBOARD: (40, 41, 44),
    Surface.SCREEN: (150, 170, 200),
    Surface.WINDOW: (330, 345, 360),
    Surface.SUNLIT: (340, 325, 290),
    Surface.BLANKET: (150, 120, 110),
    Surface.PILLOW: (216, 214, 210),
}
"""sRGB of a plain room; over 255 shines. No source: chosen by eye."""
OTHER_RGB = (118, 116, 112)
"""Any surface that has no colour of its own here."""
SOFA_RGB = np.array(
    [(92, 90, 96), (150, 140, 124), (70, 82, 104), (112, 70, 56), (60, 76, 66), (176, 166, 150)]
)
FLOOR_RGB = np.array([(122, 104, 86), (150, 116, 80), (104, 78, 56), (134, 132, 130), (112, 88, 84)])
BLANKET_RGB = np.array([(150, 120, 110), (96, 104, 124), (170, 160, 140), (120, 60, 60), (84, 100, 84)])
WALL_RGB = np.array([(206, 202, 190), (214, 214, 210), (196, 198, 186), (188, 196, 204), (204, 186, 164)])
"""Cloth and leather of sofas; wood, carpet and tiles; wall paints. No source: chosen by eye."""
_CLOTH, _WOOD, _PLAIN = (0.07, 0.012, 0.012), (0.1, 0.03, 0.8), (0.0, 1.0, 1.0)
GRAIN = {
    Surface.SOFA: _CLOTH,
    Surface.BED: (0.04, 0.08, 0.08),
    Surface.PILLOW: (0.04, 0.08, 0.08),
    Surface.BLANKET: (0.12, 0.03, 0.03),
    Surface.FLOOR: _WOOD,
    Surface.TABLE: _WOOD,
}
"""Share by which a surface's brightness strays, and over what length in metres across and along y."""
COLORFUL = (Surface.SOFA, Surface.MUG, Surface.BED, Surface.BLANKET, Surface.PILLOW)
"""What may have a colour of the suit."""


class RoomColors(NamedTuple):
    """Colours of furniture by tag, linear (T, 3); grain: (T, 3) share, cells a metre across and along y."""

    rgb: Float64
    grain: Float64


def plain_room() -> RoomColors:
    """Even colours without grain."""
    return _room({}, with_grain=False)


def paint_room(suit_rgb: UInt8, equal: float, rng: np.random.Generator) -> RoomColors:
    """A room of common colours; with a chance of ``equal`` each, a thing has one of the suit's (K, 3)."""
    chosen = {
        Surface.SOFA: rng.choice(SOFA_RGB),
        Surface.FLOOR: rng.choice(FLOOR_RGB),
        Surface.WALL: rng.choice(WALL_RGB),
        Surface.BED: np.array([200, 200, 206]) + rng.normal(0, 14, 3),
        Surface.MUG: rng.uniform(30, 230, 3),
        Surface.BLANKET: rng.choice(BLANKET_RGB),
    }
    for surface in COLORFUL:
        same, swatch = rng.random() < equal, rng.choice(suit_rgb)
        if same:
            chosen[surface] = swatch
    return _room(chosen, with_grain=True)


def _room(chosen: dict[Surface, NDArray[np.generic]], with_grain: bool) -> RoomColors:
    rgb = np.tile(np.array(OTHER_RGB, np.float64), (max(Surface) + 1, 1))
    grain = np.zeros((len(rgb), 3))
    for surface in Surface:
        rgb[surface] = np.maximum(chosen.get(surface, SURFACE_RGB.get(surface, OTHER_RGB)), 0)
        share, across, along = GRAIN.get(surface, _PLAIN)
        grain[surface] = (share * with_grain, wavelength_cells(across), wavelength_cells(along))
    return RoomColors(np.power(rgb / 255, GAMMA), grain)
