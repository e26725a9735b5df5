"""Confidence (n,) of every pixel's label: the chance that it is right, the person's outline included.

Labels go wrong in thin strips, along seams and silhouettes, and in small islands; a mean over a supervoxel
would hide them. So each pixel has a confidence of its own, and supervoxels are ranked for review by the
expected number of wrong pixels.
"""

import cv2
import numpy as np

from annotate.array_types import Bool, Float32, Float64, Index, UInt8
from annotate.cloud.color_odds import SURE_ODDS, color_odds, lab_of
from annotate.cloud.grid import grown
from annotate.cloud.supervoxels import Supervoxels
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.crop import window_of
from annotate.segmentation.part_clues import SuitReading

FEATURES = (
    "odds",  # log of the likeliest part's belief over the next one's
    "margin",  # log likelihood of the point's colour under its part, less the best other's
    "unread",  # 1 without a readable colour
    "same",  # share of its part among the person's pixels in 7 x 7
    "island",  # log pixels of the connected piece of its part
    "island of part",  # their share of the part
    "part",  # log share of the part in the person
    "outline",  # log pixels to the person's outline
    "alone",  # share off the person in 5 x 5
    "jump",  # 1 beside a depth edge within the person
    "unmeasured",  # 1 near the outline with no reading beside
    "no warmth",  # 1 without a temperature
    "cold",  # degrees Celsius below the person's median
    "contact",  # share of the supervoxel's points whose surface goes on beyond the outline
    "room color",  # log odds of its colour being the person's, against the surroundings'
    "contrast",  # degrees Celsius above the surroundings
    "frame contact",  # mean of contact over the frame
    "frame odds",  # mean of odds over the frame
    "person odds",  # log odds of the supervoxel being the person's at all
)
"""Columns of the features; their weights are `annotate.engine.Weights.confidence`."""
LEAST_BELIEF, OUTLINE_PX, LEAST_ROOM = 1e-4, 2, 0.05
"""Least belief that counts in ``odds``; pixels within which a point is near the outline; least share of the
surroundings off the person for a contrast. Chosen by eye."""
MOST_MARGIN, MOST_CONTRAST_C, FARTHEST_PX = 4.0, 6.0, 20
"""Bounds of ``margin``; in degrees Celsius of ``cold``, and of ``contrast``, above twice that; of the pixels
to the outline. Chosen by eye."""
SAME_PX, EDGE_WINDOW_PX, SURROUNDINGS_PX = 7, 5, 31
"""Sides in pixels of the windows of ``same``; of ``alone``, ``jump``, ``unmeasured``, ``contact``; of a
pixel's surroundings. Chosen by eye."""
SAME_SURFACE_M, EDGE_M = 0.03, 0.06
"""Depth differences in metres within which a surface goes on, and of a depth edge. Chosen by eye."""
ROOM_PX = 16
"""Pixels beyond the person's mask that the features look at: half of SURROUNDINGS_PX."""


def features(cloud: ThermalCloud, parts: UInt8, reading: SuitReading) -> Float64:
    """Features float64 (n, 19) of a reading's points, in the order of FEATURES; parts: (h, w), labels."""
    mask, groups, belief = reading.mask, reading.groups, reading.belief
    box = window_of(mask, ROOM_PX)
    within, chosen = mask[box], parts[box]
    depth_m = (cloud.depth_mm[box] / np.float32(1000)).astype(np.float32)
    second, first = np.sort(np.maximum(belief, LEAST_BELIEF), axis=1)[:, -2:].T
    odds = np.log(first / second)[groups.ids]
    celsius = cloud.temperature_c[mask]
    felt = np.isfinite(celsius)
    usual_c = np.median(celsius[felt]) if felt.any() else 0
    outline_px = cv2.distanceTransform(within.astype(np.uint8), cv2.DIST_C, 3)
    near = within & (outline_px <= OUTLINE_PX)
    contact = (near & _goes_on(depth_m, within))[within]
    island, share_of_part, part = _islands(chosen, within)
    columns = {
        "odds": odds,
        "margin": _margin(reading.evidence, reading.usable, parts[mask]),
        "unread": ~reading.usable,
        "same": _same(chosen, within),
        "island": island,
        "island of part": share_of_part,
        "part": part,
        "outline": np.log(np.minimum(outline_px[within], FARTHEST_PX)),
        "alone": 1 - cv2.blur(within.astype(np.float32), (EDGE_WINDOW_PX, EDGE_WINDOW_PX))[within],
        "jump": _jumps(depth_m, within)[within],
        "unmeasured": (near & (cv2.erode(depth_m, np.ones((EDGE_WINDOW_PX, EDGE_WINDOW_PX))) == 0))[within],
        "no warmth": ~felt,
        "cold": np.where(felt, np.clip(usual_c - celsius, 0, MOST_CONTRAST_C), 0),
        "contact": groups.mean(contact)[groups.ids],
        "room color": _room_color(cloud, mask),
        "contrast": _contrast_c(cloud.temperature_c[box], within),
        "frame contact": np.full(len(odds), contact.mean()),
        "frame odds": np.full(len(odds), odds.mean()),
        "person odds": reading.person_odds[groups.ids],
    }
    return np.column_stack([columns[name] for name in FEATURES]).astype(np.float64)


def chance_right(columns: Float64, weights: Float64) -> Float64:
    """Chance (n,) that a label is right, by ``features`` (n, 19) and weights (20,), last the intercept."""
    return np.asarray(1 / (1 + np.exp(-(columns @ weights[:-1] + weights[-1]))))


def worst_first(confidence: Float64, groups: Supervoxels) -> Index:
    """Supervoxels (G,), most expected wrong pixels first; confidence: (n,), of the points."""
    return np.argsort(-(1 - groups.mean(confidence)) * groups.sizes, kind="stable")


def _margin(evidence: Float64, usable: Bool, part: UInt8) -> Float64:
    """Margin (n,) of each point's log likelihood under its part over the best other's; 0 without a colour."""
    rows, own = np.arange(len(part)), part.astype(np.intp) - 1
    others = evidence.copy()
    others[rows, own] = -np.inf
    margin = np.clip(evidence[rows, own] - others.max(axis=1), -MOST_MARGIN, MOST_MARGIN)
    return np.where(usable, margin, 0)


def _same(parts: UInt8, within: Bool) -> Float64:
    """Share (n,) of each pixel's part among the person's pixels in a window around it."""
    window = (SAME_PX, SAME_PX)
    same = np.zeros(parts.shape, np.float32)
    for part in np.unique(parts[within]):
        own = parts == part
        same[own] = cv2.blur(own.astype(np.float32), window)[own]
    return np.asarray((same / cv2.blur(within.astype(np.float32), window).clip(1e-3))[within], np.float64)


def _islands(parts: UInt8, within: Bool) -> tuple[Float64, Float64, Float64]:
    """Log pixels (n,) of each pixel's piece, its share (n,) of its part, and the part's log share (n,)."""
    piece, whole = np.ones(parts.shape), np.ones(parts.shape)
    for part in np.unique(parts[within]):
        own = parts == part
        _, labels = cv2.connectedComponents(own.astype(np.uint8))
        piece[own] = np.bincount(labels.ravel())[labels[own]]
        whole[own] = own.sum()
    piece, whole = piece[within], whole[within]
    return np.log(piece), piece / whole, np.log(whole / len(whole))


def _jumps(depth_m: Float32, within: Bool) -> Bool:
    """Pixels (h, w) with a depth edge of the person in their window."""
    window = np.ones((EDGE_WINDOW_PX, EDGE_WINDOW_PX))
    farthest = cv2.dilate(np.where(within, depth_m, np.float32(0)), window)
    nearest = cv2.erode(np.where(within, depth_m, np.float32(np.inf)), window)
    return np.asarray(farthest - nearest > EDGE_M)


def _room_color(cloud: ThermalCloud, mask: Bool) -> Float32:
    """Log odds (n,) of each point's colour being the person's, against the surroundings'."""
    around = grown(mask, SURROUNDINGS_PX // 2)
    lab = lab_of(cloud.color_rgb, cloud.color_valid & around)
    odds = np.where(mask, np.float32(2 * SURE_ODDS), np.float32(-2 * SURE_ODDS))
    return color_odds(lab, odds, mask, cloud.valid & around)[mask]


def _contrast_c(celsius: Float32, within: Bool) -> Float64:
    """Degrees Celsius (n,) of each point above its surroundings off the person; 0 where unknown."""
    room = ~within & np.isfinite(celsius)
    window = (SURROUNDINGS_PX, SURROUNDINGS_PX)
    share = cv2.blur(room.astype(np.float32), window)
    mean_c = cv2.blur(np.where(room, celsius, np.float32(0)), window) / share.clip(1e-3)
    known = within & np.isfinite(celsius) & (share > LEAST_ROOM)
    above_c = np.where(known, np.clip(celsius - mean_c, -MOST_CONTRAST_C, 2 * MOST_CONTRAST_C), 0)
    return np.asarray(above_c[within], np.float64)


def _goes_on(depth_m: Float32, within: Bool) -> Bool:
    """Pixels (h, w) with something of their own depth beside them, off the person."""
    off, window = ~within & (depth_m > 0), np.ones((EDGE_WINDOW_PX, EDGE_WINDOW_PX))
    farthest = cv2.dilate(np.where(off, depth_m, np.float32(-np.inf)), window)
    nearest = cv2.erode(np.where(off, depth_m, np.float32(np.inf)), window)
    return np.asarray(np.minimum(np.abs(farthest - depth_m), np.abs(nearest - depth_m)) < SAME_SURFACE_M)
