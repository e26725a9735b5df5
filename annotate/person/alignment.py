"""Shift of the thermal image against the depth image, of one frame and of a session: the calibration's drift.

At a person's silhouette depth jumps, and temperature with it. Points just inside and just outside of the
jumps are looked up in the temperatures under every shift of a grid; the shift with the largest difference
between inside and outside is the error of the thermal camera's calibration. Over a session the contrasts of
all frames add up to a peak that a parabola places between the shifts tried.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numba import njit

from annotate.array_types import Bool, Float32, Float64, Int64
from annotate.cloud.fuse import Fuser
from annotate.cloud.grid import grown
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.person.warmth import WINDOW_C, find_window
from sensors.errors import CalibrationError
from sensors.rig.camera import Intrinsics
from sensors.rig.frame import RigFrame
from sensors.rig.rig_calibration import RigCalibration

SILHOUETTE_JUMP = 0.08
"""Depth difference across a silhouette as a share of the nearer depth: 16 cm at 2 m. Chosen by eye."""
INSIDE_PX, OUTSIDE_PX = 3, 4
"""Pixels from the jump to the points compared: a thermal pixel is three depth pixels wide. Chosen by eye."""
SEARCHED_PX, SEARCHED, SHIFT_PX = 42, 0.115, 3
"""Farthest shift tried to each side in depth pixels and as a share of the focal length, 6.5 degrees (by eye),
and spacing of the shifts: one thermal pixel of a PI200 on a Kinect v2."""
LEAST_EDGES, MOST_EDGES = 80, 600
"""Pairs of points below which the contrast counts as unknown; most compared, for speed. Chosen by eye."""
FILL_PX = 15
"""Side in pixels of the window whose mean stands in for a missing temperature. Chosen by eye."""
OFF_PX, CONTRAST_GAIN = 8.0, 2.1
"""Least shift in pixels of a camera that counts as off, and of its gain in contrast. Chosen by eye."""
LEAST_CONTRAST = 0.12
"""Least contrast after that shift, as a share of the person's warmth above the room. Chosen by eye."""
SILHOUETTES_PX = 40
"""Distance in pixels from warm pixels within which silhouettes count. Chosen by eye."""
GROUPS = 8
"""Groups of frames that give the standard deviation; least number of frames. Chosen by eye."""
TOLERABLE_DEG = 0.5
"""Largest drift in degrees that fusing and extraction allow for: one pixel of a PI200 with its 72 degree
lens."""


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
        far = float(np.hypot(*self.shift_px)) >= OFF_PX and self.edges >= LEAST_EDGES
        return far and self.best >= max(LEAST_CONTRAST, CONTRAST_GAIN * self.contrast)


@dataclass(frozen=True)
class ThermalDrift:
    """Shift (right, down) of the thermal image over the depth image, in depth pixels.

    sd_px: its standard deviations by groups of frames. degrees: the angle of the shift in the depth camera.
    frames: number of frames with enough silhouettes.
    """

    shift_px: tuple[float, float]
    sd_px: tuple[float, float]
    degrees: float
    frames: int

    @property
    def is_tolerable(self) -> bool:
        """Whether the calibration can go on being used."""
        return self.degrees <= TOLERABLE_DEG


def degrees(shift_px: tuple[float, float], camera: Intrinsics) -> float:
    """Angle in degrees of a shift (right, down) over the image of a depth camera."""
    return float(np.degrees(np.arctan2(np.hypot(*shift_px), camera.fx)))


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
    steps = min(SEARCHED_PX, round(SEARCHED * cloud.camera.fx)) // SHIFT_PX
    shifts = SHIFT_PX * np.arange(-steps, steps + 1)
    if not len(inside):
        return np.zeros((len(shifts), len(shifts))), 0
    inside, outside = inside[::stride], outside[::stride]
    return _contrasts(_warmth_image(cloud, window_c), inside, outside, shifts), len(inside)


def warm_contrast(cloud: ThermalCloud) -> Float64 | None:
    """Contrast (n, n) of every shift at the silhouettes of all that is warm; None where these are too few."""
    low_c, high_c = window = find_window(cloud, cloud.valid) or WINDOW_C
    warm = cloud.valid & (cloud.temperature_c >= low_c) & (cloud.temperature_c <= high_c)
    surface, edges = contrast_surface(cloud, window, grown(warm, SILHOUETTES_PX))
    return surface if edges >= LEAST_EDGES else None


def measure_drift(frames: Iterable[RigFrame], calibration: RigCalibration) -> ThermalDrift:
    """Drift over all frames that have temperatures.

    Raises CalibrationError where fewer than ``GROUPS`` frames show a warm person's silhouette.
    """
    fuser = Fuser(calibration)
    surfaces = []
    for frame in frames:
        if frame.thermal_c is None or calibration.thermal is None:
            continue
        surface = warm_contrast(fuser.fuse(frame.depth_mm, None, frame.thermal_c))
        if surface is not None:
            surfaces.append(surface)
    if len(surfaces) < GROUPS:
        raise CalibrationError(
            f"{len(surfaces)} frames show a warm person's outline in depth and temperature; "
            f"give a session with at least {GROUPS}"
        )
    groups = [np.mean(surfaces[i::GROUPS], axis=0) for i in range(GROUPS)]
    shift_px = peak_px(np.mean(surfaces, axis=0))
    each = np.array([peak_px(group) for group in groups])
    sd = each.std(axis=0, ddof=1) / np.sqrt(GROUPS)
    angle = degrees(shift_px, fuser.camera)
    return ThermalDrift(shift_px, (float(sd[0]), float(sd[1])), angle, len(surfaces))


def peak_px(surface: Float64) -> tuple[float, float]:
    """Shift (right, down) in pixels of the highest of contrasts (n, n), between the shifts by a parabola."""
    rows, columns = surface.shape
    row, column = np.unravel_index(int(surface.argmax()), surface.shape)
    down = row + _vertex(surface[max(row - 1, 0) : row + 2, column]) - (rows - 1) / 2
    right = column + _vertex(surface[row, max(column - 1, 0) : column + 2]) - (columns - 1) / 2
    return float(right * SHIFT_PX), float(down * SHIFT_PX)


def _vertex(three: Float64) -> float:
    """Place of the maximum of a parabola through three values at -1, 0, 1; 0 at the border."""
    if len(three) < 3 or (bend := three[0] - 2 * three[1] + three[2]) >= 0:
        return 0.0
    return float(0.5 * (three[0] - three[2]) / bend)


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
    slices: tuple[Any, ...] = (np.s_[:-2], np.s_[2:]), (np.s_[:, :-2], np.s_[:, 2:])
    for axis, (before, after) in enumerate(slices):
        nearer = np.fmin(depth_m[before], depth_m[after])
        step = (depth_m[after] - depth_m[before]) / nearer
        for sign in (1, -1):
            v, u = np.nonzero((sign * step > SILHOUETTE_JUMP) & around[before])
            middle = np.stack([v, u], axis=1)
            middle[:, axis] += 1
            direction = sign * np.eye(2, dtype=np.int64)[axis]
            insides.append(middle - INSIDE_PX * direction)
            outsides.append(middle + OUTSIDE_PX * direction)
    return np.concatenate(insides), np.concatenate(outsides)


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
