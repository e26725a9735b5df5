"""Which surfaces are a person's who is in a suit, and which lie on them or beside: blankets, laptops, seats.

Every patch of one colour is asked whether any part of the suit can look like that: by its colour in the
light that explains the whole body, how much surface has that colour, how warm it is, and where it lies
among the others. A blanket of a sleeve's colour is too large for a sleeve; a cold lower leg is a leg.
"""

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from annotate.cloud import ThermalCloud
from annotate.parts import BODY_PARTS
from annotate.segmentation.part_clues import means_of, warmth_of
from annotate.segmentation.patches import (
    LEAST_POINTS,
    MEAN_BLUR,
    MOST,
    Patches,
    pair_scores,
    patches_of,
    read_together,
)
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
ODDS, BY_PART, BY_MASK = 0.3, 0.75, 4.75
"""Log odds of being a part, and what a unit of the best part's score, and lying in the mask found without
the suit's colours, add. Logistic regression over 2,848 patches in 77 frames of 54 people of the rig (seeds
101, 110, 111, 130 to 133), rounded; left out by recording, 5 pixels are told wrong for 100 of a person."""
LOOSE, GAP_PX = 0.5, 5
"""What the mask counts for in pieces apart from its largest, by gaps wider than half of that: what is warm
near a person is a laptop as often as a leg."""

_Array = NDArray[np.float64]
_Mask = NDArray[np.bool_]


def worn(cloud: ThermalCloud, person: _Mask, beside: _Mask, room: _Mask, suit: Suit) -> NDArray[np.float32]:
    """Log odds (h, w) of being the person's, 0 where nothing is told.

    person, beside: bool (h, w), the mask found without the suit's colours, and what else may be theirs.
    room: bool (h, w), background around both. All 0 without temperatures or colours.
    """
    felt, own = np.isfinite(cloud.temperature_c), np.zeros_like(person)
    own[::STRIDE, ::STRIDE] = ((person | beside) & cloud.valid & cloud.color_valid)[::STRIDE, ::STRIDE]
    if (own & person).sum() < LEAST_SEEN or not (person & felt).any() or not (room & felt).any():
        return np.zeros(person.shape, np.float32)
    rgb, celsius = cloud.color_rgb[own], cloud.temperature_c[own]
    groups = supervoxels(cloud.points_m[own], rgb, seed_m=SEED_M)
    chroma, blur = means_of(rgb, readable(rgb, np.ones(len(rgb), np.bool_)), groups)
    patches = patches_of(groups, chroma, blur, groups.centroids_m(cloud.points_m[own]))
    patch = patches.ids[groups.ids]
    inside, held = _mean(patch, person[own]), _mean(patch, _held(person)[own])
    warmth = patches.mean(warmth_of(celsius, groups), groups.sizes)
    alike_m2 = _alike_m2(
        cloud, own, groups, patches, chroma, np.where(inside[patches.ids] > 0.5, blur, NOT_ALIKE)
    )
    odd = ANY_COLOR + _by_size(alike_m2, ODD_M2)
    felt_as = _by_warmth(
        _mean(patch, _share(celsius, cloud.temperature_c[room], cloud.temperature_c[person]))
    )
    odds = np.full(len(inside), -np.inf)
    mine = inside > 0.5
    for _ in range(ROUNDS):
        body = replace(patches, points=np.where(mine, patches.points, 0))
        belief, log_gain = read_together(body, unfitted(suit), warmth)
        palette = under(unfitted(suit), log_gain)
        by_part = palette.by_part(palette.match(patches.chroma, MEAN_BLUR * patches.blur))
        by_part = np.maximum(by_part + _by_size(alike_m2, MOST_M2), odd)
        by_part += felt_as + _by_place(patches, body, belief)
        odds = np.maximum(odds, ODDS + BY_PART * by_part.max(axis=1) + BY_MASK * held)
        mine &= odds > SURELY_NOT
    return _filled(np.where(patches.points >= LEAST_POINTS, odds, 0)[patch], own)


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
    known = np.flatnonzero(body.points[told] >= LEAST_POINTS)[:MOST]
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
