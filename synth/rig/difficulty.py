"""Difficulties of the virtual rig: no faults, a good living room, or everything at once."""

from dataclasses import dataclass
from typing import Any

from synth.appearance.photograph import COLORS, ColorDifficulty
from synth.cameras.stereo import Stereo
from synth.cameras.thermal_camera import ThermalNoise
from synth.cameras.time_of_flight import TimeOfFlight
from synth.data_files import table


@dataclass(frozen=True)
class Clutter:
    """Share of the subjects about whom something stands. No source: chosen by eye, after living rooms."""

    company: float = 0.0
    radiator: float = 0.0
    window: float = 0.0
    sunlit: float = 0.0
    mug: float = 0.0
    laptop: float = 0.0
    low_table: float = 0.0
    blanket: float = 0.0
    warm_spot: float = 0.0


@dataclass(frozen=True)
class Difficulty:
    """How hard the rig makes it.

    color: clothes, light and the colour camera. depth, stereo: one frame's faults by kind of depth camera.
    reflectance: the room's, in the
    infrared, for light that bounces twice (0: none does). unit_mm, unit_scale: standard deviations of the
    unit's own offset and scale. warmth: how unevenly warm people and things are, 1 as in a good room.
    room_c: air and walls, least and most. clutter: what stands about. stray: how far the robot's aim is off,
    1 as well as it can. loose: share of people whose clothes, the suit too, are cut as everyday clothes are
    and fold; the others' follow the skin.
    """

    name: str
    color: ColorDifficulty
    depth: TimeOfFlight
    stereo: Stereo
    thermal: ThermalNoise
    clutter: Clutter
    warmth: float
    room_c: tuple[float, float]
    reflectance: float
    unit_mm: float
    unit_scale: float
    stray: float
    loose: float


def _difficulty(name: str, entry: dict[str, Any]) -> Difficulty:
    made = {kind: _PARTS[kind](**entry[kind]) for kind in _PARTS}
    return Difficulty(name, **{**entry, **made, "color": COLORS[name]})


_PARTS = {"depth": TimeOfFlight, "stereo": Stereo, "thermal": ThermalNoise, "clutter": Clutter}
DIFFICULTIES = {name: _difficulty(name, entry) for name, entry in table("difficulties").items()}
"""Clean, normal and hard, described in ``synth/data/difficulties.toml``."""
CLEAN, NORMAL, HARD = DIFFICULTIES.values()
