"""How hard the virtual rig makes it: nothing wrong, a good living room, or all at once."""

from dataclasses import dataclass

from synth.appearance import photograph
from synth.appearance.photograph import ColorDifficulty
from synth.cameras.depth_noise import DepthNoise
from synth.cameras.thermal_camera import ThermalNoise


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

    color: clothes, light and the colour camera. depth: one frame's faults. reflectance: the room's, in the
    infrared, for light that bounces twice (0: none does). unit_mm, unit_scale: standard deviations of the
    unit's own offset and scale. warmth: how unevenly warm people and things are, 1 as in a good room.
    room_c: air and walls, least and most. clutter: what stands about. stray: how far the robot's aim is off,
    1 as well as it can.
    """

    name: str
    color: ColorDifficulty
    depth: DepthNoise
    thermal: ThermalNoise
    clutter: Clutter
    warmth: float
    room_c: tuple[float, float]
    reflectance: float
    unit_mm: float
    unit_scale: float
    stray: float


CLEAN = Difficulty(
    name="clean",
    color=photograph.CLEAN,
    depth=DepthNoise(axial=0, flying=0, grazing=0, dark=0, lateral_px=0),
    thermal=ThermalNoise(netd_c=0, blur_px=0, drift_c=0, flag=False),
    clutter=Clutter(),
    warmth=0.0, room_c=(20.5, 20.5), reflectance=0.0, unit_mm=0.0, unit_scale=0.0, stray=1.0,
)  # fmt: skip
NORMAL = Difficulty(
    name="normal",
    color=photograph.NORMAL,
    depth=DepthNoise(),
    thermal=ThermalNoise(),
    clutter=Clutter(
        company=0.15, radiator=0.5, window=0.5, sunlit=0.1, mug=0.6, laptop=0.3, low_table=0.3,
        blanket=0.0, warm_spot=0.25,
    ),
    warmth=1.0, room_c=(19.0, 22.5), reflectance=0.4, unit_mm=4.0, unit_scale=0.002, stray=1.0,
)  # fmt: skip
HARD = Difficulty(
    name="hard",
    color=photograph.HARD,
    depth=DepthNoise(axial=2, flying=1, grazing=0.9, dark=0.7, lateral_px=0.8),
    thermal=ThermalNoise(netd_c=0.16, blur_px=1.0, drift_c=2.0),
    clutter=Clutter(
        company=0.7, radiator=0.7, window=0.7, sunlit=0.4, mug=0.8, laptop=0.5, low_table=0.6,
        blanket=0.35, warm_spot=0.8,
    ),
    warmth=2.0, room_c=(18.0, 25.5), reflectance=0.6, unit_mm=8.0, unit_scale=0.004, stray=2.0,
)  # fmt: skip
"""No source for any strength but those of the cameras: chosen by eye."""
DIFFICULTIES = {d.name: d for d in (CLEAN, NORMAL, HARD)}
