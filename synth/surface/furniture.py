"""Furniture and room. World frame: z up, metres; the person faces -y towards the robot.

Constants are untuned unless a source is given.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from enum import IntEnum
from functools import cache
from typing import Any, ClassVar, Literal, NamedTuple, Self

import numpy as np
from scipy.spatial.transform import Rotation

from annotate.array_types import Float32, Float64
from synth.data_files import table
from synth.surface.rasterize import Mesh, box, merge, sheet

Side = Literal["top", "front"]  # side of a box: upwards, or towards -y


# Tags of rendered faces of things; faces of a body carry their region id (``annotate.scheme.regions``).
# A surface has always the same number, because another number changes every recording of a seed.
Surface = IntEnum(
    "Surface",
    "WHEELCHAIR FLOOR WALL SOFA BED TABLE RADIATOR MUG HAIR LAPTOP KEYBOARD SCREEN WINDOW SUNLIT BLANKET "
    "PILLOW OTHER_PERSON WOOD PAD PET",
    start=31,
)
THING_NAMES: dict[Surface, str] = {
    Surface.WHEELCHAIR: "wheelchair",
    Surface.FLOOR: "floor",
    Surface.WALL: "wall",
    Surface.SUNLIT: "wall",
    Surface.SOFA: "seat",
    Surface.BED: "bed",
    Surface.TABLE: "table",
    Surface.RADIATOR: "radiator",
    Surface.MUG: "mug",
    Surface.LAPTOP: "laptop",
    Surface.KEYBOARD: "laptop",
    Surface.SCREEN: "laptop",
    Surface.WINDOW: "window",
    Surface.BLANKET: "blanket",
    Surface.PILLOW: "pillow",
    Surface.WOOD: "seat",
}
"""Name of the thing of a scheme that carries a surface.

Chairs and sofas are a "seat". Shelves, and wooden frames and legs of the judging cast's furniture, are a
"table".
"""
# Looks and temperatures (``synth/data/surfaces.toml``).
SURFACES: dict[Surface, dict[str, Any]] = {
    Surface[k.upper()]: entry for k, entry in table("surfaces").items()
}


@dataclass(frozen=True)
class Solid:
    """Box that carries or stops a body.

    low, high: corners, metres, before rotation (3, 3) about the box's origin and translation (3,) to the
    world. give_m: depth to which a body sinks into it. tag: ``Surface``. carries_m: preference for the top. A
    limb inside leaves upwards if that way is at most ``carries_m`` longer than the way to a side.
    """

    low: tuple[float, float, float]
    high: tuple[float, float, float]
    give_m: float
    tag: int
    rotation: Float64 = field(default_factory=lambda: np.eye(3))
    translation: Float64 = field(default_factory=lambda: np.zeros(3))
    carries_m: float = 0.0

    def mesh(self) -> Mesh:
        return box(self.low, self.high, self.tag).placed(self.rotation, self.translation)

    def packed(self) -> Float64:
        """Return the box as an array (17,) for compiled code: centre, half sizes, give, carries_m, rotation
        row by row.
        """
        low, high = np.array(self.low), np.array(self.high)
        centre = self.rotation @ ((low + high) / 2) + self.translation
        return np.concatenate(
            [centre, (high - low) / 2, [self.give_m, self.carries_m], self.rotation.ravel()]
        )

    def depth_m(self, points_m: Float32) -> Float64:
        """Return the depth (...,) of world points (..., 3) below the surface after the body sank in by
        ``give_m``; 0 outside.
        """
        local = (points_m - self.translation) @ self.rotation
        x, y, z = np.moveaxis(np.minimum(local - np.array(self.low), np.array(self.high) - local), -1, 0)
        inside = np.minimum(np.minimum(x, y), z)  # in a third of the time that ``min`` takes
        return np.asarray(np.maximum(inside, 0.0), np.float64)


# give: half a centimetre for socks and carpet
FLOOR = Solid((-10.0, -10.0, -1.0), (10.0, 10.0, 0.0), 0.005, Surface.FLOOR, carries_m=2.0)


class Footprint(NamedTuple):
    """Floor area of furniture, metres: half its width about x = 0, and its y from front to back."""

    half_width_m: float
    front_y: float
    back_y: float


@dataclass(frozen=True)
class Furniture(ABC):
    """Furniture that supports a person; lengths in metres.

    height: of the supporting surface. give_m: depth to which a body sinks in. puff_m: bulge of cushions in
    their middle. soft: name of the soft side of each of the first solids. data: table of dimensions.
    """

    height: float
    give_m: float
    data: ClassVar[str] = "furniture"
    puff_m: ClassVar[float] = 0.0
    soft: ClassVar[tuple[Side, ...]] = ("top", "front")

    @classmethod
    def sample(cls, rng: np.random.Generator) -> Self:
        """Draw furniture of common dimensions (``synth/data/furniture.toml``)."""
        ranges = table(cls.data)[cls.__name__.lower()]
        return cls(**{name: rng.uniform(*between) for name, between in ranges.items()})

    @property
    @abstractmethod
    def footprint(self) -> Footprint:
        """Return the rectangle on the floor that the furniture occupies, metres."""

    @property
    def top(self) -> Footprint:
        """Return the rectangle of the supporting surface, metres, without things around it."""
        return self.footprint

    @abstractmethod
    def solids(self) -> list[Solid]:
        """Return the boxes; the first one supports the person."""

    def mesh(self) -> Mesh:
        return merge([solid.mesh() for solid in self.solids()])


@dataclass(frozen=True)
class Seat(Furniture):
    """Seat to sit on; its front edge is at y = 0, the back rest starts at y = depth."""

    depth: float
    width: float
    back_height: float
    back_tilt_rad: float

    def cleared(self) -> Self:
        """Return the seat without things on it and in front of it."""
        return self

    def back_y(self, z_m: Float32) -> Float64:
        """Return y (n,) of the back rest's front face at world heights z (n,), metres."""
        above = np.maximum(z_m.astype(np.float64) - self.height, 0)
        return np.asarray(self.depth + np.tan(self.back_tilt_rad) * above, np.float64)

    def _back_rest(self, thick_m: float, from_z: float) -> Solid:
        half, tilt = self.width / 2, Rotation.from_euler("x", -self.back_tilt_rad).as_matrix()
        low, high = (-half, 0, from_z), (half, thick_m, self.back_height)
        place = np.array([0, self.depth, self.height])
        return Solid(low, high, self.give_m, Surface.SOFA, tilt, place)


@dataclass(frozen=True)
class Sofa(Seat):
    """Sofa or arm-chair."""

    height: float = 0.42
    depth: float = 0.56
    width: float = 1.7
    back_height: float = 0.48
    back_tilt_rad: float = 0.26
    give_m: float = 0.02
    arm_height: float = 0.20
    arm_width: float = 0.18

    puff_m = 0.012
    soft: ClassVar[tuple[Side, ...]] = ("top", "front", "top", "top")

    @property
    def footprint(self) -> Footprint:
        return Footprint(self.width / 2 + self.arm_width, 0.0, self.depth + 0.3)

    def solids(self) -> list[Solid]:
        half, h, give, tag = self.width / 2, self.height, self.give_m, Surface.SOFA
        arms = [
            Solid((x, 0, 0.05), (x + self.arm_width, self.depth + 0.1, h + self.arm_height), give, tag)
            for x in (-half - self.arm_width, half)
        ]
        seat = Solid((-half, 0, 0.05), (half, self.depth + 0.16, h), give, tag, carries_m=0.1)
        return [seat, self._back_rest(0.16, 0), *arms]


@dataclass(frozen=True)
class Chair(Seat):
    """Kitchen or ward chair without arms."""

    height: float = 0.45
    depth: float = 0.42
    width: float = 0.44
    back_height: float = 0.45
    back_tilt_rad: float = 0.12
    give_m: float = 0.01

    @property
    def footprint(self) -> Footprint:
        return Footprint(self.width / 2, 0.0, self.depth + 0.12)

    def solids(self) -> list[Solid]:
        half, h, leg, tag = self.width / 2, self.height, 0.04, Surface.SOFA
        legs = [
            Solid((x, y, 0), (x + leg, y + leg, h - 0.05), 0.0, tag)
            for x in (-half, half - leg)
            for y in (0.01, self.depth - leg)
        ]
        seat = Solid((-half, 0, h - 0.05), (half, self.depth, h), self.give_m, tag, carries_m=0.1)
        return [seat, self._back_rest(0.03, 0.08), *legs]


@dataclass(frozen=True)
class ArmChair(Chair):
    """Chair with two arm rests of wood or metal. rest_height: above the seat. rest_width, rest_thick: of a
    bar.
    """

    rest_height: float = 0.22
    rest_width: float = 0.05
    rest_thick: float = 0.03

    @property
    def footprint(self) -> Footprint:
        return Footprint(self.width / 2 + 0.02 + self.rest_width, 0.0, self.depth + 0.12)

    def solids(self) -> list[Solid]:
        wide, top, tag = self.rest_width, self.height + self.rest_height, Surface.WOOD
        low, rests = top - self.rest_thick, list[Solid]()
        for x in (-self.width / 2 - 0.02 - wide, self.width / 2 + 0.02):
            rests.append(Solid((x, 0.0, low), (x + wide, self.depth + 0.04, top), 0.003, tag))
            rests += [
                Solid((x, y, 0.0), (x + wide, y + 0.03, low), 0.0, tag) for y in (0.03, self.depth - 0.03)
            ]
        return [*super().solids(), *rests]


@dataclass(frozen=True)
class Bed(Furniture):
    """Single, double or nursing bed, centred on the world's z axis, its length along y, the pillow at +y.

    give_m: between a firm and a soft foam mattress under a back; the mattress is rendered flat.
    """

    height: float = 0.50
    length: float = 2.0
    width: float = 0.95
    pillow_height: float = 0.09
    board_height: float = 0.35
    give_m: float = 0.04

    puff_m = 0.006
    soft = ("top", "top")

    @property
    def footprint(self) -> Footprint:
        return Footprint(self.width / 2, -self.length / 2, self.length / 2 + 0.05)

    def solids(self) -> list[Solid]:
        x, y, h, tag = self.width / 2, self.length / 2, self.height, Surface.BED
        half = min(0.33, x - 0.05)
        low, high = (-half, y - 0.37, h - 0.1), (half, y - 0.02, h + self.pillow_height)
        return [
            Solid((-x, -y, 0.12), (x, y, h), self.give_m, tag, carries_m=0.15),
            Solid(low, high, 0.07, Surface.PILLOW, carries_m=0.2),
            Solid((-x, y, 0.0), (x, y + 0.05, h + self.board_height), 0.0, tag),
        ]


@dataclass(frozen=True)
class Ground(Furniture):
    """Bare floor that serves as furniture; ``mesh`` is its visible part."""

    height: float = 0.0
    give_m: float = 0.0
    length: float = 2.0
    width: float = 1.0

    soft = ()

    @property
    def footprint(self) -> Footprint:
        return Footprint(self.width / 2, -self.length / 2, self.length / 2)

    def solids(self) -> list[Solid]:
        """Return an empty list, because contact with the floor is always computed."""
        return []

    def mesh(self) -> Mesh:
        return _floor()


@cache
def _floor() -> Mesh:
    return sheet(np.array([-3.0, -3.0, 0.0]), np.array([6.0, 0, 0]), np.array([0, 6.0, 0]), Surface.FLOOR)
