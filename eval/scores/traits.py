"""What kind of frame it is: who is seen, in which pose, from how far, and what makes it hard."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from sys import intern
from typing import Any, cast

import numpy as np

from annotate.array_types import Bool, UInt16
from annotate.crop import window_of
from annotate.frame_labels import FrameLabels, Status
from annotate.parts import on_body
from sensors.rig.camera import Intrinsics

DISTANCE_EDGES_M = (1.0, 1.5, 2.0, 2.5, 3.0, 4.0)
INVALID_EDGES = (0.01, 0.05, 0.1, 0.2)
MAX_CHARS, MAX_CAUSES = 100, 30
"""Bounds on what notes, which come from files, may add to a result."""
NOTHING_HARD = "nothing named"


@dataclass(frozen=True, slots=True)
class Traits:
    """Traits of one frame; "" and NaN where unknown.

    activity: the pose's family. view: the side that the camera sees. distance_m: median depth of the
    person. invalid_share: pixels without a reading in the person's box; unknown where the depth image
    shows the person only. status, predicted_status: of the truth and the prediction. hard: what makes
    the frame hard, in words. mm_per_px: what a pixel spans at the person's distance.
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
    """Traits of a frame, from the truth's notes and depth. camera: of its depth image."""
    person = on_body(truth.parts)
    readings = truth.depth_mm[person & (truth.depth_mm > 0)]
    distance_mm = float(np.median(readings)) if readings.size else math.nan
    view = truth.notes.get("camera")
    return Traits(
        activity=_text(truth.notes.get("activity")),
        view=_side(view.get("azimuth_deg") if isinstance(view, Mapping) else None),
        distance_m=distance_mm / 1000,
        invalid_share=_invalid_share(truth.depth_mm, person),
        status=cast(Status, intern(truth.status)),
        predicted_status=cast(Status, intern(predicted.status)),
        hard=_hard(truth.notes),
        mm_per_px=distance_mm / camera.fx,
    )


def groups(subjects: Sequence[str], traits: Sequence[Traits]) -> dict[str, dict[str, Bool]]:
    """Frames (F,) by trait and value, in the order to show; kinds that no frame tells are left out.

    A frame with several causes of hardness is in several groups.
    """
    causes = sorted({cause for t in traits for cause in t.hard})
    hard = {cause: np.array([cause in t.hard for t in traits]) for cause in causes}
    if hard:
        hard[NOTHING_HARD] = np.array([not t.hard for t in traits])
    kinds = {
        "subject": _same(subjects),
        "activity": _same([t.activity for t in traits]),
        "view": _same([t.view for t in traits]),
        "distance": _binned([t.distance_m for t in traits], DISTANCE_EDGES_M, 1.0, "m"),
        "invalid depth": _binned([t.invalid_share for t in traits], INVALID_EDGES, 100.0, "%"),
        "status": _same([t.status for t in traits]),
        "hard": hard,
    }
    shown = {kind: {v: mask for v, mask in masks.items() if mask.any()} for kind, masks in kinds.items()}
    return {kind: masks for kind, masks in shown.items() if masks}


def _same(values: Iterable[str]) -> dict[str, Bool]:
    array = np.array(list(values), np.str_)
    return {str(value): array == value for value in np.unique(array) if value}


def _binned(values: Sequence[float], edges: tuple[float, ...], scale: float, unit: str) -> dict[str, Bool]:
    array = np.array(values, np.float64)
    first, last = (f"{edge * scale:g} {unit}" for edge in (edges[0], edges[-1]))
    bins = {f"under {first}": array < edges[0]}
    for low, high in pairwise(edges):
        bins[f"{low * scale:g} to {high * scale:g} {unit}"] = (array >= low) & (array < high)
    bins[f"{last} and more"] = array >= edges[-1]
    return bins


def _invalid_share(depth_mm: UInt16, person: Bool) -> float:
    box = window_of(person)
    if not depth_mm[box].size:
        return math.nan
    around = depth_mm[box][~person[box]]
    if around.size and not around.any():
        return math.nan
    return float(np.mean(depth_mm[box] == 0))


def _hard(notes: Mapping[str, Any]) -> tuple[str, ...]:
    named = notes.get("hard")
    causes = [_text(cause) for cause in named[:MAX_CAUSES]] if isinstance(named, list) else []
    # A dataset's notes give numbers instead (``synth.images.presets``).
    if _number(notes.get("occluders")) > 0:
        causes.append("things in front")
    if _number(notes.get("cut")) > 0:
        causes.append("incomplete extraction")
    return tuple(dict.fromkeys(cause for cause in causes if cause))


def _side(azimuth_deg: object) -> str:
    """azimuth_deg: where the camera stands, from the sofa's front or the bed's foot, growing to the left of
    who sits on the sofa."""
    angle = _number(azimuth_deg)
    if math.isnan(angle):
        return ""
    return ("front or foot", "left", "back or head", "right")[round((angle % 360) / 90) % 4]


def writable(text: str) -> str:
    """Text that a file can hold: labels may name somebody by half a surrogate pair."""
    return text.encode(errors="replace").decode()


def _text(value: object) -> str:
    # One text for all frames that say the same.
    return intern(writable(value[:MAX_CHARS])) if isinstance(value, str) else ""


def _number(value: object) -> float:
    """A finite number, or NaN for whatever else a file holds."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return math.nan
    return float(value) if abs(value) < 1e9 else math.nan
