"""Frames to turn in three dimensions: points of the person and of what is around, small enough to embed."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from annotate.array_types import Bool, Float32, Index
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.frame_labels import FrameLabels
from annotate.labelset.frames import pinhole_of
from annotate.parts import on_body
from eval.report.figures import error_kind_ids
from sensors.rig.camera import Intrinsics, unproject

SCENE_POINTS = 14_000
"""Points of a scene: turned smoothly by a laptop's own graphics, 0.2 MB in the page; chosen by eye."""
AROUND_SHARE = 0.25
"""Share of the points that may show the surroundings; chosen by eye."""
AROUND_M = 0.3
"""Metres around the person in which the surroundings are shown; chosen by eye."""


@dataclass(frozen=True)
class Scene:
    """Points of one frame. points_mm: int16 (n, 3), depth-camera frame less the person's middle.

    colors: values (n,) by their meaning ("truth", "predicted": part ids; "error": index into
    `figures.ERROR_NAMES`; "temperature_c": float, NaN unknown).
    """

    title: str
    points_mm: NDArray[np.int16]
    colors: Mapping[str, NDArray[np.generic]]


def make_scene(
    title: str,
    predicted: FrameLabels,
    camera: Intrinsics,
    truth: FrameLabels | None = None,
    cloud: ThermalCloud | None = None,
) -> Scene | None:
    """The scene of a frame; None where nobody is seen. camera: undistorted, of the whole image."""
    frame = predicted if truth is None else truth
    points = points_of(frame, camera)
    person = on_body(predicted.parts) | (on_body(truth.parts) if truth is not None else False)
    at = _chosen(points, person & (frame.depth_mm > 0))
    if not at.size:
        return None
    middle = np.median(points.reshape(-1, 3)[at][person.ravel()[at]], axis=0)
    shown = (points.reshape(-1, 3)[at] - middle) * 1000
    colors: dict[str, NDArray[np.generic]] = {"predicted": predicted.parts.ravel()[at]}
    if truth is not None:
        colors = {"truth": truth.parts.ravel()[at], **colors}
        colors["error"] = error_kind_ids(truth.parts, predicted.parts).ravel()[at]
    if cloud is not None and np.isfinite(cloud.temperature_c).any():
        colors["temperature_c"] = cloud.temperature_c.ravel()[at]
    return Scene(title, np.clip(shown, -32_000, 32_000).astype(np.int16), colors)


def points_of(frame: FrameLabels, camera: Intrinsics) -> Float32:
    """Points (h, w, 3) in metres, NaN without a reading, of a depth image or of a crop of one.

    Raises FormatError when the frame's notes are malformed, CalibrationError when they are another image's.
    """
    metres = np.where(frame.depth_mm > 0, frame.depth_mm / 1000, np.nan)
    return unproject(pinhole_of(frame, camera), metres)


def _chosen(points: Float32, person: Bool) -> Index:
    """Pixels to show, evenly thinned: the person, and what lies within `AROUND_M` of the person's box."""
    body = np.flatnonzero(person)
    if not body.size:
        return body
    flat = points.reshape(-1, 3)
    low, high = np.percentile(flat[body], [2, 98], axis=0) + np.array([[-AROUND_M], [AROUND_M]])
    with np.errstate(invalid="ignore"):
        close = ((flat >= low) & (flat <= high)).all(-1)
    around = np.flatnonzero(close & ~person.ravel())
    around = _thinned(around, int(SCENE_POINTS * AROUND_SHARE))
    return np.concatenate([_thinned(body, SCENE_POINTS - around.size), around])


def _thinned(pixels: Index, most: int) -> Index:
    keep = np.linspace(0, pixels.size - 1, min(most, pixels.size)).round().astype(np.intp)
    return pixels[keep]
