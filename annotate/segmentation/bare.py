"""Log evidence (G, 11) of bare surface (hands, feet, face), by the sleeve that it grows out of.

Skin and shoes look the same on the left and on the right, so their colour is no evidence of the side, and
hands lie in laps, on the other arm and under chins. The evidence is the way along the surface, through bare
skin alone, from the cloth of each limb.
"""

import numpy as np

from annotate.array_types import Bool, Float64, Int32
from annotate.cloud.supervoxels import Supervoxels
from annotate.parts import PART_ID
from annotate.segmentation.patches import Patches
from annotate.suit.color_model import ColorModel

HEAD = PART_ID["head"] - 1
"""Part index of the head."""
TWINS = tuple(
    (PART_ID[f"left_{limb}"] - 1, PART_ID[f"right_{limb}"] - 1) for limb in ("forearm", "lower_leg")
)
"""(left, right) part indices of the limbs whose cloth ends in something bare."""
SHOWING_BARE = [HEAD, *(part for twins in TWINS for part in twins)]
"""Part indices of all parts that show something bare."""
LONGEST_WAY_M = 0.3
"""Longest way in metres along bare surface: a hand and a foot end nearer to their cuffs (Drillis & Contini
1966: 0.108 and 0.152 of the stature)."""
CUFF_WEIGHT = 4.0
"""Log odds of growing out of one cuff, against another that far away. Chosen by eye."""
LIKELY_BARE, CLEAR_PART = -2.0, 0.5
"""Log odds from which on a colour may be bare, as a sleeve can be orange like skin; belief from which on a
supervoxel counts as a part's. Chosen by eye."""

_Steps = tuple[Int32, Int32, Float64]
"""Steps (e,) between supervoxels: start, end, length in metres."""


def bareness(model: ColorModel, chroma: Float64, blur: Float64) -> Float64:
    """Log odds (G,) of being bare (skin, hair, shoes, all that a head shows) against cloth of the suit.

    chroma (G, 2), blur (G,): mean chromaticity and its uncertainty.
    """
    match = model.match(chroma, blur)
    bare = model.bare | model.wears[:, HEAD]
    return np.asarray(match[:, bare].max(axis=1) - match[:, ~bare].max(axis=1))


def without_sides(belief: Float64, odds: Float64) -> Float64:
    """Beliefs (G, 11) with left and right limbs alike where the odds (G,) of ``bareness`` are likely."""
    belief, bare = belief.copy(), odds > LIKELY_BARE
    for left, right in TWINS:
        belief[bare, left] = belief[bare, right] = belief[bare][:, [left, right]].mean(axis=1)
    return belief


def cuff_evidence(
    belief: Float64, odds: Float64, patches: Patches, groups: Supervoxels, centroids_m: Float64
) -> Float64:
    """Log evidence (G, 11) of bare supervoxels by their ways from head and cuffs over bare surface.

    belief: (G, 11). odds: (G,), of ``bareness``. centroids_m: (G, 3). A part without visible cloth counts as
    LONGEST_WAY_M away.
    """
    bare = odds > LIKELY_BARE
    steps = _bare_steps(bare, groups, centroids_m)
    likeliest, clear = belief.argmax(axis=1), belief.max(axis=1) > CLEAR_PART
    away_m = np.full(belief.shape, LONGEST_WAY_M)
    for part in SHOWING_BARE:
        source = clear & (likeliest == part)
        cloth = source & (odds < 0)
        source = cloth if part != HEAD and cloth.any() else source
        points = np.bincount(patches.ids, groups.sizes * source)
        away_m[:, part] = _away_m(steps, source & (patches.ids == points.argmax()))
    cost = np.zeros_like(belief)
    nearest_m = away_m.min(axis=1, keepdims=True)
    cost[:, SHOWING_BARE] = -CUFF_WEIGHT / LONGEST_WAY_M * (away_m[:, SHOWING_BARE] - nearest_m)
    cost[~bare] = 0
    return cost


def _bare_steps(bare: Bool, groups: Supervoxels, centroids_m: Float64) -> _Steps:
    """Steps between touching supervoxels that end in a bare one; bare: bool (G,)."""
    a, b = np.concatenate([groups.edges, groups.edges[:, ::-1]]).T
    into = bare[b]
    return a[into], b[into], np.linalg.norm(centroids_m[a] - centroids_m[b], axis=1)[into]


def _away_m(steps: _Steps, start: Bool) -> Float64:
    """Length (G,) in metres of the shortest way from supervoxels (bool (G,)), at most LONGEST_WAY_M."""
    a, b, length_m = steps
    away_m = np.where(start, 0.0, LONGEST_WAY_M)
    # Bellman and Ford's rounds: few, since no way is followed beyond LONGEST_WAY_M.
    while True:
        nearer_m = away_m.copy()
        np.minimum.at(nearer_m, b, away_m[a] + length_m)
        if np.array_equal(nearer_m, away_m):
            return away_m
        away_m = nearer_m
