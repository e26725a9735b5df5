"""Shift of the thermal image relative to the depth image, in a frame and over a session (calibration drift).

At a person's silhouette depth and temperature jump together. The temperatures just inside and just outside of
depth jumps are compared under a grid of shifts. The shift with the largest contrast is the calibration error.
A parabola refines the peak of a session's mean contrasts. Constants are untuned unless a source is given.
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

SILHOUETTE_JUMP = 0.08  # depth difference across a silhouette, share of the nearer depth
SEARCHED = 0.115  # farthest shift tried, share of the focal length; also how far from warm pixels edges count
SHIFT_PX = 3  # spacing of shifts, and distance of compared points from the jump: a PI200's pixel on a Kinect
LEAST_EDGES = 80  # pairs of points below which the contrast is unknown
OFF_PX = 8.0  # least shift that counts as off
LEAST_GAIN = 0.1  # of the contrast by that shift
WARMER = 0.04  # share; least gain in warmth of persons; 0 of 713 aligned frames alarm, 446 shifted ones do
GROUPS = 8  # groups of frames that give the standard deviation; least number of frames
TOLERABLE_DEG = 0.5  # drift that fusion and extraction tolerate: a pixel of a PI200 with its 72 degree lens


@dataclass(frozen=True)
class ThermalDrift:
    """Shift (right, down) of the thermal image relative to the depth image, in depth pixels, over a session.

    sd_px: standard errors, from groups of frames. degrees: angle of the shift in the depth camera. frames:
    number of frames with enough silhouettes.
    """

    shift_px: tuple[float, float]
    sd_px: tuple[float, float]
    degrees: float
    frames: int

    @property
    def is_tolerable(self) -> bool:
        """Return whether the angle is at most ``TOLERABLE_DEG``."""
        return self.degrees <= TOLERABLE_DEG


def degrees(shift_px: tuple[float, float], camera: Intrinsics) -> float:
    """Return the angle in degrees of a shift (right, down) in pixels of a depth camera's image."""
    return float(np.degrees(np.arctan2(np.hypot(*shift_px), camera.fx)))


def contrasts(cloud: ThermalCloud, window_c: tuple[float, float], warm: Bool) -> Float64 | None:
    """Return the contrast (n, n) under shifts, down by rows, right by columns; None with too few silhouettes.

    Contrast: mean warmth inside silhouettes minus outside, 1 between a person and the room. The middle is the
    zero shift. window_c: lowest and highest temperature of a person. warm: bool (h, w), area near which
    silhouettes count.
    """
    reach_px = SEARCHED * cloud.camera.fx
    inside, outside = _sides(cloud.points_m[..., 2], grown(warm, reach_px))
    if len(inside) < LEAST_EDGES:
        return None
    steps = round(reach_px) // SHIFT_PX
    shifts = SHIFT_PX * np.arange(-steps, steps + 1)
    return _contrasts(warmth(cloud.temperature_c, window_c).clip(0, 1), inside, outside, shifts)


def warm_contrasts(cloud: ThermalCloud) -> Float64 | None:
    """Return ``contrasts`` at the silhouettes of all objects as warm as a person."""
    window = find_window(cloud, cloud.valid) or WINDOW_C
    return contrasts(cloud, window, cloud.valid & is_warm(cloud.temperature_c, window))


def misplacement_px(surface: Float64) -> tuple[float, float] | None:
    """Return the shift (right, down) with the highest contrast (n, n); None below the limits of a calibration
    error.

    Small shifts do not count, because the long edges of a bed resemble a person's silhouette.
    """
    gain = surface.max() - surface[len(surface) // 2, len(surface) // 2]
    shift_px = peak_px(surface)
    return shift_px if np.hypot(*shift_px) >= OFF_PX and gain >= LEAST_GAIN else None


def is_warmer(warmth: Float32, persons: Bool, shift_px: tuple[float, float]) -> bool:
    """Return whether a shift (right, down) raises the mean warmth (h, w) on persons (h, w); True without
    warmth.

    Otherwise the contrast comes from furniture.
    """
    moved = np.roll(warmth, [-round(px) for px in shift_px[::-1]], axis=(0, 1))
    gain = (moved - warmth)[persons & np.isfinite(warmth)]
    return not np.isfinite(gain).any() or bool(np.nansum(gain) > WARMER * gain.size)


def measure_drift(frames: Iterable[RigFrame], calibration: RigCalibration) -> ThermalDrift:
    """Measure the drift over all frames with temperatures.

    Raises CalibrationError if fewer than ``GROUPS`` frames show a warm person's silhouette.
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
            f"give a session with at least {GROUPS} such frames"
        )
    groups = [np.mean(surfaces[i::GROUPS], axis=0) for i in range(GROUPS)]
    shift_px = peak_px(np.mean(surfaces, axis=0))
    each = np.array([peak_px(group) for group in groups])
    sd = each.std(axis=0, ddof=1) / np.sqrt(GROUPS)
    angle = degrees(shift_px, fuser.camera)
    return ThermalDrift(shift_px, (float(sd[0]), float(sd[1])), angle, len(surfaces))


def peak_px(surface: Float64) -> tuple[float, float]:
    """Return the shift (right, down) of the highest contrast (n, n), refined by a parabola."""
    rows, columns = surface.shape
    row, column = np.unravel_index(int(surface.argmax()), surface.shape)
    down = row + _vertex(surface[max(row - 1, 0) : row + 2, column]) - (rows - 1) / 2
    right = column + _vertex(surface[row, max(column - 1, 0) : column + 2]) - (columns - 1) / 2
    return float(right * SHIFT_PX), float(down * SHIFT_PX)


def _vertex(three: Float64) -> float:
    """Return the offset from the middle to the maximum of a parabola through three values; 0 without both
    neighbours or a maximum.
    """
    if len(three) < 3 or (bend := three[0] - 2 * three[1] + three[2]) >= 0:
        return 0.0
    return float(0.5 * (three[0] - three[2]) / bend)


def _sides(depth_m: Float32, around: Bool) -> tuple[Int64, Int64]:
    """Return pixels [v, u] (n, 2) on the near side (inside) and on the far side of depth jumps. around: bool
    (h, w), pixels to search.
    """
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
    """Return mean warmth inside minus outside (n, n), by shifts down (rows) and right (columns); 0 with too
    few readings.
    """
    height, width = warmth.shape
    shape, first, last = (shifts.size, shifts.size), shifts.min(), shifts.max()
    total, seen, known = np.zeros(shape), np.zeros(shape, np.int64), np.zeros(shape, np.int64)
    for k in range(inside.shape[0]):
        near, far = inside[k], outside[k]
        within = min(near[1], far[1]) + first >= 0 and max(near[1], far[1]) + last < width
        for i in range(shifts.size):
            v0, v1 = near[0] + shifts[i], far[0] + shifts[i]
            if min(v0, v1) < 0 or max(v0, v1) >= height:
                continue
            for j in range(shifts.size):
                u0, u1 = near[1] + shifts[j], far[1] + shifts[j]
                # Checked before for all shifts of most points, so that the loop vectorises.
                if within or (min(u0, u1) >= 0 and max(u0, u1) < width):
                    difference = warmth[v0, u0] - warmth[v1, u1]
                    seen[i, j] += 1
                    known[i, j] += not np.isnan(difference)
                    total[i, j] += np.float32(0) if np.isnan(difference) else difference
    usable = (known >= LEAST_EDGES) & (seen > inside.shape[0] // 2)
    return np.where(usable, total / np.maximum(known, 1), 0.0)
