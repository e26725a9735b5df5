"""Presets, datasets by name; and one image of a preset: a pure function of (preset, seed, index)."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numba
import numpy as np

from annotate.array_types import Bool, Float64, Index, Int32, UInt8, UInt16
from annotate.crop import Crop, crop_around, window_of
from annotate.frame_labels import FrameLabels
from sensors.errors import CloudError
from sensors.rig.camera import Intrinsics
from synth.cameras.random_sensor import draw_sensor
from synth.cameras.sensor import CleanDepth, Reading, Sensor
from synth.cameras.time_of_flight import TimeOfFlight
from synth.choices import check_choice
from synth.images.motion_scenes import Moved
from synth.images.people import Casting, Person, Wardrobe, crowd_person, paper_person
from synth.images.posed_scenes import Stage, Staging, everybody, recumbent, sitting, standing, upright
from synth.images.standing_statistics import facing_deg
from synth.images.view import PersonView, cut, occluder, render_view, visibility
from synth.images.viewpoints import Shot, inside_image
from synth.motion.repertoire import Repertoire
from synth.pose.pose_parameters import posture_class
from synth.surface.rasterize import merge

MIN_PIXELS, MIN_VISIBLE = 400, 0.4
"""Of a person's pixels, and their share that furniture leaves: with less it is no example. What hides it is
left out, or another one is drawn."""
TRIES = 50
"""Stages drawn at most until one shows the person. Chosen by eye."""


@dataclass(frozen=True)
class Preset:
    """A dataset by name: how many images by default, which random stream it draws from, and what it shows.

    stage: poses and furniture. people: bodies and clothes. sensor: the camera of an image. joints: least
    share of the joints inside the image. each: images in a row that show one person, whose cost they share;
    views: those of them that show one pose, each from its own place through its own sensor.
    occluders, cut: share of images with things in front of the person, and with holes in its extraction.
    described: whether notes describe person and sensor; the first sets, whose bytes are fixed, are older.
    """

    name: str
    count: int
    stream: int
    stage: Staging
    people: Casting = crowd_person
    sensor: Callable[[np.random.Generator], Sensor] = draw_sensor
    joints: float = 0.1
    each: int = 24
    views: int = 2
    occluders: float = 0.0
    cut: float = 0.0
    described: bool = True

    def __post_init__(self) -> None:
        for what, share in (("occluders", self.occluders), ("cut", self.cut)):
            if not 0 <= share <= 1:
                raise CloudError(f"{what} {share} is not a share of the images; give 0 to 1")


def sample(preset: Preset, seed: int, index: int) -> FrameLabels:
    """Image ``index`` of a preset: the person's crop, 212 x 212, depth in millimetres, parts, provenance.

    Notes: activity, the nearer of two; posture, None on the way between two; crop (top, left, side) in the
    sensor's image; joints_mm, camera frame; camera (azimuth_deg from the sofa's front, the bed's foot or the
    pelvis of who stands, height_m, distance_m); visible, the share of the person that furniture, occluders
    and extraction left, whole and per part; occluders, how many things stand in front; cut, the share of the
    person's pixels that the extraction lost. ``described`` presets add those of ``_description``.
    """
    rng = np.random.default_rng((preset.stream, seed, index))
    person = _person(preset.people, preset.stream, seed, index // preset.each)
    sensor = preset.sensor(rng)
    for attempt in range(TRIES):
        if preset.views > 1:
            stage = _shared_stage(preset, seed, index - index % preset.views, attempt)
        else:
            stage = preset.stage(rng, person.who.body)
        shown = person if stage.bags else person.without_bag
        shot = stage.view(rng, stage.vertices_m, stage.joints_m, sensor.camera)
        things, view = _rendered(preset, stage, shot, shown, sensor.camera, rng)
        joints = shot.camera_from_world.apply(stage.joints_m)
        inside = float(inside_image(joints, sensor.camera).mean())
        if not _shows(view) or inside < preset.joints:
            continue
        mask = view.parts > 0
        if rng.random() < preset.cut and np.count_nonzero(holed := cut(mask, rng)) >= MIN_PIXELS:
            mask = holed
        crop = crop_around(mask)
        depth, labels = _read(view, mask, crop, sensor, rng)
        if labels.any():
            break
    else:
        raise AssertionError(f"sample {preset.name}/{seed}/{index} shows no person")
    notes = {
        "activity": stage.activities[0],
        "posture": posture_class(*stage.activities),
        "crop": [crop.top + view.corner[0], crop.left + view.corner[1], crop.side],
        **_geometry(stage, shot, joints),
        "visible": _rounded(visibility(np.where(mask, view.parts, np.uint8(0)), view.whole)),
        "occluders": things,
        "cut": round(1 - np.count_nonzero(mask) / np.count_nonzero(view.parts), 3),
    }
    if preset.described:
        notes |= _description(stage, joints, view, sensor, inside) | shown.notes
    return FrameLabels(f"{index:08d}", depth, labels, subject=person.subject, status="truth", notes=notes)


def _rounded(values: Float64) -> list[float]:
    return [round(value, 3) for value in values.tolist()]


@lru_cache(maxsize=2)
def _person(people: Casting, stream: int, seed: int, number: int) -> Person:
    return people(np.random.default_rng((stream, seed, number, 1)))


@lru_cache(maxsize=4)
def _shared_stage(preset: Preset, seed: int, first: int, attempt: int) -> Stage:
    """The stage that several images show from ``first`` on, where their first attempts did not show it."""
    person = _person(preset.people, preset.stream, seed, first // preset.each)
    return preset.stage(np.random.default_rng((preset.stream, seed, first, 2, attempt)), person.who.body)


def _rendered(
    preset: Preset, stage: Stage, shot: Shot, person: Person, camera: Intrinsics, rng: np.random.Generator
) -> tuple[int, PersonView]:
    """Number of occluders, and the view: in a share of the images some stand there, unless they hide all."""
    who, draped = person.who, person.who.drape(stage.vertices_m, stage.joints_m)
    if rng.random() < preset.occluders:
        seen = rng.choice(stage.vertices_m, int(rng.integers(1, 3))).astype(np.float64)
        things = [occluder(shot.eye_m, point, rng) for point in seen]
        view = render_view(who, draped, merge([stage.around, *things]), shot.camera_from_world, camera)
        if _shows(view):
            return len(things), view
    return 0, render_view(who, draped, stage.around, shot.camera_from_world, camera)


def _shows(view: PersonView) -> bool:
    seen = np.count_nonzero(view.parts)
    return bool(seen >= max(MIN_PIXELS, MIN_VISIBLE * np.count_nonzero(view.whole)))


def _read(
    view: PersonView, mask: Bool, crop: Crop, sensor: Sensor, rng: np.random.Generator
) -> tuple[UInt16, UInt8]:
    """The crop's depth and parts through a sensor; only the pixels that the crop reads are computed."""
    clean = CleanDepth(view.camera, view.depth_m, view.dark, crop.reads(mask.shape), mask)
    reading = sensor.read(clean, rng)
    return _cropped(*reading, view.parts, *crop.pixels())


@numba.njit(cache=True)
def _cropped(
    depth_mm: UInt16, source: Int32, parts: UInt8, rows: Index, columns: Index
) -> tuple[UInt16, UInt8]:
    """Depth and parts (n, n) of a reading at these rows and columns (n,); parts are those of its sources."""
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


def _geometry(stage: Stage, shot: Shot, joints_m: Float64) -> dict[str, Any]:
    centre = stage.joints_m.mean(axis=0)
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
    stage: Stage, joints_m: Float64, view: PersonView, sensor: Sensor, inside: float
) -> dict[str, Any]:
    """Notes of a described preset.

    facing_deg: azimuth of the camera about the pelvis, 0 before it, positive on the person's left. height_px:
    rows of the image that show the person. beyond: share of the joints outside the image. sensor: its kind
    and model. intrinsics: width, height, fx, fy, cx, cy of the whole image, undistorted.
    """
    rows, _ = window_of(view.parts > 0)
    c = sensor.camera
    return {
        "facing_deg": round(facing_deg(joints_m * 1000, ("hip",)), 1),
        "height_px": rows.stop - rows.start,
        "beyond": round(1 - inside, 3),
        "sensor": {"kind": sensor.kind, "model": sensor.model},
        "intrinsics": [c.width, c.height, *(round(value, 3) for value in (c.fx, c.fy, c.cx, c.cy))],
        **stage.notes,
    }


class FreshKinect2(TimeOfFlight):
    """A Kinect v2 whose faults are drawn with each image, after everything else; labels stay at their pixels.

    So were the images of the first presets made.
    """

    def read(self, clean: CleanDepth, rng: np.random.Generator) -> Reading:
        """What the sensor makes of a clean depth image; see ``Sensor.read``."""
        wanted = replace(clean, only=clean.wanted(0), person=None)
        depth_mm, _ = TimeOfFlight.kinect2(rng).read(wanted, rng)
        return Reading(depth_mm, np.arange(depth_mm.size, dtype=np.int32).reshape(depth_mm.shape))


def fresh_kinect2(rng: np.random.Generator) -> Sensor:
    """A ``FreshKinect2``; nothing is drawn yet."""
    return FreshKinect2()


def _first(name: str, count: int, stream: int, stage: Staging) -> Preset:
    """A preset of naked builds between the paper's bodies before a Kinect v2, whole in its image."""
    return Preset(name, count, stream, stage, paper_person, fresh_kinect2, 0.9, 16, 1, described=False)


PRESETS = {
    preset.name: preset
    for preset in (
        _first("sitting-train", 10_076, 1, sitting),
        _first("sitting-test", 4_984, 2, sitting),
        _first("recumbent", 326_984, 3, recumbent),
        _first("upright", 20_000, 4, upright),
        Preset("standing", 20_000, 5, standing),
        Preset("people", 200_000, 6, everybody),
    )
}
"""The paper's sets (sections 3.2, 4.1 and 4.3), and people on their own legs, as first drawn: naked, before a
Kinect v2; and dressed people of all ages and builds before all kinds of sensors. Their streams never meet."""


def preset_of(repertoire: Repertoire) -> Preset:
    """A preset of poses of recorded motions: all else is as in ``standing``."""
    return Preset("motion", 20_000, 7, Moved(repertoire))


def preset_named(name: str) -> Preset:
    """The preset of that name. Raises CloudError naming those there are."""
    check_choice("preset", name, PRESETS)
    return PRESETS[name]


def dressed_from(preset: Preset, garments: Path) -> Preset:
    """A preset whose people wear garments of a folder. Raises CloudError where they are naked."""
    if preset.people is not crowd_person:
        dressed = ", ".join(name for name, other in PRESETS.items() if other.people is crowd_person)
        raise CloudError(
            f"people of {preset.name} are naked, like the paper's; use --garments with {dressed}"
        )
    return replace(preset, people=Wardrobe.of(garments))
