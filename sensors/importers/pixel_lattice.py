"""The pixel grid of the camera that took an unorganised cloud, found in the directions of its points.

Points of a depth image lie on rays through pixel centres: u = f x/z + c is a whole number for all of them.
The focal length is the smallest f at which these phases agree (a periodogram of x/z). Fused, thinned out or
noisy clouds have no such grid.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FOCAL_PX = (50.0, 2000.0)
"""Focal lengths tried, in pixels: from a thinned-out image to a 4K one."""
SAMPLE = 1500
"""Points whose phases are compared; untuned."""
PHASE_STEP = 0.1
"""Largest change of phase, in cycles, between two focal lengths tried; untuned."""
AGREE = 0.8
"""Least mean of the phases as unit vectors: 1 on a grid, 0.03 where there is none (0.86 for coordinates in whole
millimetres, 2 m away, at a Kinect v2's focal length)."""
FEWEST_PX = 16
"""Pixels that the points must span; untuned."""
RESIDUAL_PX = 0.15
"""Largest RMS from pixel centres, in pixels: chance gives 0.29."""


class Line(NamedTuple):
    """Pixel = focal_px * direction + centre_px, centre in [0, 1): whole numbers of pixels are unknown."""

    focal_px: float
    centre_px: float


def find_line(directions: NDArray[np.float64], seed: int = 0) -> Line | None:
    """The grid on which x/z or y/z (n,) of a cloud lie; None where there is none."""
    span = float(np.ptp(directions)) if len(directions) else 0.0
    if not span > 0 or len(directions) < 50:
        return None
    few = np.random.default_rng(seed).choice(directions, min(SAMPLE, len(directions)), replace=False)
    few -= few.mean()
    step = PHASE_STEP / span
    focals = np.arange(max(FOCAL_PX[0], FEWEST_PX / span), FOCAL_PX[1], step)
    # exp(i (f + df) r) = exp(i f r) exp(i df r): one product for each focal length.
    if not len(focals):
        return None
    turn, phase = np.exp(2j * np.pi * step * few), np.exp(2j * np.pi * focals[0] * few)
    agreed = np.zeros(len(focals))
    for number in range(len(focals)):
        agreed[number] = abs(phase.mean())
        phase = phase * turn
    on = np.flatnonzero(agreed > AGREE)
    if not len(on):
        return None
    # The first peak: the following ones are multiples.
    peak = on[0] + int(np.argmax(agreed[on[0] : on[0] + 2 * int(1 / PHASE_STEP)]))
    return _refined(directions, float(focals[peak]))


def _refined(directions: NDArray[np.float64], focal: float) -> Line | None:
    """Least squares of whole pixels over directions, from the middle outwards."""
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
