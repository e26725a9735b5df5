"""Presets, datasets by name; and one image of a preset: a pure function of (preset, seed, index)."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from annotate.array_types import Bool, Float32, Float64, UInt8
from annotate.crop import SIZE, Crop, crop_around
from annotate.frame_labels import FrameLabels
from sensors.errors import CloudError
from sensors.rig.rig_calibration import Pose
from synth.body.body import Body, blend, hair_faces, shipped_bodies
from synth.cameras.time_of_flight import TimeOfFlight
from synth.images.view import PersonView, cut, inside_image, occluder, render_view, visibility
from synth.pose.moment import Posed
from synth.pose.postures import FALLEN, IN_BED, SITTING, UPRIGHT, lie, rise, sit
from synth.surface.furniture import Bed, Chair, Ground, Sofa
from synth.surface.rasterize import Mesh, beside, look_at, merge

MIN_PIXELS, MIN_VISIBLE, MIN_JOINTS = 400, 0.4, 0.9
"""Of a person's pixels, their share that furniture leaves, and joints inside the image: with less it is no
example. What hides it is left out, or another one is drawn."""
TRIES = 50
"""Stages drawn at most until one shows the person. Chosen by eye."""
IMAGES_PER_PERSON = 16
"""Images in a row that show one build, whose cost they share. Chosen by eye."""
FALLEN_SHARE = 0.2
"""Of the recumbent, those on the floor. No source: chosen by eye."""
Viewpoint = Callable[[np.random.Generator, Float64], tuple[Float64, Float64]]
"""Draws a camera's eye and target (3,) each about a person's middle (3,), world, metres."""


@dataclass(frozen=True)
class Stage:
    """A posed person among furniture before a camera, world frame, metres.

    vertices_m: float32 (V, 3). joints_m: (J, 3). around: closed meshes. eye_m: (3,) the camera's place.
    """

    activity: str
    vertices_m: Float32
    joints_m: Float64
    around: Mesh
    eye_m: Float64
    camera_from_world: Pose


@dataclass(frozen=True)
class Preset:
    """A dataset by name: how many images by default, which random stream it draws from, and what it shows.

    occluders, cut: share of images with things in front of the person, and with holes in its extraction.
    """

    name: str
    count: int
    stream: int
    stage: Callable[[np.random.Generator, Body], Stage]
    occluders: float = 0.0
    cut: float = 0.0

    def __post_init__(self) -> None:
        for what, share in (("occluders", self.occluders), ("cut", self.cut)):
            if not 0 <= share <= 1:
                raise CloudError(f"{what} {share} is not a share of the images; give 0 to 1")


def sample(preset: Preset, seed: int, index: int) -> FrameLabels:
    """Image ``index`` of a preset: the person's crop, 212 x 212, depth in millimetres, parts, provenance.

    Notes: activity; crop (top, left, side) in the 512 x 424 image; joints_mm, camera frame; camera
    (azimuth_deg from the sofa's front or the bed's foot, height_m, distance_m); visible, the share of
    the person that furniture, occluders and extraction left, whole and per part; occluders, how many
    things stand in front; cut, the share of the person's pixels that the extraction lost.
    """
    rng = np.random.default_rng((preset.stream, seed, index))
    body, hair, subject = _person(preset.stream, seed, index // IMAGES_PER_PERSON)
    for _ in range(TRIES):
        stage = preset.stage(rng, body)
        things, view = _rendered(preset, stage, body, hair, rng)
        if _shows(view) and inside_image(stage.camera_from_world.apply(stage.joints_m)).mean() >= MIN_JOINTS:
            break
    else:
        raise AssertionError(f"sample {preset.name}/{seed}/{index} shows no person")
    person = view.parts > 0
    if rng.random() < preset.cut and np.count_nonzero(holed := cut(person, rng)) >= MIN_PIXELS:
        person = holed
    crop = crop_around(person)
    depth, labels = _shoot(view, person, crop, rng)
    notes = {
        "activity": stage.activity,
        "crop": [crop.top + view.corner[0], crop.left + view.corner[1], crop.side],
        **_geometry(stage),
        "visible": [
            round(v, 3) for v in visibility(np.where(person, view.parts, np.uint8(0)), view.whole).tolist()
        ],
        "occluders": things,
        "cut": round(1 - np.count_nonzero(person) / np.count_nonzero(view.parts), 3),
    }
    return FrameLabels(f"{index:08d}", depth, labels, subject=subject, status="truth", notes=notes)


def _rendered(
    preset: Preset, stage: Stage, body: Body, hair: Bool, rng: np.random.Generator
) -> tuple[int, PersonView]:
    """Number of occluders, and the view: in a share of the images some stand there, unless they hide all."""
    if rng.random() < preset.occluders:
        seen = rng.choice(stage.vertices_m, int(rng.integers(1, 3))).astype(np.float64)
        things = [occluder(stage.eye_m, point, rng) for point in seen]
        view = render_view(
            body, hair, stage.vertices_m, merge([stage.around, *things]), stage.camera_from_world
        )
        if _shows(view):
            return len(things), view
    return 0, render_view(body, hair, stage.vertices_m, stage.around, stage.camera_from_world)


def _shows(view: PersonView) -> bool:
    seen = np.count_nonzero(view.parts)
    return bool(seen >= max(MIN_PIXELS, MIN_VISIBLE * np.count_nonzero(view.whole)))


def _shoot(
    view: PersonView, person: Bool, crop: Crop, rng: np.random.Generator
) -> tuple[NDArray[np.uint16], UInt8]:
    """The crop's depth and parts through a noisy sensor; only the pixels that the crop reads are computed."""
    read = person & crop.reads(person.shape)
    noisy, _ = TimeOfFlight.kinect2(rng).read(view.camera, view.depth_m, view.dark, rng, only=read)
    depth = crop.cut(noisy, 0, SIZE)
    return depth, np.where(depth > 0, crop.cut(view.parts, 0, SIZE), np.uint8(0))


def _geometry(stage: Stage) -> dict[str, Any]:
    centre = stage.joints_m.mean(axis=0)
    x, y, _ = (stage.eye_m - centre).tolist()
    return {
        "joints_mm": np.rint(stage.camera_from_world.apply(stage.joints_m) * 1000).astype(int).tolist(),
        "camera": {
            "azimuth_deg": round(np.degrees(np.arctan2(x, -y)), 1),
            "height_m": round(float(stage.eye_m[2]), 2),
            "distance_m": round(float(np.linalg.norm(stage.eye_m - centre)), 2),
        },
    }


@lru_cache(maxsize=2)
def _person(stream: int, seed: int, number: int) -> tuple[Body, Bool, str]:
    """A build between two of the paper's bodies (one topology, so shapes blend), its hair, its name."""
    rng = np.random.default_rng((stream, seed, number, 1))
    bodies = shipped_bodies()
    i, j = rng.choice(len(bodies), 2, replace=False)
    share = float(rng.beta(0.6, 0.6)) / 2
    return blend(bodies[i], bodies[j], share), _hair(i), bodies[i].name


@cache
def _hair(i: int) -> Bool:
    return hair_faces(shipped_bodies()[i])


def sitting(rng: np.random.Generator, body: Body) -> Stage:
    """On a sofa, seen as by the robot."""
    sofa = Sofa.sample(rng)
    activity, moment = SITTING.single(rng)
    return _stage(activity, sit(body, sofa, moment), sofa.mesh(), _before, rng)


def recumbent(rng: np.random.Generator, body: Body) -> Stage:
    """In bed or fallen on the floor, seen from all around, several heights."""
    is_fallen = rng.random() < FALLEN_SHARE
    activity, moment = (FALLEN if is_fallen else IN_BED).single(rng)
    support = Ground() if is_fallen else Bed.sample(rng)
    return _stage(activity, lie(body, support, moment), support.mesh(), view_around, rng)


def upright(rng: np.random.Generator, body: Body) -> Stage:
    """Standing, crouching, kneeling, getting up, in front of a seat or in the open, seen from all around."""
    kind = (None, Sofa, Chair)[int(rng.integers(3))]
    seat = None if kind is None else kind.sample(rng)
    activity, moment = UPRIGHT.single(rng)
    return _stage(activity, rise(body, seat, moment), (seat or Ground()).mesh(), _beside, rng)


def _stage(activity: str, posed: Posed, around: Mesh, view: Viewpoint, rng: np.random.Generator) -> Stage:
    vertices, joints = posed
    eye, target = view(rng, joints.mean(axis=0))
    return Stage(activity, vertices, joints, around, eye, look_at(eye, target, np.radians(rng.normal(0, 2))))


def _before(rng: np.random.Generator, centre_m: Float64) -> tuple[Float64, Float64]:
    """Eye and target of a camera within 65 degrees of the front, at a robot's chest to head height."""
    azimuth, distance, height = np.radians(rng.uniform(-65, 65)), rng.uniform(1.3, 3.0), rng.uniform(0.6, 1.7)
    return beside(centre_m, azimuth, distance, height), centre_m + rng.normal(0, (0.12, 0.12, 0.10))


def _beside(rng: np.random.Generator, centre_m: Float64) -> tuple[Float64, Float64]:
    """Eye and target of a camera anywhere around somebody upright."""
    azimuth, distance, height = rng.uniform(-np.pi, np.pi), rng.uniform(1.4, 3.5), rng.uniform(0.6, 1.8)
    return beside(centre_m, azimuth, distance, height), centre_m + rng.normal(0, (0.12, 0.12, 0.10))


def view_around(rng: np.random.Generator, centre_m: Float64) -> tuple[Float64, Float64]:
    """Eye and target of a camera anywhere around a lying person (the paper's 360 degrees).

    Heights from a robot's bumper camera (0.4 m over the person) to a ceiling's (2.6 m over the floor).
    """
    azimuth = rng.uniform(-np.pi, np.pi)
    level = rng.choice((0.7, 1.1, 1.5, 2.1)) + rng.uniform(-0.2, 0.2)
    distance = rng.uniform(1.2, 2.6)
    eye = beside(centre_m, azimuth, distance, max(centre_m[2] + 0.3, level))
    return eye, centre_m + rng.normal(0, (0.12, 0.12, 0.05))


PRESETS = {
    preset.name: preset
    for preset in (
        Preset("sitting-train", 10_076, 1, sitting),
        Preset("sitting-test", 4_984, 2, sitting),
        Preset("recumbent", 326_984, 3, recumbent),
        Preset("upright", 20_000, 4, upright),
    )
}
"""The paper's sets (sections 3.2, 4.1 and 4.3), and people on their own legs; their streams never meet."""


def preset_named(name: str) -> Preset:
    """The preset of that name. Raises CloudError naming those there are."""
    if name not in PRESETS:
        raise CloudError(f"preset {name!r} is unknown; use one of {', '.join(PRESETS)}")
    return PRESETS[name]
