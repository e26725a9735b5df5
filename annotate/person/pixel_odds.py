"""What speaks for a person at each pixel: its temperature, the planes of the room, its colour. Log odds."""

import cv2
import numpy as np

from annotate.array_types import Bool, Float32
from annotate.cloud.color_odds import SURE
from annotate.cloud.grid import NO_PIXEL, flood
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.person.warm_window import ABOVE_C

LEAST_CONTRAST_C = 1.0
"""A camera's noise and a room's unevenness (0.3 degrees each): less than that parts nothing."""
UNEVEN_C = 2.0
"""Walls and floor may be colder than the commonest temperature of a room by this much."""
COLD_SHARE = 0.25
"""Below this share of the way from the background's temperature to the person's a point is no person."""
UNSURE_SHARE, STEEPNESS, MOST_BY_WARMTH = 0.22, 8.0, 3.0
"""Share at which temperature says nothing, log odds a unit of it, and the most it can be worth: cold cloth
and hair reach down to 0.2, the thermal lens blurs a silhouette over a third of a person's warmth."""
HOT_MARGIN_C, BY_HEAT = 2.0, -4.0
"""A radiometric camera is off by up to 2 degrees (Optris PI200): that far above the window is no person."""
ON_PLANE, ON_WARM_PLANE = -4.0, -1.0
"""Log odds of lying on a plane of the room: with cold points about, or a large one; and all warm, which
a chest can be that has the back rest's slant."""
OFF_PLANES = 0.6
"""Log odds of a surface off all planes: most of a room is flat."""
PLANE_COLD_SHARE, PLANE_M2 = 0.2, 0.15
"""Of a connected patch on planes: this share of it cold, or this much surface, and it is the room's."""
BY_COLD_SURFACE = -2.0
"""Log odds of a surface whose temperature is known to be cold some way on."""
WARM, COLD = 1, 2


def warmth_share(celsius: Float32, warm: Bool, window_c: tuple[float, float], size_px: int) -> Float32:
    """How far each pixel (h, w) is on the way from the background's temperature (0) to the person's (1).

    Both are local means, of what is warm and of what is colder, over windows of size_px: rooms and
    clothes are uneven. Nothing counts as colder than the room, which lies as far below the window's
    beginning as the person above it: a window pane would make warm what is beside it. NaN without a
    temperature.
    """
    low_c, hottest_c = window_c
    room_c = np.float32(2 * low_c - (hottest_c - ABOVE_C) - UNEVEN_C)
    person_c = _local_mean(celsius, warm, size_px)
    cold = np.isfinite(celsius) & ~warm & (celsius < hottest_c)
    share = np.empty_like(celsius)
    for _ in range(2):  # the second time without cold cloth, which has raised the mean
        background_c = _local_mean(np.maximum(celsius, room_c), cold, size_px)
        np.divide(celsius - background_c, np.maximum(person_c - background_c, LEAST_CONTRAST_C), out=share)
        cold &= share < COLD_SHARE
    return share


def by_warmth(share: Float32, celsius: Float32, hottest_c: float) -> Float32:
    """Log odds (h, w) of temperature alone; 0 where there is none."""
    odds = np.clip(STEEPNESS * (share - UNSURE_SHARE), -MOST_BY_WARMTH, MOST_BY_WARMTH)
    heat = (celsius - np.float32(hottest_c)) / HOT_MARGIN_C
    odds = np.where(heat > 0, odds + np.minimum(heat, 1) * (BY_HEAT - odds), odds)
    return np.asarray(np.nan_to_num(odds), np.float32)


def inherited(odds: Float32, cloud: ThermalCloud, candidates: Bool, reach_px: float) -> Float32:
    """Log odds (h, w) against pixels without a temperature that go on from a cold surface, 0 elsewhere.

    Beside a silhouette the thermal camera sees one surface in front of another, and no pixel of it is sure:
    a rim of the sofa would be anybody's. (What goes on from a warm one may be either: cushions are warm.)
    odds: (h, w) of temperature alone. reach_px: how far along a surface they speak.
    """
    known = np.isfinite(cloud.temperature_c)
    marks = np.select([odds > SURE, odds < -SURE], [np.uint8(WARM), np.uint8(COLD)], np.uint8(0))
    marks[~known] = 0
    marks[~(cloud.valid & candidates)] = NO_PIXEL
    reached = flood(marks, cloud.points_m[..., 2], reach_px)
    return np.where(~known & (reached == COLD), np.float32(BY_COLD_SURFACE), np.float32(0))


def by_planes(on: Bool, near: Bool, shaped: Bool, cold: Bool, surface_m2: Float32) -> Float32:
    """Log odds (h, w) of lying on or off the room's planes.

    on: pixels that lie on one; near: that are close to one, however turned; shaped: whose normal is known;
    cold: that are the background's temperature; surface_m2: what each pixel covers.
    """
    _, patch = cv2.connectedComponents(on.astype(np.uint8), connectivity=8)
    patch = patch[on]
    pixels = np.maximum(np.bincount(patch, minlength=1), 1)
    cold_share = np.bincount(patch, cold[on], pixels.size) / pixels
    area_m2 = np.bincount(patch, surface_m2[on], pixels.size)
    of_room = (cold_share > PLANE_COLD_SHARE) | (area_m2 > PLANE_M2)
    odds = np.where(shaped & ~near, np.float32(OFF_PLANES), np.float32(0))
    odds[on] = np.where(of_room, ON_PLANE, ON_WARM_PLANE)[patch]
    return odds


def _local_mean(values: Float32, mask: Bool, size: int) -> Float32:
    """Mean over the masked pixels of a square window; the overall mean where there is none."""
    kept = np.where(mask, values, np.float32(0))
    total = _sum(kept, size)
    count = _sum(mask.astype(np.float32), size)
    overall = np.float32(kept.sum() / max(mask.sum(), 1))
    return np.where(count > 0.5, total / np.maximum(count, 1), overall).astype(np.float32)


def _sum(values: Float32, size: int) -> Float32:
    """Sum over a square window around each pixel, nothing beyond the image."""
    border = cv2.BORDER_CONSTANT
    total = cv2.boxFilter(values, cv2.CV_32F, (size, size), normalize=False, borderType=border)
    return np.asarray(total, np.float32)
