"""Every score by name, derived from counts: of a frame, a set, or the resamples of a bootstrap alike."""

import numpy as np

from annotate.parts import BACKGROUND
from eval import metrics
from eval.boundary import TOLERANCES_PX, WIDTHS_PX, boundary_f, error_rate
from eval.calibration import calibration_error
from eval.counts import FrameCounts
from eval.metrics import Counts, Scores, present_mean, ratio

PART_SCORES = ("recall", "precision", "iou", "dice", "boundary_iou_by_part")
"""Scores (..., 12), one for each class by id; background's boundary IoU is NaN."""

_TOLERANCE = TOLERANCES_PX.index(2.0)
_WIDTH = WIDTHS_PX.index(4.0)


def scores_of(counts: FrameCounts) -> dict[str, Scores]:
    """All scores of counts with leading axes `...`; NaN where there is nothing to score.

    Scalars (...) first, then by class (..., 12), by tolerance or width, and by distance. boundary_f is
    the one at 2 px, boundary_iou the one at 4 px. inside, near: pixels away from and near the borders
    of the truth. person: pixels that truth and prediction both call a person. all: background counts
    as a twelfth class. merged: left and right are one.
    """
    return {**_pixel_scores(counts), **_border_scores(counts), **_calibration_scores(counts)}


def _pixel_scores(counts: FrameCounts) -> dict[str, Scores]:
    matrix = counts.confusion
    inside, person = matrix - counts.near, metrics.without_background(matrix)
    return {
        "mean_recall": metrics.mean_recall(matrix),
        "miou": metrics.miou(matrix),
        "person_iou": metrics.person_iou(matrix),
        "left_right_swap_rate": metrics.left_right_swap_rate(matrix),
        "mean_recall_inside": metrics.mean_recall(inside),
        "mean_recall_near": metrics.mean_recall(counts.near),
        "error_rate_inside": metrics.error_rate_on_person(inside),
        "error_rate_near": metrics.error_rate_on_person(counts.near),
        "mean_recall_person": metrics.mean_recall(person),
        "miou_person": metrics.miou(person),
        "mean_recall_all": present_mean(metrics.recall(matrix), axis=-1),
        "miou_all": present_mean(metrics.iou(matrix), axis=-1),
        "miou_merged": metrics.miou(metrics.merge_left_right(matrix)),
        "recall": metrics.recall(matrix),
        "precision": metrics.precision(matrix),
        "iou": metrics.iou(matrix),
        "dice": metrics.dice(matrix),
    }


def _border_scores(counts: FrameCounts) -> dict[str, Scores]:
    by_tolerance = boundary_f(counts.borders_px)
    by_width = _boundary_iou(counts.bands_px)
    return {
        "boundary_f": by_tolerance[..., _TOLERANCE],
        "boundary_iou": metrics.over_parts(by_width[..., _WIDTH, :]),
        "boundary_iou_by_part": by_width[..., _WIDTH, :],
        "boundary_f_px": by_tolerance,
        "boundary_f_mm": boundary_f(counts.borders_mm),
        "boundary_iou_px": metrics.over_parts(by_width),
        "boundary_iou_mm": metrics.over_parts(_boundary_iou(counts.bands_mm)),
        "error_by_distance": error_rate(counts.by_distance.sum(-3)),
        "error_by_distance_by_part": error_rate(counts.by_distance),
    }


def _calibration_scores(counts: FrameCounts) -> dict[str, Scores]:
    return {
        "ece": calibration_error(counts.reliability.sum(-3)),
        "ece_near": calibration_error(counts.reliability[..., 1, :, :]),
    }


def _boundary_iou(bands: Counts) -> Scores:
    scores = ratio(bands[..., 0], bands[..., 1])
    scores[..., BACKGROUND] = np.nan
    return scores
