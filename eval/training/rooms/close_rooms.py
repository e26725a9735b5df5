"""Rooms whose walls and things are within a metre or so of a low camera, empty or with one person near.

The camera stands over the world's origin and looks along y. Constants are untuned.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from annotate.array_types import Float64
from eval.training.rooms.clutter import draw_desk_clutter, draw_floor_clutter, in_cells
from eval.training.rooms.floor_plan import FloorPlan
from eval.training.rooms.gathering import ROLL_DEG, STEP_M, STEPS, facing, middle
from eval.training.rooms.people import Figures, draw_figures
from eval.training.rooms.rooms import Room, place, shell
from eval.training.rooms.scenes import ROOMS_OF_PEOPLE, Scene, acquaintances, rendered_scene
from sensors.rig.rig_calibration import Pose
from synth.cameras.random_sensor import draw_sensor
from synth.cameras.sensor import Sensor
from synth.clothes.dressed import Dressed
from synth.data_files import TRAINING, Cast
from synth.surface.furniture import Surface
from synth.surface.rasterize import Mesh, box, look_at, sheet

EMPTY = 0.6  # share of rooms without a person
ACQUAINTED = 4  # people who recur in the rooms of a seed
WALL_M, DEEP, DEEP_M = (0.4, 1.5), 0.45, (1.5, 4.5)  # to a wall; share and distance of far walls
ON_DESK, UNDER = 0.4, 0.15  # shares of cameras on a desk or shelf, and of others under a table or bed
EYE_M, EYE_HEIGHT_M = 0.12, (0.2, 1.0)  # free about the camera; its height above the floor
DESK_M, LENS_M, FIRST_M = (0.35, 1.3), (0.03, 0.2), 0.08  # height; lens above it; its edge from the camera
NEAR_M, PERSON_M = (0.3, 1.4), (0.45, 2.2)  # from the camera to a thing's nearest point, and to a person
CLUTTER, FURTHER, DESK_CLUTTER = (2, 9), 6, 6  # things near the camera, most further ones, most on the desk
IN_VIEW = 1.25  # greatest azimuth, share of half the field of view: the image's border cuts things and people
PITCH_DEG, DOWN_DEG = (4.0, 9.0), (-20.0, 40.0)  # mean and standard deviation of the pitch; its range


class _Stand(NamedTuple):
    """Eye (3,) of a camera, and the desk under it or the table above it."""

    eye_m: Float64
    desk: list[Mesh]
    above: list[Mesh]


def close_scenes(seed: int, cast: Cast = TRAINING) -> Iterator[Scene]:
    """Yield ``ROOMS_OF_PEOPLE`` random close rooms; the same few people of a cast recur in them."""
    rng = np.random.default_rng((seed, 64))
    people = acquaintances(rng, ACQUAINTED, cast)
    for _ in range(ROOMS_OF_PEOPLE):
        person = None if rng.random() < EMPTY else people[int(rng.integers(ACQUAINTED))]
        yield close_room(rng, draw_sensor(rng), person, cast)


def close_room(rng: np.random.Generator, sensor: Sensor, person: Dressed | None, cast: Cast) -> Scene:
    """Return the scene of a random close room, with a person if there is a free place near the camera."""
    plan = FloorPlan()
    half_view = float(np.arctan(sensor.camera.width / 2 / sensor.camera.fx))
    plan.take_circle(np.zeros(2), EYE_M)
    stand = _stand(rng)
    if stand.desk:
        plan.take(stand.desk)
    near = _near(rng, person, plan, half_view, cast) if person is not None else None
    placed = [near] if near is not None else []
    room = _room(rng, [stand.eye_m, *(middle(mesh) for one in placed for mesh in one.people)], plan, cast)
    things = _clutter(rng, plan, half_view, cast)
    if stand.desk:
        things += _on_desk(rng, stand, half_view)
    things = [in_cells(thing) for thing in (*stand.desk, *things, *room.things)]
    room = Room([*room.shell, *stand.above], room.panes, things)
    return rendered_scene(rng, sensor, _pose(rng, stand.eye_m), placed, room)


def _stand(rng: np.random.Generator) -> _Stand:
    """Draw the camera's height and what it stands on or under."""
    if rng.random() < ON_DESK:
        top, wide, deep = rng.uniform(*DESK_M), rng.uniform(0.3, 0.9), rng.uniform(0.15, 0.9)
        thick = rng.uniform(0.015, 0.05) if rng.random() < 0.7 else top
        desk = box((-wide, FIRST_M, top - thick), (wide, FIRST_M + deep, top), Surface.TABLE)
        return _Stand(np.array([0.0, 0.0, top + rng.uniform(*LENS_M)]), [desk], [])
    eye = np.array([0.0, 0.0, np.exp(rng.uniform(*np.log(EYE_HEIGHT_M)))])
    above = [_board_above(rng, float(eye[2]))] if rng.random() < UNDER else []
    return _Stand(eye, [], above)


def _board_above(rng: np.random.Generator, eye_height_m: float) -> Mesh:
    """Draw the underside of a table, bed or chair over the camera."""
    wide, deep, high = rng.uniform((0.2, 0.2, 0.12), (1.0, 1.2, 0.5))
    low = np.array([rng.uniform(-1.5, -0.2) * wide, FIRST_M, eye_height_m + high])
    return sheet(low, np.array([2 * wide, 0, 0]), np.array([0, deep, 0]), Surface.TABLE)


def _pose(rng: np.random.Generator, eye_m: Float64) -> Pose:
    pitch = np.radians(np.clip(rng.normal(*PITCH_DEG), *DOWN_DEG))
    ahead = np.array([0.0, np.cos(pitch), -np.sin(pitch)])
    return look_at(eye_m, eye_m + ahead, np.radians(np.clip(rng.normal(0, 5), -ROLL_DEG, ROLL_DEG)))


def _along(rng: np.random.Generator, half_view_rad: float) -> Float64:
    """Draw a direction (3,) on the floor in view of the camera, or just beside the view."""
    azimuth = rng.uniform(-1, 1) * IN_VIEW * half_view_rad
    return np.array([np.sin(azimuth), np.cos(azimuth), 0.0])


def _near(
    rng: np.random.Generator, person: Dressed, plan: FloorPlan, half_view_rad: float, cast: Cast
) -> Figures | None:
    """Return a person near the camera, or None if no drawn place is free."""
    figures, along = draw_figures([person], 0, cast, rng), _along(rng, half_view_rad)
    at = np.exp(rng.uniform(*np.log(PERSON_M))) * along
    turn = facing(rng, at)
    for i in range(STEPS):
        moved = figures.placed(turn, at + i * STEP_M * along)
        if plan.take([*moved.people, *moved.things]):
            return replace(moved, things=list(map(in_cells, moved.things)))
    return None


def _room(rng: np.random.Generator, points_m: list[Float64], plan: FloorPlan, cast: Cast) -> Room:
    """Draw walls around points (3,), the camera first, and things anywhere between the walls."""
    turn = Rotation.from_euler("z", rng.uniform(-np.pi, np.pi)).as_matrix()
    inside = np.stack(points_m) @ turn
    beyond = np.exp(rng.uniform(np.log(WALL_M[0]), np.log(WALL_M[1]), (2, 2)))
    beyond = np.where(rng.random((2, 2)) < DEEP, rng.uniform(*DEEP_M, (2, 2)), beyond)
    low, high = inside[:, :2].min(axis=0) - beyond[0], inside[:, :2].max(axis=0) + beyond[1]
    walls, panes = ([mesh.placed(turn, np.zeros(3)) for mesh in meshes] for meshes in shell(rng, low, high))
    drawn = [draw_floor_clutter(rng, cast) for _ in range(int(rng.integers(FURTHER + 1)))]
    moved = [thing.placed(*place(rng, turn, inside, np.array([low, high]))) for thing in drawn]
    return Room(walls, panes, [thing for thing in moved if plan.take([thing])])


def _clutter(rng: np.random.Generator, plan: FloorPlan, half_view_rad: float, cast: Cast) -> list[Mesh]:
    """Draw things on the floor near the camera."""
    things = []
    for _ in range(int(rng.integers(*CLUTTER))):
        thing = _in_front(rng, draw_floor_clutter(rng, cast), half_view_rad)
        if plan.take([thing]):
            things.append(thing)
    return things


def _on_desk(rng: np.random.Generator, stand: _Stand, half_view_rad: float) -> list[Mesh]:
    """Draw things on the desk, which may overhang."""
    plan, things = FloorPlan(), []
    plan.take_circle(np.zeros(2), EYE_M)
    top, end = (float(stand.desk[0].vertices_m[:, axis].max()) for axis in (2, 1))
    for _ in range(int(rng.integers(DESK_CLUTTER + 1))):
        thing = _in_front(rng, draw_desk_clutter(rng), half_view_rad)
        if middle(thing)[1] < end and plan.take([thing]):
            things.append(thing.placed(np.eye(3), np.array([0.0, 0.0, top])))
    return things


def _in_front(rng: np.random.Generator, thing: Mesh, half_view_rad: float) -> Mesh:
    """Return a thing, turned at random, whose nearest point is within ``NEAR_M`` of the camera."""
    turn = Rotation.from_euler("z", rng.uniform(-np.pi, np.pi)).as_matrix()
    along = _along(rng, half_view_rad)
    turned = thing.placed(turn, np.zeros(3))
    nearest = float((turned.vertices_m @ along).min())
    return turned.placed(np.eye(3), (np.exp(rng.uniform(*np.log(NEAR_M))) - nearest) * along)
