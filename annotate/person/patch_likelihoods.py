"""Log scores (R, 11) of R patches of one colour being each part, by surface, warmth and place."""

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from annotate.array_types import Bool, Float32, Float64, Index
from annotate.cloud.supervoxels import Supervoxels
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.parts import BODY_PARTS
from annotate.segmentation.patches import MOST_PATCHES, Patches, pair_scores

COMPARED_STRIDE = 2
"""Pixels between the rows and the columns whose colours are compared. Chosen by eye."""
WARMEST, LEAST_WARMTH_C, UNFELT = 80.0, 2.0, 0.8
"""Percentile of a person's temperatures that half a person under a blanket has too; its least difference to
the room in degrees Celsius; relative warmth of a surface without a temperature. Chosen by eye."""
SAME_COLOR, SAME_COLOR_BLURS, SAME_SHADE, SAME_CLOTH_M = 0.045, 0.5, 0.6, 0.7
"""Distances between places of one cloth: in chromaticity, with a share of its uncertainty added; in log
brightness; in metres. Chosen by eye."""
NEVER_ALIKE = -1.0
"""Blur of a supervoxel that is alike to no patch but its own."""
MOST_M2 = np.array([0.035, 0.13, 0.033, 0.033, 0.028, 0.028, 0.045, 0.06, 0.06, 0.056, 0.056])
"""Largest visible surface (11,) of each part in m2, measured over 107 frames of 36 people of the rig."""
LARGER = 14.0
"""Log cost of a surface e times larger; grows with the logarithm's square. Chosen by eye."""
PART_WARMTH = np.array([1.13, 0.97, 0.84, 0.84, 0.77, 0.77, 0.94, 0.86, 0.86, 0.58, 0.58])
PART_WARMTH_SD = np.array([0.25, 0.08, 0.13, 0.13, 0.22, 0.22, 0.12, 0.13, 0.13, 0.22, 0.22])
"""Mean relative warmth (11,) of each part, and its standard deviation, measured over the same frames."""
WARMTH_SCORE_WEIGHT, WARMTH_COST = 0.5, 8.0
"""Weight of the relative warmth's log density, and the largest log cost of an odd temperature before it: a
hand may have held a glass. Chosen by eye."""
ANY_COLOR = np.where([part.id in (1, 5, 6, 10, 11) for part in BODY_PARTS], -3.0, -12.0)
"""Log score (11,) of the oddest colour: skin, hair and shoes vary more. Chosen by eye."""
ODD_M2 = np.minimum(MOST_M2, [0.035, 1, 1, 1, 0.02, 0.02, 1, 1, 1, 0.03, 0.03])
"""Largest surface (11,) in m2 of an odd colour: head, hand, one and a half shoes. Chosen by eye."""
PLACE_WEIGHT, PLACE_COST, LEAST_LIKELY = 0.6, 10.0, 1e-4
"""Weight of a patch's place among the others; largest log cost of a place before it; least likelihood of a
place given one other part of the body. Chosen by eye."""


def mean_over(patch: NDArray[np.integer[Any]], values: NDArray[np.generic]) -> Float64:
    """Mean (R,) of values (n,) over each patch; patch: (n,), number of each value's patch."""
    return np.asarray(np.bincount(patch, values) / np.maximum(np.bincount(patch), 1))


def relative_warmth(celsius: Float32, room_c: Float32, person_c: Float32) -> Float64:
    """Warmth (n,): 0 at the room's median, 1 at the person's warm parts; all degrees Celsius, NaN = none."""
    middle_c = float(np.nanmedian(room_c))
    reach_c = max(float(np.nanpercentile(person_c, WARMEST)) - middle_c, LEAST_WARMTH_C)
    return np.asarray(np.where(np.isfinite(celsius), (celsius - middle_c) / reach_c, UNFELT), np.float64)


def warmth_scores(warmth: Float64) -> Float64:
    """Log score (R, 11) of every part by the patches' relative warmth (R,)."""
    away = ((warmth[:, None] - PART_WARMTH) / PART_WARMTH_SD) ** 2
    return np.asarray(-WARMTH_SCORE_WEIGHT * np.minimum(0.5 * away, WARMTH_COST))


def size_scores(surface_m2: Float64, most_m2: Float64) -> Float64:
    """Log score (R, 11) of every part by surfaces (R,) and the parts' largest surfaces (11,), in m2."""
    return np.asarray(-LARGER * np.maximum(np.log(surface_m2[:, None] / most_m2), 0) ** 2)


def place_scores(patches: Patches, body: Patches, belief: Float64) -> Float64:
    """Log score (R, 11) of every part by a patch's place among the body's patches.

    body: the same patches with 0 points in those off the body. belief: (R, 11), parts of the body's patches.
    """
    scored = np.flatnonzero(patches.is_large)
    known = np.flatnonzero(body.is_large[scored])[:MOST_PATCHES]
    pairs = pair_scores(patches, scored)
    score = np.zeros((len(patches.points), len(MOST_M2)))
    for other in known:
        by_other = np.log(np.exp(pairs[other].transpose(0, 2, 1)) @ belief[scored[other]] + LEAST_LIKELY)
        by_other[other] = 0
        score[scored] += by_other
    return PLACE_WEIGHT * np.maximum(score, -PLACE_COST)


def same_color_m2(
    cloud: ThermalCloud, compared: Bool, groups: Supervoxels, patches: Patches, chroma: Float64, blur: Float64
) -> Float64:
    """Surface (R,) in m2 near each patch that has its colour.

    compared: bool (h, w), the n pixels of the supervoxels. chroma (G, 2), blur (G,): the supervoxels' mean
    chromaticity and its uncertainty. NEVER_ALIKE as a blur keeps a supervoxel out of other patches: the room
    may have a sleeve's colour.
    """
    rgb, points_m = cloud.color_rgb[compared], cloud.points_m[compared]
    pixel_m2 = (
        COMPARED_STRIDE**2 * points_m[:, 2].astype(np.float64) ** 2 / (cloud.camera.fx * cloud.camera.fy)
    )
    surface_m2 = np.asarray(np.bincount(groups.ids, pixel_m2), np.float64)
    bright = rgb.max(axis=1).astype(np.float64)
    shade, patch_shade = (
        np.log(np.maximum(mean_over(ids, bright), 1)) for ids in (groups.ids, patches.ids[groups.ids])
    )
    of_groups = np.column_stack([chroma, shade, groups.centroids_m(points_m)])
    of_patches = np.column_stack([patches.chroma, patch_shade, patches.middle_m])
    within = SAME_COLOR + SAME_COLOR_BLURS * blur
    return np.asarray(_same_color_m2(of_groups, within, surface_m2, patches.ids, of_patches))


@njit(cache=True, nogil=True)
def _same_color_m2(
    of_groups: Float64, within: Float64, surface_m2: Float64, ids: Index, of_patches: Float64
) -> Float64:
    """Surface (R,) in m2 of a patch's own supervoxels and of the near ones of its colour.

    of_groups (G, 6), of_patches (R, 6): chromaticity, log brightness and place in metres. within: (G,),
    distance in chromaticity of one colour. ids: (G,), patch of each supervoxel.
    """
    total = np.zeros(len(of_patches))
    for r in range(len(of_patches)):
        p = of_patches[r]
        for g in range(len(of_groups)):
            x, y, shade = of_groups[g, 0] - p[0], of_groups[g, 1] - p[1], of_groups[g, 2] - p[2]
            alike = np.sqrt(x * x + y * y) < within[g] and abs(shade) < SAME_SHADE
            if alike and ids[g] != r:
                a, b, c = of_groups[g, 3] - p[3], of_groups[g, 4] - p[4], of_groups[g, 5] - p[5]
                alike = np.sqrt(a * a + b * b + c * c) < SAME_CLOTH_M
            if alike or ids[g] == r:
                total[r] += surface_m2[g]
    return total
