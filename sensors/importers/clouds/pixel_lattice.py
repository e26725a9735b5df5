"""Detection of the pixel grid of the camera that recorded an unorganised cloud, from the points' directions.

Points of a depth image lie on rays through pixel centres: u = f x/z + c is a whole number for all of them.
The focal length is the smallest f at which these phases agree (a periodogram of x/z). Fused, thinned out or
noisy clouds have no such grid. Constants are untuned unless a source is given.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FOCAL_PX = (50.0, 2000.0)  # focal lengths tried: from a thinned-out image to a 4K one
BINS_PX = 8  # bins of directions per pixel of the longest focal length
FINER = 4  # focal lengths tried per resolvable step of the span of directions
AGREE = 0.8  # least mean phase: a grid has 1, whole millimetres at 2 m (Kinect v2) 0.95, chance 0.04
WIDEST_SPAN = 4.0  # span of directions that no camera reaches: 127 degrees
FEWEST_PX = 16  # pixels that the points must span
RESIDUAL_PX = 0.15  # largest RMS from pixel centres: chance gives 0.29


class Line(NamedTuple):
    """Pixel grid along one image axis: f * direction + c is a whole number, 0 <= c < 1.

    f is ``focal_px``, c is ``centre_px``.
    """

    focal_px: float
    centre_px: float


def find_line(directions: NDArray[np.float64]) -> Line | None:
    """Return the grid on which x/z or y/z (n,) of a cloud lie; None without a grid."""
    if len(directions) < 50:
        return None
    low, high = np.percentile(directions, (0.1, 99.9))
    span = float(high - low)
    if not FEWEST_PX / FOCAL_PX[1] < span < WIDEST_SPAN:
        return None
    width = 1 / (BINS_PX * FOCAL_PX[1])
    counts, _ = np.histogram(directions, max(2, int(np.ceil(span / width))), (low, high))
    length = 1 << int(np.ceil(np.log2(FINER * len(counts))))
    step = 1 / (length * span / len(counts))
    # The transform of the histogram is the sum of all phases, for every focal length at once.
    agreed = np.abs(np.fft.rfft(counts, length)) / max(1, counts.sum())
    first = int(np.ceil(max(FOCAL_PX[0], FEWEST_PX / span) / step))
    on = first + np.flatnonzero(agreed[first : int(FOCAL_PX[1] / step) + 1] > AGREE)
    if not len(on):
        return None
    # The first peak: the following ones are multiples.
    peak = on[0] + int(np.argmax(agreed[on[0] : on[0] + 2 * FINER]))
    return _refined(directions[(directions >= low) & (directions <= high)], peak * step)


def _refined(directions: NDArray[np.float64], focal: float) -> Line | None:
    """Return the grid fitted by least squares of whole pixels over directions, from the middle outwards."""
    middle = float(np.median(directions))
    away = directions - middle
    reach = np.abs(away).max()
    fraction = -float(np.angle(np.exp(2j * np.pi * focal * away).mean()) / (2 * np.pi))
    residual = np.inf
    for share in (0.3, 0.6, 1.0, 1.0):
        near = np.abs(away) <= share * reach
        pixels = np.rint(focal * away[near] + fraction)
        slope, offset = np.polyfit(away[near], pixels, 1) if np.ptp(pixels) > 0 else (focal, fraction)
        focal, fraction = float(slope), float(offset)
        residual = float(np.sqrt(np.mean((focal * away[near] + fraction - pixels) ** 2)))
    if not residual < RESIDUAL_PX or not FOCAL_PX[0] / 2 < focal < FOCAL_PX[1]:
        return None
    return Line(focal, (fraction - focal * middle) % 1.0)
