"""Stages: a posed person among furniture, and the viewpoints it is seen from; drawn at random.

A stage is a function of a random generator and a body. Preset sets of images differ by it.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from annotate.array_types import Float32, Float64
from synth.body.body import Body
from synth.images.viewpoints import Around, Viewpoint, above, all_round, before, looking
from synth.pose.pose_parameters import Posed
from synth.pose.postures import FALLEN, IN_BED, SITTING, UPRIGHT, lie, rise, sit
from synth.pose.standing import stand
from synth.pose.standing_parameters import draw_standing
from synth.surface.furniture import Bed, Chair, Ground, Seat, Sofa
from synth.surface.rasterize import Mesh, merge

FALLEN_SHARE = 0.2
"""Of the recumbent, those on the floor. No source: chosen by eye."""


@dataclass(frozen=True)
class Stage:
    """A posed person among furniture, world frame, metres.

    vertices_m: float32 (V, 3). joints_m: (J, 3). around: closed meshes. view: draws the camera's place.
    activities: names of what the person does, or of the two that they are between, the nearer first. notes:
    what else is known of the pose, for a frame's notes. bags: whether the person carries their bag.
    """

    activities: tuple[str, ...]
    vertices_m: Float32
    joints_m: Float64
    around: Mesh
    view: Viewpoint
    notes: dict[str, Any] = field(default_factory=dict)
    bags: bool = False


Staging = Callable[[np.random.Generator, Body], Stage]


def _stage(activities: tuple[str, ...], posed: Posed, around: Mesh, view: Viewpoint) -> Stage:
    return Stage(activities, *posed, around, view)


def sitting(rng: np.random.Generator, body: Body) -> Stage:
    """On a sofa, seen as by the robot."""
    return _sitting(rng, body, Sofa)


def _sitting(rng: np.random.Generator, body: Body, kind: type[Seat]) -> Stage:
    seat = kind.sample(rng)
    activities, moment = SITTING.single(rng)
    return _stage(activities, sit(body, seat, moment), seat.mesh(), looking(before))


def recumbent(rng: np.random.Generator, body: Body) -> Stage:
    """In bed or fallen on the floor, seen from all around, several heights."""
    is_fallen = rng.random() < FALLEN_SHARE
    activities, moment = (FALLEN if is_fallen else IN_BED).single(rng)
    support = Ground() if is_fallen else Bed.sample(rng)
    return _stage(activities, lie(body, support, moment), support.mesh(), looking(above))


def upright(rng: np.random.Generator, body: Body) -> Stage:
    """Standing, crouching, kneeling, getting up, in front of a seat or in the open, seen from all around."""
    kind = (None, Sofa, Chair)[int(rng.integers(3))]
    seat = None if kind is None else kind.sample(rng)
    activities, moment = UPRIGHT.single(rng)
    return _stage(activities, rise(body, seat, moment), (seat or Ground()).mesh(), looking(all_round))


def standing(rng: np.random.Generator, body: Body) -> Stage:
    """Standing about on an open floor, mostly seen from the front, some cut by the picture."""
    how = draw_standing(rng)
    stood = stand(body, how)
    floor = Ground().mesh()
    around = merge([floor, *stood.things]) if stood.things else floor
    hands = {"hands": dict(how.hands), "stands": how.stands}
    return Stage((how.stance,), stood.vertices_m, stood.joints_m, around, Around(), hands, bags=True)


STANDING_SHARE = 0.4
"""Of ``everybody``. People before cameras mostly stand."""


def everybody(rng: np.random.Generator, body: Body) -> Stage:
    """Standing, sitting on sofas and chairs, recumbent or upright, seen as ``standing`` is."""
    kind = rng.random()
    if kind < STANDING_SHARE:
        return standing(rng, body)
    rest = (kind - STANDING_SHARE) / (1 - STANDING_SHARE)
    if rest < 0.4:
        seated = _sitting(rng, body, Sofa if rng.random() < 0.5 else Chair)
        return replace(seated, view=Around(0.65, 0.35))
    if rest < 0.75:
        return replace(recumbent(rng, body), view=Around(0.25, 0.5, over_m=0.35))
    return replace(upright(rng, body), view=Around())
