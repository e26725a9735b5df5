"""How warm is a person here: the window found from a frame's own histogram, and the paper's fixed one."""

import cv2
import numpy as np

from annotate.array_types import Bool, Float32
from annotate.cloud.thermal_cloud import ThermalCloud

WINDOW_C = (25.0, 35.0)
"""Surface temperatures of a dressed person in a room (Nishi & Miura 2017, section 4.2.1)."""
BIN_C = 0.25
REACH_C = 40.0
"""The histogram's reach to both sides of the median."""
ROOM_SPREAD_C, PERSON_SPREAD_C = 0.5, 1.0
"""Smoothing of the histogram before its highest place is taken: walls are even, a dressed person is not."""
CONTRAST_C, CONTRAST_SPREAD_C = 9.0, 3.0
"""How much warmer than the room clothes are, 20 and 29 degrees for most, and how far that may be off: 6 in a
hot room, 14 for skin in a cold one. A blanket or a sofa near a radiator is some 3 degrees warmer."""
LEAST_M2 = 0.02
"""Less warm surface than this has no mode worth trusting."""
HALFWAY = 0.5
"""The window begins halfway between the room and the person, as it does for 20 degrees and 30."""
ABOVE_C = 5.0
"""Bare skin is 3 to 4 degrees warmer than clothes (ISO 7933), a camera's noise on top."""


def fixed_window_mask(cloud: ThermalCloud, window_c: tuple[float, float] = WINDOW_C) -> Bool:
    """The paper's extraction, the baseline: every valid pixel (h, w) within the window."""
    return np.asarray(
        cloud.valid & (cloud.temperature_c >= window_c[0]) & (cloud.temperature_c <= window_c[1]), np.bool_
    )


def find_window(cloud: ThermalCloud, loose: Bool) -> tuple[float, float] | None:
    """A person's temperatures in this frame, least and most, or None where nothing stands out.

    loose: bool (h, w), pixels off the room's planes, where a person can be: a sunlit wall must not pass
    for one. The room is the commonest temperature of all, the person the commonest of what is loose and
    warmer, by surface. An offset of all temperatures moves the window by as much.
    """
    known = cloud.valid & np.isfinite(cloud.temperature_c)
    if not known.any():
        return None
    depth_m = cloud.points_m[..., 2]
    surface_m2 = np.asarray(depth_m**2 / (cloud.camera.fx * cloud.camera.fy), np.float32)
    room_c = _mode(cloud.temperature_c[known], surface_m2[known], ROOM_SPREAD_C)
    above = cloud.temperature_c - room_c
    belief = surface_m2 * np.exp(-0.5 * np.square((above - CONTRAST_C) / CONTRAST_SPREAD_C))
    warm = known & loose & (np.abs(above - CONTRAST_C) < 2.5 * CONTRAST_SPREAD_C)
    if belief[warm].sum() < LEAST_M2:
        return None
    person_c = _mode(cloud.temperature_c[warm], belief[warm].astype(np.float32), PERSON_SPREAD_C)
    return room_c + HALFWAY * (person_c - room_c), person_c + ABOVE_C


def _mode(celsius: Float32, weight: Float32, spread_c: float) -> float:
    """Where the smoothed histogram is highest."""
    # Bins around the median: a common offset of all temperatures moves them along.
    middle, bins = np.median(celsius), round(2 * REACH_C / BIN_C)
    place = ((celsius - middle).astype(np.float64) + REACH_C) / BIN_C
    within = (place >= 0) & (place < bins)
    count = np.bincount(place[within].astype(np.intp), weight[within], bins)
    smooth = cv2.GaussianBlur(count.astype(np.float32)[None], (0, 0), spread_c / BIN_C)[0]
    return float(middle) + (int(smooth.argmax()) + 0.5) * BIN_C - REACH_C
