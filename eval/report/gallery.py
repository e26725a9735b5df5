"""Frames for the report: pictures in the layout of the paper's Fig. 10 with errors, and rotatable 3D
scenes.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from annotate.array_types import Bool, Float32, Index, UInt8
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.crop import SIZE, Crop, crop_around
from annotate.frame_labels import FrameLabels
from annotate.labelset.labelled_frames import pinhole_of
from annotate.parts import BACKGROUND, BODY_PARTS, on_body
from eval.compare.compare import Comparison
from eval.network.body_state import BodyState
from eval.report import frame_images as figures
from eval.report.frame_images import Image, error_kind_ids, render_thermal_cloud
from eval.report.skeleton import draw_bearing
from eval.scores import confusion
from sensors.rig.camera import Intrinsics, unproject

AROUND_M = 0.7
"""Metres before and behind the person that the picture of a thermal cloud shows; untuned."""
MARGIN = 0.08
"""Free border of a picture on each side, as a share of the person's larger extent; untuned."""
EACH = 6
"""Frames of each group: 18 a result fill a page or two, and half a megabyte; untuned."""
SCENE_POINTS = 14_000
"""Points of a scene: turned smoothly by a laptop's own graphics, 0.2 MB in the page; untuned."""
AROUND_SHARE = 0.25
"""Share of the points that may show the surroundings; untuned."""
SCENE_AROUND_M = 0.3
"""Metres around the person in which the surroundings are shown; untuned."""


@dataclass(frozen=True)
class GalleryFrame:
    """One row of a gallery: pictures uint8 (h, w, 3) RGB by column title, in order.

    group: reason for the choice, e.g. worst. subject: the person. miou: mean IoU, NaN without a truth.
    part_iou: IoU by part id, of the parts that are present; empty without a truth.
    """

    frame_id: str
    columns: dict[str, UInt8]
    group: str = ""
    subject: str = ""
    miou: float = np.nan
    part_iou: Mapping[int, float] = field(default_factory=dict)


def pick_frames(comparison: Comparison, each: int = EACH) -> dict[str, list[str]]:
    """Return frame ids by group: worst and best by mIoU, and random others; at most `each` per group."""
    ranked = np.argsort(comparison.frame_miou, kind="stable")
    ranked = ranked[~np.isnan(comparison.frame_miou[ranked])]
    worst, best = ranked[:each], ranked[each:][::-1][:each]
    rest = ranked[each : max(len(ranked) - each, each)]
    drawn = np.random.default_rng(0).permutation(rest)[:each]
    groups = {"Worst": worst, "Random": drawn, "Best": best}
    return {name: [comparison.frame_ids[i] for i in picked] for name, picked in groups.items()}


Picture = Callable[[Bool, Crop], Image | None]
"""Function that draws a frame's thermal cloud around a person (h, w) in a crop, or returns None."""


def make_frame(
    truth: FrameLabels, predicted: FrameLabels, picture: Picture | None = None, group: str = ""
) -> GalleryFrame:
    """Return a gallery row: thermal cloud (if any), extracted depth, target, prediction, errors."""
    person = on_body(truth.parts) if on_body(truth.parts).any() else on_body(predicted.parts)
    crop = _square(person)
    target, guess = crop.cut(truth.parts, BACKGROUND), crop.cut(predicted.parts, BACKGROUND)
    columns = {
        **_input_columns(truth, person, crop, picture),
        "Target labels": figures.colorize_parts(target),
        "Predicted labels": figures.colorize_parts(guess),
        "Errors": figures.colorize_error(target, guess),
        **_bearing_column(predicted, person, crop),
    }
    matrix = confusion.confusion_matrix(truth.parts, predicted.parts)
    scores = confusion.iou(matrix)
    part_iou = {part.id: float(scores[part.id]) for part in BODY_PARTS if not np.isnan(scores[part.id])}
    subject = truth.subject or predicted.subject
    return GalleryFrame(truth.frame_id, columns, group, subject, float(confusion.miou(matrix)), part_iou)


def make_shown_frame(labels: FrameLabels, picture: Picture | None = None) -> GalleryFrame:
    """Return a gallery row without a truth: thermal cloud (if any), extracted depth, labels, confidence."""
    person = on_body(labels.parts)
    crop = _square(person)
    columns = {
        **_input_columns(labels, person, crop, picture),
        "Labels": figures.colorize_parts(crop.cut(labels.parts, BACKGROUND)),
    }
    if labels.confidence is not None:
        shown = np.where(person, labels.confidence, np.float32(np.nan))
        columns["Confidence"] = figures.colorize_share(crop.cut(shown, np.nan))
    columns |= _bearing_column(labels, person, crop)
    return GalleryFrame(labels.frame_id, columns, subject=labels.subject)


def _input_columns(frame: FrameLabels, person: Bool, crop: Crop, picture: Picture | None) -> dict[str, Image]:
    """Return the pictures of the labelling's input: the thermal cloud, if any, and the person's depth."""
    depth = crop.cut(np.where(person, frame.depth_mm, np.uint16(0)), 0)
    columns = {"Extracted depth": figures.colorize_depth(depth)}
    if picture is not None and (drawn := picture(person, crop)) is not None:
        columns = {"Thermal cloud": drawn, **columns}
    return columns


def _bearing_column(frame: FrameLabels, person: Bool, crop: Crop) -> dict[str, Image]:
    """Return a picture of joints, facing and posture over the person's depth; empty for labels without
    them.
    """
    bearing = BodyState.from_note(frame.notes.get("bearing"))
    if bearing is None:
        return {}
    depth = crop.cut(np.where(person, frame.depth_mm, np.uint16(0)), 0)
    return {"Joints": draw_bearing(figures.colorize_depth(depth), crop, bearing)}


def _square(person: Bool) -> Crop:
    """Return the crop around the person of a mask (h, w), or the whole image without a person."""
    return crop_around(person, MARGIN) if person.any() else Crop(0, 0, max(person.shape))


def cloud_picture(cloud: ThermalCloud, person: Bool, crop: Crop) -> Image:
    """Return the cloud inside a crop around a person (h, w), coloured by temperature: (212, 212, 3)."""
    side = crop.side
    points, temperature = crop.cut(cloud.points_m, np.nan, side), crop.cut(cloud.temperature_c, np.nan, side)
    shown = crop.cut(person & cloud.valid, False, side)
    if shown.any():
        away = np.abs(points[..., 2] - np.median(points[shown][:, 2])) > AROUND_M
        points[away] = np.nan
    # More points than the picture has pixels only cost time.
    step = max(1, side // SIZE)
    return render_thermal_cloud(points[::step, ::step], temperature[::step, ::step])


@dataclass(frozen=True)
class Scene:
    """Points of one frame.

    points_mm: int16 (n, 3), depth-camera frame, relative to the person's middle. colors: values (n,) by name:
    "truth" and "predicted" are part ids, "error" is an index into `figures.ERROR_NAMES`, "temperature_c" is
    float, NaN unknown.
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
    """Return the 3D scene of a frame; None without a person. camera: undistorted, of the whole image."""
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
    """Return the points (h, w, 3) of a frame in metres, NaN without a reading; the frame is an image or a
    crop.

    Raises FormatError when the frame's notes are malformed, CalibrationError when they belong to another
    image.
    """
    metres = np.where(frame.depth_mm > 0, frame.depth_mm / 1000, np.nan)
    return unproject(pinhole_of(frame, camera), metres)


def _chosen(points: Float32, person: Bool) -> Index:
    """Return the pixels to show, evenly thinned: the person, and points within `SCENE_AROUND_M` of its
    bounding box.
    """
    body = np.flatnonzero(person)
    if not body.size:
        return body
    flat = points.reshape(-1, 3)
    low, high = np.percentile(flat[body], [2, 98], axis=0) + np.array([[-SCENE_AROUND_M], [SCENE_AROUND_M]])
    with np.errstate(invalid="ignore"):
        close = ((flat >= low) & (flat <= high)).all(-1)
    around = np.flatnonzero(close & ~person.ravel())
    around = _thinned(around, int(SCENE_POINTS * AROUND_SHARE))
    return np.concatenate([_thinned(body, SCENE_POINTS - around.size), around])


def _thinned(pixels: Index, most: int) -> Index:
    keep = np.linspace(0, pixels.size - 1, min(most, pixels.size)).round().astype(np.intp)
    return pixels[keep]
