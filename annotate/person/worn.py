"""Which surfaces are a person's who is in a suit, and which lie on them or beside: blankets, laptops, seats.

Every patch of one colour is asked whether any part of the suit can look like that: by its colour in the
light that explains the whole body, how much surface has that colour, how warm it is, and where it lies
among the others. A blanket of a sleeve's colour is too large for a sleeve; a cold lower leg is a leg.
"""

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from annotate.cloud import ThermalCloud
from annotate.color_odds import color_bins, frequencies, lab_of
from annotate.parts import BODY_PARTS
from annotate.segmentation.part_clues import means_of, warmth_of
from annotate.segmentation.patches import (
    LEAST_POINTS,
    MEAN_BLUR,
    Patches,
    pair_scores,
    patches_of,
    read_together,
)
from annotate.segmentation.patches import MOST as MOST_PATCHES
from annotate.suit.color_model import readable, under, unfitted
from annotate.suit.palette import Suit
from annotate.supervoxels import Supervoxels, supervoxels

STRIDE = 2
"""Colours are compared on every second pixel of every second row."""
SEED_M = 0.05
LEAST_LIKELY = 1e-4
"""No place is less likely than that for what one other part of the body tells of it."""
ROUNDS, SURELY_NOT = 2, -2.0
"""The body is read again without what surely lay on it: log odds below these."""
LEAST_SEEN = 100
"""Points of a person without which there is nothing to compare."""
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
WEIGHTS = np.array(
    [[0.56, 4.53, 0.69, 2.39, -0.34, -1.25, -6.77], [0.43, 7.02, 0.58, 0.48, -0.46, -0.47, -5.37]]
)
"""What adds to the log odds of a patch being a person's, in and off the mask found without the suit's
colours: the best part's score; the share in that mask; its odds; log brightness above the room's; log
frequency of its colours in the room; log surface of its colour; 1. Logistic regression."""
BEST, OWN = 0, 2
"""Columns of the first and the third."""
KEPT, BY_TOUCH, MOST = 0.92, 0.42, 6.0
"""Weights of a patch's own odds and of those of what it touches: things are whole; the most of either."""
LOOSE, GAP_PX = 0.5, 5
"""What the mask counts for in pieces apart from its largest, by gaps wider than half of that: what is warm
near a person is a laptop as often as a leg."""

_Array = NDArray[np.float64]
_Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Clues:
    """What is known of the patches (R,) of what may be somebody's.

    own: bool (h, w), the pixels compared; patch: (n,) which patch each is of. odds: (n,) of each by itself.
    inside: bool (R,), which lie in the mask found without the suit. told: (R, 7), in the order of WEIGHTS.
    """

    own: _Mask
    patch: NDArray[np.intp]
    odds: NDArray[np.float32]
    patches: Patches
    inside: NDArray[np.bool_]
    told: _Array


def worn(
    cloud: ThermalCloud, person: _Mask, beside: _Mask, room: _Mask, suit: Suit, odds: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Log odds (h, w) of being the person's, 0 where nothing is told.

    person, beside: bool (h, w), the mask found without the suit's colours, and what else may be theirs.
    room: bool (h, w), background around both. odds: (h, w) of being a person, the suit's colours apart.
    All 0 without temperatures or colours.
    """
    known = clues(cloud, person, beside, room, suit, odds)
    if known is None:
        return np.zeros(person.shape, np.float32)
    patch, weights = known.patch, WEIGHTS[np.where(known.inside, 0, 1)]
    by_own = weights[:, OWN] * KEPT
    by_patch = heard(known.patches, (known.told * weights).sum(axis=1)) - by_own * known.told[:, OWN]
    return _filled(np.clip(by_patch[patch] + by_own[patch] * known.odds, -MOST, MOST), known.own)


def clues(
    cloud: ThermalCloud, person: _Mask, beside: _Mask, room: _Mask, suit: Suit, odds: NDArray[np.float32]
) -> Clues | None:
    """What ``worn`` goes by, given the same; None where it has nothing to go by."""
    felt, own = np.isfinite(cloud.temperature_c), np.zeros_like(person)
    own[::STRIDE, ::STRIDE] = ((person | beside) & cloud.valid & cloud.color_valid)[::STRIDE, ::STRIDE]
    if (own & person).sum() < LEAST_SEEN or not (person & felt).any() or not (room & felt).any():
        return None
    rgb, celsius = cloud.color_rgb[own], cloud.temperature_c[own]
    groups = supervoxels(cloud.points_m[own], rgb, seed_m=SEED_M)
    chroma, blur = means_of(rgb, readable(rgb, np.ones(len(rgb), np.bool_)), groups)
    patches = patches_of(groups, chroma, blur, groups.centroids_m(cloud.points_m[own]))
    patch = patches.ids[groups.ids]
    inside = _mean(patch, person[own]) > 0.5
    own_m2, all_m2 = (
        _alike_m2(cloud, own, groups, patches, chroma, np.where(told, blur, NOT_ALIKE))
        for told in (inside[patches.ids], True)
    )
    felt_as = _by_warmth(
        _mean(patch, _share(celsius, cloud.temperature_c[room], cloud.temperature_c[person]))
    )
    by_pixel = np.clip(odds[own], -MOST, MOST)
    others = (_held(person)[own], by_pixel, *_by_room(cloud, own, room))
    told = np.column_stack([np.zeros(len(inside)), *(_mean(patch, one) for one in others), np.log(all_m2)])
    told = np.column_stack([told, np.ones(len(inside))])
    warmth = patches.mean(warmth_of(celsius, groups), groups.sizes)
    told[:, BEST] = _best(patches, inside, suit, warmth, felt_as, own_m2, told)
    return Clues(own, patch, by_pixel, patches, inside, told)


def _best(
    patches: Patches,
    inside: NDArray[np.bool_],
    suit: Suit,
    warmth: _Array,
    felt_as: _Array,
    own_m2: _Array,
    told: _Array,
) -> _Array:
    """Score (R,) of the part that each patch is likeliest to be, the body being what surely is of it.

    warmth, felt_as: (R, 11) what temperatures say of parts, against the body's and the room's. own_m2: (R,).
    told: (R, 7) all other clues.
    """
    odd = ANY_COLOR + _by_size(own_m2, ODD_M2)
    weights = WEIGHTS[np.where(inside, 0, 1)]
    best, mine = np.full(len(inside), -np.inf), inside
    for _ in range(ROUNDS):
        body = replace(patches, points=np.where(mine, patches.points, 0))
        belief, log_gain = read_together(body, unfitted(suit), warmth)
        palette = under(unfitted(suit), log_gain)
        by_part = palette.by_part(palette.match(patches.chroma, MEAN_BLUR * patches.blur))
        by_part = np.maximum(by_part + _by_size(own_m2, MOST_M2), odd) + felt_as
        best = np.maximum(best, (by_part + _by_place(patches, body, belief)).max(axis=1))
        mine = mine & ((told * weights).sum(axis=1) + weights[:, BEST] * best > SURELY_NOT)
    return best


def _by_room(cloud: ThermalCloud, own: _Mask, room: _Mask) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Of pixels (h, w), (n,): log brightness above the room's (h, w), log frequency of the colour there."""
    seen = room & cloud.color_valid
    common = np.log(frequencies(_bins(cloud, seen)))
    usual = max(float(np.median(cloud.color_rgb[seen].max(axis=1))), 1.0)
    shade = np.log(np.maximum(cloud.color_rgb[own].max(axis=1), 1) / np.float32(usual))
    return shade, common[_bins(cloud, own)]


def _bins(cloud: ThermalCloud, among: _Mask) -> NDArray[np.int32]:
    """Bins (n,) of the colours of pixels (h, w)."""
    return color_bins(
        lab_of(cloud.color_rgb[among][None], np.ones((1, np.count_nonzero(among)), np.bool_))[0]
    )


def heard(patches: Patches, odds: _Array) -> _Array:
    """Log odds (R,) of patches, those of what they touch heard."""
    heed = patches.contacts * (patches.points >= LEAST_POINTS)
    around = heed @ np.clip(odds, -MOST, MOST) / np.maximum(heed.sum(axis=1), 1e-9)
    return np.asarray(KEPT * odds + BY_TOUCH * around)


def _mean(patch: NDArray[np.integer[Any]], values: NDArray[np.generic]) -> _Array:
    return np.asarray(np.bincount(patch, values) / np.maximum(np.bincount(patch), 1))


def _held(person: _Mask) -> NDArray[np.float32]:
    """What a mask (h, w) counts for (h, w): 1 in its largest piece, less in the others, 0 off it."""
    closed = cv2.dilate(person.astype(np.uint8), np.ones((GAP_PX, GAP_PX), np.uint8))
    pieces = cv2.connectedComponents(closed)[1]
    largest = np.bincount(pieces[person]).argmax()
    return np.where(person, np.where(pieces == largest, 1, LOOSE), 0).astype(np.float32)


def _share(celsius: NDArray[np.float32], room: NDArray[np.float32], person: NDArray[np.float32]) -> _Array:
    """How far temperatures (n,) are on the way from the room's to the warmest parts'."""
    room_c = float(np.nanmedian(room))
    reach_c = max(float(np.nanpercentile(person, WARMEST)) - room_c, LEAST_CONTRAST_C)
    return np.asarray(np.where(np.isfinite(celsius), (celsius - room_c) / reach_c, UNFELT), np.float64)


def _by_warmth(share: _Array) -> _Array:
    """Log score (R, 11) of patches' temperatures (R,) for every part."""
    away = ((share[:, None] - WARMTH) / WARMTH_SD) ** 2
    return np.asarray(-WARMTH_WEIGHT * np.minimum(0.5 * away, WARMTH_COST))


def _by_size(alike_m2: _Array, most_m2: _Array) -> _Array:
    """Log score (R, 11) of patches' surfaces (R,) for every part, which has at most so much (11,)."""
    return np.asarray(-LARGER * np.maximum(np.log(alike_m2[:, None] / most_m2), 0) ** 2)


def _by_place(patches: Patches, body: Patches, belief: _Array) -> _Array:
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


def _alike_m2(
    cloud: ThermalCloud, own: _Mask, groups: Supervoxels, patches: Patches, chroma: _Array, blur: _Array
) -> _Array:
    """Surface (R,) that has a patch's colour and is near it; chroma (G, 2), blur (G,): the supervoxels'.

    A blur of ``NOT_ALIKE`` keeps a supervoxel out: the room may have a sleeve's colour.
    """
    rgb, points_m = cloud.color_rgb[own], cloud.points_m[own]
    pixel_m2 = STRIDE**2 * points_m[:, 2].astype(np.float64) ** 2 / (cloud.camera.fx * cloud.camera.fy)
    surface_m2 = np.asarray(np.bincount(groups.ids, pixel_m2), np.float64)
    bright = rgb.max(axis=1).astype(np.float64)
    shade, shades = (
        np.log(np.maximum(_mean(ids, bright), 1)) for ids in (groups.ids, patches.ids[groups.ids])
    )
    here = np.column_stack([chroma, shade, groups.centroids_m(points_m)])
    there = np.column_stack([patches.chroma, shades, patches.middle_m])
    return np.asarray(_alike(here, ALIKE + ALIKE_BLURS * blur, surface_m2, patches.ids, there))


@njit(cache=True, nogil=True)
def _alike(here: _Array, within: _Array, surface_m2: _Array, ids: NDArray[np.intp], there: _Array) -> _Array:
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


def _filled(values: NDArray[np.floating], own: _Mask) -> NDArray[np.float32]:
    """Values (n,) of the pixels looked at (h, w) for those between them (h, w): the mean of those beside."""
    image, block = np.zeros(own.shape, np.float32), (2 * STRIDE - 1, 2 * STRIDE - 1)
    image[own] = values
    total, count = (
        cv2.boxFilter(one, cv2.CV_32F, block, normalize=False, borderType=cv2.BORDER_CONSTANT)
        for one in (image, own.astype(np.float32))
    )
    return np.asarray(total / np.maximum(count, 1), np.float32)
