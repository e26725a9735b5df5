"""The frames a reader should see, laid out as the paper's Fig. 10, with the errors beside."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from annotate.cloud import ThermalCloud
from annotate.labels import FrameLabels
from annotate.parts import BACKGROUND, UNDEFINED
from annotate.store import LabelSet
from eval.compare import Comparison
from eval.report import figures
from eval.report.figures import Image

ROOM_M = 0.7
"""How far in front of and behind the person the thermal cloud shows the room."""


@dataclass(frozen=True)
class GalleryFrame:
    """One row of a gallery: pictures uint8 (h, w, 3) RGB by column title, in order."""

    frame_id: str
    columns: dict[str, NDArray[np.uint8]]
    group: str = ""


def pick_frames(comparison: Comparison, each: int = 4, seed: int = 0) -> dict[str, list[str]]:
    """Frame ids by group: the worst and best by mIoU, and random ones of the rest; `each` at most."""
    ranked = np.argsort(comparison.frame_miou, kind="stable")
    ranked = ranked[~np.isnan(comparison.frame_miou[ranked])]
    worst, best = ranked[:each], ranked[each:][::-1][:each]
    rest = ranked[each : max(len(ranked) - each, each)]
    drawn = np.random.default_rng(seed).permutation(rest)[:each]
    groups = {"Worst": worst, "Random": drawn, "Best": best}
    return {name: [comparison.frame_ids[i] for i in picked] for name, picked in groups.items()}


def make_gallery(
    comparison: Comparison,
    predicted: LabelSet,
    truth: LabelSet,
    cloud_of: Callable[[str], ThermalCloud | None] | None = None,
    each: int = 4,
) -> list[GalleryFrame]:
    """Pictures of the worst, random and best frames; `cloud_of` yields a frame's cloud by its id.

    Raises FormatError where a frame is corrupt.
    """
    return [
        make_frame(
            truth.read(frame_id), predicted.read(frame_id), cloud_of(frame_id) if cloud_of else None, group
        )
        for group, frame_ids in pick_frames(comparison, each).items()
        for frame_id in frame_ids
    ]


def make_frame(
    truth: FrameLabels, predicted: FrameLabels, cloud: ThermalCloud | None = None, group: str = ""
) -> GalleryFrame:
    """One row: thermal cloud (where there is one), extracted depth, target, prediction, errors."""
    person = _person(truth) if _person(truth).any() else _person(predicted)
    box = figures.person_box(person)
    target = np.asarray(figures.crop(truth.parts, box), np.uint8)
    guess = np.asarray(figures.crop(predicted.parts, box), np.uint8)
    depth = np.where(person, truth.depth_mm, np.uint16(0))
    extracted = figures.colorize_depth(np.asarray(figures.crop(depth, box), np.uint16))
    columns = {
        "Extracted depth": figures.to_size(extracted),
        "Target labels": figures.to_size(figures.colorize_parts(target)),
        "Predicted labels": figures.to_size(figures.colorize_parts(guess)),
        "Errors": figures.to_size(figures.colorize_error(target, guess)),
    }
    if cloud is not None:
        columns = {"Thermal cloud": _cloud_picture(cloud, person, box), **columns}
    return GalleryFrame(truth.frame_id, columns, group)


def _person(frame: FrameLabels) -> NDArray[np.bool_]:
    return np.asarray((frame.parts != BACKGROUND) & (frame.parts != UNDEFINED))


def _cloud_picture(cloud: ThermalCloud, person: NDArray[np.bool_], box: tuple[int, int, int]) -> Image:
    points = np.asarray(figures.crop(cloud.points_m, box, np.nan), np.float32)
    shown = np.asarray(figures.crop(person & cloud.valid, box), np.bool_)
    if shown.any():
        away = np.abs(points[..., 2] - np.median(points[shown][:, 2])) > ROOM_M
        points[away] = np.nan
    temperature = np.asarray(figures.crop(cloud.temperature_c, box, np.nan), np.float32)
    # More points than the picture has pixels only cost time.
    step = max(1, box[2] // figures.SIZE_PX)
    return figures.render_thermal_cloud(points[::step, ::step], temperature[::step, ::step])
