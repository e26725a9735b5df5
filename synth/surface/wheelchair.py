"""Wheelchair: seat, back, arm rests, foot rests, push handles, wheels with hand rims.

World frame and constants as in ``synth.surface.furniture``; lengths in metres.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from annotate.array_types import Float64
from synth.data_files import JUDGE, Cast
from synth.surface import judge_furniture
from synth.surface.furniture import Chair, Footprint, Seat, Solid, Surface
from synth.surface.rasterize import Mesh, merge, tagged

CORNERS, SPOKES = 24, 8  # corners of a ring or tube, spokes of a wheel
TYRE_M, RIM_M, TUBE_M = 0.03, 0.012, 0.024  # thickness of tyre, hand rim and frame tubes, as sold
CASTOR_M = 0.18  # diameter of the small front wheels, as sold
REST_Z_M = 0.05  # height of the foot rests above the floor, as sold
_TAG = int(Surface.WHEELCHAIR)


def _loop(half: tuple[float, float], across: float) -> Float64:
    """Return the corners (CORNERS, 3) of an ellipse around the x axis. half: its y and z; across: its x."""
    turn = np.linspace(0, 2 * np.pi, CORNERS, endpoint=False)
    return np.stack([np.full(CORNERS, across), half[0] * np.cos(turn), half[1] * np.sin(turn)], axis=1)


def _band(loops: list[Float64]) -> Mesh:
    """Return the surface between each loop (CORNERS, 3) and the next; the last joins the first."""
    i, n = np.arange(CORNERS), CORNERS * len(loops)
    j = (i + 1) % CORNERS
    faces = []
    for start in range(0, n, CORNERS):
        a, b = i + start, j + start
        c, d = (i + start + CORNERS) % n, (j + start + CORNERS) % n
        faces += [np.stack([a, b, d], 1), np.stack([a, d, c], 1)]
    points = np.concatenate(loops).astype(np.float32)
    return tagged(points, np.concatenate(faces).astype(np.int32), _TAG)


@dataclass(frozen=True)
class Tube(Solid):
    """Tube that fills its box, along the axis 0, 1 or 2 of the box."""

    axis: int = 0

    def mesh(self) -> Mesh:
        half = (np.array(self.high) - np.array(self.low)) / 2
        order = [self.axis, *(k for k in range(3) if k != self.axis)]
        x, y, z = half[order].tolist()
        loops = [_loop((y, z), -x), _loop((y, z), x), _loop((0.0, 0.0), x), _loop((0.0, 0.0), -x)]
        along = np.eye(3)[order].T  # from the x axis to the tube's own
        middle = (np.array(self.low) + np.array(self.high)) / 2
        return _band(loops).placed(along, middle).placed(self.rotation, self.translation)


@dataclass(frozen=True)
class SpokedWheel(Solid):
    """Wheel about the x axis whose tyre fills its box, with spokes. It stops a body like a disc.

    rim_x: middle of a hand rim beside the tyre, relative to the wheel's; 0 = none.
    """

    rim_x: float = 0.0

    def mesh(self) -> Mesh:
        low, high = np.array(self.low), np.array(self.high)
        middle, (x, radius, _) = (low + high) / 2, (high - low) / 2
        parts = [_ring(radius, radius - TYRE_M, (-x, x)), *_spokes(radius)]
        if self.rim_x:
            inner = radius - 2 * TYRE_M
            sides = (self.rim_x - RIM_M / 2, self.rim_x + RIM_M / 2)
            parts.append(_ring(inner + RIM_M, inner, sides))
        return merge(parts).placed(np.eye(3), middle).placed(self.rotation, self.translation)


def _ring(outer: float, inner: float, sides: tuple[float, float]) -> Mesh:
    """Return a flat ring about the x axis between two radii and two x."""
    left, right = sides
    corners = ((outer, left), (outer, right), (inner, right), (inner, left))
    return _band([_loop((radius, radius), x) for radius, x in corners])


def _spokes(radius: float) -> list[Mesh]:
    spoke, hub = 0.004, 0.025  # half a spoke's width, and the hub's radius
    one = Tube((-spoke, -spoke, 0.0), (spoke, spoke, radius - TYRE_M / 2), 0.0, _TAG, axis=2).mesh()
    turns = np.linspace(0, 2 * np.pi, SPOKES, endpoint=False)
    middle = Tube((-0.02, -hub, -hub), (0.02, hub, hub), 0.0, _TAG).mesh()
    return [middle, *(one.placed(Rotation.from_euler("x", turn).as_matrix(), np.zeros(3)) for turn in turns)]


@dataclass(frozen=True)
class Wheelchair(Chair):
    """Manual wheelchair. wheel: radius of a large wheel; rest_height: of the arm rests above the seat."""

    rest_height: float = 0.22
    wheel: float = 0.3

    @property
    def footprint(self) -> Footprint:
        return Footprint(self.width / 2 + 0.14, -0.1, self.depth + 0.3)

    def solids(self) -> list[Solid]:
        half, h = self.width / 2, self.height
        back = replace(self._back_rest(0.03, 0.05), tag=_TAG)
        seat = Solid((-half, 0, h - 0.04), (half, self.depth, h), self.give_m, _TAG, carries_m=0.1)
        return [seat, back, *self._wheels(), *self._arm_rests(), *self._foot_rests(), *self._handles()]

    def _wheels(self) -> list[Solid]:
        half, r, y = self.width / 2, self.wheel, self.depth - 0.02
        large = [
            SpokedWheel((x, y - r, 0.0), (x + TYRE_M, y + r, 2 * r), 0.0, _TAG, rim_x=sign * 0.035)
            for x, sign in ((-half - 0.09, -1), (half + 0.06, 1))
        ]
        axle = Tube((-half - 0.08, y - 0.015, r - 0.015), (half + 0.08, y + 0.015, r + 0.015), 0.0, _TAG)
        small = [
            SpokedWheel((x, -0.02, 0.0), (x + TYRE_M, CASTOR_M - 0.02, CASTOR_M), 0.0, _TAG)
            for x in (-half, half - TYRE_M)
        ]
        forks = [
            _upright(x, CASTOR_M / 2 - 0.02, CASTOR_M / 2, self.height - 0.04)
            for x in (-half + 0.012, half - 0.012)
        ]
        return [*large, axle, *small, *forks]

    def _arm_rests(self) -> list[Solid]:
        h, rise = self.height, self.rest_height
        rests = list[Solid]()
        for x in (-self.width / 2 - 0.03, self.width / 2 + 0.03):
            pad = (x - 0.025, 0.06, h + rise - 0.03), (x + 0.025, self.depth - 0.04, h + rise)
            panel = (x - 0.006, 0.12, h + 0.02), (x + 0.006, self.depth - 0.02, h + rise - 0.06)
            rests += [Solid(*pad, 0.005, _TAG), Solid(*panel, 0.0, _TAG)]
            rests += [_upright(x, y, h - 0.06, h + rise - 0.03) for y in (0.12, self.depth - 0.06)]
        return rests

    def _foot_rests(self) -> list[Solid]:
        """Return foot plates turned up and aside, as for a person with feet on the floor."""
        rests = list[Solid]()
        for sign in (-1, 1):
            x = sign * (self.width / 2 + 0.02)
            rests.append(_upright(x, -0.06, REST_Z_M, self.height - 0.06))
            plate = sorted((x, x + sign * 0.012))
            rests.append(Solid((plate[0], -0.2, REST_Z_M), (plate[1], -0.04, REST_Z_M + 0.16), 0.0, _TAG))
            tube = TUBE_M / 2
            y, z = (-0.07, 0.02), (self.height - 0.07, self.height - 0.07 + TUBE_M)
            rests.append(Tube((x - tube, y[0], z[0]), (x + tube, y[1], z[1]), 0.0, _TAG, axis=1))
        return rests

    def _handles(self) -> list[Solid]:
        """Return the tubes beside the back rest, and the push handles behind their upper ends."""
        tilt, place = Rotation.from_euler("x", -self.back_tilt_rad).as_matrix(), self._back_place
        tube, top = TUBE_M / 2, self.back_height
        handles = list[Solid]()
        for x in (-self.width / 2, self.width / 2):
            low, high = (x - tube, 0.0, -0.1), (x + tube, TUBE_M, top + 0.03)
            grip = (x - 0.016, 0.0, top), (x + 0.016, 0.15, top + 0.032)
            handles.append(Tube(low, high, 0.0, _TAG, tilt, place, axis=2))
            handles.append(Tube(*grip, 0.0, _TAG, tilt, place, axis=1))
        return handles

    @property
    def _back_place(self) -> Float64:
        return np.array([0.0, self.depth + 0.005, self.height])


def _upright(x: float, y: float, low: float, high: float) -> Tube:
    """Return a vertical frame tube."""
    half = TUBE_M / 2
    return Tube((x - half, y - half, low), (x + half, y + half, high), 0.0, _TAG, axis=2)


def draw_wheelchair(cast: Cast, rng: np.random.Generator) -> Seat:
    """Draw a cast's wheelchair; all its faces have the tag ``Surface.WHEELCHAIR``."""
    if cast == JUDGE:
        return replace(judge_furniture.Wheelchair.sample(rng), surface=Surface.WHEELCHAIR)
    return Wheelchair.sample(rng)
