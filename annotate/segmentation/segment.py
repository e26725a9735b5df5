"""Person points -> body parts: suit colour pooled over supervoxels, joined over time and the part tree."""

from dataclasses import dataclass

import numpy as np

from annotate.array_types import Bool, Float32, Float64, UInt8
from annotate.cloud.supervoxels import Supervoxels, single_points, supervoxels
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.engine import Engine, Steps
from annotate.frame_labels import FrameLabels
from annotate.labelset.probabilities import Probabilities
from annotate.parts import BACKGROUND, BODY_PARTS, NEIGHBOURS, UNDEFINED
from annotate.segmentation.bare import bareness, grown_from, without_sides
from annotate.segmentation.confidence import calibrated, features
from annotate.segmentation.part_clues import hint, means_of, pooled, warmth_of, with_earlier
from annotate.segmentation.part_tree import settle, softmax
from annotate.segmentation.patches import patches_of, read_alone, read_together
from annotate.segmentation.previous_parts import earlier_parts
from annotate.segmentation.reading import Reading
from annotate.segmentation.refine import refine
from annotate.suit.color_model import CLIPPED, readable, refit_colors, under, unfitted
from annotate.suit.palette import Suit
from sensors.rig.nearest import Nearest

SEED_M = 0.05
"""Distance of supervoxel seeds: a forearm is about 7 cm thick."""
MIN_READABLE_SHARE = 0.05
"""Below this share of person points with a readable colour there is nothing to go by."""
ROUNDS = 3
PATCH_WEIGHT, PATCH_DOUBT = 1.0, 0.02
BAD_SHARE = 0.3
"""From this share of colours lost to darkness or glare on the user is told."""
UNKNOWN, UNTOLD_BELOW = 0.35, 0.8
"""Beliefs below which a supervoxel stays undefined: without any colour; with a rival that looks alike."""
TELLING_M = 0.08
"""How far surroundings tell the part of places without a colour: a forearm is that thick."""
UNTOLD_SHARE = 0.05
"""From this share of a person left undefined on the user is told: less are specks that lost their colour."""
UNTOLD = "some parts stay undefined: their colours cannot be read, or look alike in the suit"
OWN_COLOR, OWN_GROUP = 1.0, 0.25
"""Weights of a point's own colour and of its supervoxel's belief where the border runs within supervoxels."""

_N = len(BODY_PARTS)


@dataclass(frozen=True)
class Segmentation:
    """Parts over the depth image. parts: uint8 (h, w); confidence: float32 (h, w), 0 off the person.

    notes: what went wrong, for the person who reviews. probabilities: of all classes, where a network gave
    them and they are to be kept. reading: how a suit was read, where one was.
    """

    parts: UInt8
    confidence: Float32
    notes: tuple[str, ...] = ()
    probabilities: Probabilities | None = None
    reading: Reading | None = None


def segment(
    cloud: ThermalCloud,
    person: Bool,
    suit: Suit,
    before: FrameLabels | None = None,
    engine: Engine | None = None,
) -> Segmentation:
    """Label a person's points by the suit they wear.

    person: bool (h, w). before: the labels of the frame before. What cannot be told stays undefined: all of
    a frame whose colours say nothing, neighbours of one colour, and places where other parts that look
    alike are not told apart by what they join; a note says why.
    """
    engine = engine or Engine()
    mask = person & cloud.valid
    rgb = cloud.color_rgb[mask]
    usable = readable(rgb, cloud.color_valid[mask])
    notes = _diagnosis(rgb, cloud.color_valid[mask], usable)
    if usable.sum() <= MIN_READABLE_SHARE * len(usable):
        return unlabelled(mask, *notes)
    groups = tile(cloud, mask) if engine.steps.supervoxels else single_points(mask)
    return labelled(cloud, _read(cloud, mask, usable, suit, groups, before, engine.steps), engine, notes)


def labelled(
    cloud: ThermalCloud, reading: Reading, engine: Engine, notes: tuple[str, ...] = ()
) -> Segmentation:
    """Every point's label and its confidence; what cannot be told stays undefined."""
    mask = reading.mask
    parts, confidence = chosen_parts(cloud, reading, engine.steps), np.zeros(mask.shape, np.float32)
    confidence[mask] = calibrated(features(cloud, parts, reading), engine.weights.confidence)
    if (untold := _untold(reading, parts[mask] - 1, cloud.points_m[mask])).any():
        parts[mask] = np.where(untold, UNDEFINED, parts[mask])
        confidence[mask] = np.where(untold, 0, confidence[mask])
        notes = (*notes, UNTOLD) if untold.mean() > UNTOLD_SHARE else notes
    return Segmentation(parts, confidence, notes, reading=reading)


def chosen_parts(cloud: ThermalCloud, reading: Reading, steps: Steps) -> UInt8:
    """The likeliest part (h, w) of each point, with the borders where its own colour and its neighbours see
    them; 0 off the mask."""
    scores = point_scores(reading.belief, reading.evidence, reading.groups)
    chosen = scores.argmax(axis=1).astype(np.uint8)
    if steps.fine_borders:
        chosen = refine(scores, chosen, cloud.points_m[..., 2], reading.mask)
    parts = np.zeros(reading.mask.shape, np.uint8)
    parts[reading.mask] = chosen + 1
    return parts


def unlabelled(mask: Bool, *notes: str) -> Segmentation:
    """A person (bool (h, w)) whose parts stay undefined, and why."""
    parts = np.where(mask, UNDEFINED, BACKGROUND).astype(np.uint8)
    return Segmentation(parts, np.zeros(mask.shape, np.float32), notes)


def _diagnosis(rgb: UInt8, seen: Bool, usable: Bool) -> tuple[str, ...]:
    """What is wrong with a person's colours (n, 3), and what to do about it."""
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
) -> Reading:
    """What the suit's colours, warmth and the frame before make of the masked points.

    The second round knows from the first what parts the colours are on: so it learns this person's skin
    and how far the cloth has faded.
    """
    rgb, centroids_m = cloud.color_rgb[mask][usable], groups.centroids_m(cloud.points_m[mask])
    palette = unfitted(suit)
    chroma, blur = means_of(cloud.color_rgb[mask], usable, groups)
    patches = patches_of(groups, chroma, blur, centroids_m)
    warmth = np.zeros((groups.count, _N))
    if steps.skin_warmth:
        warmth = warmth_of(cloud.temperature_c[mask], groups)
    earlier = None
    if before is not None and steps.frame_before:
        earlier = earlier_parts(before, cloud.camera, centroids_m)
    clues = warmth if earlier is None else warmth + hint(earlier)
    read = read_together if steps.joint_reading else read_alone
    by_patch, log_gain = read(patches, palette, patches.mean(clues, groups.sizes))
    first = by_patch[patches.ids] if steps.patch_belief else np.full((groups.count, _N), 1 / _N)
    model, belief = under(palette, log_gain), first
    for _ in range(ROUNDS):
        if steps.color_refit:
            model = refit_colors(model, rgb, belief[groups.ids[usable]])
        bare = bareness(model, chroma, blur)
        sided = without_sides(first, bare) if steps.sleeves else first
        second = PATCH_WEIGHT * np.log(sided + PATCH_DOUBT)
        evidence = np.zeros((len(usable), _N))
        evidence[usable] = model.evidence(rgb)
        unary = pooled(evidence, usable, groups) + warmth + second
        if steps.sleeves:
            unary += grown_from(belief, bare, patches, groups, centroids_m)
        if earlier is not None:
            unary = with_earlier(unary, groups, earlier)
        belief = settle(unary, groups, centroids_m, belief) if steps.part_tree else softmax(unary)
    return Reading(suit, mask, groups, belief, np.zeros(groups.count), usable, evidence, model)


def _untold(reading: Reading, chosen: UInt8, points_m: Float32) -> Bool:
    """Points (n,) of which too little is known; chosen: (n,) part indices, points_m: (n, 3).

    Between neighbours of one colour no border can be seen; elsewhere what they join may tell look-alikes.
    Surroundings tell the part of a place without a colour only near by.
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
    guessed = unread & ((best < UNKNOWN) | (away_m > TELLING_M))
    in_group = guessed | (best < UNTOLD_BELOW) & alike[part, rival]
    return np.asarray(in_group[groups.ids] | borderless[chosen])


def tile(cloud: ThermalCloud, mask: Bool) -> Supervoxels:
    """The supervoxels of the masked points, row-major: what ``segment`` works with."""
    return supervoxels(cloud.points_m[mask], cloud.color_rgb[mask], seed_m=SEED_M)


def point_scores(belief: Float64, evidence: Float64, groups: Supervoxels) -> Float64:
    """Log score (n, 11) of the parts a point may take: those of its supervoxel and the touching ones."""
    chosen = belief.argmax(axis=1)
    allowed = np.zeros((groups.count, _N), bool)
    allowed[np.arange(groups.count), chosen] = True
    a, b = groups.edges.T
    allowed[a, chosen[b]] = True
    allowed[b, chosen[a]] = True
    score = OWN_GROUP * np.log(belief + 1e-6)[groups.ids] + OWN_COLOR * evidence
    score[~allowed[groups.ids]] = -np.inf
    return np.asarray(score)
