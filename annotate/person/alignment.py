"""Does the thermal image lie on the depth image? Warm and cold must change where near and far do.

At a person's silhouette depth jumps, and temperature with it. Points just inside and just outside of the
jumps are looked up in the temperatures shifted by every few pixels: the shift at which inside is most
above outside is how far the thermal camera is off.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit

from annotate.array_types import Bool, Float32, Float64, Int64
from annotate.cloud.thermal_cloud import ThermalCloud

JUMP = 0.08
"""Depth difference, as a share of the nearer one, across a silhouette: 16 cm at 2 m."""
INSIDE_PX, OUTSIDE_PX = 3, 4
"""Where the two sides are looked up, pixels from the jump: a thermal pixel is three depth pixels wide."""
SEARCHED_PX, STEP_PX = 42, 3
"""Shifts tried to each side, 6.5 degrees of a Kinect v2, and their spacing, one thermal pixel."""
MOST_EDGES = 600
LEAST_EDGES = 80
"""With fewer points on silhouettes nothing can be said."""
FILL_PX = 15
"""Points without a temperature take the mean of a window of this size."""
OFF_PX, GAIN, LEAST_CONTRAST = 8.0, 2.1, 0.12
"""A camera is off when a shift of at least this much raises the contrast by this factor, to at least this
share of a person's warmth."""


@dataclass(frozen=True)
class Alignment:
    """Best shift of the temperatures over the depth image, (right, down) in its pixels, and what it gains.

    contrast: how much warmer the insides of silhouettes are than the outsides as things stand, as a share
    of the difference between person and room. best: the same after the shift. edges: points compared.
    """

    shift_px: tuple[float, float]
    contrast: float
    best: float
    edges: int

    @property
    def is_off(self) -> bool:
        """Whether the thermal image does not belong where the calibration puts it."""
        far = float(np.hypot(*self.shift_px)) >= OFF_PX
        return far and self.edges >= LEAST_EDGES and self.best >= max(LEAST_CONTRAST, GAIN * self.contrast)

    def degrees(self, focal_px: float) -> float:
        """The angle that the shift is in a camera of this focal length."""
        return float(np.degrees(np.arctan2(np.hypot(*self.shift_px), focal_px)))


def thermal_alignment(cloud: ThermalCloud, window_c: tuple[float, float], around: Bool) -> Alignment:
    """How the temperatures of a frame lie on its depth.

    window_c: a person's temperatures; around: bool (h, w), where silhouettes count.
    """
    contrast, edges = contrast_surface(cloud, window_c, around)
    if not edges:
        return Alignment((0.0, 0.0), 0.0, 0.0, 0)
    row, column = np.unravel_index(int(contrast.argmax()), contrast.shape)
    middle = len(contrast) // 2
    shift = float(STEP_PX * (column - middle)), float(STEP_PX * (row - middle))
    return Alignment(shift, float(contrast[middle, middle]), float(contrast.max()), edges)


def contrast_surface(cloud: ThermalCloud, window_c: tuple[float, float], around: Bool) -> tuple[Float64, int]:
    """Contrast (n, n) at every shift tried, down by rows and right by columns; how many points were compared.

    The middle is no shift, its neighbours are ``STEP_PX`` apart.
    """
    inside, outside = _sides(cloud.points_m[..., 2], around)
    stride = max(1, len(inside) // MOST_EDGES)
    shifts = np.arange(-SEARCHED_PX, SEARCHED_PX + 1, STEP_PX)
    if not len(inside):
        return np.zeros((len(shifts), len(shifts))), 0
    inside, outside = inside[::stride], outside[::stride]
    return _contrasts(_filled(cloud, window_c), inside, outside, shifts), len(inside)


def _filled(cloud: ThermalCloud, window_c: tuple[float, float]) -> Float32:
    """Temperature (h, w) as 0 below the window to 1 in it, without gaps."""
    low, high = window_c
    span = np.float32(0.5 * (high - low))
    warmth = np.clip((cloud.temperature_c - np.float32(low)) / span + np.float32(0.5), 0, 1)
    known = np.isfinite(warmth)
    window = (FILL_PX, FILL_PX)
    total = cv2.boxFilter(np.where(known, warmth, np.float32(0)), cv2.CV_32F, window)
    share = cv2.boxFilter(known.astype(np.float32), cv2.CV_32F, window)
    filled = np.where(known, warmth, total / np.maximum(share, np.float32(1e-3)))
    return np.asarray(filled, np.float32)


def _sides(depth_m: Float32, around: Bool) -> tuple[Int64, Int64]:
    """Pixels (n, 2) just inside and just outside of jumps, the near side being inside."""
    insides, outsides = [], []
    for axis in (0, 1):
        before, after = _slices(axis, depth_m.shape[axis])
        nearer = np.fmin(depth_m[before], depth_m[after])
        step = (depth_m[after] - depth_m[before]) / nearer
        for sign in (1, -1):
            v, u = np.nonzero((sign * step > JUMP) & around[before])
            at = np.stack([v, u], axis=1)
            middle = at.copy()
            middle[:, axis] += 1
            direction = np.zeros(2, np.int64)
            direction[axis] = sign
            insides.append(middle - INSIDE_PX * direction)
            outsides.append(middle + OUTSIDE_PX * direction)
    return np.concatenate(insides), np.concatenate(outsides)


def _slices(axis: int, size: int) -> tuple[tuple[slice, ...], tuple[slice, ...]]:
    """Index of pixels two apart along an axis, the earlier and the later ones."""
    before, after = [slice(None)] * 2, [slice(None)] * 2
    before[axis], after[axis] = slice(0, size - 2), slice(2, size)
    return tuple(before), tuple(after)


@njit(cache=True, nogil=True)
def _contrasts(warmth: Float32, inside: Int64, outside: Int64, shifts: Int64) -> Float64:
    """Mean of warmth inside less outside (n, n) for every shift down (rows) and right (columns)."""
    height, width = warmth.shape
    contrast = np.zeros((shifts.size, shifts.size))
    for i in range(shifts.size):
        for j in range(shifts.size):
            total, count = 0.0, 0
            for k in range(inside.shape[0]):
                v0, u0 = inside[k, 0] + shifts[i], inside[k, 1] + shifts[j]
                v1, u1 = outside[k, 0] + shifts[i], outside[k, 1] + shifts[j]
                if min(v0, u0, v1, u1) >= 0 and max(v0, v1) < height and max(u0, u1) < width:
                    total += warmth[v0, u0] - warmth[v1, u1]
                    count += 1
            contrast[i, j] = total / count if count > inside.shape[0] // 2 else 0.0
    return contrast
