"""Warmth (h, w) of each pixel between the room's temperature and a person's, whatever the two are."""

import cv2
import numpy as np

from annotate.array_types import Bool, Float32
from annotate.cloud.thermal_cloud import ThermalCloud

WINDOW_C = (25.0, 35.0)
"""Least and most surface temperature in degrees Celsius of a dressed person in a room, where the frame itself
gives none (Nishi & Miura 2017, section 4.2.1)."""
SPREAD_C, REACH_C = 1.0, 40.0
"""Smoothing of the histograms of room and person in degrees Celsius, as a dressed person is uneven, and their
reach to both sides of the median. Chosen by eye."""
CONTRAST_C, CONTRAST_SPREAD_C = 9.0, 3.0
"""Expected degrees Celsius of clothes above the room, 20 and 29 degrees for most, and their standard
deviation: 6 above a hot room, 14 for skin in a cold one; a blanket or a sofa near a radiator is some 3 above.
Chosen by eye."""
LEAST_M2 = 0.02
"""Warm surface in m2, weighted by its contrast, below which no window is found. Chosen by eye."""
ABOVE_C = 5.0
"""End of the window above the person's commonest temperature in degrees Celsius: bare skin is 3 to 4 degrees
warmer than clothes (ISO 7933), plus a camera's noise."""
LEAST_CONTRAST_C = 1.0
"""Least difference in degrees Celsius between person and background that a share is taken of: a camera's
noise and a room's unevenness are 0.3 each. Chosen by eye."""


def warmth(celsius: Float32, window_c: tuple[float, float]) -> Float32:
    """Share (h, w) of the way from the room's temperature, 0, to a person's, 1; NaN = no reading.

    celsius: float32 (h, w) degrees. window_c: a person's least and most degrees, as ``find_window`` gives.
    """
    low_c, hottest_c = window_c
    person_c = hottest_c - ABOVE_C
    room_c = 2 * low_c - person_c
    return np.asarray((celsius - np.float32(room_c)) / np.float32(max(person_c - room_c, LEAST_CONTRAST_C)))


def is_warm(celsius: Float32, window_c: tuple[float, float]) -> Bool:
    """Flags (h, w) of degrees Celsius (h, w) in a person's window (least, most); False for no reading."""
    low_c, high_c = window_c
    return np.asarray((celsius >= low_c) & (celsius <= high_c), np.bool_)


def find_window(cloud: ThermalCloud, loose: Bool) -> tuple[float, float] | None:
    """Least and most degrees Celsius of a person in this frame, or None where nothing stands out.

    loose: bool (h, w), pixels off the room's planes: a sunlit wall is no person. The room has the commonest
    temperature of all pixels, the person the commonest of the loose and warmer ones, by surface; the window
    begins halfway, at the paper's 25 degrees for a room of 20 and a person of 30. An offset of all
    temperatures moves it by as much.
    """
    known = cloud.valid & np.isfinite(cloud.temperature_c)
    if not known.any():
        return None
    depth_m = cloud.points_m[..., 2]
    surface_m2 = np.asarray(depth_m**2 / (cloud.camera.fx * cloud.camera.fy), np.float32)
    room_c = _mode(cloud.temperature_c[known], surface_m2[known])
    above = cloud.temperature_c - room_c
    belief = surface_m2 * np.exp(-0.5 * np.square((above - CONTRAST_C) / CONTRAST_SPREAD_C))
    warm = known & loose & (np.abs(above - CONTRAST_C) < 2.5 * CONTRAST_SPREAD_C)
    if belief[warm].sum() < LEAST_M2:
        return None
    person_c = _mode(cloud.temperature_c[warm], belief[warm].astype(np.float32))
    return (room_c + person_c) / 2, person_c + ABOVE_C


def _mode(celsius: Float32, weight: Float32) -> float:
    """Commonest temperature in degrees Celsius of temperatures (n,) with weights (n,), histogram smoothed."""
    # Bins around the median: a common offset of all temperatures moves them along.
    middle, bin_c = float(np.median(celsius)), SPREAD_C / 4
    bins, around = round(2 * REACH_C / bin_c), (-REACH_C, REACH_C)
    count, edges_c = np.histogram(celsius - middle, bins, around, weights=weight)
    smooth = cv2.GaussianBlur(count.astype(np.float32)[None], (0, 0), SPREAD_C / bin_c)[0]
    return middle + float(edges_c[smooth.argmax()]) + bin_c / 2


def warmth_share(celsius: Float32, warm: Bool, window_c: tuple[float, float], size_px: int) -> Float32:
    """Share (h, w) of the way from the background's temperature (0) to the person's (1); NaN = no reading.

    celsius: float32 (h, w) degrees, NaN = no reading. warm: bool (h, w). window_c: a person's least and most
    degrees. Both ends are local means, of warm and of colder pixels, over windows of ``size_px`` pixels:
    rooms and clothes are uneven.
    """
    cold = np.isfinite(celsius) & ~warm & (celsius < window_c[1])
    background_c = _local_mean(celsius, cold, size_px)
    above_c = _local_mean(celsius, warm, size_px) - background_c
    return np.asarray((celsius - background_c) / np.maximum(above_c, LEAST_CONTRAST_C), np.float32)


def _local_mean(values: Float32, mask: Bool, size: int) -> Float32:
    """Mean (h, w) over the masked pixels of a square window, ``size`` pixels wide; else over all masked."""
    kept, window, border = np.where(mask, values, np.float32(0)), (size, size), cv2.BORDER_CONSTANT
    total, count = (
        cv2.boxFilter(plane, cv2.CV_32F, window, normalize=False, borderType=border)
        for plane in (kept, mask.astype(np.float32))
    )
    overall = np.float32(kept.sum() / max(mask.sum(), 1))
    return np.where(count > 0.5, total / np.maximum(count, 1), overall).astype(np.float32)
