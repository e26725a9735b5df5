"""Boundary scores: accuracy of the borders between parts, and error rate by distance from a border.

A border pixel is a person pixel with a 4-neighbour of another label, part or background. The image edge and
undefined pixels make no border. Borders of truth and prediction count only where the truth is defined.
"""

from collections.abc import Sequence

import numpy as np

from annotate.array_types import Float32
from eval.scores import kernels as passes
from eval.scores.confusion import Counts, Labels, Scores, ratio

TOLERANCES_PX = (1.0, 2.0, 3.0, 5.0)
TOLERANCES_MM = (5.0, 10.0, 20.0, 40.0)
"""Distances up to which two borders match, in pixels of the depth image and on the person.

Convention; compare with the score that two corrections of the same frames reach, because no labelling
can agree better than people do (Metrics Reloaded, Nature Methods 2024).
"""

WIDTHS_PX = (2.0, 4.0, 8.0)
WIDTHS_MM = (10.0, 20.0, 40.0)
"""Widths of the bands along a part's outline that boundary IoU compares; untuned."""

DISTANCE_EDGES_PX = (1.0, 2.0, 3.0, 5.0, 9.0, 17.0)
"""Upper edges, exclusive, of the distance bins; one more bin holds larger distances; untuned."""

N_DISTANCES = len(DISTANCE_EDGES_PX) + 1

FARTHEST_PX = 100.0
"""Farthest distance at which a border is searched, for any stated scale; untuned.

4 cm span 100 px at a distance of 15 cm, nearer than the range of every camera.
"""


def border_parts(labels: Labels) -> Labels:
    """Return part ids on the border pixels, 0 elsewhere: (h, w) -> (h, w)."""
    return np.asarray(passes.borders(np.ascontiguousarray(labels)))


def distance_to(border: Labels, labels: Labels, reach_px: float, around_px: float) -> Float32:
    """Return the Euclidean distance of every pixel (h, w) to the nearest border pixel, in pixels.

    Infinite where the distance exceeds ``reach_px``, or where the pixel is farther than ``around_px`` from
    the person.
    """
    reach = min(reach_px, FARTHEST_PX)
    return np.asarray(passes.distances(np.ascontiguousarray(labels), border, reach, around_px))


def boundary_counts(of_truth: Labels, of_prediction: Labels, tolerances_px: Sequence[float]) -> Counts:
    """Return matched and all border pixels of the prediction, then of the truth: int64 (T, 4).

    A border pixel (of `border_parts`) is matched by one of the same part within the tolerance (Euclidean) in
    the other map. Counts of frames add up; `boundary_f` turns them into the score.
    """
    reach = min(max(tolerances_px), FARTHEST_PX)
    drawn = passes.apart(of_prediction, of_truth, reach)
    true = passes.apart(of_truth, of_prediction, reach)
    within = [[np.count_nonzero(a <= tolerance) for a in (drawn, true)] for tolerance in tolerances_px]
    return np.array([[near, len(drawn), found, len(true)] for near, found in within], np.int64)


def boundary_f(counts: Counts) -> Scores:
    """Return the harmonic mean of border precision and recall: (..., 4) -> (...); NaN without any border.

    Source: Csurka et al., What is a good evaluation measure for semantic segmentation?, BMVC 2013.
    """
    near, drawn, met, true = np.moveaxis(np.asarray(counts, np.float64), -1, 0)
    precise, recalled = near / np.maximum(drawn, 1), met / np.maximum(true, 1)
    score = 2 * precise * recalled / np.maximum(precise + recalled, np.finfo(np.float64).tiny)
    return np.where(drawn + true > 0, score, np.nan)


def band_counts(
    truth: Labels, predicted: Labels, away: tuple[Float32, Float32], widths_px: Sequence[float]
) -> Counts:
    """Return intersection and union of the bands along each part's outline: int64 (W, 12, 2).

    A part's band holds its pixels closer than the width to a border of the same map. away: distances (h, w)
    to the borders of truth and of prediction. Their ratio is the boundary IoU (Cheng et al., Boundary IoU,
    CVPR 2021), here with Euclidean bands and without the image edge.
    """
    maps = np.ascontiguousarray(truth), np.ascontiguousarray(predicted)
    hit, true, drawn = np.moveaxis(passes.bands(*maps, *away, np.array(widths_px, np.float32)), -1, 0)
    return np.stack([hit, true + drawn - hit], axis=-1)


def errors_by_distance(truth: Labels, predicted: Labels, away: Float32) -> Counts:
    """Return wrong and all person pixels of the truth, by part and distance to a border: int64 (12, 7, 2).

    away: distance to the borders of the truth, 0 on the border itself; bins end at `DISTANCE_EDGES_PX`.
    """
    maps = np.ascontiguousarray(truth), np.ascontiguousarray(predicted)
    return np.asarray(passes.errors(*maps, away, np.array(DISTANCE_EDGES_PX, np.float32)))


def error_rate(counts: Counts) -> Scores:
    """Return the share of wrong pixels: wrong and all (..., 2) -> (...), NaN without pixels."""
    return ratio(counts[..., 0], counts[..., 1])
