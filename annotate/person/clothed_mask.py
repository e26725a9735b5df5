"""Which surfaces are a person's who is in a suit, and which lie on them or beside: blankets, laptops, seats.

Every patch of one colour is asked whether any part of the suit can look like that: by its colour in the
light that explains the whole body, how much surface has that colour, how warm it is, and where it lies
among the others. A blanket of a sleeve's colour is too large for a sleeve; a cold lower leg is a leg.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from annotate.array_types import Bool, Float32, Float64, Index, Int32
from annotate.cloud.color_odds import color_bins, frequencies, lab_of
from annotate.cloud.supervoxels import Supervoxels, supervoxels
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.engine import Weights
from annotate.person.patch_likelihoods import (
    ANY_COLOR,
    MOST_M2,
    NOT_ALIKE,
    ODD_M2,
    STRIDE,
    alike_m2,
    by_place,
    by_size,
    by_warmth,
    mean_by,
    share,
)
from annotate.segmentation.part_clues import means_of, warmth_of
from annotate.segmentation.patches import LEAST_POINTS, MEAN_BLUR, Patches, patches_of, read_together
from annotate.suit.color_model import readable, under, unfitted
from annotate.suit.palette import Suit

SEED_M = 0.05
ROUNDS, SURELY_NOT = 2, -2.0
"""The body is read again without what surely lay on it: log odds below these."""
LEAST_SEEN = 100
"""Points of a person without which there is nothing to compare."""
CLUES = (
    "best part's score",
    "share in the mask",
    "odds of the mask",
    "log brightness above the room's",
    "log frequency of its colours in the room",
    "log surface of its colour",
    "one",
)
"""What adds to the log odds of a patch being a person's, each by its weight (`Weights.clothed`). The mask is
the one found without the suit's colours."""
BEST, OWN = 0, 2
"""Columns of the first and the third."""
MOST = 6.0
"""Log odds of a patch, or of those that touch it, are at most that, either way; chosen by eye."""
LOOSE, GAP_PX = 0.5, 5
"""What the mask counts for in pieces apart from its largest, by gaps wider than half of that: what is warm
near a person is a laptop as often as a leg."""


@dataclass(frozen=True)
class Clues:
    """What is known of the patches (R,) of what may be somebody's.

    own: bool (h, w), the n pixels compared. odds: (n,) of each by itself. groups: their supervoxels; chroma
    (G, 2), blur (G,): mean chromaticity of each and its uncertainty. inside: bool (R,), which patches lie in
    the mask found without the suit. alike_m2: (R,) surface of a patch's colour. told: (R, 7), in the order
    of CLUES.
    """

    own: Bool
    odds: Float32
    groups: Supervoxels
    chroma: Float64
    blur: Float64
    patches: Patches
    inside: Bool
    alike_m2: Float64
    told: Float64

    @property
    def patch(self) -> Index:
        """The patch (n,) of each pixel compared."""
        return self.patches.ids[self.groups.ids]


def worn(known: Clues, fitted: Weights) -> Float32:
    """Log odds (h, w) of being the person's, 0 where nothing is told."""
    patch, weights = known.patch, fitted.clothed[np.where(known.inside, 0, 1)]
    kept, by_touch = fitted.touch
    by_own, odds = weights[:, OWN] * kept, (known.told * weights).sum(axis=1)
    by_patch = kept * odds + by_touch * of_touching(known.patches, odds) - by_own * known.told[:, OWN]
    told = np.clip(by_patch[patch] + by_own[patch] * known.odds, -MOST, MOST)
    return filled(np.where(known.patches.points[patch] >= LEAST_POINTS, told, 0), known.own)


def clues(
    cloud: ThermalCloud,
    person: Bool,
    beside: Bool,
    room: Bool,
    suit: Suit,
    odds: Float32,
    weights: Float64,
) -> Clues | None:
    """What ``worn`` goes by; None without temperatures or colours.

    person, beside: bool (h, w), the mask found without the suit's colours, and what else may be theirs.
    room: bool (h, w), background around both. odds: (h, w) of being a person, the suit's colours apart.
    weights: (2, 7) of the clues, inside the mask and off it.
    """
    felt, own = np.isfinite(cloud.temperature_c), np.zeros_like(person)
    own[::STRIDE, ::STRIDE] = ((person | beside) & cloud.valid & cloud.color_valid)[::STRIDE, ::STRIDE]
    if (own & person).sum() < LEAST_SEEN or not (person & felt).any() or not (room & felt).any():
        return None
    rgb, celsius = cloud.color_rgb[own], cloud.temperature_c[own]
    groups = supervoxels(cloud.points_m[own], rgb, seed_m=SEED_M)
    chroma, blur = means_of(rgb, readable(rgb, np.ones(len(rgb), np.bool_)), groups)
    patches = patches_of(groups, chroma, blur, groups.centroids_m(cloud.points_m[own]))
    patch = patches.ids[groups.ids]
    inside = mean_by(patch, person[own]) > 0.5
    own_m2, all_m2 = (
        alike_m2(cloud, own, groups, patches, chroma, np.where(told, blur, NOT_ALIKE))
        for told in (inside[patches.ids], True)
    )
    felt_as = by_warmth(
        mean_by(patch, share(celsius, cloud.temperature_c[room], cloud.temperature_c[person]))
    )
    by_pixel = np.clip(odds[own], -MOST, MOST)
    seen = (_held(person)[own], by_pixel, *by_room(cloud, own, room))
    best, one = np.zeros(len(inside)), np.ones(len(inside))
    told = np.column_stack([best, *(mean_by(patch, values) for values in seen), np.log(all_m2), one])
    warmth = patches.mean(warmth_of(celsius, groups), groups.sizes)
    told[:, BEST] = _best(
        patches, inside, suit, warmth, felt_as, own_m2, told, weights[np.where(inside, 0, 1)]
    )
    return Clues(own, by_pixel, groups, chroma, blur, patches, inside, all_m2, told)


def _best(
    patches: Patches,
    inside: Bool,
    suit: Suit,
    warmth: Float64,
    felt_as: Float64,
    own_m2: Float64,
    told: Float64,
    weights: Float64,
) -> Float64:
    """Score (R,) of the part that each patch is likeliest to be, the body being what surely is of it.

    warmth, felt_as: (R, 11) what temperatures say of parts, against the body's and the room's. own_m2: (R,).
    told: (R, 7) all other clues. weights: (R, 7) theirs.
    """
    odd = ANY_COLOR + by_size(own_m2, ODD_M2)
    best, mine = np.full(len(inside), -np.inf), inside
    for _ in range(ROUNDS):
        body = replace(patches, points=np.where(mine, patches.points, 0))
        belief, log_gain = read_together(body, unfitted(suit), warmth)
        palette = under(unfitted(suit), log_gain)
        by_part = palette.by_part(palette.match(patches.chroma, MEAN_BLUR * patches.blur))
        by_part = np.maximum(by_part + by_size(own_m2, MOST_M2), odd) + felt_as
        best = np.maximum(best, (by_part + by_place(patches, body, belief)).max(axis=1))
        mine = mine & ((told * weights).sum(axis=1) + weights[:, BEST] * best > SURELY_NOT)
    return best


def by_room(cloud: ThermalCloud, own: Bool, room: Bool) -> tuple[Float32, Float32]:
    """Of pixels (h, w), (n,): log brightness above the room's (h, w), log frequency of the colour there."""
    seen = room & cloud.color_valid
    common = np.log(frequencies(_bins(cloud, seen)))
    usual = max(float(np.median(cloud.color_rgb[seen].max(axis=1))), 1.0)
    shade = np.log(np.maximum(cloud.color_rgb[own].max(axis=1), 1) / np.float32(usual))
    return shade, common[_bins(cloud, own)]


def _bins(cloud: ThermalCloud, among: Bool) -> Int32:
    """Bins (n,) of the colours of pixels (h, w)."""
    return color_bins(
        lab_of(cloud.color_rgb[among][None], np.ones((1, np.count_nonzero(among)), np.bool_))[0]
    )


def of_touching(patches: Patches, odds: Float64) -> Float64:
    """Mean log odds (R,) of the patches that touch each, from log odds (R,); 0 where none does."""
    contacts = patches.contacts * (patches.points >= LEAST_POINTS)
    return np.asarray(contacts @ np.clip(odds, -MOST, MOST) / np.maximum(contacts.sum(axis=1), 1e-9))


def _held(person: Bool) -> Float32:
    """What a mask (h, w) counts for (h, w): 1 in its largest piece, less in the others, 0 off it."""
    closed = cv2.dilate(person.astype(np.uint8), np.ones((GAP_PX, GAP_PX), np.uint8))
    pieces = cv2.connectedComponents(closed)[1]
    largest = np.bincount(pieces[person]).argmax()
    return np.where(person, np.where(pieces == largest, 1, LOOSE), 0).astype(np.float32)


def filled(values: NDArray[np.floating], own: Bool) -> Float32:
    """Values (n,) of the pixels looked at (h, w) for those between them (h, w): the mean of those beside."""
    image, block = np.zeros(own.shape, np.float32), (2 * STRIDE - 1, 2 * STRIDE - 1)
    image[own] = values
    total, count = (
        cv2.boxFilter(one, cv2.CV_32F, block, normalize=False, borderType=cv2.BORDER_CONSTANT)
        for one in (image, own.astype(np.float32))
    )
    return np.asarray(total / np.maximum(count, 1), np.float32)
