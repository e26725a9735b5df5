"""Blankets on a person in a suit: much surface of one colour, warm, and yet clearly colder than the person.

No part of a suit of eleven colours shows as much of one colour, but for the trunk, and that is the warmest.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from annotate.cloud import ThermalCloud
from annotate.color_model import DARK
from annotate.part_clues import means_of
from annotate.patches import patches_of
from annotate.suit import chromaticity
from annotate.supervoxels import supervoxels

STRIDE = 2
"""Colours are compared on every second pixel of every second row."""
SEED_M = 0.05
WARMEST = 80.0
"""Percentile of a person's temperatures that half a person under a blanket has too."""
LEAST_CONTRAST_C = 2.0
ALIKE, ALIKE_SHADE = 0.045, 0.6
"""Chromaticity, along either axis, and log brightness within which two places can be one cloth."""
REACH_M = 1.0
LEAST_M2, PART_M2, TRUNK_SHARE = 0.004, 0.09, 0.8
"""Patches that are looked at; from the second on a cloth is larger than a part that has no more than this
share of the way from the room's temperature to the warmest part's."""
COVERED_SHARE = 0.9
"""Warmer than this nothing is a cover, however large."""
COLDER, COLORED, GREYISH = 3.0, 4.0, 0.15
"""How much smaller (natural logarithm) a cloth may be for being colder by the whole way; how much larger a
part for each unit of chromaticity that it is farther from the light's than most blankets are."""

HUE = 0.06
"""Side of the cells of chromaticity that count as different colours."""

_Array = NDArray[np.float64]


def colors_worn(cloud: ThermalCloud, person: NDArray[np.bool_], room: NDArray[np.bool_]) -> float:
    """How many strong colours somebody (h, w) shows: the perplexity of their hues by the share that has any.

    A suit has many, clothes one or two, things none. room: bool (h, w), what shows the light's own colour.
    """
    rgb = cloud.color_rgb[person & cloud.color_valid][::4]
    white = np.median(chromaticity(cloud.color_rgb[room & cloud.color_valid][::7]), axis=0)
    chroma = chromaticity(rgb[(rgb >= DARK).any(axis=1)])
    strong = chroma[np.linalg.norm(chroma - white, axis=1) > GREYISH]
    if not len(strong):
        return 0.0
    cells = np.unique((strong / HUE).astype(np.int64), axis=0, return_counts=True)[1]
    share = cells / cells.sum()
    return float(np.exp(-(share * np.log(share)).sum()) * len(strong) / len(chroma))


def covers(cloud: ThermalCloud, person: NDArray[np.bool_], room: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which of a person's pixels (h, w) are a cloth over them. room: bool (h, w), background around them.

    Nothing without temperatures or colours. Fitted to the virtual rig's blankets, 24 subjects of seeds 101,
    110 and 111: on it most parts have under 0.06 m2 below the trunk's share, a blanket 0.05 to 0.4 m2.
    """
    nothing = np.zeros_like(person)
    celsius = cloud.temperature_c
    felt = np.isfinite(celsius)
    own = nothing.copy()
    own[::STRIDE, ::STRIDE] = (person & cloud.color_valid)[::STRIDE, ::STRIDE]
    if not own.any() or not (person & felt).any() or not (room & felt & cloud.color_valid).any():
        return nothing
    room_c = float(np.median(celsius[room & felt]))
    reach_c = max(float(np.percentile(celsius[person & felt], WARMEST)) - room_c, LEAST_CONTRAST_C)
    rgb, points_m, warmth = cloud.color_rgb[own], cloud.points_m[own], celsius[own]
    groups = supervoxels(points_m, rgb, seed_m=SEED_M)
    usable = rgb.max(axis=1) >= DARK
    patch = patches_of(groups, *means_of(rgb, usable, groups), groups.centroids_m(points_m)).ids[groups.ids]
    surface_m2 = STRIDE**2 * points_m[:, 2].astype(np.float64) ** 2 / (cloud.camera.fx * cloud.camera.fy)
    share = np.where(np.isfinite(warmth), (warmth - room_c) / reach_c, TRUNK_SHARE)
    colder = _mean(patch, share) < COVERED_SHARE
    alike_m2 = _alike_m2(
        patch, chromaticity(rgb), np.log(np.maximum(rgb.max(axis=1), 1)), points_m, surface_m2
    )
    score = np.log(np.maximum(alike_m2, 1e-6) / PART_M2) + COLDER * (TRUNK_SHARE - _mean(patch, share))
    hue = chromaticity(rgb) - np.median(chromaticity(cloud.color_rgb[room & cloud.color_valid][::7]), axis=0)
    score -= COLORED * np.maximum(np.hypot(*(_mean(patch, axis) for axis in hue.T)) - GREYISH, 0)
    cloth = np.zeros_like(person)
    cloth[own] = ((score > 0) & colder)[patch]
    return _filled(cloth, own) & person


def _mean(patch: NDArray[np.intp], values: NDArray[np.floating]) -> _Array:
    return np.asarray(np.bincount(patch, values) / np.maximum(np.bincount(patch), 1))


def _alike_m2(
    patch: NDArray[np.intp], chroma: _Array, shade: _Array, points_m: NDArray[np.float32], surface_m2: _Array
) -> _Array:
    """Surface (R,) that has a patch's colour and is near it; patch, shade, surface_m2: (n,) of the points."""
    colour = np.column_stack([chroma / ALIKE, shade / ALIKE_SHADE]).astype(np.float32)
    middle = np.column_stack([_mean(patch, column) for column in (*colour.T, *points_m.T)])
    total = np.bincount(patch, surface_m2)
    for k in np.flatnonzero(total > LEAST_M2):
        alike = (np.abs(colour - middle[k, :3].astype(np.float32)) < 1).all(axis=1)
        near = ((points_m[alike] - middle[k, 3:].astype(np.float32)) ** 2).sum(axis=1) < REACH_M**2
        total[k] = surface_m2[alike][near].sum()
    return np.asarray(total)


def _filled(cloth: NDArray[np.bool_], own: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The answer of the pixels looked at (h, w), as ``own`` says, for those between them."""
    block = np.ones((2 * STRIDE + 1, 2 * STRIDE + 1))
    near = cv2.filter2D(cloth.astype(np.float32), -1, block)
    return np.asarray(2 * near > cv2.filter2D(own.astype(np.float32), -1, block))
