"""Posed scenes: a person among furniture, with random viewpoints of the camera."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Protocol

import numpy as np

from annotate.array_types import Float32, Float64
from synth.body.body import Body
from synth.data_files import TRAINING, Cast
from synth.images.viewpoints import (
    PlannedViewpoint,
    Viewpoint,
    frontal_place,
    overhead_place,
    surrounding_place,
    unplanned,
)
from synth.motion import placed
from synth.motion.library import Repertoire
from synth.pose.postures import lie, poses_of, rise, sit
from synth.pose.standing import stand
from synth.pose.standing_parameters import draw_standing
from synth.surface import judge_furniture
from synth.surface.furniture import Chair, Ground, Seat, Sofa
from synth.surface.rasterize import Mesh, merge

FALLEN_SHARE = 0.2  # recumbent people who lie on the floor; untuned
_sofa = partial(judge_furniture.draw_sofa, varied=False)
_chair = partial(judge_furniture.draw_chair, varied=False)
_bed = partial(judge_furniture.draw_bed, varied=False)
STANDING_SHARE = 0.4  # of ``everybody``, because people in front of cameras mostly stand


@dataclass(frozen=True)
class PosedScene:
    """Posed person among furniture, world frame, metres.

    vertices_m: float32 (V, 3). joints_m: (J, 3). around: closed meshes. activities: one, or the two between
    which the pose lies, nearer first. notes: for a frame's notes. bags: True if the person keeps a bag.
    """

    activities: tuple[str, ...]
    vertices_m: Float32
    joints_m: Float64
    around: Mesh
    view: Viewpoint
    notes: dict[str, Any] = field(default_factory=dict)
    bags: bool = False


SceneSampler = Callable[[np.random.Generator, Body], PosedScene]


class CastSceneSampler(Protocol):
    """Sampler of scenes with a cast's poses and furniture."""

    def __call__(self, rng: np.random.Generator, body: Body, cast: Cast = ...) -> PosedScene:
        """Draw a scene with a body and a cast's poses and furniture."""


def sitting(rng: np.random.Generator, body: Body, cast: Cast = TRAINING) -> PosedScene:
    """Draw a person on a sofa, seen from a robot's place."""
    return _sitting(rng, body, _sofa, cast)


SeatSampler = Callable[[Cast, np.random.Generator], Seat]


def _sitting(rng: np.random.Generator, body: Body, draw_seat: SeatSampler, cast: Cast) -> PosedScene:
    seat = draw_seat(cast, rng)
    activities, moment = poses_of(cast).sitting.single(rng)
    return PosedScene(activities, *sit(body, seat, moment), seat.mesh(), unplanned(frontal_place))


def recumbent(rng: np.random.Generator, body: Body, cast: Cast = TRAINING) -> PosedScene:
    """Draw a person in bed or fallen on the floor, seen from all around and several heights."""
    is_fallen, poses = rng.random() < FALLEN_SHARE, poses_of(cast)
    activities, moment = (poses.fallen if is_fallen else poses.in_bed).single(rng)
    support = Ground() if is_fallen else _bed(cast, rng)
    return PosedScene(activities, *lie(body, support, moment), support.mesh(), unplanned(overhead_place))


def upright(rng: np.random.Generator, body: Body, cast: Cast = TRAINING) -> PosedScene:
    """Draw a person standing, crouching, kneeling or getting up, at a seat or without, from all around."""
    draw_seat: SeatSampler | None = (None, _sofa, _chair)[int(rng.integers(3))]
    seat = None if draw_seat is None else draw_seat(cast, rng)
    activities, moment = poses_of(cast).upright.single(rng)
    mesh = (seat or Ground()).mesh()
    return PosedScene(activities, *rise(body, seat, moment), mesh, unplanned(surrounding_place))


def standing(rng: np.random.Generator, body: Body, cast: Cast = TRAINING) -> PosedScene:
    """Draw a person standing on an open floor, mostly seen from the front, some cut by the image."""
    how = draw_standing(rng, cast)
    stood = stand(body, how)
    floor = Ground().mesh()
    around = merge([floor, *stood.things]) if stood.things else floor
    notes = {"hands": dict(how.hands), "stands": how.stands}
    view = PlannedViewpoint()
    return PosedScene((how.stance,), stood.vertices_m, stood.joints_m, around, view, notes, bags=True)


def everybody(rng: np.random.Generator, body: Body, cast: Cast = TRAINING) -> PosedScene:
    """Draw a person standing, sitting on sofa or chair, recumbent or upright."""
    kind = rng.random()
    if kind < STANDING_SHARE:
        return standing(rng, body, cast)
    rest = (kind - STANDING_SHARE) / (1 - STANDING_SHARE)
    if rest < 0.4:
        seated = _sitting(rng, body, _sofa if rng.random() < 0.5 else _chair, cast)
        return replace(seated, view=PlannedViewpoint(0.65, 0.35))
    if rest < 0.75:
        return replace(recumbent(rng, body, cast), view=PlannedViewpoint(0.25, 0.5, over_m=0.35))
    return replace(upright(rng, body, cast), view=PlannedViewpoint())


@dataclass(frozen=True, eq=False)
class MotionScenes:
    """Sampler of scenes from recorded motions, on the floor or, for a sitting frame, on a seat."""

    repertoire: Repertoire

    def __call__(self, rng: np.random.Generator, body: Body) -> PosedScene:
        """Draw a frame of a motion, the body posed as the recorded person."""
        name, motion, frame = self.repertoire.draw(rng)
        if not motion.sits[frame]:
            posed, view = placed.stand(body, motion, frame), PlannedViewpoint()
            return PosedScene((name,), *posed, Ground().mesh(), view, bags=True)
        kind: type[Seat] = Sofa if rng.random() < 0.5 else Chair  # legs of other seats have a fixed height
        posed, seat = placed.take_seat(body, motion, frame, kind.sample(rng))
        return PosedScene((name,), *posed, seat.mesh(), PlannedViewpoint())
