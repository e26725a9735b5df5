"""Shift of the thermal image against the depth image, found where warm and cold should meet.

At a person's silhouette depth jumps, and temperature with it. Points just inside and just outside of the
jumps are looked up in the temperatures under every shift of a grid; the shift with the largest difference
between inside and outside is the error of the thermal camera's calibration.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit

from annotate.array_types import Bool, Float32, Float64, Int64
from annotate.cloud.thermal_cloud import ThermalCloud

SILHOUETTE_JUMP = 0.08
"""Depth difference across a silhouette as a share of the nearer depth: 16 cm at 2 m. Chosen by eye."""
INSIDE_PX = 3
"""Pixels from the jump to the point compared on the near side. Chosen by eye."""
OUTSIDE_PX = 4
"""The same on the far side; a thermal pixel is three depth pixels wide. Chosen by eye."""
SEARCHED_PX = 42
"""Farthest shift tried to each side in depth pixels, 6.5 degrees of a Kinect v2. Chosen by eye."""
SHIFT_PX = 3
"""Spacing of the shifts tried in depth pixels: one thermal pixel of a PI200."""
MOST_EDGES = 600
"""Pairs of points compared at most, for speed. Chosen by eye."""
LEAST_EDGES = 80
"""Pairs of points below which the contrast counts as unknown. Chosen by eye."""
FILL_PX = 15
"""Side in pixels of the window whose mean stands in for a missing temperature. Chosen by eye."""
OFF_PX = 8.0
"""Least shift in pixels of a camera that counts as off. Chosen by eye."""
CONTRAST_GAIN = 2.1
"""Factor by which that shift must raise the contrast. Chosen by eye."""
LEAST_CONTRAST = 0.12
"""Least contrast after that shift, as a share of the person's warmth above the room. Chosen by eye."""


@dataclass(frozen=True)
class Alignment:
    """Best shift (right, down) of the temperatures over the depth image, in depth pixels.

    contrast: mean warmth inside silhouettes above that outside as calibrated, as a share of the difference
    between person and room. best: the same after the shift. edges: pairs of points compared.
    """

    shift_px: tuple[float, float]
    contrast: float
    best: float
    edges: int

    @property
    def is_off(self) -> bool:
        """Whether the calibration misplaces the thermal image: a far shift with a much larger contrast."""
        far = float(np.hypot(*self.shift_px)) >= OFF_PX
        return (
            far
            and self.edges >= LEAST_EDGES
            and self.best >= max(LEAST_CONTRAST, CONTRAST_GAIN * self.contrast)
        )

    def degrees(self, focal_px: float) -> float:
        """Angle of the shift in degrees for a depth camera of focal length ``focal_px`` pixels."""
        return float(np.degrees(np.arctan2(np.hypot(*self.shift_px), focal_px)))


def thermal_alignment(cloud: ThermalCloud, window_c: tuple[float, float], around: Bool) -> Alignment:
    """Alignment of a cloud's temperatures with its depth.

    window_c: a person's (least, most) degrees Celsius. around: bool (h, w), where silhouettes count.
    """
    contrast, edges = contrast_surface(cloud, window_c, around)
    if not edges:
        return Alignment((0.0, 0.0), 0.0, 0.0, 0)
    row, column = np.unravel_index(int(contrast.argmax()), contrast.shape)
    middle = len(contrast) // 2
    shift = float(SHIFT_PX * (column - middle)), float(SHIFT_PX * (row - middle))
    return Alignment(shift, float(contrast[middle, middle]), float(contrast.max()), edges)


def contrast_surface(cloud: ThermalCloud, window_c: tuple[float, float], around: Bool) -> tuple[Float64, int]:
    """Contrast (n, n) of every shift, down by rows and right by columns, and the number of pairs of points.

    The middle is no shift; steps are ``SHIFT_PX`` pixels. Arguments as of ``thermal_alignment``.
    """
    inside, outside = _sides(cloud.points_m[..., 2], around)
    stride = max(1, len(inside) // MOST_EDGES)
    shifts = np.arange(-SEARCHED_PX, SEARCHED_PX + 1, SHIFT_PX)
    if not len(inside):
        return np.zeros((len(shifts), len(shifts))), 0
    inside, outside = inside[::stride], outside[::stride]
    return _contrasts(_warmth_image(cloud, window_c), inside, outside, shifts), len(inside)


def _warmth_image(cloud: ThermalCloud, window_c: tuple[float, float]) -> Float32:
    """Warmth (h, w) from 0 below the window to 1 in it, gaps filled by the mean around them."""
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
    """Pixels [v, u] (n, 2) just inside and just outside of depth jumps; the near side is inside."""
    insides, outsides = [], []
    for axis in (0, 1):
        before, after = _slices(axis, depth_m.shape[axis])
        nearer = np.fmin(depth_m[before], depth_m[after])
        step = (depth_m[after] - depth_m[before]) / nearer
        for sign in (1, -1):
            v, u = np.nonzero((sign * step > SILHOUETTE_JUMP) & around[before])
            at = np.stack([v, u], axis=1)
            middle = at.copy()
            middle[:, axis] += 1
            direction = np.zeros(2, np.int64)
            direction[axis] = sign
            insides.append(middle - INSIDE_PX * direction)
            outsides.append(middle + OUTSIDE_PX * direction)
    return np.concatenate(insides), np.concatenate(outsides)


def _slices(axis: int, size: int) -> tuple[tuple[slice, ...], tuple[slice, ...]]:
    """Slices of an image along ``axis`` to the earlier and the later of all pixels two apart."""
    before, after = [slice(None)] * 2, [slice(None)] * 2
    before[axis], after[axis] = slice(0, size - 2), slice(2, size)
    return tuple(before), tuple(after)


@njit(cache=True, nogil=True)
def _contrasts(warmth: Float32, inside: Int64, outside: Int64, shifts: Int64) -> Float64:
    """Mean difference (n, n) of warmth inside less outside, by shifts down (rows) and right (columns)."""
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
