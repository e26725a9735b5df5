"""Difficulties of the virtual rig, from ``synth/data/difficulties.toml``."""

from dataclasses import dataclass
from typing import Any

from synth.appearance.photograph import COLORS, ColorDifficulty
from synth.cameras.stereo import Stereo
from synth.cameras.thermal_camera import ThermalNoise
from synth.cameras.time_of_flight import TimeOfFlight
from synth.data_files import table


@dataclass(frozen=True)
class Clutter:
    """Share of the subjects with each thing nearby; untuned."""

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
    """Strengths of the rig's faults.

    color: clothes, illuminants and colour camera. depth, stereo: faults by kind of depth camera. reflectance:
    of the room in the infrared, for multipath. unit_mm, unit_scale: standard deviations of the unit's offset
    and scale. warmth: unevenness of temperatures, 1 in a good room. room_c: least and greatest. stray:
    error of the robot's aim, 1 at best. loose: share of people with loose clothes, also of the suit.
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
CLEAN, NORMAL, HARD = DIFFICULTIES.values()
