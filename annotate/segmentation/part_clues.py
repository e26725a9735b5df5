"""What colour, warmth and the frame before say of each supervoxel, part by part, as log evidence."""

import numpy as np

from annotate.array_types import Bool, Float32, Float64, UInt8
from annotate.cloud.supervoxels import Supervoxels
from annotate.parts import BODY_PARTS
from annotate.segmentation.body_plan import WARMTH_C, WARMTH_SD_C
from annotate.segmentation.part_tree import softmax
from annotate.segmentation.previous_parts import LEAST_AGREEMENT, agreement
from annotate.suit.color_model import blur
from annotate.suit.palette import chromaticity

WARMTH_WEIGHT, WARMTH_FLOOR = 0.3, -4.0
"""Weight of a supervoxel's temperature; no temperature, of a mug held or a draught, excludes a part."""
EARLIER_WEIGHT = 0.5
"""Weight of the frame before."""
HINT = 0.8
"""How likely it is to show somebody else or another pose, before anything has been compared."""
FULL, HALF_POINTS = 3.0, 10.0
"""How many independent colours a supervoxel's are worth: they share their light. Half of it at ten points."""
LEAST_BLUR = 0.02
"""No colour is known better than that."""

_N = len(BODY_PARTS)


def means_of(rgb: UInt8, usable: Bool, groups: Supervoxels) -> tuple[Float64, Float64]:
    """Mean chromaticity (G, 2) of each supervoxel's readable colours (n, 3), and its uncertainty (G,)."""
    noise = blur(rgb)
    weight = usable / (noise**2 + LEAST_BLUR**2)
    total = np.bincount(groups.ids, weight, groups.count)
    mean = [np.bincount(groups.ids, weight * x, groups.count) for x in chromaticity(rgb).T]
    few = np.bincount(groups.ids, usable, groups.count) < 3
    chroma = np.where(few[:, None], 1 / 3, np.stack(mean, axis=1) / np.maximum(total, 1e-9)[:, None])
    return chroma, np.where(few, 1.0, np.bincount(groups.ids, noise, groups.count) / groups.sizes)


def pooled(evidence: Float64, usable: Bool, groups: Supervoxels) -> Float64:
    """Mean evidence (G, 11) over each supervoxel's readable points, weighing more the more there are."""
    total = np.stack([np.bincount(groups.ids, column, groups.count) for column in evidence.T], axis=1)
    count = np.bincount(groups.ids, usable, groups.count)
    return np.asarray(total / np.maximum(count, 1)[:, None] * (FULL * count / (count + HALF_POINTS))[:, None])


def warmth_of(temperature_c: Float32, groups: Supervoxels) -> Float64:
    """Log evidence (G, 11) of the points' temperatures (n,) against the person's median; none where NaN."""
    known = np.isfinite(temperature_c)
    if not known.any():
        return np.zeros((groups.count, _N))
    above = np.where(known, temperature_c - np.median(temperature_c[known]), 0)
    count = np.bincount(groups.ids, known, groups.count)
    mean = np.bincount(groups.ids, above, groups.count) / np.maximum(count, 1)
    score = -0.5 * ((mean[:, None] - WARMTH_C) / WARMTH_SD_C) ** 2 - np.log(WARMTH_SD_C)
    return np.asarray(WARMTH_WEIGHT * np.maximum(score, WARMTH_FLOOR) * (count > 0)[:, None])


def hint(earlier: Float64) -> Float64:
    """Log evidence (G, 11) of the frame before (G, 11), whomever it shows: for a part, hardly against one."""
    return np.asarray(np.log(HINT + (1 - HINT) * earlier * _N))


def with_earlier(unary: Float64, groups: Supervoxels, earlier: Float64) -> Float64:
    """Log evidence (G, 11) with what the frame before says (G, 11), unless it shows somebody else."""
    if agreement(softmax(unary), earlier, groups.sizes) < LEAST_AGREEMENT:
        return unary
    return np.asarray(unary + EARLIER_WEIGHT * np.log(earlier * _N))
