"""Frames as rows of images, after the paper's Fig. 10, and as point clouds. Constants are untuned."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from annotate.array_types import Bool, Float32, Index, UInt8
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.crop import SIZE, Crop, crop_around
from annotate.frame_labels import FrameLabels
from annotate.labelset.labelled_frames import pinhole_of
from annotate.scheme.scheme import BACKGROUND, Scheme
from eval.compare.compare import Comparison
from eval.network.body_state import BodyState
from eval.report import frame_images as images
from eval.report.frame_images import Image
from eval.scores import confusion
from sensors.rig.camera import Intrinsics, unproject

AROUND_M = 0.7  # m in front of and behind the person in the image of a thermal cloud
MARGIN = 0.08  # free border of an image on each side, as a share of the person's larger extent
EACH = 6  # frames of a group; 18 frames are half a megabyte
SCENE_POINTS = 14_000  # points of a scene, 0.2 MB
AROUND_SHARE = 0.25  # largest share of the surroundings in these points
SCENE_AROUND_M = 0.3  # m of surroundings around the person in a scene


@dataclass(frozen=True)
class GalleryFrame:
    """A row of images uint8 (h, w, 3) RGB by title; group: reason to show it; miou: NaN without a truth."""

    frame_id: str
    columns: dict[str, UInt8]
    group: str = ""
    subject: str = ""
    miou: float = np.nan


def pick_frames(comparison: Comparison, each: int = EACH) -> dict[str, list[str]]:
    """Return frame ids by group: at most ``each`` worst, best and random others, by mIoU."""
    ranked = np.argsort(comparison.frame_miou, kind="stable")
    ranked = ranked[~np.isnan(comparison.frame_miou[ranked])]
    worst, best = ranked[:each], ranked[each:][::-1][:each]
    rest = ranked[each : max(len(ranked) - each, each)]
    drawn = np.random.default_rng(0).permutation(rest)[:each]
    groups = {"Worst": worst, "Random": drawn, "Best": best}
    return {name: [comparison.frame_ids[i] for i in picked] for name, picked in groups.items()}


CloudImage = Callable[[Bool, Crop], Image | None]
"""Draw a frame's thermal cloud around a person (h, w) in a crop; None without a cloud."""


def make_frame(
    truth: FrameLabels, predicted: FrameLabels, cloud_image: CloudImage | None = None, group: str = ""
) -> GalleryFrame:
    """Return a row: thermal cloud (if any), extracted depth, target, prediction, errors, joints (if any).

    Both frames have one scheme.
    """
    scheme = truth.scheme
    person = truth.on_body if truth.on_body.any() else predicted.on_body
    crop = _square(person)
    target, guess = crop.cut(truth.parts, BACKGROUND), crop.cut(predicted.parts, BACKGROUND)
    columns = {
        **_inputs(truth, person, crop, cloud_image),
        "Target labels": images.colorize_parts(target, scheme),
        "Predicted labels": images.colorize_parts(guess, scheme),
        "Errors": images.colorize_error(target, guess, scheme),
        **_joints(predicted, person, crop),
    }
    miou = float(confusion.miou(confusion.confusion_matrix(truth.parts, predicted.parts, scheme)))
    return GalleryFrame(truth.frame_id, columns, group, truth.subject or predicted.subject, miou)


def make_shown_frame(labels: FrameLabels, cloud_image: CloudImage | None = None) -> GalleryFrame:
    """Return a row without a truth: as ``make_frame``, with labels and confidence."""
    person = labels.on_body
    crop = _square(person)
    columns = {
        **_inputs(labels, person, crop, cloud_image),
        "Labels": images.colorize_parts(crop.cut(labels.parts, BACKGROUND), labels.scheme),
    }
    if labels.confidence is not None:
        shown = np.where(person, labels.confidence, np.float32(np.nan))
        columns["Confidence"] = images.colorize_share(crop.cut(shown, np.nan))
    columns |= _joints(labels, person, crop)
    return GalleryFrame(labels.frame_id, columns, subject=labels.subject)


def compared_images(
    labels: Mapping[str, FrameLabels], pair: tuple[str, str], color_rgb: Image | None
) -> dict[str, Image]:
    """Return the images of a frame in several label sets of one scheme, by title.

    pair: sets whose differences are drawn. color_rgb: camera colours (h, w, 3), or None.
    """
    first = labels[pair[0]]
    person = np.logical_or.reduce([frame.on_body for frame in labels.values()])
    crop = _square(person)
    parts = {name: crop.cut(frame.parts, BACKGROUND) for name, frame in labels.items()}
    columns = {"Depth": _depth(first, np.ones_like(person), crop)}
    if color_rgb is not None:
        columns = {"Camera": crop.cut(color_rgb, 0)}
    columns |= {name: images.colorize_parts(part, first.scheme) for name, part in parts.items()}
    columns["Differences"] = images.colorize_error(parts[pair[1]], parts[pair[0]], first.scheme)
    for name, frame in labels.items():
        drawn = _joints(frame, person, crop)
        columns |= {f"{name}, joints": image for image in drawn.values()}
    return columns


def _depth(frame: FrameLabels, person: Bool, crop: Crop) -> Image:
    return images.colorize_depth(crop.cut(np.where(person, frame.depth_mm, np.uint16(0)), 0))


def _inputs(frame: FrameLabels, person: Bool, crop: Crop, cloud_image: CloudImage | None) -> dict[str, Image]:
    drawn = None if cloud_image is None else cloud_image(person, crop)
    columns = {} if drawn is None else {"Thermal cloud": drawn}
    return {**columns, "Extracted depth": _depth(frame, person, crop)}


def _joints(frame: FrameLabels, person: Bool, crop: Crop) -> dict[str, Image]:
    state = BodyState.from_note(frame.notes.get("bearing"))
    if state is None:
        return {}
    drawn = images.draw_body_state(_depth(frame, person, crop), crop, state, frame.scheme)
    return {"Joints": drawn}


def _square(person: Bool) -> Crop:
    """Return the crop around a mask (h, w), or of the whole image without a person."""
    return crop_around(person, MARGIN) if person.any() else Crop(0, 0, max(person.shape))


def cloud_picture(cloud: ThermalCloud, person: Bool, crop: Crop) -> Image:
    """Return a cloud's points around a person (h, w) in a crop, coloured by temperature: (SIZE, SIZE, 3)."""
    side = crop.side
    points, temperature = crop.cut(cloud.points_m, np.nan, side), crop.cut(cloud.temperature_c, np.nan, side)
    shown = crop.cut(person & cloud.valid, False, side)
    if shown.any():
        away = np.abs(points[..., 2] - np.median(points[shown][:, 2])) > AROUND_M
        points[away] = np.nan
    # More points than the image has pixels only cost time.
    step = max(1, side // SIZE)
    return images.render_thermal_cloud(points[::step, ::step], temperature[::step, ::step])


@dataclass(frozen=True)
class Scene:
    """Point cloud of a frame. points_mm: int16 (n, 3), depth-camera axes, origin at the person's middle.

    colors: values (n,) by name: part ids of "truth" and "predicted", index in ``ERROR_KINDS`` of "error",
    float "temperature_c", NaN if unknown. scheme: of the part ids.
    """

    title: str
    scheme: Scheme
    points_mm: NDArray[np.int16]
    colors: Mapping[str, NDArray[np.generic]]


def make_scene(
    title: str,
    predicted: FrameLabels,
    camera: Intrinsics,
    truth: FrameLabels | None = None,
    cloud: ThermalCloud | None = None,
) -> Scene | None:
    """Return the scene of a frame; None without a person. camera: undistorted, of the whole image."""
    frame = predicted if truth is None else truth
    points = points_of(frame, camera).reshape(-1, 3)
    person = predicted.on_body | (truth.on_body if truth is not None else False)
    at = _chosen(points, person & (frame.depth_mm > 0))
    if not at.size:
        return None
    middle = np.median(points[at][person.ravel()[at]], axis=0)
    shown = (points[at] - middle) * 1000
    colors: dict[str, NDArray[np.generic]] = {"predicted": predicted.parts.ravel()[at]}
    if truth is not None:
        colors = {"truth": truth.parts.ravel()[at], **colors}
        colors["error"] = images.error_kind_ids(truth.parts, predicted.parts, frame.scheme).ravel()[at]
    if cloud is not None and np.isfinite(cloud.temperature_c).any():
        colors["temperature_c"] = cloud.temperature_c.ravel()[at]
    return Scene(title, frame.scheme, np.clip(shown, -32_000, 32_000).astype(np.int16), colors)


def points_of(frame: FrameLabels, camera: Intrinsics) -> Float32:
    """Return points (h, w, 3) in metres of a depth image or a crop of one, NaN without a reading.

    Raises FormatError for malformed notes, CalibrationError for notes of another image.
    """
    metres = np.where(frame.depth_mm > 0, frame.depth_mm / 1000, np.nan)
    return unproject(pinhole_of(frame, camera), metres)


def _chosen(points: Float32, person: Bool) -> Index:
    """Return indices of evenly thinned pixels: of the person, and of the surroundings within
    `SCENE_AROUND_M`.
    """
    body = np.flatnonzero(person)
    if not body.size:
        return body
    margin = np.array([[-SCENE_AROUND_M], [SCENE_AROUND_M]])
    low, high = np.percentile(points[body], [2, 98], axis=0) + margin
    with np.errstate(invalid="ignore"):
        close = ((points >= low) & (points <= high)).all(-1)
    around = _thinned(np.flatnonzero(close & ~person.ravel()), int(SCENE_POINTS * AROUND_SHARE))
    return np.concatenate([_thinned(body, SCENE_POINTS - around.size), around])


def _thinned(pixels: Index, most: int) -> Index:
    keep = np.linspace(0, pixels.size - 1, min(most, pixels.size)).round().astype(np.intp)
    return pixels[keep]
