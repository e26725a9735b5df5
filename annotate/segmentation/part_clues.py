"""Log evidence (G, 11) of each supervoxel's parts, by colour, warmth and the previous frame."""

import numpy as np

from annotate.array_types import Bool, Float32, Float64, UInt8
from annotate.cloud.supervoxels import Supervoxels
from annotate.parts import BODY_PARTS
from annotate.segmentation.body_plan import WARMTH_C, WARMTH_SD_C
from annotate.segmentation.part_tree import softmax
from annotate.segmentation.previous_parts import LEAST_AGREEMENT, agreement
from annotate.suit.color_model import blur
from annotate.suit.palette import chromaticity

TEMPERATURE_WEIGHT = 0.3
"""Weight of a supervoxel's temperature. Chosen by eye."""
WARMTH_FLOOR = -4.0
"""Least log density of a temperature: no mug, no draught excludes a part. Chosen by eye."""
EARLIER_WEIGHT = 0.5
"""Weight of the previous frame's log probabilities. Chosen by eye."""
ANOTHER = 0.8
"""Probability that the previous frame shows another person or pose, before any comparison. Chosen by eye."""
FULL_EVIDENCE = 3.0
"""Independent colours that a large supervoxel's colours, under one light, are worth. Chosen by eye."""
HALF_POINTS = 10.0
"""Points of a supervoxel whose colours are worth half of that. Chosen by eye."""
LEAST_COLOR_BLUR = 0.02
"""Least uncertainty of a colour's chromaticity. Chosen by eye."""

_N = len(BODY_PARTS)


def means_of(rgb: UInt8, usable: Bool, groups: Supervoxels) -> tuple[Float64, Float64]:
    """Mean chromaticity (G, 2) of each supervoxel's readable colours, and its uncertainty (G,).

    rgb: uint8 (n, 3) sRGB of the points. usable: bool (n,), readable colours.
    """
    noise = blur(rgb)
    weight = usable / (noise**2 + LEAST_COLOR_BLUR**2)
    total = np.bincount(groups.ids, weight, groups.count)
    mean = [np.bincount(groups.ids, weight * x, groups.count) for x in chromaticity(rgb).T]
    few = np.bincount(groups.ids, usable, groups.count) < 3
    chroma = np.where(few[:, None], 1 / 3, np.stack(mean, axis=1) / np.maximum(total, 1e-9)[:, None])
    return chroma, np.where(few, 1.0, np.bincount(groups.ids, noise, groups.count) / groups.sizes)


def pooled(evidence: Float64, usable: Bool, groups: Supervoxels) -> Float64:
    """Mean evidence (G, 11) over each supervoxel's readable points, with more weight the more there are.

    evidence: (n, 11), log likelihoods of the points. usable: bool (n,), readable colours.
    """
    total = np.stack([np.bincount(groups.ids, column, groups.count) for column in evidence.T], axis=1)
    count = np.bincount(groups.ids, usable, groups.count)
    return np.asarray(
        total / np.maximum(count, 1)[:, None] * (FULL_EVIDENCE * count / (count + HALF_POINTS))[:, None]
    )


def warmth_evidence(temperature_c: Float32, groups: Supervoxels) -> Float64:
    """Log evidence (G, 11) of the points' degrees Celsius (n,) against their median; 0 where all are NaN."""
    known = np.isfinite(temperature_c)
    if not known.any():
        return np.zeros((groups.count, _N))
    above = np.where(known, temperature_c - np.median(temperature_c[known]), 0)
    count = np.bincount(groups.ids, known, groups.count)
    mean = np.bincount(groups.ids, above, groups.count) / np.maximum(count, 1)
    score = -0.5 * ((mean[:, None] - WARMTH_C) / WARMTH_SD_C) ** 2 - np.log(WARMTH_SD_C)
    return np.asarray(TEMPERATURE_WEIGHT * np.maximum(score, WARMTH_FLOOR) * (count > 0)[:, None])


def previous_evidence(earlier: Float64) -> Float64:
    """Log evidence (G, 11) of the previous frame's parts (G, 11) before any comparison; small against."""
    return np.asarray(np.log(ANOTHER + (1 - ANOTHER) * earlier * _N))


def with_earlier(unary: Float64, groups: Supervoxels, earlier: Float64) -> Float64:
    """Log evidence (G, 11) with the previous frame's parts (G, 11), unless that shows another person."""
    if agreement(softmax(unary), earlier, groups.sizes) < LEAST_AGREEMENT:
        return unary
    return np.asarray(unary + EARLIER_WEIGHT * np.log(earlier * _N))
