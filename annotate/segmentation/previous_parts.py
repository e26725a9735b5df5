"""What the labels of the frame before say of places in this one: people move only a little."""

import numpy as np

from annotate.array_types import Float64, Int64
from annotate.frame_labels import FrameLabels
from annotate.parts import BODY_PARTS
from sensors.rig.camera import Intrinsics
from sensors.rig.nearest import Nearest

MOVE_M = 0.08
"""How far a limb moves between two frames at 2 Hz (spread)."""
NEAREST = 5
STRIDE = 4
"""Of the earlier points every so manieth is looked at: neighbours say the same."""
DOUBT = 1.0
"""Weight of knowing nothing, against one earlier point at the very place."""
LEAST_AGREEMENT = 0.6
"""Where parts found by colour agree less than this with the earlier ones, it is somebody else."""


def earlier_parts(before: FrameLabels, camera: Intrinsics, at_m: Float64) -> Float64:
    """Probabilities (G, 11) of the parts at places (G, 3) in metres, undistorted depth camera's frame,
    by the frame before.

    A mean over the nearest labelled points, less the farther they are; uniform far from all.
    """
    flat = np.full((len(at_m), len(BODY_PARTS)), 1 / len(BODY_PARTS))
    labelled = (before.parts >= 1) & (before.parts <= len(BODY_PARTS)) & (before.depth_mm > 0)
    v, u = (index[::STRIDE] for index in np.nonzero(labelled))
    if len(v) < NEAREST or before.parts.shape != camera.shape:
        return flat
    rays = np.column_stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(len(u))])
    points = rays * (before.depth_mm[v, u, None] / 1000)
    away_m, nearest = Nearest(points).query(at_m, NEAREST, within=3 * MOVE_M)
    found = np.isfinite(away_m)
    weight = np.where(found, np.exp(-(away_m**2) / (2 * MOVE_M**2)), 0)
    part = before.parts[v, u][np.where(found, nearest, 0)].astype(np.intp) - 1
    votes = np.zeros_like(flat)
    np.add.at(votes, (np.arange(len(at_m))[:, None], part), weight)
    return np.asarray((votes + DOUBT * flat) / (weight.sum(axis=1, keepdims=True) + DOUBT))


def agreement(belief: Float64, earlier: Float64, sizes: Int64) -> float:
    """Share of the points whose part by colour (G, 11) is the earlier one, where both are clear."""
    clear = (belief.max(axis=1) > 0.7) & (earlier.max(axis=1) > 0.5)
    same = belief.argmax(axis=1) == earlier.argmax(axis=1)
    total = int(sizes[clear].sum())
    return float(sizes[clear & same].sum() / total) if total else 0.0
