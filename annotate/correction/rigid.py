"""Rigid motion of every part of a body from one frame to another, along the part tree."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from annotate.array_types import Float64, UInt8
from annotate.parts import BACKGROUND, N_CLASSES, UNDEFINED
from sensors.rig.rig_calibration import Pose

PARENTS = ((2, 2), (1, 2), (3, 2), (4, 2), (5, 3), (6, 4), (7, 2), (8, 7), (9, 7), (10, 8), (11, 9))
"""(part, its parent), parents first: the part tree with the torso as its root."""
GATES_M = (0.25, 0.25, 0.15, 0.15, 0.1, 0.1, 0.06, 0.06, 0.04, 0.04, 0.04)
"""Largest distance of a pair in each step of a registration, in metres: a hand moves 0.3 m between frames at
2 Hz. Untuned."""
REFINING_STEP = 6
"""First step of a registration that refines a known motion. Untuned."""
LEAST_POINTS = 25
"""Least number of points of a part that is registered; with fewer it moves as its parent. Untuned."""
SAMPLED_POINTS = 300
"""Number of points of a part that are registered, about. Untuned."""
STILL = Pose.identity()


@dataclass(frozen=True)
class LabelledPoints:
    """Points of a body. points_m: float64 (n, 3), camera frame. automatic: uint8 (n,), automatic part ids."""

    points_m: Float64
    automatic: UInt8


def part_motions(
    source: LabelledPoints, parts: UInt8, target: LabelledPoints, known: list[Pose] | None = None
) -> list[Pose]:
    """Motion to_target_from_source of every class id; the background's is none.

    parts: uint8 (n,), the true part of every source point. Points are paired with the nearest ones of the
    same automatic label: the same cloth is mistaken for the same part in both frames.
    Each part is registered point to point (Besl & McKay 1992, trimmed by distance), starting from the motion
    of its parent, from no motion, and from the shift of its median; the best fit counts.
    known: approximate motions to refine instead.
    """
    trees = {
        int(label): cKDTree(target.points_m[target.automatic == label])
        for label in np.unique(target.automatic)
        if label not in (BACKGROUND, UNDEFINED)
    }
    motions = [STILL] * N_CLASSES
    for part, parent in PARENTS:
        own = np.flatnonzero((parts == part) & np.isin(source.automatic, list(trees)))
        if own.size < LEAST_POINTS:
            motions[part] = motions[parent]
            continue
        own = own[:: max(1, own.size // SAMPLED_POINTS)]
        body = LabelledPoints(source.points_m[own], source.automatic[own])
        if known:
            fits = [_register(body, trees, known[part], GATES_M[REFINING_STEP:])]
        else:
            starts = [motions[parent], STILL, *_median_shift(body, part, trees)]
            fits = [_register(body, trees, start, GATES_M) for start in starts]
        motions[part] = min(fits, key=lambda fit: fit[0])[1]
    return motions


def _median_shift(body: LabelledPoints, part: int, trees: dict[int, cKDTree]) -> list[Pose]:
    """Shift of the median of the points labelled as this part, where both frames have enough of them."""
    own = body.automatic == part
    if part not in trees or len(trees[part].data) < LEAST_POINTS or own.sum() < LEAST_POINTS:
        return []
    shift = np.median(trees[part].data, axis=0) - np.median(body.points_m[own], axis=0)
    return [Pose(np.eye(3), shift)]


def _register(
    body: LabelledPoints, trees: dict[int, cKDTree], start: Pose, gates_m: tuple[float, ...]
) -> tuple[float, Pose]:
    """Mean distance in metres, limited to the last gate, and the motion."""
    pose = start
    for gate_m in gates_m:
        away_m, matched = _nearest(pose.apply(body.points_m), body.automatic, trees)
        paired = away_m <= gate_m
        if paired.sum() < LEAST_POINTS:
            break
        pose = _align(body.points_m[paired], matched[paired])
    away_m, _ = _nearest(pose.apply(body.points_m), body.automatic, trees)
    return float(np.minimum(away_m, gates_m[-1]).mean()), pose


def _nearest(points_m: Float64, labels: UInt8, trees: dict[int, cKDTree]) -> tuple[Float64, Float64]:
    """Distance (n,) and position (n, 3) of the nearest point of the same label."""
    away_m, matched = np.empty(len(points_m)), np.empty_like(points_m)
    for label in np.unique(labels):
        own, tree = labels == label, trees[int(label)]
        away_m[own], index = tree.query(points_m[own])
        matched[own] = tree.data[index]
    return away_m, matched


def _align(source: Float64, target: Float64) -> Pose:
    """The rigid motion with the least squared distances (Kabsch 1976)."""
    middle, goal = source.mean(axis=0), target.mean(axis=0)
    u, _, vt = np.linalg.svd((target - goal).T @ (source - middle))
    mirrored = np.array([1, 1, np.sign(np.linalg.det(u @ vt))])
    matrix = (u * mirrored) @ vt
    return Pose(matrix, goal - matrix @ middle)
