"""Truth of the virtual rig: true parts and persons (h, w) of the measured surfaces."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from annotate.array_types import Bool, Float64, Int32, UInt8
from annotate.cloud.fuse import undistortion_index
from annotate.frame_labels import FrameLabels
from annotate.parts import PAPER, UNDEFINED
from annotate.scheme.regions import N_REGIONS
from annotate.scheme.scheme import Scheme
from annotate.suit.palette import MIN_CHROMA_DISTANCE, chromaticity
from sensors.calibration_files.kinect2_factory import KINECT2_DEPTH
from sensors.rig.camera import Intrinsics, project
from sensors.rig.frame import RigFrame
from synth.appearance.color_camera import CameraState
from synth.appearance.outfit import GAMMA, Outfit
from synth.appearance.warmth import SURFACE_C
from synth.cameras.sensor import Reading, Sensor
from synth.cameras.time_of_flight import TimeOfFlight
from synth.rig.episode import Scene, SceneState
from synth.surface.furniture import THING_NAMES, Surface
from synth.surface.rasterize import ZBuffer

FLYING_MM = 60.0  # from the surfaces of its pixel and the neighbours, beyond which a reading is undefined
SOFT = (Surface.SOFA, Surface.BED, Surface.PILLOW, Surface.WHEELCHAIR)
# Thresholds of a frame's hardships; untuned.
BODY_WARM_C = (25.0, 36.0)  # temperatures that resemble a person's
SEEN_PX = 150
WARM_ROOM_C, DRIFTED_C = 24.0, 1.0
HIDDEN, OUTSIDE = 0.12, 0.1  # shares of the person hidden, and of joints out of view
BLUR_M = 0.01  # a limb's way during the exposure: 5 colour pixels at 2 m
DIM_GAIN = 3.0
COLD = 0.5  # share of the way to cold hands and feet


@dataclass(frozen=True)
class Truth:
    """Truth of a frame.

    regions: uint8 (h, w) of the raw depth image, ids of ``Region``, 0 elsewhere, 255 where several surfaces
    mix. persons: uint8 (h, w), as in ``FrameLabels``. surfaces: uint8 (h, w), ids of ``Surface``, 0 on the
    subject and without a reading. joints_m: (J, 3), depth camera. bodies: names, of which the subject is a
    blend. hard: causes of difficulty. drift_c: temperature error common to all pixels. spot_c: a pyrometer's
    reading, or NaN.
    """

    regions: UInt8
    persons: UInt8
    surfaces: UInt8
    joints_m: Float64
    subject: str
    bodies: tuple[str, ...]
    hard: tuple[str, ...]
    drift_c: float = 0.0
    spot_c: float = float("nan")


class Owners(NamedTuple):
    """Regions, persons and surfaces, uint8 (h, w), as in ``Truth``."""

    regions: UInt8
    persons: UInt8
    surfaces: UInt8


def whose_readings(seen: ZBuffer, tags: Int32, reading: Reading, sensor: Sensor) -> Owners:
    """Return the owners of the readings, from the faces' tags (F,)."""
    tag = np.append(tags, 0)[seen.face]
    if isinstance(sensor, TimeOfFlight):
        _follow_edges(tag, seen, reading.depth_mm, sensor)
    else:
        tag = tag.ravel()[reading.source]
    regions = np.where((tag > 0) & (tag <= N_REGIONS), tag, 0).astype(np.uint8)
    persons = (regions > 0) + np.uint8(2) * (tag == Surface.OTHER_PERSON)
    surfaces = np.where(tag > N_REGIONS, tag, 0).astype(np.uint8)
    regions[tag < 0] = UNDEFINED
    unread = reading.depth_mm == 0
    regions[unread] = persons[unread] = surfaces[unread] = 0
    return Owners(regions, persons.astype(np.uint8), surfaces)


def _follow_edges(tag: Int32, seen: ZBuffer, depth_mm: NDArray[np.uint16], sensor: TimeOfFlight) -> None:
    """Set the tags (h, w) of jittered edge pixels to a neighbour's, and of mixed pixels to -1, in place."""
    expected = sensor.offset_mm + 1000 * sensor.scale * np.nan_to_num(seen.depth_m)
    off_mm = np.abs(depth_mm - expected)
    v, u = np.nonzero((depth_mm > 0) & (off_mm > FLYING_MM))
    nearest = np.full(len(v), FLYING_MM)
    found = np.zeros(len(v), np.int64) - 1
    for dv in (-1, 0, 1):
        for du in (-1, 0, 1):
            y, x = (v + dv).clip(0, tag.shape[0] - 1), (u + du).clip(0, tag.shape[1] - 1)
            gap = np.abs(depth_mm[v, u] - expected[y, x])
            found = np.where(gap < nearest, tag[y, x], found)
            nearest = np.minimum(nearest, gap)
    tag[v, u] = found


def thing_table(scheme: Scheme) -> UInt8:
    """Return part ids uint8 (256,) by ``Surface``: the thing of its name in ``THING_NAMES``, or 0."""
    table = np.zeros(256, np.uint8)
    things = {part.name: part.id for part in scheme.parts if part.is_free}
    for surface, name in THING_NAMES.items():
        table[surface] = things.get(name, 0)
    return table


def truth_labels(
    frame: RigFrame, truth: Truth, camera: Intrinsics = KINECT2_DEPTH, scheme: Scheme = PAPER
) -> FrameLabels:
    """Return the true labels of the depth image in a scheme, things included, undistorted as in fusion."""
    source = undistortion_index(camera)
    parts = np.where(truth.regions > 0, scheme.table[truth.regions], thing_table(scheme)[truth.surfaces])
    depth_mm, parts, persons = (
        np.where(source >= 0, image.ravel()[source], 0) for image in (frame.depth_mm, parts, truth.persons)
    )
    notes = {"joints_mm": np.rint(truth.joints_m * 1000).astype(int).tolist(), "hard": list(truth.hard)}
    return FrameLabels(
        f"{frame.index:06d}",
        depth_mm.astype(np.uint16),
        parts.astype(np.uint8),
        subject=truth.subject,
        status="truth",
        notes=notes,
        persons=persons.astype(np.uint8),
        scheme=scheme,
    )


def scene_hardships(
    scene: Scene, state: SceneState, seen: ZBuffer, alone: ZBuffer, camera: Intrinsics
) -> list[str]:
    """Return the causes of difficulty in the scene. seen: render of the whole scene, alone: of the
    subject.
    """
    tags, celsius = np.append(scene.tags, 0)[seen.face], np.append(state.celsius, -100.0)[seen.face]
    warm = (celsius > BODY_WARM_C[0]) & (celsius < BODY_WARM_C[1])
    own, whole = (tags > 0) & (tags <= N_REGIONS), alone.face >= 0
    pixels = project(camera, scene.camera_from_world.apply(state.joints_m))
    inside = ((pixels >= 0) & (pixels < (camera.width, camera.height))).all(axis=1)
    causes = {
        "second person": _many(tags == Surface.OTHER_PERSON),
        "warm seat": _many(np.isin(tags, SOFT) & warm),
        "things as warm as a person": _many(np.isin(tags, tuple(SURFACE_C)) & warm),
        "warm room": scene.room_c > WARM_ROOM_C,
        "cold sleeves": bool(scene.clothing.cold_sleeves),
        "cold feet": scene.clothing.cold_feet > COLD,
        "cold hands": scene.clothing.cold_hands > COLD,
        "hidden by things": whole.sum() - own.sum() > HIDDEN * whole.sum(),
        "out of view": inside.mean() < 1 - OUTSIDE,
        "similar colours": _similar(scene.outfits[0]),
    }
    return [cause for cause, present in causes.items() if present]


def camera_hardships(speed_m_s: float, camera: CameraState, drift_c: float) -> list[str]:
    """Return the causes of difficulty in the cameras. speed_m_s: of the subject's fastest limb."""
    causes = {
        "motion blur": speed_m_s * camera.exposure_s > BLUR_M,
        "dim light": camera.gain > DIM_GAIN,
        "thermal drift": abs(drift_c) > DRIFTED_C,
    }
    return [cause for cause, there in causes.items() if there]


def _many(pixels: Bool) -> bool:
    return int(np.count_nonzero(pixels)) > SEEN_PX


def _similar(outfit: Outfit) -> bool:
    cloth = chromaticity(255 * np.power(outfit.cloth_rgb, 1 / GAMMA))
    gaps = np.linalg.norm(cloth[:, None] - cloth[None], axis=2)
    return bool(gaps[np.triu_indices(len(cloth), 1)].min(initial=np.inf) < MIN_CHROMA_DISTANCE)
