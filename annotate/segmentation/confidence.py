"""How sure every pixel's label is: the chance that it is right, the person's outline included.

Labels go wrong in thin strips, along seams and silhouettes, and in small islands; a mean over a
supervoxel would hide them. So each pixel has a confidence of its own, and a supervoxel is worth a look for
all the wrong pixels that are to be expected in it.
"""

import cv2
import numpy as np

from annotate.array_types import Bool, Float32, Float64, Index, UInt8
from annotate.cloud.color_odds import SURE, by_color, lab_of
from annotate.cloud.supervoxels import Supervoxels
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.segmentation.reading import Reading

FEATURES = (
    "odds",
    "margin",
    "unread",
    "same",
    "island",
    "island of part",
    "part",
    "outline",
    "alone",
    "jump",
    "unmeasured",
    "no warmth",
    "cold",
    "contact",
    "room color",
    "contrast",
    "frame contact",
    "frame odds",
    "theirs",
)
"""What adds to the log odds of a label being right, each by its weight (`annotate.engine.Weights`).

odds: log of the likeliest part's belief over the next one's. margin: how much better the point's own colour
fits its part than any other, log. unread: no readable colour. same: share of its part in 7 x 7. island: log
pixels of the connected piece of its part; island of part: their share of the part. part: log share of the
person. outline: log pixels to the person's outline. alone: share off the person in 5 x 5. jump: depth edge
within the person. unmeasured: near the outline and no depth beside. no warmth: no temperature. cold: degrees
below the person's median. contact: share of the supervoxel's points near the outline that go on in depth off
the person. room color: log odds of its colour being the person's and not the surroundings'. contrast: degrees
above what lies around. frame contact, frame odds: means over the frame. theirs: log odds of the supervoxel
being the person's."""

LEAST_BELIEF, MOST_MARGIN, COLDEST_C, FARTHEST_PX = 1e-4, 4.0, 6.0, 20
"""Beyond these a feature says no more."""
SAME_PX, NEAR_PX, OUTLINE_PX = 7, 5, 2
"""Sides of the windows, and how near the outline is near."""
CONTACT_M, JUMP_M = 0.03, 0.06
"""Depth differences within which a surface goes on, and from which on it does not."""
AROUND_PX, LEAST_ROOM = 31, 0.05
"""Side of the window that is a place's surroundings, and the share of it that must be off the person."""
MARGIN_PX = 16


def features(cloud: ThermalCloud, parts: UInt8, reading: Reading) -> Float64:
    """What tells right labels from wrong ones (n, 19), in the order of FEATURES, of the points read.

    parts: uint8 (h, w) as chosen.
    """
    mask, groups, belief = reading.mask, reading.groups, reading.belief
    box = _box(mask)
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
    return np.column_stack(
        [
            odds,
            _margin(reading.evidence, reading.usable, parts[mask]),
            ~reading.usable,
            _same(chosen, within),
            *_islands(chosen, within),
            np.log(np.minimum(outline_px[within], FARTHEST_PX)),
            1 - cv2.blur(within.astype(np.float32), (NEAR_PX, NEAR_PX))[within],
            _jumps(depth_m, within)[within],
            (near & (cv2.erode(depth_m, np.ones((NEAR_PX, NEAR_PX))) == 0))[within],
            ~felt,
            np.where(felt, np.clip(usual_c - celsius, 0, COLDEST_C), 0),
            groups.mean(contact)[groups.ids],
            _room_color(cloud, mask),
            _contrast_c(cloud.temperature_c[box], within),
            np.full(len(odds), contact.mean()),
            np.full(len(odds), odds.mean()),
            reading.theirs[groups.ids],
        ]
    ).astype(np.float64)


def calibrated(found: Float64, weights: Float64) -> Float64:
    """Chance (n,) that a label is right from ``features`` (n, 19): a logistic curve.

    weights: (20,) of the features and, last, the intercept.
    """
    return np.asarray(1 / (1 + np.exp(-(found @ weights[:-1] + weights[-1]))))


def worst_first(confidence: Float64, groups: Supervoxels) -> Index:
    """Supervoxels (G,) in the order they are worth looking at: the most wrong pixels to be expected first.

    confidence: (n,) of the points.
    """
    return np.argsort(-(1 - groups.mean(confidence)) * groups.sizes, kind="stable")


def _box(mask: Bool) -> tuple[slice, slice]:
    """What of an image (h, w) holds the mask and its surroundings."""
    v, u = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
    low, high = (np.array([v[i], u[i]]) for i in (0, -1))
    low = np.maximum(low - MARGIN_PX, 0)
    return slice(low[0], high[0] + MARGIN_PX + 1), slice(low[1], high[1] + MARGIN_PX + 1)


def _margin(evidence: Float64, usable: Bool, part: UInt8) -> Float64:
    """By how much each point's colour speaks for its part (n,), against the best other."""
    rows, own = np.arange(len(part)), part.astype(np.intp) - 1
    others = evidence.copy()
    others[rows, own] = -np.inf
    margin = np.clip(evidence[rows, own] - others.max(axis=1), -MOST_MARGIN, MOST_MARGIN)
    return np.where(usable, margin, 0)


def _same(parts: UInt8, within: Bool) -> Float64:
    """Share (n,) of the person's pixels in a window around each that are of its part."""
    window = (SAME_PX, SAME_PX)
    same = np.zeros(parts.shape, np.float32)
    for part in np.unique(parts[within]):
        own = parts == part
        same[own] = cv2.blur(own.astype(np.float32), window)[own]
    return np.asarray((same / cv2.blur(within.astype(np.float32), window).clip(1e-3))[within], np.float64)


def _islands(parts: UInt8, within: Bool) -> tuple[Float64, Float64, Float64]:
    """Of each pixel's connected piece: log pixels, and share of its part; and the part's log share; (n,)."""
    piece, whole = np.ones(parts.shape), np.ones(parts.shape)
    for part in np.unique(parts[within]):
        own = parts == part
        _, labels = cv2.connectedComponents(own.astype(np.uint8))
        piece[own] = np.bincount(labels.ravel())[labels[own]]
        whole[own] = own.sum()
    piece, whole = piece[within], whole[within]
    return np.log(piece), piece / whole, np.log(whole / len(whole))


def _jumps(depth_m: Float32, within: Bool) -> Bool:
    """Pixels (h, w) in whose window the person has a depth edge."""
    window = np.ones((NEAR_PX, NEAR_PX))
    farthest = cv2.dilate(np.where(within, depth_m, np.float32(0)), window)
    nearest = cv2.erode(np.where(within, depth_m, np.float32(np.inf)), window)
    return np.asarray(farthest - nearest > JUMP_M)


def _room_color(cloud: ThermalCloud, mask: Bool) -> Float32:
    """Log odds (n,) of each point's colour being the person's and not its surroundings'."""
    around = cv2.dilate(mask.astype(np.uint8), np.ones((AROUND_PX, AROUND_PX))) > 0
    lab = lab_of(cloud.color_rgb, cloud.color_valid & around)
    odds = np.where(mask, np.float32(2 * SURE), np.float32(-2 * SURE))
    return by_color(lab, odds, mask, cloud.valid & around)[mask]


def _contrast_c(celsius: Float32, within: Bool) -> Float64:
    """How much warmer each point (n,) is than what lies around the person; 0 where not known."""
    room = ~within & np.isfinite(celsius)
    window = (AROUND_PX, AROUND_PX)
    share = cv2.blur(room.astype(np.float32), window)
    mean_c = cv2.blur(np.where(room, celsius, np.float32(0)), window) / share.clip(1e-3)
    known = within & np.isfinite(celsius) & (share > LEAST_ROOM)
    return np.asarray(
        np.where(known, np.clip(celsius - mean_c, -COLDEST_C, 2 * COLDEST_C), 0)[within], np.float64
    )


def _goes_on(depth_m: Float32, within: Bool) -> Bool:
    """Pixels (h, w) beside which, off the person, something is as far away as they are."""
    off, window = ~within & (depth_m > 0), np.ones((NEAR_PX, NEAR_PX))
    farthest = cv2.dilate(np.where(off, depth_m, np.float32(-np.inf)), window)
    nearest = cv2.erode(np.where(off, depth_m, np.float32(np.inf)), window)
    return np.asarray(np.minimum(np.abs(farthest - depth_m), np.abs(nearest - depth_m)) < CONTACT_M)
