"""People of random scenes: their postures, supports, and furniture in front. Constants are untuned."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from annotate.array_types import Float32, Float64
from eval.training.rooms import things
from synth.clothes.dressed import Dressed
from synth.data_files import Cast
from synth.pose.postures import lie, poses_of, rise, sit
from synth.pose.standing import stand
from synth.pose.standing_parameters import draw_standing
from synth.surface.furniture import Ground, Seat, Surface
from synth.surface.judge_furniture import draw_bed, draw_chair, draw_sofa
from synth.surface.rasterize import Mesh
from synth.surface.wheelchair import draw_wheelchair

STANDING, RISING, SITTING_DOWN = 0.45, 0.55, 0.8  # cumulative shares of groups; the rest lie
SOFA, WHEELCHAIR = 0.45, 0.6  # cumulative shares of seats; the rest are chairs
ALONE = 0.4  # share of sofas for one person
AT_TABLE, WITH_WALKER, RAILED = 0.45, 0.08, 0.5  # shares of chairs at a table, of standing people, of beds
FIRST_PERSON = 1000  # tag of the first person's faces, one more for each next; tags of things are lower


@dataclass(frozen=True)
class Figures:
    """One person, or several on one sofa, with furniture, world frame, metres; they face -y.

    people: meshes with tags from ``FIRST_PERSON`` on. dark: absorbed share of infrared of the people's faces.
    """

    people: list[Mesh]
    dark: list[Float32]
    things: list[Mesh]

    def placed(self, rotation: Float64, at_m: Float64) -> "Figures":
        """Return the figures rotated by (3, 3), then moved by (3,)."""
        people, around = (
            [mesh.placed(rotation, at_m) for mesh in group] for group in (self.people, self.things)
        )
        return Figures(people, self.dark, around)


def draw_figures(people: Sequence[Dressed], first: int, cast: Cast, rng: np.random.Generator) -> Figures:
    """Draw a posture and furniture for the first of ``people``, or a sofa for several of them.

    first: number of the first person in the scene, from 0.
    """
    kind, person = rng.random(), people[0]
    if kind >= RISING and kind < SITTING_DOWN:
        return _seated(people, first, cast, rng)
    if kind < STANDING:
        vertices, joints, held = stand(person.body, draw_standing(rng, cast))
        around = [replace(mesh, tags=np.full(len(mesh.faces), Surface.TABLE, np.int32)) for mesh in held]
        if rng.random() < WITH_WALKER:
            around.append(things.walker(rng).placed(np.eye(3), np.array([0.0, -0.4, 0.0])))
    elif kind < RISING:
        seat = draw_chair(cast, rng) if rng.random() < 0.5 else None
        vertices, joints = rise(person.body, seat, poses_of(cast).upright.single(rng)[1])
        around = [seat.mesh()] if seat else []
    elif rng.random() < 0.5:
        vertices, joints = lie(person.body, Ground(), poses_of(cast).fallen.single(rng)[1])
        around = []
    else:
        bed = draw_bed(cast, rng)
        vertices, joints = lie(person.body, bed, poses_of(cast).in_bed.single(rng)[1])
        around = [things.railed(bed, rng) if rng.random() < RAILED else bed.mesh()]
    return Figures([_mesh(person, vertices, joints, first)], [person.dark], around)


def _seated(people: Sequence[Dressed], first: int, cast: Cast, rng: np.random.Generator) -> Figures:
    """Return people on one sofa, or the first of them on a chair or wheelchair."""
    kind = rng.random()
    seat: Seat = (
        draw_sofa(cast, rng)
        if kind < SOFA
        else draw_wheelchair(cast, rng)
        if kind < WHEELCHAIR
        else draw_chair(cast, rng)
    )
    around = [seat.mesh()]
    if kind >= SOFA and rng.random() < AT_TABLE:
        top = things.desk(rng) if rng.random() < 0.3 else things.table(rng, (0.66, 0.78))
        around.append(top.placed(np.eye(3), np.array([rng.normal(0, 0.15), -rng.uniform(0.35, 0.7), 0.0])))
    across = [0.0]
    if kind < SOFA and rng.random() >= ALONE and len(people) > 1:
        free = max(seat.width / 2 - 0.2, 0.3)
        across = [rng.uniform(-free, -0.1), rng.uniform(0.15, free)]
        around = [seat.cleared().mesh()]
    meshes, dark = [], []
    for number, x in enumerate(across):
        person = people[number]
        vertices, joints = sit(person.body, seat, poses_of(cast).sitting.single(rng)[1])
        mesh = _mesh(person, vertices, joints, first + number)
        meshes.append(mesh.placed(np.eye(3), np.array([x, 0.0, 0.0])))
        dark.append(person.dark)
    return Figures(meshes, dark, around)


def _mesh(person: Dressed, vertices: Float32, joints: Float64, number: int) -> Mesh:
    tags = np.full(len(person.faces), FIRST_PERSON + number, np.int32)
    return Mesh(person.drape(vertices, joints), person.faces, tags)
