"""Hands, feet and face show no cloth of the suit: they belong to the sleeve they grow out of.

Skin and shoes look the same on the left and on the right, so their colour says nothing of the side, and
hands lie in laps, on the other arm and under chins. What tells is the way along the surface, through bare
skin alone, from the cloth of each limb.
"""

import numpy as np

from annotate.array_types import Bool, Float64, Int32
from annotate.cloud.supervoxels import Supervoxels
from annotate.parts import PART_ID
from annotate.segmentation.patches import Patches
from annotate.suit.color_model import ColorModel

HEAD = PART_ID["head"] - 1
TWINS = tuple(
    (PART_ID[f"left_{limb}"] - 1, PART_ID[f"right_{limb}"] - 1) for limb in ("forearm", "lower_leg")
)
OWN = [HEAD, *(part for twins in TWINS for part in twins)]
"""Limbs whose cloth ends in something bare, and all that show something bare."""
FAR_M = 0.3
"""A hand and a foot end less than that from their cuffs, along the skin (Drillis & Contini 1966: 0.108 and
0.152 of the stature); what is farther belongs to nobody in particular."""
WEIGHT = 4.0
"""Log odds of growing out of one cuff against being that far from another."""
LIKELY = -2.0
"""Log odds against cloth from which on a colour may be bare: a sleeve can be orange as skin is."""
SURE = 0.5
"""Belief from which on a patch is a part's."""

_Ways = tuple[Int32, Int32, Float64]
"""Steps between supervoxels: from, to, length in metres."""


def bareness(model: ColorModel, chroma: Float64, blur: Float64) -> Float64:
    """Log odds (G,) against cloth of colours (G, 2) being bare: skin, hair, shoes, whatever a head shows."""
    match = model.match(chroma, blur)
    bare = model.bare | model.wears[:, HEAD]
    return np.asarray(match[:, bare].max(axis=1) - match[:, ~bare].max(axis=1))


def without_sides(belief: Float64, odds: Float64) -> Float64:
    """Beliefs (G, 11) that do not tell left limbs from right ones where ``bareness`` (G,) is likely."""
    belief, bare = belief.copy(), odds > LIKELY
    for left, right in TWINS:
        belief[bare, left] = belief[bare, right] = belief[bare][:, [left, right]].mean(axis=1)
    return belief


def grown_from(
    belief: Float64, odds: Float64, patches: Patches, groups: Supervoxels, centroids_m: Float64
) -> Float64:
    """Log evidence (G, 11) of what may be bare: how far each is from head and cuffs, on a way through such.

    belief: (G, 11). odds: (G,) as ``bareness`` gives them. A part of which no cloth is seen is as good as the
    farthest.
    """
    bare = odds > LIKELY
    ways = _ways(bare, groups, centroids_m)
    part, sure = belief.argmax(axis=1), belief.max(axis=1) > SURE
    away_m = np.full(belief.shape, FAR_M)
    for own in OWN:
        shows = sure & (part == own)
        cloth = shows & (odds < 0)
        shows = cloth if own != HEAD and cloth.any() else shows
        points = np.bincount(patches.ids, groups.sizes * shows)
        away_m[:, own] = _away(ways, shows & (patches.ids == points.argmax()))
    cost = np.zeros_like(belief)
    nearest_m = away_m.min(axis=1, keepdims=True)
    cost[:, OWN] = -WEIGHT / FAR_M * (away_m[:, OWN] - nearest_m)
    cost[~bare] = 0
    return cost


def _ways(bare: Bool, groups: Supervoxels, centroids_m: Float64) -> _Ways:
    """The steps that lead into bare supervoxels."""
    a, b = np.concatenate([groups.edges, groups.edges[:, ::-1]]).T
    into = bare[b]
    return a[into], b[into], np.linalg.norm(centroids_m[a] - centroids_m[b], axis=1)[into]


def _away(ways: _Ways, start: Bool) -> Float64:
    """Way (G,) in metres from the nearest of some supervoxels (G,), at most FAR_M."""
    a, b, length_m = ways
    away_m = np.where(start, 0.0, FAR_M)
    # Bellman and Ford's rounds: few, since nothing is followed farther than FAR_M.
    while True:
        nearer_m = away_m.copy()
        np.minimum.at(nearer_m, b, away_m[a] + length_m)
        if np.array_equal(nearer_m, away_m):
            return away_m
        away_m = nearer_m
