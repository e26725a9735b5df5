"""Furniture of the judging cast: classes and dimensions of its own.

Training shows boards and bars of other forms (``synth.surface.furniture_variation``). Dimensions:
``synth/data/judge/furniture.toml``. World frame and constants as in ``synth.surface.furniture``.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from synth.data_files import JUDGE, Cast
from synth.surface.furniture import ArmChair, Bed, Chair, Footprint, Furniture, Seat, Sofa, Solid, Surface
from synth.surface.furniture_variation import vary_bed, vary_chair, vary_sofa
from synth.surface.rasterize import Mesh, tagged

LEG_M = 0.05  # side of a leg; of a rail's post less
SPOKES = 24  # corners of a wheel


@dataclass(frozen=True)
class Wheel(Solid):
    """Disc about the x axis that fills its box."""

    def mesh(self) -> Mesh:
        turn = np.linspace(0, 2 * np.pi, SPOKES, endpoint=False)
        low, high = np.array(self.low), np.array(self.high)
        middle, half = (low + high) / 2, (high - low) / 2
        rims = [
            np.stack(
                [
                    np.full(SPOKES, x),
                    middle[1] + half[1] * np.cos(turn),
                    middle[2] + half[2] * np.sin(turn),
                ],
                axis=1,
            )
            for x in (low[0], high[0])
        ]
        hubs = np.array([[low[0], *middle[1:]], [high[0], *middle[1:]]])
        points = np.concatenate([*rims, hubs]).astype(np.float32)
        i, j, n = np.arange(SPOKES), (np.arange(SPOKES) + 1) % SPOKES, SPOKES
        faces = np.concatenate(
            [
                np.stack([i, j, j + n], 1),
                np.stack([i, j + n, i + n], 1),
                np.stack([np.full(n, 2 * n), j, i], 1),
                np.stack([np.full(n, 2 * n + 1), i + n, j + n], 1),
            ]
        )
        return tagged(points, faces.astype(np.int32), self.tag).placed(self.rotation, self.translation)


@dataclass(frozen=True)
class CornerSofa(Sofa):
    """Sofa with a chaise longue at one end and an arm at the other; side: sign of the chaise's x."""

    chaise: float = 0.8
    side: float = 1.0

    data = "judge/furniture"
    soft = ("top", "front", "top", "top")

    @property
    def footprint(self) -> Footprint:
        return Footprint(self.width / 2 + self.arm_width, -self.chaise, self.depth + 0.3)

    def solids(self) -> list[Solid]:
        half, h, tag, sign = self.width / 2, self.height, Surface.SOFA, np.sign(self.side)
        seat, back, left, right = super().solids()
        x = sorted((sign * (half - 0.7), sign * half))
        longue = Solid((x[0], -self.chaise, 0.05), (x[1], 0.0, h), self.give_m, tag, carries_m=0.1)
        return [seat, back, longue, left if sign > 0 else right]


@dataclass(frozen=True)
class Futon(Sofa):
    """Low mattress with a sloping back on a frame with legs, without arms."""

    data = "judge/furniture"
    puff_m = 0.02
    soft = ("top", "front")

    @property
    def footprint(self) -> Footprint:
        return Footprint(self.width / 2, 0.0, self.depth + 0.3)

    def solids(self) -> list[Solid]:
        half, h, tag = self.width / 2, self.height, Surface.SOFA
        seat = Solid((-half, 0, h - 0.15), (half, self.depth + 0.1, h), self.give_m, tag, carries_m=0.1)
        rail = Solid((-half, 0.06, h - 0.2), (half, 0.1, h - 0.15), 0.0, Surface.TABLE)
        legs = [
            Solid((x, y, 0), (x + LEG_M, y + LEG_M, h - 0.15), 0.0, Surface.TABLE)
            for x in (-half + 0.1, half - 0.1 - LEG_M)
            for y in (0.06, self.depth)
        ]
        return [seat, self._back_rest(0.12, 0), rail, *legs]


@dataclass(frozen=True)
class WingChair(Sofa):
    """Arm-chair with a high back between two wings."""

    wing: float = 0.2

    data = "judge/furniture"

    def solids(self) -> list[Solid]:
        half, wide = self.width / 2, 0.07
        tilt, place = Rotation.from_euler("x", -self.back_tilt_rad).as_matrix(), [0, self.depth, self.height]
        wings = [
            Solid(
                (x, -self.wing, self.arm_height),
                (x + wide, 0.1, self.back_height),
                self.give_m,
                Surface.SOFA,
                tilt,
                np.array(place),
            )
            for x in (-half - wide, half)
        ]
        return [*super().solids(), *wings]


def _arm_rests(seat: Seat, rise_m: float) -> list[Solid]:
    """Return two padded boards on posts beside a chair's seat."""
    half, h = seat.width / 2, seat.height
    boards = [(x, x + 0.05) for x in (-half - 0.06, half + 0.01)]
    y = seat.depth / 2
    tops = [
        Solid((a, 0.06, h + rise_m - 0.03), (b, seat.depth - 0.04, h + rise_m), 0.005, Surface.TABLE)
        for a, b in boards
    ]
    posts = [
        Solid((a + 0.01, y, h - 0.04), (b - 0.01, y + 0.04, h + rise_m - 0.03), 0.0, Surface.TABLE)
        for a, b in boards
    ]
    return [*tops, *posts]


@dataclass(frozen=True)
class OfficeChair(Chair):
    """Swivel chair: arm rests, one column, a foot of two crossed bars."""

    rest_height: float = 0.2

    data = "judge/furniture"

    @property
    def footprint(self) -> Footprint:
        return Footprint(self.width / 2 + 0.07, 0.0, self.depth + 0.12)

    def solids(self) -> list[Solid]:
        h, middle = self.height, self.depth / 2
        seat, back = super().solids()[:2]
        column = Solid((-0.03, middle - 0.03, 0.06), (0.03, middle + 0.03, h - 0.05), 0.0, Surface.TABLE)
        place, turn = np.array([0, middle, 0]), Rotation.from_euler("z", 0.6).as_matrix()
        bars = [
            Solid((-0.3, -0.025, 0.02), (0.3, 0.025, 0.08), 0.0, Surface.TABLE, turn, place),
            Solid((-0.025, -0.3, 0.02), (0.025, 0.3, 0.08), 0.0, Surface.TABLE, turn, place),
        ]
        return [seat, back, *_arm_rests(self, self.rest_height), column, *bars]


@dataclass(frozen=True)
class Wheelchair(Chair):
    """Wheelchair: arm rests, two large and two small wheels.

    wheel: radius of a large wheel. surface: tag of all faces; None = the tags of other chairs.
    """

    rest_height: float = 0.22
    wheel: float = 0.3
    surface: Surface | None = None

    data = "judge/furniture"

    @property
    def footprint(self) -> Footprint:
        return Footprint(self.width / 2 + 0.12, 0.0, self.depth + 0.25)

    def solids(self) -> list[Solid]:
        half, r, tag = self.width / 2, self.wheel, Surface.TABLE
        seat, back = super().solids()[:2]
        y = self.depth - 0.02
        large = [
            Wheel((x, y - r, 0.0), (x + 0.03, y + r, 2 * r), 0.0, tag) for x in (-half - 0.11, half + 0.08)
        ]
        small = [Wheel((x, 0.0, 0.0), (x + 0.03, 0.18, 0.18), 0.0, tag) for x in (-half, half - 0.03)]
        solids = [seat, back, *_arm_rests(self, self.rest_height), *large, *small]
        return solids if self.surface is None else [replace(one, tag=self.surface) for one in solids]


@dataclass(frozen=True)
class CareBed(Bed):
    """Nursing bed: an open frame with legs, boards at both ends, a rail along half of each side."""

    rail: float = 0.3

    data = "judge/furniture"

    def solids(self) -> list[Solid]:
        x, y, h, tag = self.width / 2, self.length / 2, self.height, Surface.BED
        half = min(0.36, x - 0.06)
        low, high = (-half, y - 0.42, h - 0.1), (half, y - 0.03, h + self.pillow_height)
        boards = [
            Solid((-x, end, 0.2), (x, end + 0.04, h + self.board_height), 0.0, Surface.TABLE)
            for end in (y, -y - 0.04)
        ]
        legs = [
            Solid((a, b, 0.0), (a + LEG_M, b + LEG_M, h - 0.18), 0.0, Surface.TABLE)
            for a in (-x + 0.05, x - 0.05 - LEG_M)
            for b in (-y + 0.1, y - 0.1 - LEG_M)
        ]
        rails = [
            Solid((a, -0.15, h + z), (a + 0.025, y - 0.1, h + z + 0.03), 0.0, Surface.TABLE)
            for a in (-x - 0.03, x + 0.005)
            for z in (self.rail / 2, self.rail)
        ]
        posts = [
            Solid((a, b, h - 0.1), (a + 0.025, b + 0.025, h + self.rail), 0.0, Surface.TABLE)
            for a in (-x - 0.03, x + 0.005)
            for b in (-0.15, y - 0.125)
        ]
        mattress = Solid((-x, -y, h - 0.18), (x, y, h), self.give_m, tag, carries_m=0.15)
        pillow = Solid(low, high, 0.07, Surface.PILLOW, carries_m=0.2)
        return [mattress, pillow, *boards, *legs, *rails, *posts]


@dataclass(frozen=True)
class DoubleBed(Bed):
    """Low, wide bed with one long bolster and a high head board."""

    foot_board: float = 0.1

    data = "judge/furniture"

    def solids(self) -> list[Solid]:
        x, y, h = self.width / 2, self.length / 2, self.height
        mattress, _, head = super().solids()
        low, high = (-x + 0.08, y - 0.3, h - 0.1), (x - 0.08, y - 0.02, h + self.pillow_height)
        bolster = Solid(low, high, 0.06, Surface.PILLOW, carries_m=0.2)
        foot = Solid((-x, -y - 0.05, 0.0), (x, -y, h + self.foot_board), 0.0, Surface.TABLE)
        return [mattress, bolster, head, foot]


@dataclass(frozen=True)
class DayBed(Bed):
    """Narrow bed with a panel along one side; side: sign of the panel's x."""

    panel: float = 0.2
    side: float = 1.0

    data = "judge/furniture"

    def solids(self) -> list[Solid]:
        x, y, h, sign = self.width / 2, self.length / 2, self.height, np.sign(self.side)
        a, b = sorted((sign * x, sign * (x + 0.06)))
        panel = Solid((a, -y, 0.0), (b, y, h + self.panel), 0.0, Surface.TABLE)
        return [*super().solids(), panel]


SOFAS: tuple[type[Sofa], ...] = (CornerSofa, Futon, WingChair)
CHAIRS: tuple[type[Chair], ...] = (OfficeChair, Wheelchair)
BEDS: tuple[type[Bed], ...] = (CareBed, DoubleBed, DayBed)
OWN: tuple[type[Furniture], ...] = (*SOFAS, *CHAIRS, *BEDS)
"""Furniture of the judging cast."""


def draw_sofa(cast: Cast, rng: np.random.Generator, *, varied: bool = True) -> Sofa:
    """Draw a cast's sofa or arm-chair. varied: False for the training cast's plain one."""
    if cast == JUDGE:
        return SOFAS[int(rng.integers(len(SOFAS)))].sample(rng)
    plain = Sofa.sample(rng)
    return vary_sofa(plain, rng.spawn(1)[0]) if varied else plain


def draw_chair(cast: Cast, rng: np.random.Generator, *, varied: bool = True) -> Chair:
    """Draw a cast's chair. varied: False for the training cast's plain one."""
    if cast == JUDGE:
        return CHAIRS[int(rng.integers(len(CHAIRS)))].sample(rng)
    plain = Chair.sample(rng)
    return vary_chair(plain, rng.spawn(1)[0]) if varied else plain


def draw_arm_chair(cast: Cast, rng: np.random.Generator) -> Chair:
    """Draw a cast's chair with bare arm rests."""
    return (OfficeChair if cast == JUDGE else ArmChair).sample(rng)


def draw_bed(cast: Cast, rng: np.random.Generator, *, varied: bool = True) -> Bed:
    """Draw a cast's bed. varied: False for the training cast's plain one."""
    if cast == JUDGE:
        return BEDS[int(rng.integers(len(BEDS)))].sample(rng)
    plain = Bed.sample(rng)
    return vary_bed(plain, rng.spawn(1)[0]) if varied else plain
