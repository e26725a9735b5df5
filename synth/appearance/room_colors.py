"""What colour a room's things have, and how their cloth or wood is grained."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from annotate.array_types import Float64, UInt8
from synth.appearance.outfit import GAMMA
from synth.surface.facets import wavelength_cells
from synth.surface.furniture import SURFACES, Surface

_PLAIN = (0.0, 1.0, 1.0)
"""Grain of what has none."""
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
        Surface.SOFA: rng.choice(SURFACES[Surface.SOFA]["often"]),
        Surface.FLOOR: rng.choice(SURFACES[Surface.FLOOR]["often"]),
        Surface.WALL: rng.choice(SURFACES[Surface.WALL]["often"]),
        Surface.BED: np.array([200, 200, 206]) + rng.normal(0, 14, 3),
        Surface.MUG: rng.uniform(30, 230, 3),
        Surface.BLANKET: rng.choice(SURFACES[Surface.BLANKET]["often"]),
    }
    for surface in COLORFUL:
        same, swatch = rng.random() < equal, rng.choice(suit_rgb)
        if same:
            chosen[surface] = swatch
    return _room(chosen, with_grain=True)


def _room(chosen: dict[Surface, NDArray[np.generic]], with_grain: bool) -> RoomColors:
    rgb, grain = np.zeros((2, max(Surface) + 1, 3))
    for surface, entry in SURFACES.items():
        rgb[surface] = np.maximum(chosen.get(surface, entry["rgb"]), 0)
        share, across, along = entry.get("grain", _PLAIN)
        grain[surface] = (share * with_grain, wavelength_cells(across), wavelength_cells(along))
    return RoomColors(np.power(rgb / 255, GAMMA), grain)
