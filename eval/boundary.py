"""How well the borders between parts are met, and how errors fall off away from them.

A border pixel is a person pixel with a 4-neighbour of another label, be it another part or
background; the picture's edge and undefined pixels make no border. Both borders are looked at
only where the truth is defined.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from annotate.parts import BACKGROUND, UNDEFINED
from eval.metrics import Counts, Labels, Scores, named, ratio

TOLERANCE_PX = 2.0
"""How far apart two borders may lie and still be one, in pixels of the depth image.

A convention: measure it from two corrections of the same frames where you have them, since a border
cannot be met better than people agree on it (Metrics Reloaded, Nature Methods 2024).
"""

DISTANCE_EDGES_PX = (1.0, 2.0, 3.0, 5.0, 9.0, 17.0)
"""Upper edges, exclusive, of the distance bins; one more bin takes what is farther."""


def border_parts(labels: Labels) -> Labels:
    """Part ids on the border pixels, 0 elsewhere: (h, w) -> (h, w)."""
    border = np.zeros(labels.shape, np.bool_)
    for here, there in (
        (np.s_[1:], np.s_[:-1]),
        (np.s_[:, 1:], np.s_[:, :-1]),
    ):
        a, b = labels[here], labels[there]
        differ = (a != b) & (a != UNDEFINED) & (b != UNDEFINED)
        border[here] |= differ
        border[there] |= differ
    return np.where(border & (labels != UNDEFINED), labels, np.uint8(BACKGROUND))


def boundary_counts(truth: Labels, predicted: Labels, tolerance_px: float = TOLERANCE_PX) -> Counts:
    """Matched and all border pixels of the prediction, matched and all of the truth: int64 (4,).

    A border pixel is matched by one of the same part within `tolerance_px` (Euclidean) in the
    other map. Counts of frames add up; `boundary_f` turns them into the score.
    """
    reach = int(tolerance_px)
    masked = np.where(truth == UNDEFINED, truth, named(predicted))
    of_truth = np.pad(border_parts(truth), reach)
    of_prediction = np.pad(border_parts(masked), reach)
    return np.array(
        [
            _matched(of_prediction, of_truth, tolerance_px),
            np.count_nonzero(of_prediction),
            _matched(of_truth, of_prediction, tolerance_px),
            np.count_nonzero(of_truth),
        ],
        np.int64,
    )


def _matched(border: Labels, other: Labels, tolerance_px: float) -> int:
    # Only border pixels are looked up, so the cost follows the outline, not the picture.
    rows, columns = np.nonzero(border)
    part = border[rows, columns]
    reach = int(tolerance_px)
    met = np.zeros(part.shape, np.bool_)
    for dy in range(-reach, reach + 1):
        for dx in range(-reach, reach + 1):
            if dy * dy + dx * dx <= tolerance_px**2:
                met |= other[rows + dy, columns + dx] == part
    return int(met.sum())


def boundary_f(counts: Counts) -> Scores:
    """Harmonic mean of border precision and recall: (..., 4) -> (...); NaN without any border.

    Source: Csurka et al., What is a good evaluation measure for semantic segmentation?, BMVC 2013.
    """
    near, drawn, met, true = np.moveaxis(np.asarray(counts, np.float64), -1, 0)
    precise, recalled = near / np.maximum(drawn, 1), met / np.maximum(true, 1)
    score = 2 * precise * recalled / np.maximum(precise + recalled, np.finfo(np.float64).tiny)
    return np.where(drawn + true > 0, score, np.nan)


def errors_by_distance(truth: Labels, predicted: Labels) -> Counts:
    """Wrong and all person pixels of the truth by distance to its nearest border: int64 (7, 2).

    Distance is Euclidean in pixels, 0 on the border itself; bins end at `DISTANCE_EDGES_PX`.
    """
    border = border_parts(truth) != BACKGROUND
    person = (truth != UNDEFINED) & (truth != BACKGROUND)
    away = cv2.distanceTransform((~border).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    bins = np.searchsorted(np.array(DISTANCE_EDGES_PX), np.asarray(away)[person], side="right")
    wrong = (truth != predicted)[person]
    size = len(DISTANCE_EDGES_PX) + 1
    return np.stack([np.bincount(bins[wrong], minlength=size), np.bincount(bins, minlength=size)], axis=-1)


def error_rate(counts: Counts) -> NDArray[np.float64]:
    """Share of wrong pixels in each bin: (..., 7, 2) -> (..., 7), NaN for an empty bin."""
    return ratio(counts[..., 0], counts[..., 1])
