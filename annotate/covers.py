"""What lies on a person in a suit and is none of theirs: blankets, laptops, rims of a seat.

Every patch of one colour is asked whether any part of the suit can look like that: by its colour in the
light that explains the whole body, how much surface has that colour, how warm it is, and where it lies
among the others. A blanket of a sleeve's colour is too large for a sleeve, a cold lower leg is no blanket.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from annotate.cloud import ThermalCloud
from annotate.color_model import DARK, readable, under, unfitted
from annotate.evidence import color_bins, frequencies, lab_of
from annotate.part_clues import means_of, warmth_of
from annotate.patches import LEAST_POINTS, MEAN_BLUR, MOST, Patches, pair_scores, patches_of, read_together
from annotate.suit import Suit, chromaticity
from annotate.supervoxels import Supervoxels, supervoxels

STRIDE = 2
"""Colours are compared on every second pixel of every second row."""
SEED_M = 0.05
LEAST_SEEN = 100
"""Points of a person without which there is nothing to compare."""
WARMEST, LEAST_CONTRAST_C = 80.0, 2.0
"""Percentile of a person's temperatures that half a person under a blanket has too, above the room's."""
ALIKE, ALIKE_BLURS, ALIKE_SHADE = 0.045, 0.5, 0.6
"""Chromaticity (and share of its uncertainty), and log brightness, by which one cloth's places differ."""
REACH_M = 1.0
MOST_M2 = np.array([0.035, 0.13, 0.033, 0.033, 0.028, 0.028, 0.045, 0.06, 0.06, 0.056, 0.056])
"""Surface of each part (11,) that can be seen at once: the most of 107 frames of 36 people of the rig."""
LARGER = 8.0
"""Log cost of being e times larger, times the square of the logarithm."""
WARMTH = np.array([1.13, 0.97, 0.84, 0.84, 0.77, 0.77, 0.94, 0.86, 0.86, 0.58, 0.58])
WARMTH_SD = np.array([0.25, 0.08, 0.13, 0.13, 0.22, 0.22, 0.12, 0.13, 0.13, 0.22, 0.22])
"""How far each part is on the way from the room's temperature to the warmest parts', counted likewise."""
WARMTH_COST = 8.0
"""The most that an odd temperature can cost: a hand may have held a glass."""
UNFELT = 0.8
"""What a surface without a temperature counts for."""
PLACE, PLACE_COST = 0.6, 10.0
"""Weight of where a patch lies, and the most that a place can cost before."""
ODDS, BY_PERSON, BY_ROOM = -4.2, -0.67, 0.58
"""Log odds of being no part, and what a unit of the best part's score and of the colour's log frequency in
the room add. Logistic regression over 2,400 patches of 36 people (seeds 101, 110, 111, 130 to 133), left
out by recording 3.5 % of the pixels are told wrong."""
HUE, GREYISH = 0.06, 0.15
"""Side of the cells of chromaticity that count as different colours; so near to the light's it is none."""

_Array = NDArray[np.float64]
_Mask = NDArray[np.bool_]


def colors_worn(cloud: ThermalCloud, person: _Mask, room: _Mask) -> float:
    """How many strong colours somebody (h, w) shows: the perplexity of their hues by the share that has any.

    A suit has many, clothes one or two, things none. room: bool (h, w), what shows the light's own colour.
    """
    rgb = cloud.color_rgb[person & cloud.color_valid][::4]
    white = np.median(chromaticity(cloud.color_rgb[room & cloud.color_valid][::29]), axis=0)
    chroma = chromaticity(rgb[(rgb >= DARK).any(axis=1)])
    strong = chroma[np.linalg.norm(chroma - white, axis=1) > GREYISH]
    if not len(strong):
        return 0.0
    cells = np.unique((strong / HUE).astype(np.int64) @ (1000, 1), return_counts=True)[1]
    share = cells / cells.sum()
    return float(np.exp(-(share * np.log(share)).sum()) * len(strong) / len(chroma))


def covers(cloud: ThermalCloud, person: _Mask, room: _Mask, suit: Suit) -> _Mask:
    """Which of a person's pixels (h, w) are none of theirs. room: bool (h, w), background around them.

    Nothing without temperatures or colours.
    """
    nothing, felt = np.zeros_like(person), np.isfinite(cloud.temperature_c)
    own = nothing.copy()
    own[::STRIDE, ::STRIDE] = (person & cloud.valid & cloud.color_valid)[::STRIDE, ::STRIDE]
    around = room & felt & cloud.color_valid
    if own.sum() < LEAST_SEEN or not (person & felt).any() or not around.any():
        return nothing
    rgb, celsius = cloud.color_rgb[own], cloud.temperature_c[own]
    groups = supervoxels(cloud.points_m[own], rgb, seed_m=SEED_M)
    middle_m = groups.centroids_m(cloud.points_m[own])
    patches = patches_of(groups, *means_of(rgb, readable(rgb, cloud.color_valid[own]), groups), middle_m)
    belief, log_gain = read_together(
        patches, unfitted(suit), patches.mean(warmth_of(celsius, groups), groups.sizes)
    )
    palette = under(unfitted(suit), log_gain)
    by_part = palette.by_part(palette.match(patches.chroma, MEAN_BLUR * patches.blur))
    by_part += _by_size(_alike_m2(cloud, own, groups, patches)) + _by_place(patches, belief)
    patch = patches.ids[groups.ids]
    by_part += _by_warmth(
        _mean(patch, _share(celsius, cloud.temperature_c[around], cloud.temperature_c[person]))
    )
    odds = ODDS + BY_PERSON * by_part.max(axis=1) + BY_ROOM * _mean(patch, _common(cloud, around, own))
    cloth = nothing.copy()
    cloth[own] = ((odds > 0) & (patches.points >= LEAST_POINTS))[patch]
    return _filled(cloth, own) & person


def _mean(patch: NDArray[np.intp], values: NDArray[np.floating]) -> _Array:
    return np.asarray(np.bincount(patch, values) / np.maximum(np.bincount(patch), 1))


def _share(celsius: NDArray[np.float32], room: NDArray[np.float32], person: NDArray[np.float32]) -> _Array:
    """How far temperatures (n,) are on the way from the room's to the warmest parts'; a trunk's if unknown."""
    room_c = float(np.median(room))
    reach_c = max(float(np.nanpercentile(person, WARMEST)) - room_c, LEAST_CONTRAST_C)
    return np.asarray(np.where(np.isfinite(celsius), (celsius - room_c) / reach_c, UNFELT), np.float64)


def _common(cloud: ThermalCloud, around: _Mask, own: _Mask) -> NDArray[np.float32]:
    """Log frequency (n,) in the room (h, w) of the colours of own pixels (h, w)."""
    bins = [
        color_bins(lab_of(cloud.color_rgb[mask][None], np.ones((1, mask.sum()), np.bool_)))
        for mask in (around, own)
    ]
    return np.asarray(np.log(frequencies(bins[0].ravel()))[bins[1].ravel()], np.float32)


def _by_warmth(share: _Array) -> _Array:
    """Log score (R, 11) of patches' temperatures (R,) for every part."""
    return np.asarray(-0.5 * np.minimum(((share[:, None] - WARMTH) / WARMTH_SD) ** 2, 2 * WARMTH_COST))


def _by_size(alike_m2: _Array) -> _Array:
    """Log score (R, 11) of patches' surfaces (R,) for every part."""
    return np.asarray(-LARGER * np.maximum(np.log(alike_m2[:, None] / MOST_M2), 0) ** 2)


def _by_place(patches: Patches, belief: _Array) -> _Array:
    """Log score (R, 11) of every part of a patch, the others being what they are believed to be (R, 11)."""
    used = np.flatnonzero(patches.points >= LEAST_POINTS)[:MOST]
    part = belief[used].argmax(axis=1)
    pairs = pair_scores(patches, used)
    order = np.arange(len(used))
    heard = pairs[order[None], order[:, None], part[None]]  # [patch, other]: the other's part against 11
    heard[order, order] = 0
    score = np.zeros((len(patches.points), len(MOST_M2)))
    score[used] = PLACE * np.maximum(heard.sum(axis=1), -PLACE_COST)
    return score


def _alike_m2(cloud: ThermalCloud, own: _Mask, groups: Supervoxels, patches: Patches) -> _Array:
    """Surface (R,) that has a patch's colour and is near it."""
    rgb, points_m = cloud.color_rgb[own], cloud.points_m[own]
    chroma, blur = means_of(rgb, readable(rgb, cloud.color_valid[own]), groups)
    pixel_m2 = STRIDE**2 * points_m[:, 2].astype(np.float64) ** 2 / (cloud.camera.fx * cloud.camera.fy)
    surface_m2 = np.bincount(groups.ids, pixel_m2)
    bright = rgb.max(axis=1).astype(np.float64)
    shade = np.log(np.maximum(_mean(groups.ids, bright), 1))
    shades = np.log(np.maximum(_mean(patches.ids[groups.ids], bright), 1))
    alike = np.linalg.norm(chroma - patches.chroma[:, None], axis=2) < ALIKE + ALIKE_BLURS * blur
    alike &= np.abs(shade - shades[:, None]) < ALIKE_SHADE
    alike &= np.linalg.norm(groups.centroids_m(points_m) - patches.middle_m[:, None], axis=2) < REACH_M
    return np.asarray((alike | (patches.ids == np.arange(len(patches.points))[:, None])) @ surface_m2)


def _filled(cloth: _Mask, own: _Mask) -> _Mask:
    """The answer of the pixels looked at (h, w), as ``own`` says, for those between them."""
    block = np.ones((2 * STRIDE + 1, 2 * STRIDE + 1))
    near = cv2.filter2D(cloth.astype(np.float32), -1, block)
    return np.asarray(2 * near > cv2.filter2D(own.astype(np.float32), -1, block))
