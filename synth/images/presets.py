"""Presets of datasets, and one image of a preset: a pure function of (preset, seed, index)."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import numba
import numpy as np

from annotate.array_types import Bool, Float64, Index, Int32, UInt8, UInt16
from annotate.crop import Crop, crop_around, window_of
from annotate.frame_labels import FrameLabels
from annotate.parts import PAPER
from annotate.scheme.scheme import Scheme
from sensors.errors import CloudError
from sensors.rig.camera import Intrinsics
from synth.body.crowd import crowd_of, suit_wearers
from synth.cameras.random_sensor import draw_sensor
from synth.cameras.sensor import CleanDepth, Reading, Sensor
from synth.cameras.time_of_flight import TimeOfFlight
from synth.clothes.dressed import Dressed
from synth.data_files import CASTS, JUDGE, TRAINING, Cast, check_choice
from synth.images.people import Person, PersonSampler, Wardrobe, blended, crowd_person, paper_person
from synth.images.posed_scenes import (
    CastSceneSampler,
    MotionScenes,
    PosedScene,
    SceneSampler,
    everybody,
    recumbent,
    sitting,
    standing,
    upright,
)
from synth.images.standing_statistics import facing_deg
from synth.images.view import PersonView, cut, occluder, render_view, visibility
from synth.images.viewpoints import Shot, inside_image
from synth.motion.library import Repertoire
from synth.pose.pose_parameters import posture_class
from synth.surface.rasterize import merge

MIN_PIXELS, MIN_VISIBLE = 400, 0.4  # of a person, and their share that furniture leaves, in an image
TRIES = 50  # scenes drawn at most until one shows the person


@dataclass(frozen=True)
class Preset:
    """Kind of dataset, by name.

    count: images by default. stream: number of the random stream, unique. joints: least share of joints
    inside the image. each, views: number of successive images of one person, and of one pose, because drawing
    a person is slow. occluders, cut: share of images with things in front of the person, and with holes in
    the person's mask. described: True if notes describe person and sensor. cast: of people, clothes and
    furniture. scheme: of the parts; depth does not depend on it.
    """

    name: str
    count: int
    stream: int
    scene: SceneSampler
    people: PersonSampler = crowd_person
    sensor: Callable[[np.random.Generator], Sensor] = draw_sensor
    joints: float = 0.1
    each: int = 24
    views: int = 2
    occluders: float = 0.0
    cut: float = 0.0
    described: bool = True
    cast: Cast = TRAINING
    scheme: Scheme = PAPER

    def __post_init__(self) -> None:
        for name, share in (("occluders", self.occluders), ("cut", self.cut)):
            if not 0 <= share <= 1:
                raise CloudError(f"{name} {share} is not a share of the images; give 0 to 1")


def sample(preset: Preset, seed: int, index: int) -> FrameLabels:
    """Return image ``index`` of a preset: the person's crop, 212 x 212, depth in millimetres, and parts.

    The frame has the following notes. activity: the nearer of two; posture: None if the two differ in it.
    crop: (top, left, side) in the image. joints_mm: camera frame. camera: azimuth_deg from the front of sofa,
    bed or pelvis, height_m, distance_m. visible: share left by furniture, occluders and holes in the mask, of
    the person, then of each part by id. occluders: number. cut: share of pixels that the holes took. Notes of
    ``_description`` are added.
    """
    rng = np.random.default_rng((preset.stream, seed, index))
    person = _person(preset.people, preset.stream, seed, index // preset.each)
    sensor = preset.sensor(rng)
    for attempt in range(TRIES):
        if preset.views > 1:
            scene = _shared_scene(preset, seed, index - index % preset.views, attempt)
        else:
            scene = preset.scene(rng, person.dressed.body)
        shown = person if scene.bags else person.without_bag
        shot = scene.view(rng, scene.vertices_m, scene.joints_m, sensor.camera)
        share = preset.occluders
        things, view = _rendered(scene, shown.dressed, Camera(shot, sensor.camera), share, rng)
        joints = shot.camera_from_world.apply(scene.joints_m)
        inside = float(inside_image(joints, sensor.camera).mean())
        if not _shows(view) or inside < preset.joints:
            continue
        mask = view.regions > 0
        if rng.random() < preset.cut and np.count_nonzero(holed := cut(mask, rng)) >= MIN_PIXELS:
            mask = holed
        crop = crop_around(mask)
        depth, labels = _read(view, mask, crop, sensor, rng)
        if labels.any():
            break
    else:
        c = sensor.camera
        raise CloudError(
            f"image {index} of preset {preset.name} shows no person in {TRIES} views by a camera of "
            f"{c.width}x{c.height}, fx {c.fx:.0f}; give a camera with more pixels or a wider view"
        )
    scheme = preset.scheme
    shown_parts = scheme.table[np.where(mask, view.regions, np.uint8(0))]
    notes = {
        "activity": scene.activities[0],
        "posture": posture_class(*scene.activities),
        "crop": [crop.top + view.corner[0], crop.left + view.corner[1], crop.side],
        **_geometry(scene, shot, joints),
        "visible": _rounded(visibility(shown_parts, scheme.table[view.whole], scheme.n_classes)),
        "occluders": things,
        "cut": round(1 - np.count_nonzero(mask) / np.count_nonzero(view.regions), 3),
    }
    if preset.described:
        notes |= _description(scene, joints, view, sensor, inside) | shown.notes
    return FrameLabels(
        f"{index:08d}",
        depth,
        scheme.table[labels],
        subject=person.subject,
        status="truth",
        notes=notes,
        scheme=scheme,
    )


def _rounded(values: Float64) -> list[float]:
    return [round(value, 3) for value in values.tolist()]


@lru_cache(maxsize=2)
def _person(people: PersonSampler, stream: int, seed: int, number: int) -> Person:
    return people(np.random.default_rng((stream, seed, number, 1)))


@lru_cache(maxsize=4)
def _shared_scene(preset: Preset, seed: int, first: int, attempt: int) -> PosedScene:
    """Return the scene that ``preset.views`` images share, from index ``first`` on. attempt: number of the
    retry.
    """
    person = _person(preset.people, preset.stream, seed, first // preset.each)
    return preset.scene(np.random.default_rng((preset.stream, seed, first, 2, attempt)), person.dressed.body)


class Camera(NamedTuple):
    """Camera of an image: its pose, and the pinhole of the whole image."""

    shot: Shot
    pinhole: Intrinsics


def _rendered(
    scene: PosedScene, dressed: Dressed, camera: Camera, share: float, rng: np.random.Generator
) -> tuple[int, PersonView]:
    """Return the number of occluders and the view.

    share: share of images with occluders. Occluders that hide the whole person are left out.
    """
    draped, (shot, pinhole) = dressed.drape(scene.vertices_m, scene.joints_m), camera
    if rng.random() < share:
        seen = rng.choice(scene.vertices_m, int(rng.integers(1, 3))).astype(np.float64)
        things = [occluder(shot.eye_m, point, rng) for point in seen]
        view = render_view(dressed, draped, merge([scene.around, *things]), shot.camera_from_world, pinhole)
        if _shows(view):
            return len(things), view
    return 0, render_view(dressed, draped, scene.around, shot.camera_from_world, pinhole)


def _shows(view: PersonView) -> bool:
    seen = np.count_nonzero(view.regions)
    return bool(seen >= max(MIN_PIXELS, MIN_VISIBLE * np.count_nonzero(view.whole)))


def _read(
    view: PersonView, mask: Bool, crop: Crop, sensor: Sensor, rng: np.random.Generator
) -> tuple[UInt16, UInt8]:
    clean = CleanDepth(view.camera, view.depth_m, view.dark, crop.reads(mask.shape), mask)
    reading = sensor.read(clean, rng)
    return _cropped(*reading, view.regions, *crop.pixels())


@numba.njit(cache=True)
def _cropped(
    depth_mm: UInt16, source: Int32, parts: UInt8, rows: Index, columns: Index
) -> tuple[UInt16, UInt8]:
    """Return depth and parts (n, n) of a reading, resampled at rows and columns (n,). source: as in
    ``Reading``.
    """
    height, width = depth_mm.shape
    depth = np.zeros((len(rows), len(columns)), np.uint16)
    labels = np.zeros((len(rows), len(columns)), np.uint8)
    for i in range(len(rows)):
        for j in range(len(columns)):
            v, u = rows[i], columns[j]
            if 0 <= v < height and 0 <= u < width and depth_mm[v, u] > 0:
                depth[i, j] = depth_mm[v, u]
                s = source[v, u]
                if s >= 0:
                    labels[i, j] = parts[s // width, s % width]
    return depth, labels


def _geometry(scene: PosedScene, shot: Shot, joints_m: Float64) -> dict[str, Any]:
    centre = scene.joints_m.mean(axis=0)
    x, y, _ = (shot.eye_m - centre).tolist()
    return {
        "joints_mm": np.rint(joints_m * 1000).astype(int).tolist(),
        "camera": {
            "azimuth_deg": round(np.degrees(np.arctan2(x, -y)), 1),
            "height_m": round(float(shot.eye_m[2]), 2),
            "distance_m": round(float(np.linalg.norm(shot.eye_m - centre)), 2),
        },
    }


def _description(
    scene: PosedScene, joints_m: Float64, view: PersonView, sensor: Sensor, inside: float
) -> dict[str, Any]:
    """Return the notes of a described preset.

    facing_deg: azimuth of the camera about the pelvis, 0 in front, positive on the person's left. height_px:
    rows that show the person. beyond: share of joints outside the image. intrinsics: width, height, fx, fy,
    cx, cy of the whole image, undistorted.
    """
    rows, _ = window_of(view.regions > 0)
    c = sensor.camera
    return {
        "facing_deg": round(facing_deg(joints_m * 1000, ("hip",)), 1),
        "height_px": rows.stop - rows.start,
        "beyond": round(1 - inside, 3),
        "sensor": {"kind": sensor.kind, "model": sensor.model},
        "intrinsics": [c.width, c.height, *(round(value, 3) for value in (c.fx, c.fy, c.cx, c.cy))],
        **scene.notes,
    }


class FreshKinect2(TimeOfFlight):
    """Kinect v2 of the paper's presets: faults are drawn for each image; each pixel keeps its clean label."""

    def read(self, clean: CleanDepth, rng: np.random.Generator) -> Reading:
        """Return the depth reading of a clean image, as ``Sensor.read``."""
        wanted = replace(clean, only=clean.wanted(0), person=None)
        depth_mm, _ = TimeOfFlight.kinect2(rng).read(wanted, rng)
        return Reading(depth_mm, np.arange(depth_mm.size, dtype=np.int32).reshape(depth_mm.shape))


def fresh_kinect2(rng: np.random.Generator) -> Sensor:
    """Return a Kinect v2 that draws its faults at each reading; ``rng`` is unused."""
    return FreshKinect2()


JUDGE_STREAMS = 100  # added to a preset's stream for the judging cast


def _preset(name: str, count: int, stream: int, scene: CastSceneSampler, cast: Cast) -> Preset:
    """Return a preset of dressed people of a cast."""
    if cast == TRAINING:
        return Preset(name, count, stream, scene)
    judged = partial(scene, cast=cast)
    return Preset(name, count, stream + JUDGE_STREAMS, judged, partial(crowd_person, cast=cast), cast=cast)


def _paper(name: str, count: int, stream: int, scene: CastSceneSampler, cast: Cast) -> Preset:
    """Return a preset of the paper (sections 3.2, 4.1, 4.3): naked bodies, whole in a Kinect v2's image."""
    people: PersonSampler = paper_person if cast == TRAINING else partial(paper_person, cast=cast)
    return replace(
        _preset(name, count, stream, scene, cast),
        people=people,
        sensor=fresh_kinect2,
        joints=0.9,
        each=16,
        views=1,
        described=False,
    )


def _presets_of(cast: Cast) -> dict[str, Preset]:
    presets = (
        _paper("sitting-train", 10_076, 1, sitting, cast),
        _paper("sitting-test", 4_984, 2, sitting, cast),
        _paper("recumbent", 326_984, 3, recumbent, cast),
        _paper("upright", 20_000, 4, upright, cast),
        _preset("standing", 20_000, 5, standing, cast),
        _preset("people", 200_000, 6, everybody, cast),
    )
    return {preset.name: preset for preset in presets}


PRESETS, JUDGE_PRESETS = _presets_of(TRAINING), _presets_of(JUDGE)


MOTION, MOTION_STREAM = "motion", 7


def preset_of(repertoire: Repertoire) -> Preset:
    """Return a preset of people in poses of recorded motions; other settings are the defaults."""
    return Preset(MOTION, 20_000, MOTION_STREAM, MotionScenes(repertoire))


def preset_named(name: str, cast: Cast = TRAINING) -> Preset:
    """Return the preset of that name with a cast. Raises CloudError for an unknown name."""
    check_choice("preset", name, PRESETS)
    check_choice("cast", cast, CASTS)
    return (PRESETS if cast == TRAINING else JUDGE_PRESETS)[name]


def blended_bodies(name: str, cast: Cast, seed: int, index: int) -> tuple[str, str] | None:
    """Return the names of the two bodies in an image of a preset, or of motions; None for another name."""
    if name in PRESETS:
        preset = preset_named(name, cast)
    elif name == MOTION:
        preset = Preset(MOTION, 20_000, MOTION_STREAM, everybody)
    else:
        return None
    naked = name in PRESETS and PRESETS[name].people is paper_person
    rng = np.random.default_rng((preset.stream, seed, index // preset.each, 1))
    return blended(suit_wearers(cast) if naked else crowd_of(cast), rng)


def dressed_from(preset: Preset, garments: Path) -> Preset:
    """Return a preset whose people wear garments of a folder. Raises CloudError for a naked preset."""
    if preset.people is not crowd_person:
        dressed = ", ".join(name for name, other in PRESETS.items() if other.people is crowd_person)
        raise CloudError(f"people of preset {preset.name} are naked; give garments to {dressed}")
    return replace(preset, people=Wardrobe.of(garments))
