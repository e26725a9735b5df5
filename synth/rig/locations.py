"""Locations of the virtual rig: seats, bed or floor, with behaviour and the robot's viewpoint."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from annotate.array_types import Float64
from sensors.rig.rig_calibration import Pose
from synth.body.body import Body
from synth.data_files import TRAINING, Cast
from synth.pose.on_floor import OnFloor
from synth.pose.pose_parameters import Moment, Posed
from synth.pose.postures import in_bed, on_seat
from synth.rig.cushion import Cushion
from synth.surface.furniture import Furniture, Ground, Seat, Solid
from synth.surface.judge_furniture import draw_arm_chair, draw_bed, draw_chair, draw_sofa
from synth.surface.rasterize import beside, look_at
from synth.surface.room import PLAIN_ROOM, Room, draw_room
from synth.surface.wheelchair import draw_wheelchair

SOFA_GIVE_M = (0.015, 0.045)  # depth of a sitter, from firm to soft foam; untuned
BED_AZIMUTH_RAD = (np.radians(25.0), np.radians(110.0))  # from the foot: not head-on, not behind the wall
FLOOR_M = 2.4  # side of the square that people on a floor reach
Viewpoint = Callable[[np.random.Generator, float], tuple[Float64, Float64]]
"""Sampler of a robot's eye and target (3,), world, metres; the float scales the error of the aim."""


class Activity(Protocol):
    """Behaviour of a person at a location, or a recorded motion."""

    def draw(self, rng: np.random.Generator) -> Moment:
        """Draw pose parameters."""
        ...

    def stream(self, rng: np.random.Generator, frames_per_second: float) -> Iterator[Moment]:
        """Yield pose parameters frame by frame, without end."""
        ...

    @property
    def pose(self) -> Callable[[Body, Moment], Posed]:
        """Return a function that poses a body."""
        ...


@dataclass(frozen=True)
class Location:
    """Furniture or bare floor in a room, with a robot in front; world frame, metres. wall_y: y of the wall
    behind.
    """

    furniture: Furniture
    wall_y: float
    behaviour: Activity
    lies: bool
    view: Viewpoint
    room: Room = PLAIN_ROOM

    def cushions(self) -> list[Cushion]:
        """Return the soft sides: seat and back rest, arm rests, mattress and pillow."""
        solids, soft = self.furniture.solids(), self.furniture.soft
        return [Cushion(solids[i], side, self.furniture.puff_m) for i, side in enumerate(soft)]

    def hard_solids(self) -> list[Solid]:
        """Return the solids without a soft side."""
        return self.furniture.solids()[len(self.furniture.soft) :]

    def robot_eye(self, rng: np.random.Generator, stray: float) -> Pose:
        """Draw the pose ``camera_from_world`` of a robot. stray: factor on the error of its aim at the
        person.
        """
        roll = np.radians(rng.normal(0, 1.5))
        return look_at(*self.view(rng, stray), roll)


def _sofa(rng: np.random.Generator, cast: Cast) -> Location:
    return _seat(replace(draw_sofa(cast, rng), give_m=rng.uniform(*SOFA_GIVE_M)), rng, cast)


def _chair(rng: np.random.Generator, cast: Cast) -> Location:
    return _seat(draw_chair(cast, rng), rng, cast)


def _arm_chair(rng: np.random.Generator, cast: Cast) -> Location:
    return _seat(draw_arm_chair(cast, rng), rng, cast)


def _wheelchair(rng: np.random.Generator, cast: Cast) -> Location:
    return _seat(draw_wheelchair(cast, rng), rng, cast)


def _seat(seat: Seat, rng: np.random.Generator, cast: Cast) -> Location:
    wall_y = seat.footprint.back_y + rng.uniform(0.3, 1.1)
    return Location(seat, wall_y, on_seat(seat, cast=cast), False, _view_of_sitter)


def _bed(rng: np.random.Generator, cast: Cast) -> Location:
    bed = draw_bed(cast, rng)

    def view(rng: np.random.Generator, stray: float) -> tuple[Float64, Float64]:
        azimuth, distance = rng.choice((-1, 1)) * rng.uniform(*BED_AZIMUTH_RAD), rng.uniform(1.7, 2.4)
        eye = beside(np.zeros(3), azimuth, distance, bed.height + rng.uniform(0.7, 1.6))
        return eye, np.array([0.0, 0.0, bed.height]) + stray * rng.normal(0, (0.08, 0.12, 0.05))

    return Location(bed, bed.footprint.back_y + rng.uniform(0.02, 0.1), in_bed(bed, cast), True, view)


def _view_of_sitter(rng: np.random.Generator, stray: float) -> tuple[Float64, Float64]:
    azimuth, distance = np.radians(rng.uniform(-40, 40)), rng.uniform(1.9, 2.5)
    eye = beside(np.zeros(3), azimuth, distance, rng.uniform(1.0, 1.35))
    return eye, np.array([0.0, 0.0, 0.68]) + stray * rng.normal(0, 0.06, 3)


def _floor(rng: np.random.Generator, cast: Cast) -> Location:

    def view(rng: np.random.Generator, stray: float) -> tuple[Float64, Float64]:
        azimuth, distance = np.radians(rng.uniform(-40, 40)), rng.uniform(2.6, 3.2)
        eye = beside(np.zeros(3), azimuth, distance, rng.uniform(0.9, 1.7))
        return eye, np.array([0.0, 0.0, 0.8]) + stray * rng.normal(0, 0.06, 3)

    wall_y = rng.uniform(0.5, 1.1)
    return Location(Ground(length=FLOOR_M, width=FLOOR_M), wall_y, OnFloor(wall_y, cast), False, view)


SCENES: dict[str, Callable[[np.random.Generator, Cast], Location]] = {
    "sofa": _sofa,
    "chair": _chair,
    "bed": _bed,
    "floor": _floor,
    "wheelchair": _wheelchair,
    "armchair": _arm_chair,
}


def located(scene: str, cast: Cast = TRAINING) -> Callable[[np.random.Generator], Location]:
    """Return the sampler of a scene's locations, with a cast's furniture, poses and rooms."""

    def draw(rng: np.random.Generator) -> Location:
        place = SCENES[scene](rng, cast)
        return replace(place, room=draw_room(cast, rng))

    return draw
