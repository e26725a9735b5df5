"""Simulated recordings of people who walk past one another, some behind a pillar, in a furnished room.

The camera stands over the world's origin and looks along y. Constants are untuned.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from annotate.array_types import Float64
from eval.training.rooms.floor_plan import FloorPlan
from eval.training.rooms.gathering import aim
from eval.training.rooms.people import FIRST_PERSON, Figures
from eval.training.rooms.rooms import draw_surroundings
from eval.training.rooms.scenes import EYE_HEIGHT_M, EYE_M, Scene, rendered_scene
from synth.body.body import blend, pose
from synth.body.crowd import crowd_of
from synth.body.skeleton import Posture
from synth.cameras.random_sensor import draw_sensor
from synth.clothes.dress import dress
from synth.clothes.dressed import Dressed
from synth.data_files import Cast
from synth.pose.standing import stood
from synth.pose.standing_parameters import OTHER, draw_standing
from synth.surface.furniture import Surface
from synth.surface.rasterize import Mesh, box

FRAMES_PER_SECOND, SECONDS = 10, 8
WALKERS = (2, 5)  # least and greatest number of people
NEAREST_M, LANE_M = (1.4, 2.2), (0.55, 0.9)  # distance of the first lane; from lane to lane
SPEED_M_S, STEP_M = (0.5, 1.5), 0.65
STANDS, PILLAR = 0.2, 0.5  # shares of people who stand, and of recordings with a pillar
IN_VIEW = 1.15  # half of a way, share of half the field of view: people leave and come back
LEAST_STRIDE = 0.25  # parameter ``ahead`` of stances with one foot in front
MOST_BENT_DEG = 40.0  # parameter ``knee`` of these stances


@dataclass(frozen=True)
class Walker:
    """Person who walks to and fro on a lane, or stands.

    strides: the two ends of a step. lane_m: (2,) middle of the lane; reach_m, slope: half of the way, and its
    distance by x. start_m: part of the way walked at first.
    """

    person: Dressed
    strides: tuple[Posture, Posture]
    lane_m: Float64
    reach_m: float
    slope: float
    speed_m_s: float
    start_m: float

    def mesh(self, seconds: float, number: int) -> Mesh:
        """Return the person's mesh, world frame, metres. number: of the person in the scene, from 0."""
        walked = self.start_m + self.speed_m_s * seconds
        there = walked % (4 * self.reach_m)
        x, ahead = (there, 1) if there < 2 * self.reach_m else (4 * self.reach_m - there, -1)
        share = (1 - np.cos(np.pi * walked / STEP_M)) / 2
        first, other = self.strides
        angles = (1 - share) * first.angles_rad + share * other.angles_rad
        vertices, joints = pose(self.person.body, Posture(angles, first.pelvis_m))
        tags = np.full(len(self.person.faces), FIRST_PERSON + number, np.int32)
        mesh = Mesh(self.person.drape(vertices, joints), self.person.faces, tags)
        turn = Rotation.from_euler("z", np.arctan2(ahead * self.slope, ahead) + np.pi / 2).as_matrix()
        along = x - self.reach_m
        at = np.array([*(self.lane_m + along * np.array([1, self.slope])), -float(vertices[:, 2].min())])
        return mesh.placed(turn, at)


def walking_scenes(seed: int, cast: Cast) -> Iterator[Scene]:
    """Yield the frames of a recording, ``FRAMES_PER_SECOND``."""
    rng = np.random.default_rng((seed, 63))
    sensor = draw_sensor(rng)
    half_view = float(np.arctan(sensor.camera.width / 2 / sensor.camera.fx))
    walkers, plan = _walkers(rng, half_view, cast), FloorPlan()
    plan.take_circle(np.zeros(2), EYE_M)
    for walker in walkers:
        for along in np.arange(-walker.reach_m, walker.reach_m, 0.2):
            plan.take_circle(walker.lane_m + along * np.array([1, walker.slope]), 0.35)
    eye = np.array([0.0, 0.0, rng.uniform(*EYE_HEIGHT_M)])
    middles = [np.array([*walker.lane_m, 1.0]) for walker in walkers]
    room = draw_surroundings(rng, np.stack([eye, *middles]), plan, cast, may_be_none=True)
    if rng.random() < PILLAR:
        room.shell.append(_pillar(rng, walkers[-1], half_view))
    camera_from_world = aim(rng, eye, middles)
    for frame in range(FRAMES_PER_SECOND * SECONDS):
        meshes = [walker.mesh(frame / FRAMES_PER_SECOND, i) for i, walker in enumerate(walkers)]
        figures = Figures(meshes, [walker.person.dark for walker in walkers], [])
        yield rendered_scene(rng, sensor, camera_from_world, [figures], room)


def _walkers(rng: np.random.Generator, half_view_rad: float, cast: Cast) -> list[Walker]:
    bodies, walkers = crowd_of(cast), []
    away = rng.uniform(*NEAREST_M)
    for _ in range(rng.integers(WALKERS[0], WALKERS[1] + 1)):
        one, other = rng.choice(len(bodies), 2, replace=False)
        person = dress(blend(bodies[one], bodies[other], float(rng.beta(0.6, 0.6) / 2)), rng, cast)
        reach, standing = IN_VIEW * away * np.tan(half_view_rad), rng.random() < STANDS
        speed = 0.0 if standing else rng.uniform(*SPEED_M_S)
        start = reach * rng.uniform(0.6, 1.4) if standing else rng.uniform(0, 4 * reach)
        slope = rng.normal(0, 0.06)
        lane = np.array([0.0, away])
        walkers.append(Walker(person, _strides(rng, person, cast), lane, reach, slope, speed, start))
        away += rng.uniform(*LANE_M)
    return walkers


def _strides(rng: np.random.Generator, person: Dressed, cast: Cast) -> tuple[Posture, Posture]:
    """Draw a step: a posture with one foot in front, and its mirror image."""
    how = draw_standing(rng, cast)
    while abs(how.legs.get("ahead", 0.0)) < LEAST_STRIDE or how.legs.get("knee", 0.0) > MOST_BENT_DEG:
        how = draw_standing(rng, cast)
    return stood(person.body, how), stood(person.body, replace(how, stands=OTHER[how.stands]))


def _pillar(rng: np.random.Generator, behind: Walker, half_view_rad: float) -> Mesh:
    """Draw a pillar in front of a lane, so wide that it hides a walker for less than two seconds."""
    share = rng.uniform(0.45, 0.6)
    wide = share * rng.uniform(0.6, 0.9) * max(behind.speed_m_s, 0.4) / 2
    x = share * behind.lane_m[1] * np.tan(half_view_rad) * rng.uniform(-0.5, 0.5)
    y = share * behind.lane_m[1]
    return box((x - wide, y - 0.1, 0.0), (x + wide, y + 0.1, 2.4), Surface.WALL)
