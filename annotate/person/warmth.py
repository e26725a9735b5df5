"""Warmth (h, w) of each pixel: temperature scaled to 0 at the room's, 1 at a person's.

Temperatures are in degrees Celsius. Constants are untuned unless a source is given.
"""

import cv2
import numpy as np

from annotate.array_types import Bool, Float32
from annotate.cloud.thermal_cloud import ThermalCloud

WINDOW_C = (25.0, 35.0)  # surface of a dressed person, where a frame gives none (Nishi & Miura 2017, 4.2.1)
SPREAD_C, REACH_C = 1.0, 40.0  # smoothing of the histograms; their reach to both sides of the median
CONTRAST_C, CONTRAST_SPREAD_C = 9.0, 3.0  # clothes above the room: 6 in a hot one, 14 for skin in a cold one
LEAST_M2 = 0.02  # warm surface, weighted by its contrast, below which no window is found
ABOVE_C = 5.0  # end of the window above a person's commonest temperature: skin 3 to 4 (ISO 7933), plus noise
LEAST_CONTRAST_C = 1.0  # between person and background; noise and unevenness are 0.3 each


def warmth(celsius: Float32, window_c: tuple[float, float]) -> Float32:
    """Return the warmth (h, w) of temperatures (h, w), NaN = no reading.

    window_c: a person's lowest and highest temperature, from ``find_window``.
    """
    low_c, hottest_c = window_c
    person_c = hottest_c - ABOVE_C
    room_c = 2 * low_c - person_c
    return np.asarray((celsius - np.float32(room_c)) / np.float32(max(person_c - room_c, LEAST_CONTRAST_C)))


def is_warm(celsius: Float32, window_c: tuple[float, float]) -> Bool:
    """Return flags (h, w) of temperatures (h, w) inside a person's range; False without a reading."""
    low_c, high_c = window_c
    return np.asarray((celsius >= low_c) & (celsius <= high_c), np.bool_)


def find_window(cloud: ThermalCloud, loose: Bool) -> tuple[float, float] | None:
    """Return the lowest and highest temperature of a person in this frame; None if no loose surface is warm
    enough.

    loose: bool (h, w), pixels not on a plane of the room. The room's temperature is the mode over all pixels,
    weighted by surface area. The person's temperature is the mode over loose pixels warmer than the room. The
    lower end is halfway between both, as the paper's 25 degrees for a room of 20 and a person of 30.
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
    """Return the mode of temperatures (n,) with weights (n,), from a smoothed histogram."""
    # Bins around the median: a common offset of all temperatures moves them along.
    middle, bin_c = float(np.median(celsius)), SPREAD_C / 4
    bins, around = round(2 * REACH_C / bin_c), (-REACH_C, REACH_C)
    count, edges_c = np.histogram(celsius - middle, bins, around, weights=weight)
    smooth = cv2.GaussianBlur(count.astype(np.float32)[None], (0, 0), SPREAD_C / bin_c)[0]
    return middle + float(edges_c[smooth.argmax()]) + bin_c / 2


def warmth_share(celsius: Float32, warm: Bool, window_c: tuple[float, float], size_px: int) -> Float32:
    """Return the temperature (h, w) relative to local background (0) and local person (1); NaN = no reading.

    warm: bool (h, w), pixels of a person's temperature. window_c: lowest and highest temperature of a person.
    Both references are means over windows of ``size_px`` pixels, because rooms and clothes are uneven.
    """
    cold = np.isfinite(celsius) & ~warm & (celsius < window_c[1])
    background_c = _local_mean(celsius, cold, size_px)
    above_c = _local_mean(celsius, warm, size_px) - background_c
    return np.asarray((celsius - background_c) / np.maximum(above_c, LEAST_CONTRAST_C), np.float32)


def _local_mean(values: Float32, mask: Bool, size: int) -> Float32:
    """Return the mean (h, w) of masked pixels in a square window; of all masked pixels where the window has
    none.
    """
    kept, window, border = np.where(mask, values, np.float32(0)), (size, size), cv2.BORDER_CONSTANT
    total, count = (
        cv2.boxFilter(plane, cv2.CV_32F, window, normalize=False, borderType=border)
        for plane in (kept, mask.astype(np.float32))
    )
    overall = np.float32(kept.sum() / max(mask.sum(), 1))
    return np.where(count > 0.5, total / np.maximum(count, 1), overall).astype(np.float32)
