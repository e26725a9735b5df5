"""Boundary scores: agreement of the borders between parts, and errors by distance to a border.

A border pixel is a part's pixel with a 4-neighbour of another label, a part or background. The image's edge
and undefined pixels are not borders. Both borders count only where the truth is defined. Constants are
untuned.
"""

from collections.abc import Sequence

import numpy as np

from annotate.array_types import Float32
from eval.scores import kernels
from eval.scores.confusion import Counts, Labels, Scores, ratio

TOLERANCES_PX = (1.0, 2.0, 3.0, 5.0)  # pixels of the depth image
TOLERANCES_MM = (5.0, 10.0, 20.0, 40.0)
"""Largest distances of matching borders; two people's corrections limit the reachable score."""
WIDTHS_PX, WIDTHS_MM = (2.0, 4.0, 8.0), (10.0, 20.0, 40.0)  # of a part's band for boundary IoU
DISTANCE_EDGES_PX = (1.0, 2.0, 3.0, 5.0, 9.0, 17.0)
"""Upper edges, exclusive, of the distance bins; one more bin holds larger distances."""
N_DISTANCES = len(DISTANCE_EDGES_PX) + 1
FARTHEST_PX = 100.0  # limit of all distances, whatever scale a file has: 4 cm at 15 cm from a camera


def boundary_counts(of_truth: Labels, of_prediction: Labels, tolerances_px: Sequence[float]) -> Counts:
    """Count matched and all border pixels of the prediction, matched and all of the truth: int64 (T, 4).

    A border pixel (`kernels.borders`) matches one of the same part within the tolerance (Euclidean) in the
    other map. Counts of frames add up.
    """
    reach = min(max(tolerances_px), FARTHEST_PX)
    drawn = kernels.apart(of_prediction, of_truth, reach)
    true = kernels.apart(of_truth, of_prediction, reach)
    within = [[np.count_nonzero(a <= tolerance) for a in (drawn, true)] for tolerance in tolerances_px]
    return np.array([[near, len(drawn), found, len(true)] for near, found in within], np.int64)


def boundary_f(counts: Counts) -> Scores:
    """Return the harmonic mean of border precision and recall: (..., 4) -> (...); NaN without a border.

    Source: Csurka et al., BMVC 2013.
    """
    near, drawn, met, true = np.moveaxis(np.asarray(counts, np.float64), -1, 0)
    precise, recalled = near / np.maximum(drawn, 1), met / np.maximum(true, 1)
    score = 2 * precise * recalled / np.maximum(precise + recalled, np.finfo(np.float64).tiny)
    return np.where(drawn + true > 0, score, np.nan)


def band_counts(
    truth: Labels,
    predicted: Labels,
    away: tuple[Float32, Float32],
    widths_px: Sequence[float],
    classes: int,
) -> Counts:
    """Count intersection and union of the bands along each part's outline: int64 (W, classes, 2).

    A part's band holds its pixels closer than the width to a border of their own map. away: distances (h, w)
    to the borders of truth and prediction. classes: as in ``kernels``. Source: Cheng et al., Boundary IoU,
    CVPR 2021; here with Euclidean distances and without the image's edge.
    """
    counts = kernels.bands(truth, predicted, away, np.array(widths_px, np.float32), classes)
    hit, true, drawn = np.moveaxis(counts, -1, 0)
    return np.stack([hit, true + drawn - hit], axis=-1)


def error_rate(counts: Counts) -> Scores:
    """Return the share of wrong pixels: wrong and all (..., 2) -> (...); NaN without pixels."""
    return ratio(counts[..., 0], counts[..., 1])
