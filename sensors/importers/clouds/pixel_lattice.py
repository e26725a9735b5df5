"""Pixel grid of the camera that took an unorganised cloud, found in the directions of its points.

Points of a depth image lie on rays through pixel centres: u = f x/z + c is a whole number for all of them.
The focal length is the smallest f at which these phases agree (a periodogram of x/z). Fused, thinned out or
noisy clouds have no such grid.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FOCAL_PX = (50.0, 2000.0)
"""Focal lengths tried, in pixels: from a thinned-out image to a 4K one."""
BINS_PX = 8
"""Bins of the histogram of directions per pixel of the longest focal length; untuned."""
FINER = 4
"""Focal lengths tried per resolvable step of the span of directions. Untuned."""
AGREE = 0.8
"""Least mean of the phases as unit vectors: 1 on a grid, 0.04 where there is none, 0.95 for coordinates in
whole millimetres 2 m away at a Kinect v2's focal length."""
WIDEST_SPAN = 4.0
"""Span of directions that no camera reaches: 127 degrees. Untuned."""
FEWEST_PX = 16
"""Pixels that the points must span; untuned."""
RESIDUAL_PX = 0.15
"""Largest RMS from pixel centres, in pixels: chance gives 0.29."""


class Line(NamedTuple):
    """Grid of pixels: pixel = focal_px * direction + centre_px.

    centre_px is in [0, 1), because whole numbers of pixels are unknown.
    """

    focal_px: float
    centre_px: float


def find_line(directions: NDArray[np.float64]) -> Line | None:
    """Return the grid on which x/z or y/z (n,) of a cloud lie; None where there is none."""
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
    """Fit whole pixels over directions by least squares, from the middle outwards."""
    middle = float(np.median(directions))
    away = directions - middle
    reach = np.abs(away).max()
    centre = float(np.angle(np.exp(2j * np.pi * focal * away).mean()) / (2 * np.pi))
    fraction = -centre
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
