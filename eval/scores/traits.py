"""Traits of a frame, and groups of frames by trait."""

import math
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from sys import intern
from typing import Any, cast

import numpy as np

from annotate.array_types import Bool, Index, UInt16
from annotate.crop import window_of
from annotate.frame_labels import FrameLabels, Status
from eval.scores.joint_errors import TRUE_JOINTS, all_joints_mm
from sensors.rig.camera import Intrinsics
from synth.pose.pose_parameters import posture_class

DISTANCE_EDGES_M = (1.0, 1.5, 2.0, 2.5, 3.0, 4.0)
INVALID_EDGES = (0.01, 0.05, 0.1, 0.2)  # ends of the groups by share of invalid pixels
FACED_DEG = (45.0, 135.0)  # ends of the facings from the front and from the side
NOTE_CHARS, NOTE_CAUSES = 100, 30  # kept of a note
NOTHING_HARD = "nothing named"


@dataclass(frozen=True, slots=True)
class Traits:
    """Traits of one frame; "" and NaN where unknown.

    activity: family of the pose. posture: of ``annotate.posture``. facing: of the camera about the chest, by
    the true joints. sensor: kind of depth camera. view: side of the person or furniture in front of the
    camera. distance_m: median depth of the person. invalid_share: of the pixels in the person's box; unknown
    if the depth image shows the person only. hard: causes of difficulty. mm_per_px: size of a pixel at the
    person's distance.
    """

    activity: str = ""
    posture: str = ""
    facing: str = ""
    sensor: str = ""
    view: str = ""
    distance_m: float = math.nan
    invalid_share: float = math.nan
    status: Status = "auto"
    predicted_status: Status = "auto"
    hard: tuple[str, ...] = ()
    mm_per_px: float = math.nan


def traits_of(truth: FrameLabels, predicted: FrameLabels, camera: Intrinsics) -> Traits:
    """Return a frame's traits from the truth's notes and depth; camera: of its depth image."""
    whole = truth.on_body
    box = window_of(whole)
    person, depth_mm = whole[box], truth.depth_mm[box]
    readings = depth_mm[person & (depth_mm > 0)]
    distance_mm = float(np.median(readings)) if readings.size else math.nan
    view, sensor = truth.notes.get("camera"), truth.notes.get("sensor")
    activity = _text(truth.notes.get("activity"))
    return Traits(
        activity=activity,
        posture=_text(truth.notes.get("posture", posture_class(activity))),
        facing=_facing(truth),
        sensor=_text(sensor.get("kind")) if isinstance(sensor, Mapping) else "",
        view=_side(view.get("azimuth_deg") if isinstance(view, Mapping) else None),
        distance_m=distance_mm / 1000,
        invalid_share=_invalid_share(depth_mm, person),
        status=cast(Status, intern(truth.status)),
        predicted_status=cast(Status, intern(predicted.status)),
        hard=_hard(truth.notes),
        mm_per_px=distance_mm / camera.fx,
    )


def groups(subjects: Sequence[str], traits: Sequence[Traits]) -> dict[str, dict[str, Index]]:
    """Return indices (n,) of frames by trait and value, in the order to show; empty groups are left out."""
    hard = _by_value(t.hard for t in traits)
    if hard:
        hard[NOTHING_HARD] = np.flatnonzero([not t.hard for t in traits])
    kinds = {
        "subject": _by_value((subject,) for subject in subjects),
        "activity": _by_value((t.activity,) for t in traits),
        "posture": _by_value((t.posture,) for t in traits),
        "facing": _by_value((t.facing,) for t in traits),
        "sensor": _by_value((t.sensor,) for t in traits),
        "view": _by_value((t.view,) for t in traits),
        "distance": _binned([t.distance_m for t in traits], DISTANCE_EDGES_M, 1.0, "m"),
        "invalid depth": _binned([t.invalid_share for t in traits], INVALID_EDGES, 100.0, "%"),
        "status": _by_value((t.status,) for t in traits),
        "hard": hard,
    }
    shown = {kind: {v: index for v, index in found.items() if index.size} for kind, found in kinds.items()}
    return {kind: found for kind, found in shown.items() if found}


def _by_value(values: Iterable[Sequence[str]]) -> dict[str, Index]:
    """Return indices (n,) of frames by value, sorted, without ""."""
    found = defaultdict(list)
    for i, own in enumerate(values):
        for value in own:
            found[value].append(i)
    return {value: np.array(found[value]) for value in sorted(found) if value}


def _binned(values: Sequence[float], edges: tuple[float, ...], scale: float, unit: str) -> dict[str, Index]:
    ends = [f"{edge * scale:g}" for edge in edges]
    between = (f"{low} to {high} {unit}" for low, high in pairwise(ends))
    names = (f"under {ends[0]} {unit}", *between, f"{ends[-1]} {unit} and more")
    bins = np.where(np.isnan(values), -1, np.searchsorted(edges, values, side="right"))
    return {name: np.flatnonzero(bins == i) for i, name in enumerate(names)}


def _invalid_share(depth_mm: UInt16, person: Bool) -> float:
    if not person.size:
        return math.nan
    around = depth_mm[~person]
    if around.size and not around.any():
        return math.nan
    return float(np.mean(depth_mm == 0))


def _hard(notes: Mapping[str, Any]) -> tuple[str, ...]:
    named = notes.get("hard")
    causes = [_text(cause) for cause in named[:NOTE_CAUSES]] if isinstance(named, list) else []
    # Notes of datasets (``synth.images.presets``).
    if _number(notes.get("occluders")) > 0:
        causes.append("things in front")
    if _number(notes.get("cut")) > 0:
        causes.append("incomplete extraction")
    return tuple(dict.fromkeys(cause for cause in causes if cause))


def _facing(truth: FrameLabels) -> str:
    from synth.images.standing_statistics import facing_deg

    if TRUE_JOINTS not in truth.notes:
        return ""
    azimuth_deg = abs(facing_deg(all_joints_mm(truth)))
    names = {FACED_DEG[0]: "from the front", FACED_DEG[1]: "from the side", 180.0: "from behind"}
    return next((name for end, name in names.items() if azimuth_deg <= end), "")


def _side(azimuth_deg: object) -> str:
    """Return the side of the furniture on which the camera stands; "" for no number.

    azimuth_deg: 0 in front of the sofa or at the foot of the bed, 90 on the sitter's left.
    """
    angle = _number(azimuth_deg)
    if math.isnan(angle):
        return ""
    return ("front or foot", "left", "back or head", "right")[round((angle % 360) / 90) % 4]


def writable(text: str) -> str:
    """Return text without halves of surrogate pairs, which files of text cannot hold."""
    return text.encode(errors="replace").decode()


def _text(value: object) -> str:
    return intern(writable(value[:NOTE_CHARS])) if isinstance(value, str) else ""


def _number(value: object) -> float:
    """Return a finite number, or NaN for any other value of a file."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return math.nan
    return float(value) if abs(value) < 1e9 else math.nan
