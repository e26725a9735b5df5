"""Scores by name from counts, and their JSON."""

from collections.abc import Sequence
from itertools import pairwise
from typing import TypeAlias

import numpy as np

from annotate.scheme.scheme import BACKGROUND, Scheme
from eval.scores import confusion
from eval.scores.boundary import (
    DISTANCE_EDGES_PX,
    TOLERANCES_MM,
    TOLERANCES_PX,
    WIDTHS_MM,
    WIDTHS_PX,
    boundary_f,
    error_rate,
)
from eval.scores.confusion import Counts, Scores, present_mean, ratio
from eval.scores.counts import FrameCounts
from eval.scores.reliability import calibration_error

PART_SCORES = ("recall", "precision", "iou", "dice", "boundary_iou_by_part")
"""Scores (..., n) by part id; background's boundary IoU is NaN."""
_TOLERANCE = TOLERANCES_PX.index(2.0)
_WIDTH = WIDTHS_PX.index(4.0)


def scores_of(counts: FrameCounts) -> dict[str, Scores]:
    """Return all scores of counts with leading axes `...`; NaN without pixels to score.

    Scalars (...), scores by part (..., n), by tolerance or width, and by distance. boundary_f: at 2 px;
    boundary_iou: at 4 px. inside, near: pixels away from and near the borders of the truth. person: pixels
    with a part of the body in both maps. all: background is one more part. merged: left and right are one.
    """
    ece = {"ece": counts.reliability.sum(-3), "ece_near": counts.reliability[..., 1, :, :]}
    return {
        **_pixel_scores(counts),
        **_border_scores(counts),
        **{name: calibration_error(bins) for name, bins in ece.items()},
    }


def _pixel_scores(counts: FrameCounts) -> dict[str, Scores]:
    matrix, scheme = counts.confusion, counts.scheme
    inside, person = matrix - counts.near, confusion.on_person(matrix, scheme)
    return {
        "mean_recall": confusion.mean_recall(matrix),
        "miou": confusion.miou(matrix),
        "person_iou": confusion.person_iou(matrix, scheme),
        "left_right_swap_rate": confusion.left_right_swap_rate(matrix, scheme),
        "mean_recall_inside": confusion.mean_recall(inside),
        "mean_recall_near": confusion.mean_recall(counts.near),
        "error_rate_inside": confusion.error_rate_on_person(inside, scheme),
        "error_rate_near": confusion.error_rate_on_person(counts.near, scheme),
        "mean_recall_person": confusion.mean_recall(person),
        "miou_person": confusion.miou(person),
        "mean_recall_all": present_mean(confusion.recall(matrix), axis=-1),
        "miou_all": present_mean(confusion.iou(matrix), axis=-1),
        "miou_merged": confusion.miou(confusion.merge_left_right(matrix, scheme)),
        "recall": confusion.recall(matrix),
        "precision": confusion.precision(matrix),
        "iou": confusion.iou(matrix),
        "dice": confusion.dice(matrix),
    }


def _border_scores(counts: FrameCounts) -> dict[str, Scores]:
    by_tolerance = boundary_f(counts.borders_px)
    by_width = _boundary_iou(counts.bands_px)
    return {
        "boundary_f": by_tolerance[..., _TOLERANCE],
        "boundary_iou": confusion.over_parts(by_width[..., _WIDTH, :]),
        "boundary_iou_by_part": by_width[..., _WIDTH, :],
        "boundary_f_px": by_tolerance,
        "boundary_f_mm": boundary_f(counts.borders_mm),
        "boundary_iou_px": confusion.over_parts(by_width),
        "boundary_iou_mm": confusion.over_parts(_boundary_iou(counts.bands_mm)),
        "error_by_distance": error_rate(counts.by_distance.sum(-3)),
        "error_by_distance_by_part": error_rate(counts.by_distance),
    }


def _boundary_iou(bands: Counts) -> Scores:
    scores = ratio(bands[..., 0], bands[..., 1])
    scores[..., BACKGROUND] = np.nan
    return scores


FROM_CONFUSION = frozenset(
    {"mean_recall", "miou", "person_iou", "left_right_swap_rate", "mean_recall_person", "miou_person"}
    | {"mean_recall_all", "miou_all", "miou_merged", "recall", "precision", "iou", "dice"}
)
"""Scores that the confusion matrix alone gives."""

JsonScore: TypeAlias = "float | list[JsonScore] | dict[str, JsonScore] | None"


def _lengths(values: Sequence[float], unit: str) -> list[str]:
    return [f"{value:g} {unit}" for value in values]


DISTANCES = (
    *(
        f"{low:g} px" if high - low == 1 else f"{low:g} to {high - 1:g} px"
        for low, high in pairwise((0.0, *DISTANCE_EDGES_PX))
    ),
    f"{DISTANCE_EDGES_PX[-1]:g} px and more",
)
"""Names of the distance bins, by whole pixels."""
_NAMES = {
    "boundary_f_px": _lengths(TOLERANCES_PX, "px"),
    "boundary_f_mm": _lengths(TOLERANCES_MM, "mm"),
    "boundary_iou_px": _lengths(WIDTHS_PX, "px"),
    "boundary_iou_mm": _lengths(WIDTHS_MM, "mm"),
    "error_by_distance": list(DISTANCES),
}
"""Names along a score's last axis."""


def plain(values: Scores | float) -> JsonScore:
    """Return numbers as JSON; NaN becomes null."""
    array = np.asarray(values, np.float64)
    if array.ndim:
        return [plain(value) for value in array]
    return float(array) if np.isfinite(array) else None


def named(name: str, values: Scores, scheme: Scheme) -> JsonScore:
    """Return a score or its interval (2, ...) by the names of its last axis, without background."""
    if name in PART_SCORES:
        return {part.name: plain(values[..., part.id]) for part in scheme.parts}
    if name == "error_by_distance_by_part":
        by_part = {part.name: values[..., part.id, :] for part in scheme.parts}
        return {part: named("error_by_distance", own, scheme) for part, own in by_part.items()}
    if name in _NAMES:
        return {key: plain(values[..., i]) for i, key in enumerate(_NAMES[name])}
    return plain(values)
