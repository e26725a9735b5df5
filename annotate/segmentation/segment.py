"""Parts and confidence (h, w) of a person's points, by the suit's colours, time and the part tree."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit

from annotate.array_types import Bool, Float32, Float64, Int32, UInt8
from annotate.cloud.supervoxels import Supervoxels, single_points, supervoxels
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.engine import Engine, Steps
from annotate.frame_labels import FrameLabels
from annotate.labelset.images import Probabilities
from annotate.parts import BACKGROUND, BODY_PARTS, NEIGHBOURS, UNDEFINED
from annotate.segmentation.bare import bareness, cuff_evidence, without_sides
from annotate.segmentation.confidence import chance_right, features
from annotate.segmentation.part_clues import (
    SuitReading,
    earlier_parts,
    means_of,
    pooled,
    previous_evidence,
    warmth_evidence,
    with_earlier,
)
from annotate.segmentation.part_tree import softmax, tree_belief
from annotate.segmentation.patches import SEED_M, patches_of, read_alone, read_together
from annotate.suit.color_model import CLIPPED, readable, refit_colors, under, unfitted
from annotate.suit.palette import Suit
from sensors.rig.nearest import Nearest

MIN_READABLE_SHARE, BAD_SHARE = 0.05, 0.3
"""Share of a person's points with a readable colour up to which the frame is not read, and share of colours
lost to darkness or glare from which on a note is given. Chosen by eye."""
READ_ROUNDS, REFINE_ROUNDS = 3, 6
"""Rounds of fitting colours and belief to each other, and most rounds of iterated conditional modes. Chosen
by eye."""
PATCH_WEIGHT, PATCH_DOUBT = 1.0, 0.02
"""Weight of the patches' log beliefs, and probability added, so that no patch excludes a part. Chosen by
eye."""
LEAST_GUESS, LEAST_AGAINST_ALIKE = 0.35, 0.8
"""Beliefs below which a supervoxel stays undefined: without any colour; if its next best part looks alike.
Chosen by eye."""
GUESS_M = 0.08
"""Metres to a supervoxel with a colour up to which one without takes its part from there: a forearm's
thickness. Chosen by eye."""
UNDEFINED_SHARE = 0.05
SOME_UNDEFINED = "some parts stay undefined: their colours cannot be read, or look alike in the suit"
"""Share of a person left undefined above which a note is given, as specks lose their colour, and the note.
Chosen by eye."""
OWN_COLOR, OWN_GROUP = 1.0, 0.25
"""Weights, where the border runs within supervoxels, of a point's own colour and of its supervoxel's log
belief. Chosen by eye."""
NEIGHBOUR, JUMP_M = 0.5, 0.03
"""Log score that each of the eight neighbours adds to its own part at a pixel, and the depth difference in
metres of neighbours on different surfaces. Chosen by eye."""

_N = len(BODY_PARTS)


@dataclass(frozen=True)
class Segmentation:
    """Parts uint8 (h, w) over the depth image, and their confidence float32 (h, w), 0 off the person.

    notes: remarks for the reviewer. probabilities: of all classes, if a network's are to be kept. reading:
    the beliefs behind the labels, if read from a suit. bearing: what a network says of the whole person, as
    a frame's note.
    """

    parts: UInt8
    confidence: Float32
    notes: tuple[str, ...] = ()
    probabilities: Probabilities | None = None
    reading: SuitReading | None = None
    bearing: dict[str, Any] | None = None


def segment(
    cloud: ThermalCloud,
    person: Bool,
    suit: Suit,
    before: FrameLabels | None = None,
    engine: Engine | None = None,
) -> Segmentation:
    """Labels of a person's points by their suit.

    person: bool (h, w). before: labels of the previous frame. Undefined stay all points of a frame without
    readable colours, neighbouring parts of one colour, and supervoxels between other parts that look alike; a
    note gives the reason. engine: None for the shipped one.
    """
    engine = engine or Engine()
    mask = person & cloud.valid
    rgb = cloud.color_rgb[mask]
    usable = readable(rgb, cloud.color_valid[mask])
    notes = _diagnosis(rgb, cloud.color_valid[mask], usable)
    if usable.sum() <= MIN_READABLE_SHARE * len(usable):
        return unlabelled(mask, *notes)
    groups = single_points(mask)
    if engine.steps.supervoxels:
        groups = supervoxels(cloud.points_m[mask], rgb, seed_m=SEED_M)
    return labelled(cloud, _read(cloud, mask, usable, suit, groups, before, engine.steps), engine, notes)


def labelled(
    cloud: ThermalCloud, reading: SuitReading, engine: Engine, notes: tuple[str, ...] = ()
) -> Segmentation:
    """Labels of a reading's points and their confidence; parts without evidence stay undefined."""
    mask = reading.mask
    parts, confidence = chosen_parts(cloud, reading, engine.steps), np.zeros(mask.shape, np.float32)
    confidence[mask] = chance_right(features(cloud, parts, reading), engine.weights.confidence)
    if (undefined := _undefined(reading, parts[mask] - 1, cloud.points_m[mask])).any():
        parts[mask] = np.where(undefined, UNDEFINED, parts[mask])
        confidence[mask] = np.where(undefined, 0, confidence[mask])
        notes = (*notes, SOME_UNDEFINED) if undefined.mean() > UNDEFINED_SHARE else notes
    return Segmentation(parts, confidence, notes, reading=reading)


def chosen_parts(cloud: ThermalCloud, reading: SuitReading, steps: Steps) -> UInt8:
    """Likeliest part uint8 (h, w) of each point, 0 off the mask, with borders at depth resolution."""
    scores = point_scores(reading.belief, reading.evidence, reading.groups)
    chosen = scores.argmax(axis=1).astype(np.uint8)
    if steps.fine_borders:
        chosen = refine(scores, chosen, cloud.points_m[..., 2], reading.mask)
    parts = np.zeros(reading.mask.shape, np.uint8)
    parts[reading.mask] = chosen + 1
    return parts


def unlabelled(mask: Bool, *notes: str) -> Segmentation:
    """Undefined parts on a person's mask (bool (h, w)); notes: the reasons."""
    parts = np.where(mask, UNDEFINED, BACKGROUND).astype(np.uint8)
    return Segmentation(parts, np.zeros(mask.shape, np.float32), notes)


def _diagnosis(rgb: UInt8, seen: Bool, usable: Bool) -> tuple[str, ...]:
    """Note on colours uint8 (n, 3), defect and remedy; seen, usable: bool (n,), by the camera; readable."""
    if not len(rgb):
        return ("no person: nothing to label",)
    if seen.mean() < MIN_READABLE_SHARE:
        return ("no colour on the person: point the colour camera at them and check its calibration",)
    lost = rgb[seen & ~usable].max(axis=1) < CLIPPED
    if lost.sum() > BAD_SHARE * seen.sum():
        return ("colour is too dark on the person: light the room or raise the colour camera's exposure",)
    if (~lost).sum() > BAD_SHARE * seen.sum():
        return ("colour is over-exposed on the person: lower the colour camera's exposure or the light",)
    return ()


def _read(
    cloud: ThermalCloud,
    mask: Bool,
    usable: Bool,
    suit: Suit,
    groups: Supervoxels,
    before: FrameLabels | None,
    steps: Steps,
) -> SuitReading:
    """Reading of the masked points by the suit's colours, warmth and the previous frame.

    mask: bool (h, w), n pixels. usable: bool (n,), readable colours. Every round fits the colours to the
    parts of the one before, this person's skin and the fading of the cloth among them.
    """
    rgb, centroids_m = cloud.color_rgb[mask][usable], groups.centroids_m(cloud.points_m[mask])
    palette = unfitted(suit)
    chroma, blur = means_of(cloud.color_rgb[mask], usable, groups)
    patches = patches_of(groups, chroma, blur, centroids_m)
    warmth = np.zeros((groups.count, _N))
    if steps.skin_warmth:
        warmth = warmth_evidence(cloud.temperature_c[mask], groups)
    known = before if steps.frame_before else None
    earlier = earlier_parts(known, cloud.camera, centroids_m) if known else None
    besides = warmth if earlier is None else warmth + previous_evidence(earlier)
    read = read_together if steps.joint_reading else read_alone
    by_patch, log_gain = read(patches, palette, patches.mean(besides, groups.sizes))
    first = by_patch[patches.ids] if steps.patch_belief else np.full((groups.count, _N), 1 / _N)
    model, belief = under(palette, log_gain), first
    for _ in range(READ_ROUNDS):
        if steps.color_refit:
            model = refit_colors(model, rgb, belief[groups.ids[usable]])
        bare = bareness(model, chroma, blur)
        sided = without_sides(first, bare) if steps.sleeves else first
        evidence = np.zeros((len(usable), _N))
        evidence[usable] = model.evidence(rgb)
        unary = pooled(evidence, usable, groups) + warmth + PATCH_WEIGHT * np.log(sided + PATCH_DOUBT)
        if steps.sleeves:
            unary += cuff_evidence(belief, bare, patches, groups, centroids_m)
        if earlier is not None:
            unary = with_earlier(unary, groups, earlier)
        belief = tree_belief(unary, groups, centroids_m, belief) if steps.part_tree else softmax(unary)
    return SuitReading(suit, mask, groups, belief, np.zeros(groups.count), usable, evidence, model)


def _undefined(reading: SuitReading, chosen: UInt8, points_m: Float32) -> Bool:
    """Flags (n,) of points whose part stays undefined; chosen: (n,), part indices; points_m: (n, 3).

    Between neighbours of one colour no border can be seen; elsewhere their joints may part look-alikes. A
    place without a colour takes its part from its surroundings only near by.
    """
    groups, belief = reading.groups, reading.belief
    rival, part = np.argsort(belief, axis=1)[:, -2:].T
    best = belief.max(axis=1)
    alike, borderless = np.zeros((_N, _N), bool), np.zeros(_N, bool)
    for a, b in reading.suit.look_alikes:
        alike[a - 1, b - 1] = alike[b - 1, a - 1] = True
        borderless[[a - 1, b - 1]] |= frozenset((a, b)) in NEIGHBOURS
    unread = np.bincount(groups.ids, reading.usable, groups.count) == 0
    middle_m = groups.centroids_m(points_m)
    away_m = Nearest(middle_m[~unread]).query(middle_m)[0]
    guessed = unread & ((best < LEAST_GUESS) | (away_m > GUESS_M))
    in_group = guessed | (best < LEAST_AGAINST_ALIKE) & alike[part, rival]
    return np.asarray(in_group[groups.ids] | borderless[chosen])


def point_scores(belief: Float64, evidence: Float64, groups: Supervoxels) -> Float64:
    """Log score (n, 11) of each point's parts: those of its supervoxel and the touching ones, else -inf.

    belief: (G, 11). evidence: (n, 11), log likelihood of the points' colours.
    """
    chosen = belief.argmax(axis=1)
    allowed = np.zeros((groups.count, _N), bool)
    allowed[np.arange(groups.count), chosen] = True
    a, b = groups.edges.T
    allowed[a, chosen[b]] = allowed[b, chosen[a]] = True
    score = OWN_GROUP * np.log(belief + 1e-6)[groups.ids] + OWN_COLOR * evidence
    score[~allowed[groups.ids]] = -np.inf
    return np.asarray(score)


def refine(scores: Float64, start: UInt8, depth_m: Float32, mask: Bool) -> UInt8:
    """Part indices uint8 (n,) of the masked pixels by iterated conditional modes (Besag 1986).

    scores: (n, k), log score of each part for the masked pixels in row-major order, -inf for forbidden parts.
    start: uint8 (n,), part indices to begin with. depth_m, mask: (h, w).
    """
    index = np.full(mask.shape, -1, np.int32)
    index[mask] = np.arange(len(start))
    return np.asarray(_modes(scores, start, depth_m.astype(np.float32), index), np.uint8)


@njit(cache=True, nogil=True)
def _modes(scores: Float64, start: UInt8, depth: Float32, index: Int32) -> UInt8:
    """Part indices (n,); index: (h, w), place of each pixel in ``scores``, -1 off the mask. As ``refine``."""
    height, width = index.shape
    chosen = start.copy()
    total = np.empty(scores.shape[1])
    for _ in range(REFINE_ROUNDS):
        last = chosen.copy()
        for v in range(height):
            for u in range(width):
                i = index[v, u]
                if i < 0:
                    continue
                total[:] = scores[i]
                for dv in range(-1, 2):
                    for du in range(-1, 2):
                        r, c = v + dv, u + du
                        if (dv == 0 and du == 0) or r < 0 or c < 0 or r >= height or c >= width:
                            continue
                        j = index[r, c]
                        if j >= 0 and abs(depth[r, c] - depth[v, u]) <= JUMP_M:
                            total[last[j]] += NEIGHBOUR
                chosen[i] = np.argmax(total)
        if np.array_equal(chosen, last):
            break
    return chosen
