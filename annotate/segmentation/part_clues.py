"""Log evidence (G, 11) of each supervoxel's parts, by colour, warmth and the previous frame."""

from dataclasses import dataclass

import numpy as np

from annotate.array_types import Bool, Float32, Float64, UInt8
from annotate.cloud.supervoxels import Supervoxels
from annotate.frame_labels import FrameLabels
from annotate.parts import BODY_PARTS
from annotate.segmentation.body_plan import WARMTH_C, WARMTH_SD_C
from annotate.segmentation.part_tree import softmax
from annotate.suit.color_model import ColorModel, blur
from annotate.suit.palette import Suit, chromaticity
from sensors.rig.camera import Intrinsics
from sensors.rig.nearest import Nearest

TEMPERATURE_WEIGHT, WARMTH_FLOOR = 0.3, -4.0
"""Weight of a supervoxel's temperature, and least log density: no mug, no draught excludes a part. Chosen by
eye."""
EARLIER_WEIGHT, ANOTHER = 0.5, 0.8
"""Weight of the previous frame's log probabilities, and chance of another person or pose in it, before any
comparison. Chosen by eye."""
FULL_EVIDENCE, HALF_POINTS = 3.0, 10.0
"""Independent colours that a large supervoxel's colours, under one light, are worth, and the points of one
whose colours are worth half of that. Chosen by eye."""
LEAST_COLOR_BLUR = 0.02
"""Least uncertainty of a colour's chromaticity. Chosen by eye."""
MOVE_M, UNIFORM_WEIGHT = 0.08, 1.0
"""Standard deviation in metres of a limb's motion between two frames at 2 Hz; weight of the uniform
distribution, against one earlier point at the very place. Chosen by eye."""
NEAREST_POINTS, POINT_STRIDE = 5, 4
"""Nearest labelled points averaged, and the step through the earlier points: neighbours agree. Chosen by
eye."""
LEAST_AGREEMENT = 0.6
"""Agreement of earlier parts with colours below which two persons are seen. Chosen by eye."""
CLEAR_BELIEF, CLEAR_EARLIER = 0.7, 0.5
"""Belief by colour, and probability by the earlier frame, from which on a supervoxel counts in that share.
Chosen by eye."""

_N = len(BODY_PARTS)


@dataclass(frozen=True)
class SuitReading:
    """Beliefs about a person's n points, those of a mask (h, w) in row-major order.

    groups: their G supervoxels. belief: (G, 11), probabilities of the parts. person_odds: (G,), log odds of
    being the person's at all, 0 = unknown. usable: bool (n,), points with a readable colour. evidence: (n,
    11), log likelihood of their colours, 0 elsewhere. model: the suit's colours in the frame's light.
    """

    suit: Suit
    mask: Bool
    groups: Supervoxels
    belief: Float64
    person_odds: Float64
    usable: Bool
    evidence: Float64
    model: ColorModel


def means_of(rgb: UInt8, usable: Bool, groups: Supervoxels) -> tuple[Float64, Float64]:
    """Mean chromaticity (G, 2) of each supervoxel's readable colours, and its uncertainty (G,).

    rgb: uint8 (n, 3) sRGB of the points. usable: bool (n,), readable colours.
    """
    noise = blur(rgb)
    weight = usable / (noise**2 + LEAST_COLOR_BLUR**2)
    total = np.bincount(groups.ids, weight, groups.count)
    mean = [np.bincount(groups.ids, weight * x, groups.count) for x in chromaticity(rgb).T]
    few = np.bincount(groups.ids, usable, groups.count) < 3
    chroma = np.where(few[:, None], 1 / 3, np.stack(mean, axis=1) / np.maximum(total, 1e-9)[:, None])
    return chroma, np.where(few, 1.0, np.bincount(groups.ids, noise, groups.count) / groups.sizes)


def pooled(evidence: Float64, usable: Bool, groups: Supervoxels) -> Float64:
    """Mean evidence (G, 11) over each supervoxel's readable points, with more weight the more there are.

    evidence: (n, 11), log likelihoods of the points. usable: bool (n,), readable colours.
    """
    total = np.stack([np.bincount(groups.ids, column, groups.count) for column in evidence.T], axis=1)
    count = np.bincount(groups.ids, usable, groups.count)
    worth = FULL_EVIDENCE * count / (count + HALF_POINTS)
    return np.asarray(total / np.maximum(count, 1)[:, None] * worth[:, None])


def warmth_evidence(temperature_c: Float32, groups: Supervoxels) -> Float64:
    """Log evidence (G, 11) of the points' degrees Celsius (n,) against their median; 0 where all are NaN."""
    known = np.isfinite(temperature_c)
    if not known.any():
        return np.zeros((groups.count, _N))
    above = np.where(known, temperature_c - np.median(temperature_c[known]), 0)
    count = np.bincount(groups.ids, known, groups.count)
    mean = np.bincount(groups.ids, above, groups.count) / np.maximum(count, 1)
    score = -0.5 * ((mean[:, None] - WARMTH_C) / WARMTH_SD_C) ** 2 - np.log(WARMTH_SD_C)
    return np.asarray(TEMPERATURE_WEIGHT * np.maximum(score, WARMTH_FLOOR) * (count > 0)[:, None])


def earlier_parts(before: FrameLabels, camera: Intrinsics, at_m: Float64) -> Float64:
    """Probabilities (G, 11) of the parts at places (G, 3) by the labels of the previous frame.

    at_m: metres, undistorted depth camera's frame. A mean over the nearest labelled points, each with less
    weight the farther it is; uniform far from all.
    """
    flat = np.full((len(at_m), _N), 1 / _N)
    labelled = (before.parts >= 1) & (before.parts <= _N) & (before.depth_mm > 0)
    v, u = (index[::POINT_STRIDE] for index in np.nonzero(labelled))
    if len(v) < NEAREST_POINTS or before.parts.shape != camera.shape:
        return flat
    rays = np.column_stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(len(u))])
    points = rays * (before.depth_mm[v, u, None] / 1000)
    away_m, nearest = Nearest(points).query(at_m, NEAREST_POINTS, within=3 * MOVE_M)
    found = np.isfinite(away_m)
    weight = np.where(found, np.exp(-(away_m**2) / (2 * MOVE_M**2)), 0)
    part = before.parts[v, u][np.where(found, nearest, 0)].astype(np.intp) - 1
    votes = np.zeros_like(flat)
    np.add.at(votes, (np.arange(len(at_m))[:, None], part), weight)
    return np.asarray((votes + UNIFORM_WEIGHT * flat) / (weight.sum(axis=1, keepdims=True) + UNIFORM_WEIGHT))


def previous_evidence(earlier: Float64) -> Float64:
    """Log evidence (G, 11) of the previous frame's parts (G, 11) before any comparison; small against."""
    return np.asarray(np.log(ANOTHER + (1 - ANOTHER) * earlier * _N))


def with_earlier(unary: Float64, groups: Supervoxels, earlier: Float64) -> Float64:
    """Log evidence (G, 11) with the previous frame's parts (G, 11), unless that shows another person."""
    belief, sizes = softmax(unary), groups.sizes
    clear = (belief.max(axis=1) > CLEAR_BELIEF) & (earlier.max(axis=1) > CLEAR_EARLIER)
    same = clear & (belief.argmax(axis=1) == earlier.argmax(axis=1))
    if sizes[same].sum() < LEAST_AGREEMENT * max(sizes[clear].sum(), 1):
        return unary
    return np.asarray(unary + EARLIER_WEIGHT * np.log(earlier * _N))
