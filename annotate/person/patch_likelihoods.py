"""How like each part of the suit the patches of one colour are: by surface, by warmth, and by where they lie.

Scores are log, of shape (R, 11): R patches, eleven parts.
"""

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from annotate.array_types import Bool, Float32, Float64, Index
from annotate.cloud.supervoxels import Supervoxels
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.parts import BODY_PARTS
from annotate.segmentation.patches import LEAST_POINTS, Patches, pair_scores
from annotate.segmentation.patches import MOST as MOST_PATCHES

STRIDE = 2
"""Colours are compared on every second pixel of every second row."""
WARMEST, LEAST_CONTRAST_C = 80.0, 2.0
"""Percentile of a person's temperatures that half a person under a blanket has too, above the room's."""
UNFELT = 0.8
"""What a surface without a temperature counts for: a share of that contrast."""
ALIKE, ALIKE_BLURS, ALIKE_SHADE = 0.045, 0.5, 0.6
"""Chromaticity (and share of its uncertainty), and log brightness, by which one cloth's places differ."""
REACH_M, NOT_ALIKE = 0.7, -1.0
MOST_M2 = np.array([0.035, 0.13, 0.033, 0.033, 0.028, 0.028, 0.045, 0.06, 0.06, 0.056, 0.056])
"""Surface of each part (11,) that can be seen at once: the most of 107 frames of 36 people of the rig."""
LARGER = 14.0
"""Log cost of being e times larger, times the square of the logarithm."""
WARMTH = np.array([1.13, 0.97, 0.84, 0.84, 0.77, 0.77, 0.94, 0.86, 0.86, 0.58, 0.58])
WARMTH_SD = np.array([0.25, 0.08, 0.13, 0.13, 0.22, 0.22, 0.12, 0.13, 0.13, 0.22, 0.22])
"""How far each part is on the way from the room's temperature to the warmest parts', counted likewise."""
WARMTH_WEIGHT, WARMTH_COST = 0.5, 8.0
"""The most that an odd temperature can cost: a hand may have held a glass."""
ANY_COLOR = np.where([part.id in (1, 5, 6, 10, 11) for part in BODY_PARTS], -3.0, -12.0)
"""Log score (11,) of the oddest colour: skin, hair and shoes differ more, and shine more, than cloth does."""
ODD_M2 = np.minimum(MOST_M2, [0.035, 1, 1, 1, 0.02, 0.02, 1, 1, 1, 0.03, 0.03])
"""Surface (11,) of what may have an odd colour: a head, a hand, a shoe and half of the other one."""
PLACE, PLACE_COST = 0.6, 10.0
"""Weight of where a patch lies, and the most that a place can cost before."""
LEAST_LIKELY = 1e-4
"""No place is less likely than that for what one other part of the body tells of it."""


def mean_by(patch: NDArray[np.integer[Any]], values: NDArray[np.generic]) -> Float64:
    """Mean (R,) of values (n,) over the patch (n,) that each is of."""
    return np.asarray(np.bincount(patch, values) / np.maximum(np.bincount(patch), 1))


def share(celsius: Float32, room: Float32, person: Float32) -> Float64:
    """How far temperatures (n,) are on the way from the room's to the warmest parts'."""
    room_c = float(np.nanmedian(room))
    reach_c = max(float(np.nanpercentile(person, WARMEST)) - room_c, LEAST_CONTRAST_C)
    return np.asarray(np.where(np.isfinite(celsius), (celsius - room_c) / reach_c, UNFELT), np.float64)


def by_warmth(share: Float64) -> Float64:
    """Log score (R, 11) of patches' temperatures (R,) for every part."""
    away = ((share[:, None] - WARMTH) / WARMTH_SD) ** 2
    return np.asarray(-WARMTH_WEIGHT * np.minimum(0.5 * away, WARMTH_COST))


def by_size(alike_m2: Float64, most_m2: Float64) -> Float64:
    """Log score (R, 11) of patches' surfaces (R,) for every part, which has at most so much (11,)."""
    return np.asarray(-LARGER * np.maximum(np.log(alike_m2[:, None] / most_m2), 0) ** 2)


def by_place(patches: Patches, body: Patches, belief: Float64) -> Float64:
    """Log score (R, 11) of every part of a patch, the body's being what they are believed to be (R, 11)."""
    told = np.flatnonzero(patches.points >= LEAST_POINTS)
    known = np.flatnonzero(body.points[told] >= LEAST_POINTS)[:MOST_PATCHES]
    pairs = pair_scores(patches, told)
    score = np.zeros((len(patches.points), len(MOST_M2)))
    for other in known:
        heard = np.log(np.exp(pairs[other].transpose(0, 2, 1)) @ belief[told[other]] + LEAST_LIKELY)
        heard[other] = 0
        score[told] += heard
    return PLACE * np.maximum(score, -PLACE_COST)


def alike_m2(
    cloud: ThermalCloud, own: Bool, groups: Supervoxels, patches: Patches, chroma: Float64, blur: Float64
) -> Float64:
    """Surface (R,) that has a patch's colour and is near it; chroma (G, 2), blur (G,): the supervoxels'.

    A blur of ``NOT_ALIKE`` keeps a supervoxel out: the room may have a sleeve's colour.
    """
    rgb, points_m = cloud.color_rgb[own], cloud.points_m[own]
    pixel_m2 = STRIDE**2 * points_m[:, 2].astype(np.float64) ** 2 / (cloud.camera.fx * cloud.camera.fy)
    surface_m2 = np.asarray(np.bincount(groups.ids, pixel_m2), np.float64)
    bright = rgb.max(axis=1).astype(np.float64)
    shade, shades = (
        np.log(np.maximum(mean_by(ids, bright), 1)) for ids in (groups.ids, patches.ids[groups.ids])
    )
    here = np.column_stack([chroma, shade, groups.centroids_m(points_m)])
    there = np.column_stack([patches.chroma, shades, patches.middle_m])
    return np.asarray(_alike(here, ALIKE + ALIKE_BLURS * blur, surface_m2, patches.ids, there))


@njit(cache=True, nogil=True)
def _alike(here: Float64, within: Float64, surface_m2: Float64, ids: Index, there: Float64) -> Float64:
    """Surface (R,) of the supervoxels (G,) that are a patch's, or like it and near.

    here (G, 6), there (R, 6): chromaticity, log brightness and place of both. within: (G,) how alike.
    """
    total = np.zeros(len(there))
    for r in range(len(there)):
        for g in range(len(here)):
            x, y, shade = here[g, 0] - there[r, 0], here[g, 1] - there[r, 1], here[g, 2] - there[r, 2]
            alike = np.sqrt(x * x + y * y) < within[g] and abs(shade) < ALIKE_SHADE
            if alike and ids[g] != r:
                a, b, c = here[g, 3] - there[r, 3], here[g, 4] - there[r, 4], here[g, 5] - there[r, 5]
                alike = np.sqrt(a * a + b * b + c * c) < REACH_M
            if alike or ids[g] == r:
                total[r] += surface_m2[g]
    return total
