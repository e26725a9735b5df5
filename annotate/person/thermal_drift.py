"""Drift of a thermal camera's calibration, measured on an ordinary session of a warm person.

The contrasts of all frames (``annotate.person.alignment``) add up to a peak that a parabola places between
the shifts tried; groups of frames give its standard deviation.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np

from annotate.array_types import Float64
from annotate.cloud.fuse import Fuser
from annotate.person.alignment import LEAST_EDGES, SHIFT_PX, contrast_surface
from annotate.person.warm_window import WINDOW_C, find_window
from sensors.errors import CalibrationError
from sensors.rig.frame import RigFrame
from sensors.rig.rig_calibration import RigCalibration

SILHOUETTES_PX = 40
"""Distance in pixels from warm pixels within which silhouettes count. Chosen by eye."""
GROUPS = 8
"""Groups of frames that give the standard deviation; least number of frames. Chosen by eye."""
TOLERABLE_DEG = 0.5
"""Largest drift in degrees that fusing and extraction allow for: one pixel of a PI200 with its 72 degree
lens."""


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


def measure_drift(frames: Iterable[RigFrame], calibration: RigCalibration) -> ThermalDrift:
    """Drift over all frames that have temperatures.

    Raises CalibrationError where fewer than ``GROUPS`` frames show a warm person's silhouette.
    """
    fuser = Fuser(calibration)
    surfaces = []
    for frame in frames:
        if frame.thermal_c is None or calibration.thermal is None:
            continue
        cloud = fuser.fuse(frame.depth_mm, None, frame.thermal_c)
        window = find_window(cloud, cloud.valid) or WINDOW_C
        warm = cloud.valid & (cloud.temperature_c >= window[0]) & (cloud.temperature_c <= window[1])
        side = 2 * SILHOUETTES_PX + 1
        around = cv2.dilate(warm.astype(np.uint8), np.ones((side, side), np.uint8)) > 0
        surface, edges = contrast_surface(cloud, window, np.asarray(around))
        if edges >= LEAST_EDGES:
            surfaces.append(surface)
    if len(surfaces) < GROUPS:
        raise CalibrationError(
            f"{len(surfaces)} frames show a warm person's outline in depth and temperature; "
            f"give a session with at least {GROUPS}"
        )
    groups = [np.mean(surfaces[i::GROUPS], axis=0) for i in range(GROUPS)]
    right, down = _peak(np.mean(surfaces, axis=0))
    each = np.array([_peak(group) for group in groups])
    sd = each.std(axis=0, ddof=1) / np.sqrt(GROUPS)
    degrees = float(np.degrees(np.arctan2(np.hypot(right, down), fuser.camera.fx)))
    return ThermalDrift((right, down), (float(sd[0]), float(sd[1])), degrees, len(surfaces))


def _peak(surface: Float64) -> tuple[float, float]:
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
