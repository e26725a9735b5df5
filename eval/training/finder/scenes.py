"""Scenes for training the person finder: depth images with nobody, one or several people, and who is where.

Some are the virtual rig's living rooms and bedrooms, the others rooms put together at random, down to none at
all, with dressed people who stand, sit and lie, alone or side by side, before any depth sensor.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from annotate.array_types import Float32, Float64, UInt8, UInt16
from annotate.parts import N_CLASSES
from annotate.suit.palette import DEFAULT_SUIT
from eval.training.finder.rooms import surroundings
from sensors.rig.camera import Intrinsics
from sensors.rig.kinect2_factory import KINECT2_PINHOLE
from synth.body.body import blend
from synth.body.crowd import crowd
from synth.cameras.draw import draw_sensor
from synth.cameras.multipath import multipath_m
from synth.cameras.sensor import CleanDepth, Sensor
from synth.clothes.dress import dress
from synth.clothes.dressed import Dressed
from synth.pose.postures import FALLEN, IN_BED, SITTING, UPRIGHT, lie, rise, sit
from synth.pose.stances import draw_standing
from synth.pose.standing import stand
from synth.rig.difficulty import DIFFICULTIES, Difficulty
from synth.rig.place import SCENES
from synth.rig.stay import Stay
from synth.surface.furniture import Bed, Chair, Ground, Sofa, Surface
from synth.surface.rasterize import Mesh, beside, look_at, merge, rasterize

FRAMES_OF_STAY, STAY_FPS = 4, 0.15
"""Frames of one subject of the rig, and frames a second, so that postures differ. Chosen by eye."""
COMPANY, HARD, EMPTY = 0.6, 0.6, 0.15
"""Shares of the rig's subjects with a visitor, of its `hard` scenes, and of those that all people have left.
Chosen by eye."""
RIG_SENSOR, MULTIPATH = 0.6, 0.7
"""Share of the rig's frames seen by its own camera, and share of these with light that bounces twice. Chosen
by eye."""
ROOMS_OF_PEOPLE, ACQUAINTED = 8, 3
"""Rooms in which the same people are, and how many these are. Chosen by eye."""
PEOPLE = (0.1, 0.45, 0.3, 0.15)
"""Shares of rooms with none, one, two and three people. Chosen by eye."""
STANDING, RISING, SITTING_DOWN = 0.6, 0.72, 0.9
"""Of the people in rooms, those who stand, who stand or crouch or get up, and all but those who lie. Chosen
by eye."""
BESIDE, BESIDE_M, APART_M = 0.5, (0.35, 0.7), (0.7, 2.5)
"""Share of the others who stand beside the first, and distances of these and of the rest. Chosen by eye."""
DISTANCE_M, HEIGHT_M = (0.9, 4.2), (0.4, 2.4)
"""Of the camera from the first person, and over the floor. Chosen by eye."""
FIRST_PERSON = 1000
"""Tag of the first person's faces in a room, one more for each next; those of the room are lower."""


class Scene(NamedTuple):
    """Depth image uint16 (h, w) in millimetres, and who is where, uint8 (h, w): 0 nobody, 1 and on people."""

    camera: Intrinsics
    depth_mm: UInt16
    persons: UInt8


def rig_scenes(seed: int) -> Iterator[Scene]:
    """Some frames of one subject of the virtual rig."""
    rng = np.random.default_rng((seed, 61))
    place = str(rng.choice(("sofa", "sofa", "chair", "bed")))
    rig = DIFFICULTIES["hard" if rng.random() < HARD else "normal"]
    rig = replace(rig, clutter=replace(rig.clutter, company=COMPANY), warmth=0.0)
    stay = Stay(SCENES[place], rig, DEFAULT_SUIT, seed, 0, STAY_FPS)
    cast = stay.cast
    whose = np.where(cast.tags == Surface.OTHER_PERSON, 2, (cast.tags > 0) & (cast.tags < N_CLASSES))
    shown = np.flatnonzero(whose == 0) if rng.random() < EMPTY else np.arange(len(whose))
    faces, whose, dark = cast.faces[shown], whose[shown], cast.dark[np.append(shown, -1)]
    for _, tableau in zip(range(FRAMES_OF_STAY), stay.tableaux(), strict=False):
        camera, sensor, reflectance = _rig_camera(rig, rng)
        points = cast.camera_from_world.apply(tableau.vertices_m).astype(np.float32)
        yield _seen(camera, sensor, Mesh(points, faces, whose), dark, reflectance, rng)


def _rig_camera(rig: Difficulty, rng: np.random.Generator) -> tuple[Intrinsics, Sensor, float]:
    """Camera, sensor and the room's reflectance of a frame: the rig's own, or any."""
    if rng.random() < RIG_SENSOR:
        return KINECT2_PINHOLE, rig.depth, rig.reflectance if rng.random() < MULTIPATH else 0.0
    sensor = draw_sensor(rng)
    return sensor.camera, sensor, 0.0


def _seen(
    camera: Intrinsics,
    sensor: Sensor,
    scene: Mesh,
    dark: Float32,
    reflectance: float,
    rng: np.random.Generator,
) -> Scene:
    """Reading of a mesh in the camera's frame, its tags the people; dark: (F + 1,), the last for nothing."""
    seen = rasterize(camera, scene.vertices_m, scene.faces)
    depth_m = seen.depth_m
    if reflectance:
        depth_m = depth_m + multipath_m(camera, depth_m, reflectance)
    reading = sensor.read(CleanDepth(camera, depth_m, dark[seen.face]), rng)
    whose = np.append(scene.tags, 0)[seen.face].astype(np.uint8)
    return Scene(camera, reading.depth_mm, reading.carry(whose))


def room_scenes(seed: int) -> Iterator[Scene]:
    """Some rooms put together at random, with the same few people."""
    rng, bodies = np.random.default_rng((seed, 62)), crowd()
    people = []
    for _ in range(ACQUAINTED):
        one, other = rng.choice(len(bodies), 2, replace=False)
        people.append(dress(blend(bodies[one], bodies[other], float(rng.beta(0.6, 0.6) / 2)), rng))
    for _ in range(ROOMS_OF_PEOPLE):
        yield _room(rng, people[: int(rng.choice(len(PEOPLE), p=PEOPLE))])


def _room(rng: np.random.Generator, people: list[Dressed]) -> Scene:
    """One room with all these people in it."""
    meshes, dark = [], []
    for number, person in enumerate(people):
        at = _place(rng) if number else np.zeros(3)
        turn = Rotation.from_euler("z", rng.uniform(-np.pi, np.pi)).as_matrix()
        vertices, carriers = _posed(rng, person)
        own = Mesh(vertices, person.faces, np.full(len(person.faces), FIRST_PERSON + number, np.int32))
        meshes += [mesh.placed(turn, at) for mesh in (own, *carriers)]
        dark += [person.dark, *(np.zeros(len(mesh.faces), np.float32) for mesh in carriers)]
    middle = np.array([0.0, 0.0, rng.uniform(0.4, 1.4)])
    if meshes:
        middle = meshes[0].vertices_m.mean(axis=0).astype(np.float64)
    distance, height = np.exp(rng.uniform(*np.log(DISTANCE_M))), rng.uniform(*HEIGHT_M)
    eye = beside(middle, rng.uniform(-np.pi, np.pi), distance, height)
    whole = merge(meshes + surroundings(rng, eye, middle, may_be_none=bool(meshes)))
    target = middle + rng.normal(0, (0.3, 0.3, 0.25))
    pose = look_at(eye, target, np.radians(rng.normal(0, 3)))
    points = pose.apply(whole.vertices_m).astype(np.float32)
    darkness = np.concatenate([np.zeros(0, np.float32), *dark])
    darkness = np.pad(darkness, (0, len(whole.faces) + 1 - len(darkness)))
    sensor, whose = draw_sensor(rng), np.maximum(whole.tags - FIRST_PERSON + 1, 0)
    return _seen(sensor.camera, sensor, Mesh(points, whole.faces, whose), darkness, 0.0, rng)


def _place(rng: np.random.Generator) -> Float64:
    """Where another person is, the first one being at the origin."""
    span = BESIDE_M if rng.random() < BESIDE else APART_M
    return beside(np.zeros(3), rng.uniform(-np.pi, np.pi), rng.uniform(*span), 0.0)


def _posed(rng: np.random.Generator, person: Dressed) -> tuple[Float32, list[Mesh]]:
    """Vertices (V, 3) of a person in some posture about the origin, and what carries or is carried."""
    body, kind = person.body, rng.random()
    things: list[Mesh] = []
    if kind < STANDING:
        vertices, joints, things = stand(body, draw_standing(rng))
        things = [replace(mesh, tags=np.full(len(mesh.faces), Surface.TABLE, np.int32)) for mesh in things]
    elif kind < RISING:
        chair = Chair.sample(rng) if rng.random() < 0.5 else None
        vertices, joints = rise(body, chair, UPRIGHT.single(rng)[1])
        things = [chair.mesh()] if chair else []
    elif kind < SITTING_DOWN:
        seat = Sofa.sample(rng) if rng.random() < 0.5 else Chair.sample(rng)
        vertices, joints = sit(body, seat, SITTING.single(rng)[1])
        things = [seat.mesh()]
    elif rng.random() < 0.5:
        vertices, joints = lie(body, Ground(), FALLEN.single(rng)[1])
    else:
        bed = Bed.sample(rng)
        vertices, joints = lie(body, bed, IN_BED.single(rng)[1])
        things = [bed.mesh()]
    return person.drape(vertices, joints), things
