"""Classes of furniture in many forms: other sizes, legs, boards, and bars around it.

World frame, metres. ``synth.surface.furniture_variation`` draws them.
"""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from annotate.array_types import Float64
from synth.surface.furniture import Bed, Chair, Footprint, Side, Sofa, Solid
from synth.surface.rasterize import Mesh, box, merge


@dataclass(frozen=True)
class Bars(Solid):
    """Fence of bars that fills its box and stops a body like a board.

    along: axis of the horizontal bars, 0 or 1. thick_m: side of a bar.
    """

    along: int = 0
    horizontal: int = 2
    upright: int = 2
    thick_m: float = 0.03

    def mesh(self) -> Mesh:
        low, high = np.array(self.low), np.array(self.high)
        bars = [self._bar(low, high, 2, at) for at in np.linspace(0, 1, self.horizontal)]
        bars += [self._bar(low, high, self.along, at) for at in np.linspace(0, 1, self.upright)]
        return merge(bars).placed(self.rotation, self.translation)

    def _bar(self, low: Float64, high: Float64, axis: int, at: float) -> Mesh:
        """Return the bar at a place from 0 to 1 on an axis of the box, as long as the box on the others."""
        low, high = low.copy(), high.copy()
        thick_m = min(self.thick_m, high[axis] - low[axis])
        low[axis] += at * (high[axis] - low[axis] - thick_m)
        high[axis] = low[axis] + thick_m
        return box((low[0], low[1], low[2]), (high[0], high[1], high[2]), self.tag)


@dataclass(frozen=True)
class VariedBed(Bed):
    """Bed with a free or closed space below the mattress. from_z: of the mattress. around: its frame."""

    from_z: float = 0.12
    pillow_half: float = 0.33
    around: tuple[Solid, ...] = ()

    @property
    def footprint(self) -> Footprint:
        return _widened(self.top, self.around)

    @property
    def top(self) -> Footprint:
        return super().footprint

    def solids(self) -> list[Solid]:
        mattress, pillow, _ = super().solids()
        half = min(self.pillow_half, self.width / 2 - 0.05)
        pillow = replace(pillow, low=(-half, *pillow.low[1:]), high=(half, *pillow.high[1:]))
        return [_from(mattress, self.from_z), pillow, *self.around]


@dataclass(frozen=True)
class VariedSofa(Sofa):
    """Sofa with other arms, on legs or not.

    from_z: of the seat and the arms. around: legs and fences. beside: things beside one sitter.
    """

    from_z: float = 0.05
    around: tuple[Solid, ...] = ()
    beside: tuple[Solid, ...] = ()

    @property
    def footprint(self) -> Footprint:
        return _widened(self.top, (*self.around, *self.beside))

    @property
    def top(self) -> Footprint:
        return super().footprint

    def cleared(self) -> "VariedSofa":
        return replace(self, beside=())

    def solids(self) -> list[Solid]:
        seat, back, *arms = super().solids()
        arms = [_from(arm, self.from_z) for arm in arms]
        return [_from(seat, self.from_z), back, *arms, *self.around, *self.beside]


@dataclass(frozen=True)
class VariedChair(Chair):
    """Chair with another frame. around: legs and arm rests."""

    around: tuple[Solid, ...] = ()

    @property
    def footprint(self) -> Footprint:
        return _widened(self.top, self.around)

    @property
    def top(self) -> Footprint:
        return super().footprint

    def solids(self) -> list[Solid]:
        return [*super().solids()[:2], *self.around]


@dataclass(frozen=True)
class SlattedChair(VariedChair):
    """Chair whose back rest is bars without a cushion. slats: number of upright bars."""

    slats: int = 4

    soft: ClassVar[tuple[Side, ...]] = ("top",)

    def solids(self) -> list[Solid]:
        seat, back, *around = super().solids()
        shape = (back.low, back.high, back.give_m, back.tag, back.rotation, back.translation)
        return [seat, Bars(*shape, upright=self.slats), *around]


def _widened(footprint: Footprint, around: tuple[Solid, ...]) -> Footprint:
    """Return the footprint that also holds other solids, which are not rotated."""
    half, front, back = footprint
    for one in around:
        half = max(half, -one.low[0], one.high[0])
        front, back = min(front, one.low[1]), max(back, one.high[1])
    return Footprint(half, front, back)


def _from(solid: Solid, z: float) -> Solid:
    """Return a box that starts at the height z."""
    return replace(solid, low=(*solid.low[:2], min(z, solid.high[2] - 0.03)))
