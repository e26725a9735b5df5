"""Log odds (h, w) of the person in a suit, without things on or beside them: blankets, laptops, seats.

Every patch of one colour is scored as each part of the suit: by its colour in the light that explains the
whole body, by the surface of that colour, by its warmth, and by its place among the others. A blanket of a
sleeve's colour is too large for a sleeve; a cold lower leg is a leg.
"""

from dataclasses import dataclass, replace
from enum import IntEnum

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
    COMPARED_STRIDE,
    MOST_M2,
    NEVER_ALIKE,
    ODD_M2,
    mean_over,
    place_scores,
    relative_warmth,
    same_color_m2,
    size_scores,
    warmth_scores,
)
from annotate.segmentation.part_clues import means_of, warmth_evidence
from annotate.segmentation.patches import MEAN_BLUR, SEED_M, Patches, patches_of, read_together
from annotate.suit.color_model import readable, under, unfitted
from annotate.suit.palette import Suit

BODY_ROUNDS, REJECTED_ODDS = 2, -2.0
"""Readings of the body, each without the patches rejected by the one before, and the log odds below which a
patch is rejected. Chosen by eye."""
LEAST_SEEN = 100
"""Pixels of a person below which there is nothing to compare. Chosen by eye."""


class Clue(IntEnum):
    """Columns of a patch's clues, all of the order of one; their weights are `Weights.clothed`."""

    PART_SCORE = 0  # log score of its best part
    IN_MASK = 1  # mean weight of its pixels in the mask found without the suit's colours
    PIXEL_ODDS = 2  # mean log odds of its pixels without the suit's colours
    BRIGHTNESS = 3  # log brightness above the room's median
    FREQUENCY = 4  # log frequency of its colours in the room
    SURFACE = 5  # log surface in m2 of its colour near by
    ONE = 6  # for the intercept


MOST_PERSON_ODDS = 6.0
"""Bound of the log odds of being the person's. Chosen by eye."""
LOOSE_WEIGHT, GAP_PX = 0.5, 5
"""Weight of the mask's smaller pieces, as a warm thing is a laptop as often as a leg, and twice the width in
pixels of a gap that parts two pieces. Chosen by eye."""


@dataclass(frozen=True)
class PatchClues:
    """Clues of the R patches on and around a person.

    compared: bool (h, w), the n pixels of the patches. pixel_odds: (n,), log odds without the suit. groups:
    their G supervoxels; chroma (G, 2), blur (G,): mean chromaticity and its uncertainty. in_mask: bool (R,),
    patches mostly in the mask found without the suit. surface_m2: (R,), surface of a patch's colour near by.
    columns: (R, 7), clues in the order of ``Clue``.
    """

    compared: Bool
    pixel_odds: Float32
    groups: Supervoxels
    chroma: Float64
    blur: Float64
    patches: Patches
    in_mask: Bool
    surface_m2: Float64
    columns: Float64

    @property
    def patch(self) -> Index:
        """Number (n,) of the patch of each compared pixel."""
        return self.patches.ids[self.groups.ids]


def clothed_odds(clues: PatchClues, weights: Weights) -> Float32:
    """Log odds (h, w) of being the person's, 0 where unknown."""
    patch, by_clue = clues.patch, weights.clothed[np.where(clues.in_mask, 0, 1)]
    own, touching = weights.touch
    by_pixel, odds = by_clue[:, Clue.PIXEL_ODDS] * own, (clues.columns * by_clue).sum(axis=1)
    by_patch = own * odds + touching * touching_odds(clues.patches, odds)
    by_patch = by_patch - by_pixel * clues.columns[:, Clue.PIXEL_ODDS]
    odds = by_patch[patch] + by_pixel[patch] * clues.pixel_odds
    odds = np.clip(odds, -MOST_PERSON_ODDS, MOST_PERSON_ODDS)
    return interpolated(np.where(clues.patches.is_large[patch], odds, 0), clues.compared)


def patch_clues(
    cloud: ThermalCloud, person: Bool, beside: Bool, room: Bool, suit: Suit, odds: Float32, weights: Weights
) -> PatchClues | None:
    """Clues of the patches on a person and beside; None without temperatures or colours.

    person: bool (h, w), the mask found without the suit's colours. beside: bool (h, w), other pixels that may
    be the person's. room: bool (h, w), background around both. odds: (h, w), log odds without the suit.
    """
    felt, compared = np.isfinite(cloud.temperature_c), np.zeros_like(person)
    compared[::COMPARED_STRIDE, ::COMPARED_STRIDE] = True
    compared &= (person | beside) & cloud.valid & cloud.color_valid
    if (compared & person).sum() < LEAST_SEEN or not (person & felt).any() or not (room & felt).any():
        return None
    rgb, celsius = cloud.color_rgb[compared], cloud.temperature_c[compared]
    groups = supervoxels(cloud.points_m[compared], rgb, seed_m=SEED_M)
    chroma, blur = means_of(rgb, readable(rgb, np.ones(len(rgb), np.bool_)), groups)
    patches = patches_of(groups, chroma, blur, groups.centroids_m(cloud.points_m[compared]))
    patch = patches.ids[groups.ids]
    in_mask = mean_over(patch, person[compared]) > 0.5
    own_m2, all_m2 = (
        same_color_m2(cloud, compared, groups, patches, chroma, np.where(counted, blur, NEVER_ALIKE))
        for counted in (in_mask[patches.ids], True)
    )
    warmth = relative_warmth(celsius, cloud.temperature_c[room], cloud.temperature_c[person])
    pixel_odds = np.clip(odds[compared], -MOST_PERSON_ODDS, MOST_PERSON_ODDS)
    by_pixel = (_mask_weight(person)[compared], pixel_odds, *room_contrast(cloud, compared, room))
    unscored, one = np.zeros(len(in_mask)), np.ones(len(in_mask))
    means = (mean_over(patch, values) for values in by_pixel)
    columns = np.column_stack([unscored, *means, np.log(all_m2), one])
    by_warmth = warmth_scores(mean_over(patch, warmth))
    evidence = patches.mean(warmth_evidence(celsius, groups), groups.sizes)
    by_clue = weights.clothed[np.where(in_mask, 0, 1)]
    columns[:, Clue.PART_SCORE] = _part_score(
        patches, in_mask, suit, evidence, by_warmth, own_m2, columns, by_clue
    )
    return PatchClues(compared, pixel_odds, groups, chroma, blur, patches, in_mask, all_m2, columns)


def _part_score(
    patches: Patches,
    in_mask: Bool,
    suit: Suit,
    evidence: Float64,
    by_warmth: Float64,
    own_m2: Float64,
    columns: Float64,
    weights: Float64,
) -> Float64:
    """Log score (R,) of each patch's best part, the body being the patches not yet rejected.

    evidence, by_warmth: (R, 11), of temperatures against the body's median, and against the room's. columns:
    (R, 7), clues without this one; weights: (R, 7).
    """
    odd = ANY_COLOR + size_scores(own_m2, ODD_M2)
    best, accepted = np.full(len(in_mask), -np.inf), in_mask
    for _ in range(BODY_ROUNDS):
        body = replace(patches, points=np.where(accepted, patches.points, 0))
        belief, log_gain = read_together(body, unfitted(suit), evidence)
        palette = under(unfitted(suit), log_gain)
        by_part = palette.by_part(palette.match(patches.chroma, MEAN_BLUR * patches.blur))
        by_part = np.maximum(by_part + size_scores(own_m2, MOST_M2), odd) + by_warmth
        best = np.maximum(best, (by_part + place_scores(patches, body, belief)).max(axis=1))
        odds = (columns * weights).sum(axis=1) + weights[:, Clue.PART_SCORE] * best
        accepted = accepted & (odds > REJECTED_ODDS)
    return best


def room_contrast(cloud: ThermalCloud, compared: Bool, room: Bool) -> tuple[Float32, Float32]:
    """Log brightness (n,) above the room's median, and log frequency (n,) of the colour in the room.

    compared, room: bool (h, w), the n pixels and the background.
    """
    seen = room & cloud.color_valid
    common = np.log(frequencies(_bins(cloud, seen)))
    usual = max(float(np.median(cloud.color_rgb[seen].max(axis=1))), 1.0)
    shade = np.log(np.maximum(cloud.color_rgb[compared].max(axis=1), 1) / np.float32(usual))
    return shade, common[_bins(cloud, compared)]


def _bins(cloud: ThermalCloud, among: Bool) -> Int32:
    """Colour bins (n,) of the pixels of a mask (h, w)."""
    rgb = cloud.color_rgb[among][None]
    return color_bins(lab_of(rgb, np.ones(rgb.shape[:2], np.bool_))[0])


def touching_odds(patches: Patches, odds: Float64) -> Float64:
    """Mean log odds (R,) of the patches that touch each one, from log odds (R,); 0 without contacts."""
    weight = patches.contacts * patches.is_large
    bounded = np.clip(odds, -MOST_PERSON_ODDS, MOST_PERSON_ODDS)
    return np.asarray(weight @ bounded / np.maximum(weight.sum(axis=1), 1e-9))


def _mask_weight(person: Bool) -> Float32:
    """Weight (h, w) of a mask's pixels: 1 in its largest piece, LOOSE_WEIGHT in the others, 0 off it."""
    closed = cv2.dilate(person.astype(np.uint8), np.ones((GAP_PX, GAP_PX), np.uint8))
    pieces = cv2.connectedComponents(closed)[1]
    largest = np.bincount(pieces[person]).argmax()
    return np.where(person, np.where(pieces == largest, 1, LOOSE_WEIGHT), 0).astype(np.float32)


def interpolated(values: NDArray[np.floating], compared: Bool) -> Float32:
    """Values (n,) of the compared pixels (h, w), and means of them for the pixels between: (h, w)."""
    image, block = np.zeros(compared.shape, np.float32), (2 * COMPARED_STRIDE - 1, 2 * COMPARED_STRIDE - 1)
    image[compared] = values
    total, count = (
        cv2.boxFilter(plane, cv2.CV_32F, block, normalize=False, borderType=cv2.BORDER_CONSTANT)
        for plane in (image, compared.astype(np.float32))
    )
    return np.asarray(total / np.maximum(count, 1), np.float32)
