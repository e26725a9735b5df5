"""Shift of the thermal image against the depth image, of one frame and of a session: the calibration's drift.

At a person's silhouette depth jumps, and temperature with it. Points just inside and just outside of the
jumps are looked up in the temperatures under every shift of a grid; the shift with the largest difference
between inside and outside is the error of the thermal camera's calibration. Over a session the contrasts of
all frames add up to a peak that a parabola places between the shifts tried.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit

from annotate.array_types import Bool, Float32, Float64, Int64
from annotate.cloud.fuse import Fuser
from annotate.cloud.grid import grown
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.person.warmth import WINDOW_C, find_window, is_warm, warmth
from sensors.errors import CalibrationError
from sensors.rig.camera import Intrinsics
from sensors.rig.frame import RigFrame
from sensors.rig.rig_calibration import RigCalibration

SILHOUETTE_JUMP = 0.08
"""Depth difference across a silhouette as a share of the nearer depth: 16 cm at 2 m. Chosen by eye."""
SEARCHED = 0.115
"""Farthest shift tried to each side as a share of the focal length, 6.5 degrees, and how far from warm pixels
silhouettes count. Chosen by eye."""
SHIFT_PX = 3
"""Spacing of the shifts in pixels, and distance of the points compared from the jump between them: a thermal
pixel of a PI200 on a Kinect v2."""
LEAST_EDGES, OFF_PX = 80, 8.0
"""Pairs of points below which the contrast counts as unknown; least shift in pixels that counts as off.
Chosen by eye."""
LEAST_GAIN, WARMER = 0.1, 0.04
"""Least gain by that shift in contrast, and in the warmth of persons' pixels, a share. Of 713 frames of the
virtual rig they take none for moved, and 446 of them moved by 5 to 8 thermal pixels; 0.1, 0.05: none, 425."""
GROUPS = 8
"""Groups of frames that give the standard deviation; least number of frames. Chosen by eye."""
TOLERABLE_DEG = 0.5
"""Largest drift in degrees that fusion and extraction bear: a pixel of a PI200 with its 72 degree lens."""


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


def contrasts(cloud: ThermalCloud, window_c: tuple[float, float], warm: Bool) -> Float64 | None:
    """Contrast (n, n) of every shift, down by rows and right by columns; None for lack of silhouettes.

    A contrast is the mean warmth inside silhouettes less that outside: 1 between a person and the room. The
    middle is no shift; steps are ``SHIFT_PX`` pixels. window_c: a person's (least, most) degrees Celsius.
    warm: bool (h, w), near which silhouettes count.
    """
    reach_px = SEARCHED * cloud.camera.fx
    inside, outside = _sides(cloud.points_m[..., 2], grown(warm, reach_px))
    if len(inside) < LEAST_EDGES:
        return None
    steps = round(reach_px) // SHIFT_PX
    shifts = SHIFT_PX * np.arange(-steps, steps + 1)
    return _contrasts(warmth(cloud.temperature_c, window_c).clip(0, 1), inside, outside, shifts)


def warm_contrasts(cloud: ThermalCloud) -> Float64 | None:
    """Contrasts at the silhouettes of all that is as warm as a person, found from the cloud itself."""
    window = find_window(cloud, cloud.valid) or WINDOW_C
    return contrasts(cloud, window, cloud.valid & is_warm(cloud.temperature_c, window))


def misplacement_px(surface: Float64) -> tuple[float, float] | None:
    """Shift (right, down) in pixels by which contrasts (n, n) say that the calibration is wrong, or None.

    That is a far shift with a larger contrast: somebody in bed has few silhouettes, and a bed has long ones.
    """
    gain = surface.max() - surface[len(surface) // 2, len(surface) // 2]
    shift_px = peak_px(surface)
    return shift_px if np.hypot(*shift_px) >= OFF_PX and gain >= LEAST_GAIN else None


def is_warmer(warmth: Float32, persons: Bool, shift_px: tuple[float, float]) -> bool:
    """Whether persons (h, w), if any, gain known warmth (h, w) by a shift: else furniture tells it."""
    moved = np.roll(warmth, [-round(px) for px in shift_px[::-1]], axis=(0, 1))
    gain = (moved - warmth)[persons & np.isfinite(warmth)]
    return not np.isfinite(gain).any() or bool(np.nansum(gain) > WARMER * gain.size)


def measure_drift(frames: Iterable[RigFrame], calibration: RigCalibration) -> ThermalDrift:
    """Drift over all frames that have temperatures.

    Raises CalibrationError where fewer than ``GROUPS`` frames show a warm person's silhouette.
    """
    fuser = Fuser(calibration)
    surfaces = []
    for frame in frames:
        if frame.thermal_c is None or calibration.thermal is None:
            continue
        surface = warm_contrasts(fuser.fuse(frame.depth_mm, None, frame.thermal_c))
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
            insides.append(middle - SHIFT_PX * direction)
            outsides.append(middle + SHIFT_PX * direction)
    return np.concatenate(insides), np.concatenate(outsides)


@njit(cache=True, nogil=True)
def _contrasts(warmth: Float32, inside: Int64, outside: Int64, shifts: Int64) -> Float64:
    """Mean difference (n, n) of warmth inside less outside, by shifts down (rows) and right (columns)."""
    height, width = warmth.shape
    contrast = np.zeros((shifts.size, shifts.size))
    for i in range(shifts.size):
        for j in range(shifts.size):
            total, seen, known = 0.0, 0, 0
            for k in range(inside.shape[0]):
                v0, u0 = inside[k, 0] + shifts[i], inside[k, 1] + shifts[j]
                v1, u1 = outside[k, 0] + shifts[i], outside[k, 1] + shifts[j]
                if min(v0, u0, v1, u1) >= 0 and max(v0, v1) < height and max(u0, u1) < width:
                    seen += 1
                    difference = warmth[v0, u0] - warmth[v1, u1]
                    if not np.isnan(difference):
                        total += difference
                        known += 1
            if known >= LEAST_EDGES and seen > inside.shape[0] // 2:
                contrast[i, j] = total / known
    return contrast
