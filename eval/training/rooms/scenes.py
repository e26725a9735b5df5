"""Scenes for training the person finder: depth images with zero to several people, and each pixel's person.

Some are recordings of the virtual rig with temperatures. The others are random rooms, some empty, with up to
seven dressed people, as seen by any depth sensor. Constants are untuned.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from annotate.array_types import Float32, UInt8, UInt16
from annotate.cloud.coarse import CoarseCloud
from annotate.cloud.fuse import Fuser
from annotate.person.extract import PersonDetection
from annotate.person.subject import persons_before
from eval.training.rooms.floor_plan import FloorPlan
from eval.training.rooms.gathering import aim, gather, middle
from eval.training.rooms.panes import wandering
from eval.training.rooms.people import FIRST_PERSON, Figures
from eval.training.rooms.rooms import Room, draw_surroundings
from eval.training.rooms.things import BLACK
from eval.training.segmentation.scenes import training_rig
from sensors.rig.camera import Intrinsics
from sensors.rig.rig_calibration import Pose
from synth.body.body import blend
from synth.body.crowd import crowd_of
from synth.cameras.random_sensor import draw_sensor
from synth.cameras.sensor import CleanDepth, Sensor
from synth.clothes.dress import dress
from synth.clothes.dressed import Dressed
from synth.data_files import TRAINING, Cast
from synth.rig.truth import truth_labels
from synth.surface.rasterize import Mesh, ZBuffer, merge, rasterize

ROOMS_OF_PEOPLE, ACQUAINTED = 10, 8  # rooms with the same people, and their number
PEOPLE = (0.22, 0.24, 0.18, 0.12, 0.09, 0.06, 0.05, 0.04)  # shares of rooms with none to seven people
EYE_M, EYE_HEIGHT_M = 0.25, (0.3, 2.8)  # free about the camera; its height
CLOSE_M, SILHOUETTE_PX = 0.1, 128  # least distance, and side of the image, to count a person's pixels
DARK_SCREEN = 0.8  # absorbed share of infrared


class Scene(NamedTuple):
    """Depth image uint16 (h, w) in millimetres, its warmth and its people.

    warmth: float32 (h, w), NaN = unmeasured. persons: uint8 (h, w), 0 = no person, else a person's number.
    sensor: kind of the depth camera in ``synth/data/sensors.toml``, or "rig". whole_px: pixels of each person
    from number 1 on in an endless image without other people and things; empty for the rig.
    things: uint8 (h, w), 0 = no thing, else the number of a piece of furniture or another thing, from 1 on;
    None for the rig.
    """

    camera: Intrinsics
    depth_mm: UInt16
    warmth: Float32
    persons: UInt8
    sensor: str
    whole_px: tuple[float, ...] = ()
    things: UInt8 | None = None


def rig_scenes(number: int) -> Iterator[Scene]:
    """Yield the frames of training recording ``number`` of the suit network."""
    rig = training_rig(number)
    fuser = Fuser(rig.calibration)
    for frame, known in rig.with_truth():
        survey = PersonDetection(CoarseCloud.of(fuser.fuse_frame(frame)))
        truth = survey.cloud.coarse(truth_labels(frame, known, rig.calibration.depth))
        yield Scene(survey.cloud.cloud.camera, truth.depth_mm, survey.warmth, persons_before(truth), "rig")


def room_scenes(seed: int, cast: Cast = TRAINING) -> Iterator[Scene]:
    """Yield random rooms; the same few people of a cast recur in them."""
    rng = np.random.default_rng((seed, 62))
    people = acquaintances(rng, ACQUAINTED, cast)
    for _ in range(ROOMS_OF_PEOPLE):
        count = int(rng.choice(len(PEOPLE), p=PEOPLE))
        chosen = [people[i] for i in rng.permutation(ACQUAINTED)[:count]]
        yield room(rng, draw_sensor(rng), chosen, cast)


def acquaintances(rng: np.random.Generator, count: int, cast: Cast) -> list[Dressed]:
    """Draw dressed people with bodies blended from two bodies of a cast."""
    bodies, people = crowd_of(cast), []
    for _ in range(count):
        one, other = rng.choice(len(bodies), 2, replace=False)
        people.append(dress(blend(bodies[one], bodies[other], float(rng.beta(0.6, 0.6) / 2)), rng, cast))
    return people


def room(rng: np.random.Generator, sensor: Sensor, people: list[Dressed], cast: Cast) -> Scene:
    """Return the scene of a random room with ``people`` in it, as far as they have a place."""
    plan = FloorPlan()
    plan.take_circle(np.zeros(2), EYE_M)
    half_view = float(np.arctan(sensor.camera.width / 2 / sensor.camera.fx))
    placed = gather(rng, people, plan, half_view, cast)
    eye = np.array([0.0, 0.0, rng.uniform(*EYE_HEIGHT_M)])
    meshes = [mesh for figures in placed for mesh in figures.people]
    middles = [middle(mesh) for mesh in meshes] or [np.array([0.0, 3.0, 1.0])]
    around = draw_surroundings(rng, np.stack([eye, *middles]), plan, cast, may_be_none=bool(meshes))
    return rendered_scene(rng, sensor, aim(rng, eye, middles), placed, around)


def rendered_scene(
    rng: np.random.Generator, sensor: Sensor, camera_from_world: Pose, placed: Sequence[Figures], room: Room
) -> Scene:
    """Return the scene of people, their furniture and a room as a sensor reads it."""
    meshes = [mesh for figures in placed for mesh in figures.people]
    own = [mesh for figures in placed for mesh in figures.things]
    whole = merge([*meshes, *own, *room.shell, *room.things])
    image = _rendered(sensor.camera, camera_from_world, whole)
    depth, face = image.depth_m, image.face
    tags = np.append(np.maximum(whole.tags - FIRST_PERSON + 1, 0), 0)[face].astype(np.uint8)
    numbers = _thing_numbers([meshes, own, room.shell, room.things])[face]
    if room.panes:
        panes = _rendered(sensor.camera, camera_from_world, merge(room.panes))
        depth, shown = wandering(depth, panes.depth_m, rng)
        tags[~shown] = numbers[~shown] = 0
    dark = _darkness(whole, placed)[face]
    reading = sensor.read(CleanDepth(sensor.camera, depth, dark), rng)
    unfelt = np.full(reading.depth_mm.shape, np.nan, np.float32)
    whole_px = tuple(_silhouette_px(sensor.camera, camera_from_world, mesh) for mesh in meshes)
    persons, things = (reading.carry(image) for image in (tags, numbers))
    return Scene(sensor.camera, reading.depth_mm, unfelt, persons, sensor.kind, whole_px, things)


def _thing_numbers(groups: list[list[Mesh]]) -> UInt8:
    """Return the number of the thing of each face and of no face (F + 1,); 0 for people and a room's shell.

    groups: meshes of people, of things at people, of the shell, of other things.
    """
    is_thing = np.concatenate([np.full(len(group), i % 2, np.bool_) for i, group in enumerate(groups)])
    numbers = np.where(is_thing, np.cumsum(is_thing).clip(max=255), 0)
    faces = [len(mesh.faces) for group in groups for mesh in group]
    return np.append(np.repeat(numbers, faces), 0).astype(np.uint8)


def _darkness(whole: Mesh, placed: Sequence[Figures]) -> Float32:
    """Return the absorbed share of infrared (F + 1,) of people's faces, other faces and no face."""
    dark = np.where(whole.tags == BLACK, np.float32(DARK_SCREEN), np.float32(0))
    own = [dark for figures in placed for dark in figures.dark]
    dark[: sum(map(len, own))] = np.concatenate([*own, dark[:0]])
    return np.append(dark, np.float32(0))


def _rendered(camera: Intrinsics, camera_from_world: Pose, mesh: Mesh) -> ZBuffer:
    points = camera_from_world.apply(mesh.vertices_m).astype(np.float32)
    return rasterize(camera, points, mesh.faces)


def _silhouette_px(camera: Intrinsics, camera_from_world: Pose, mesh: Mesh) -> float:
    """Return the pixels of a mesh in front of the camera in an endless image."""
    points = camera_from_world.apply(mesh.vertices_m).astype(np.float32)
    ahead = points[points[:, 2] > CLOSE_M]
    if not len(ahead):
        return 0.0
    slopes = ahead[:, :2] / ahead[:, 2:]
    low, extent = slopes.min(axis=0), float(np.ptp(slopes, axis=0).max())
    focal = SILHOUETTE_PX / max(extent, 1e-3)
    cx, cy = (-focal * low).tolist()
    small = Intrinsics(SILHOUETTE_PX, SILHOUETTE_PX, focal, focal, cx, cy)
    count = np.isfinite(rasterize(small, points, mesh.faces).depth_m).sum()
    return float(count) * (camera.fx / focal) ** 2
