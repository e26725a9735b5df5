"""Difficulty levels of the virtual rig, from ``synth/data/difficulties.toml``."""

from dataclasses import dataclass
from typing import Any

from synth.appearance.photograph import COLORS, ColorDifficulty
from synth.cameras.stereo import Stereo
from synth.cameras.thermal_camera import ThermalNoise
from synth.cameras.time_of_flight import TimeOfFlight
from synth.data_files import table


@dataclass(frozen=True)
class Clutter:
    """Share of the subjects with each kind of object nearby; untuned."""

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
    """Strengths of the simulated faults of a rig.

    color: clothes, illuminants and colour camera. depth, stereo: faults of time-of-flight and stereo cameras.
    reflectance: infrared reflectance of the room, for multipath. unit_mm, unit_scale: standard deviations of
    a camera unit's depth offset and scale. warmth: factor on the unevenness of temperatures, 1 = good room.
    room_c: lowest and highest room temperature. stray: factor on the aiming error of the robot, 1 = best.
    loose: share of people with loose clothes, in a suit too.
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
