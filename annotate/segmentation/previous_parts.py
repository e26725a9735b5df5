"""Probabilities (G, 11) of parts at places of this frame, by the labels of the previous one."""

import numpy as np

from annotate.array_types import Float64, Int64
from annotate.frame_labels import FrameLabels
from annotate.parts import BODY_PARTS
from sensors.rig.camera import Intrinsics
from sensors.rig.nearest import Nearest

MOVE_M = 0.08
"""Standard deviation in metres of a limb's motion between two frames at 2 Hz. Chosen by eye."""
NEAREST_POINTS = 5
"""Nearest labelled points averaged. Chosen by eye."""
POINT_STRIDE = 4
"""Step through the earlier points: neighbours agree. Chosen by eye."""
UNIFORM_WEIGHT = 1.0
"""Weight of the uniform distribution, against one earlier point at the very place. Chosen by eye."""
LEAST_AGREEMENT = 0.6
"""Agreement of earlier parts with colours below which two persons are seen. Chosen by eye."""
CLEAR_BELIEF = 0.7
"""Belief by colour from which on a supervoxel counts in that share. Chosen by eye."""
CLEAR_EARLIER = 0.5
"""Probability by the earlier frame from which on it counts. Chosen by eye."""


def earlier_parts(before: FrameLabels, camera: Intrinsics, at_m: Float64) -> Float64:
    """Probabilities (G, 11) of the parts at places (G, 3) by the labels of the previous frame.

    at_m: metres, undistorted depth camera's frame. A mean over the nearest labelled points, each with less
    weight the farther it is; uniform far from all.
    """
    flat = np.full((len(at_m), len(BODY_PARTS)), 1 / len(BODY_PARTS))
    labelled = (before.parts >= 1) & (before.parts <= len(BODY_PARTS)) & (before.depth_mm > 0)
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


def agreement(belief: Float64, earlier: Float64, sizes: Int64) -> float:
    """Share of the points with the same part by belief and by ``earlier`` (G, 11), where both are clear.

    sizes: (G,), number of points of each supervoxel.
    """
    clear = (belief.max(axis=1) > CLEAR_BELIEF) & (earlier.max(axis=1) > CLEAR_EARLIER)
    same = belief.argmax(axis=1) == earlier.argmax(axis=1)
    total = int(sizes[clear].sum())
    return float(sizes[clear & same].sum() / total) if total else 0.0
