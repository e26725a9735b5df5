"""Traits of a frame: the person, the pose, the distance, and causes of difficulty."""

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
from annotate.parts import on_body
from sensors.rig.camera import Intrinsics

DISTANCE_EDGES_M = (1.0, 1.5, 2.0, 2.5, 3.0, 4.0)
INVALID_EDGES = (0.01, 0.05, 0.1, 0.2)
"""Ends of the groups by distance and by share of pixels without a reading; untuned."""
NOTE_CHARS, NOTE_CAUSES = 100, 30
"""Characters of a note and causes of hardness that a result keeps of a frame; untuned."""
NOTHING_HARD = "nothing named"


@dataclass(frozen=True, slots=True)
class Traits:
    """Traits of one frame; "" and NaN where unknown.

    activity: kind of pose. view: side of the person that the camera shows. distance_m: median depth of the
    person. invalid_share: share of pixels without a reading in the person's box; unknown where the depth
    image shows the person only. status, predicted_status: of the truth and the prediction. hard: causes of
    difficulty, in words. mm_per_px: millimetres per pixel at the person's distance.
    """

    activity: str = ""
    view: str = ""
    distance_m: float = math.nan
    invalid_share: float = math.nan
    status: Status = "auto"
    predicted_status: Status = "auto"
    hard: tuple[str, ...] = ()
    mm_per_px: float = math.nan


def traits_of(truth: FrameLabels, predicted: FrameLabels, camera: Intrinsics) -> Traits:
    """Return the traits of a frame from the truth's notes and depth. camera: of its depth image."""
    whole = on_body(truth.parts)
    box = window_of(whole)
    person, depth_mm = whole[box], truth.depth_mm[box]
    readings = depth_mm[person & (depth_mm > 0)]
    distance_mm = float(np.median(readings)) if readings.size else math.nan
    view = truth.notes.get("camera")
    return Traits(
        activity=_text(truth.notes.get("activity")),
        view=_side(view.get("azimuth_deg") if isinstance(view, Mapping) else None),
        distance_m=distance_mm / 1000,
        invalid_share=_invalid_share(depth_mm, person),
        status=cast(Status, intern(truth.status)),
        predicted_status=cast(Status, intern(predicted.status)),
        hard=_hard(truth.notes),
        mm_per_px=distance_mm / camera.fx,
    )


def groups(subjects: Sequence[str], traits: Sequence[Traits]) -> dict[str, dict[str, Index]]:
    """Return indices (n,) of frames by trait and value, in display order; traits that no frame has are left
    out.

    A frame with several causes of difficulty is in several groups.
    """
    hard = _by_value(t.hard for t in traits)
    if hard:
        hard[NOTHING_HARD] = np.flatnonzero([not t.hard for t in traits])
    kinds = {
        "subject": _by_value((subject,) for subject in subjects),
        "activity": _by_value((t.activity,) for t in traits),
        "view": _by_value((t.view,) for t in traits),
        "distance": _binned([t.distance_m for t in traits], DISTANCE_EDGES_M, 1.0, "m"),
        "invalid depth": _binned([t.invalid_share for t in traits], INVALID_EDGES, 100.0, "%"),
        "status": _by_value((t.status,) for t in traits),
        "hard": hard,
    }
    shown = {kind: {v: index for v, index in found.items() if index.size} for kind, found in kinds.items()}
    return {kind: found for kind, found in shown.items() if found}


def _by_value(values: Iterable[Sequence[str]]) -> dict[str, Index]:
    """Return indices (n,) of the frames with each value, sorted by value; frames with "" are left out."""
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
    """Return the share of pixels without a reading in the box of the person (h, w)."""
    if not person.size:
        return math.nan
    around = depth_mm[~person]
    if around.size and not around.any():
        return math.nan
    return float(np.mean(depth_mm == 0))


def _hard(notes: Mapping[str, Any]) -> tuple[str, ...]:
    named = notes.get("hard")
    causes = [_text(cause) for cause in named[:NOTE_CAUSES]] if isinstance(named, list) else []
    # A dataset's notes give numbers instead (``synth.images.presets``).
    if _number(notes.get("occluders")) > 0:
        causes.append("things in front")
    if _number(notes.get("cut")) > 0:
        causes.append("incomplete extraction")
    return tuple(dict.fromkeys(cause for cause in causes if cause))


def _side(azimuth_deg: object) -> str:
    """Return the name of the person's side that the camera shows.

    azimuth_deg: azimuth of the camera from the sofa's front or the bed's foot, growing to the left of a
    seated person.
    """
    angle = _number(azimuth_deg)
    if math.isnan(angle):
        return ""
    return ("front or foot", "left", "back or head", "right")[round((angle % 360) / 90) % 4]


def writable(text: str) -> str:
    """Return text that can be encoded as UTF-8, because names in labels may not be."""
    return text.encode(errors="replace").decode()


def _text(value: object) -> str:
    # One text for all frames that have it.
    return intern(writable(value[:NOTE_CHARS])) if isinstance(value, str) else ""


def _number(value: object) -> float:
    """Return a finite number, or NaN for any other value of a file."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return math.nan
    return float(value) if abs(value) < 1e9 else math.nan
