"""How far a thermal camera's calibration has drifted, told from an ordinary session of a warm person.

Every frame says a little (``annotate.person.alignment``); their contrasts add up to a peak that a parabola
places between the shifts tried, and groups of frames say how sure it is.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np

from annotate.array_types import Float64
from annotate.cloud.fuse import Fuser
from annotate.person.alignment import LEAST_EDGES, STEP_PX, contrast_surface
from annotate.person.warm_window import WINDOW_C, find_window
from sensors.errors import CalibrationError
from sensors.rig.frame import RigFrame
from sensors.rig.rig_calibration import RigCalibration

AROUND_PX = 40
"""How far from warm pixels silhouettes count."""
GROUPS = 8
TOLERABLE_DEG = 0.5
"""One pixel of a PI200 with its 72 degree lens: what fusing and extraction were made for."""


@dataclass(frozen=True)
class Drift:
    """The thermal image's place over the depth image. shift_px: (right, down), in depth pixels.

    sd_px: their standard deviations over groups of frames. degrees: the angle between the cameras that it
    stands for. frames: how many said something.
    """

    shift_px: tuple[float, float]
    sd_px: tuple[float, float]
    degrees: float
    frames: int

    @property
    def is_tolerable(self) -> bool:
        """Whether the calibration can go on being used."""
        return self.degrees <= TOLERABLE_DEG


def measure_drift(frames: Iterable[RigFrame], calibration: RigCalibration) -> Drift:
    """Measure over all frames that have temperatures.

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
        side = 2 * AROUND_PX + 1
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
    return Drift((right, down), (float(sd[0]), float(sd[1])), degrees, len(surfaces))


def _peak(surface: Float64) -> tuple[float, float]:
    """(right, down) of the highest point of contrasts (n, n) by shift, between the shifts by a parabola."""
    rows, columns = surface.shape
    row, column = np.unravel_index(int(surface.argmax()), surface.shape)
    down = row + _vertex(surface[max(row - 1, 0) : row + 2, column]) - (rows - 1) / 2
    right = column + _vertex(surface[row, max(column - 1, 0) : column + 2]) - (columns - 1) / 2
    return float(right * STEP_PX), float(down * STEP_PX)


def _vertex(three: Float64) -> float:
    """Where a parabola through three values at -1, 0, 1 is highest; 0 at the border."""
    if len(three) < 3 or (bend := three[0] - 2 * three[1] + three[2]) >= 0:
        return 0.0
    return float(0.5 * (three[0] - three[2]) / bend)
