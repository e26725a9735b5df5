"""Scenes for training the person finder: depth images with zero to several people, and each pixel's person.

Some are recordings of the virtual rig with temperatures. The others are random rooms, some empty, with
dressed people who stand, sit and lie, as seen by any depth sensor. Constants are untuned.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from annotate.array_types import Float32, Float64, UInt8, UInt16
from annotate.cloud.coarse import CoarseCloud
from annotate.cloud.fuse import Fuser
from annotate.person.extract import PersonDetection
from annotate.person.subject import persons_before
from eval.training.finder.rooms import surroundings
from eval.training.segmentation.scenes import training_rig
from sensors.rig.camera import Intrinsics
from synth.body.body import blend
from synth.body.crowd import crowd
from synth.cameras.random_sensor import draw_sensor
from synth.cameras.sensor import CleanDepth
from synth.clothes.dress import dress
from synth.clothes.dressed import Dressed
from synth.pose.postures import FALLEN, IN_BED, SITTING, UPRIGHT, lie, rise, sit
from synth.pose.standing import stand
from synth.pose.standing_parameters import draw_standing
from synth.rig.truth import truth_labels
from synth.surface.furniture import Bed, Chair, Ground, Sofa, Surface
from synth.surface.rasterize import Mesh, beside, look_at, merge, rasterize

ROOMS_OF_PEOPLE, ACQUAINTED = 8, 3  # rooms with the same people, and their number
PEOPLE = (0.3, 0.35, 0.23, 0.12)  # shares of rooms with none, one, two and three people
STANDING, RISING, SITTING_DOWN = 0.45, 0.57, 0.75  # cumulative shares of people; the rest lie
BESIDE, BESIDE_M, APART_M = 0.5, (0.35, 0.7), (0.7, 2.5)  # share beside the first; distances beside, apart
DISTANCE_M, HEIGHT_M = (0.9, 4.2), (0.4, 2.4)  # of the camera from the first person, over the floor
FIRST_PERSON = 1000  # tag of the first person's faces, one more for each next; tags of the room are lower


class Scene(NamedTuple):
    """Depth image uint16 (h, w) in millimetres, its warmth and its people.

    warmth: float32 (h, w), NaN = unmeasured. persons: uint8 (h, w), 0 = no person, else a person's number.
    """

    camera: Intrinsics
    depth_mm: UInt16
    warmth: Float32
    persons: UInt8


def rig_scenes(number: int) -> Iterator[Scene]:
    """Yield the frames of training recording ``number`` of the suit network."""
    rig = training_rig(number)
    fuser = Fuser(rig.calibration)
    for frame, known in rig.with_truth():
        survey = PersonDetection(CoarseCloud.of(fuser.fuse_frame(frame)))
        truth = survey.cloud.coarse(truth_labels(frame, known, rig.calibration.depth))
        yield Scene(survey.cloud.cloud.camera, truth.depth_mm, survey.warmth, persons_before(truth))


def room_scenes(seed: int) -> Iterator[Scene]:
    """Yield random rooms; the same few people recur in them."""
    rng, bodies = np.random.default_rng((seed, 62)), crowd()
    people = []
    for _ in range(ACQUAINTED):
        one, other = rng.choice(len(bodies), 2, replace=False)
        people.append(dress(blend(bodies[one], bodies[other], float(rng.beta(0.6, 0.6) / 2)), rng))
    for _ in range(ROOMS_OF_PEOPLE):
        yield _room(rng, people[: int(rng.choice(len(PEOPLE), p=PEOPLE))])


def _room(rng: np.random.Generator, people: list[Dressed]) -> Scene:
    """Return the scene of a random room with all of ``people`` in it."""
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
    sensor, tags = draw_sensor(rng), np.append(np.maximum(whole.tags - FIRST_PERSON + 1, 0), 0)
    image = rasterize(sensor.camera, points, whole.faces)
    reading = sensor.read(CleanDepth(sensor.camera, image.depth_m, darkness[image.face]), rng)
    unfelt = np.full(reading.depth_mm.shape, np.nan, np.float32)
    return Scene(sensor.camera, reading.depth_mm, unfelt, reading.carry(tags[image.face].astype(np.uint8)))


def _place(rng: np.random.Generator) -> Float64:
    """Return a random place (3,), metres, for a further person; the first person is at the origin."""
    span = BESIDE_M if rng.random() < BESIDE else APART_M
    return beside(np.zeros(3), rng.uniform(-np.pi, np.pi), rng.uniform(*span), 0.0)


def _posed(rng: np.random.Generator, person: Dressed) -> tuple[Float32, list[Mesh]]:
    """Return vertices (V, 3) of a person in a random posture at the origin; meshes of furniture and bags."""
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
