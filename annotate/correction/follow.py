"""Parts of one frame moved with the body onto another."""

import numpy as np
from scipy.spatial import cKDTree

from annotate.array_types import Float64, UInt8
from annotate.correction.propagate import CorrectedFrame
from annotate.correction.rigid import LabelledPoints, part_motions
from annotate.frame_labels import FrameLabels
from annotate.parts import BACKGROUND, UNDEFINED, on_body
from sensors.rig.camera import Intrinsics, unproject

REACH_M = 0.06
"""Largest distance of a point from the moved one whose part it gets, in metres. Untuned."""


def followed(previous: CorrectedFrame, target: FrameLabels, camera: Intrinsics) -> UInt8:
    """Parts (h, w) of another frame, moved with the body; 255 where none of them came to lie.

    previous: the frame before. target: the frame to label; only points of its body get a part. camera: the
    undistorted depth camera of both.
    """
    parts = np.full(target.parts.shape, UNDEFINED, np.uint8)
    there = (previous.corrected.depth_mm > 0) & on_body(previous.corrected.parts)
    here = (target.depth_mm > 0) & (target.parts != BACKGROUND)
    if not there.any() or not here.any():
        return parts
    given = previous.corrected.parts[there]
    source = LabelledPoints(_points_m(previous.corrected, camera)[there], previous.automatic.parts[there])
    body = LabelledPoints(_points_m(target, camera)[here], target.parts[here])
    moved, motions = source.points_m.copy(), part_motions(source, given, body)
    for part in np.unique(given).tolist():
        own = given == part
        moved[own] = motions[part].apply(source.points_m[own])
    away_m, nearest = cKDTree(moved).query(body.points_m)
    parts[here] = np.where(away_m <= REACH_M, given[nearest], UNDEFINED)
    return parts


def _points_m(frame: FrameLabels, camera: Intrinsics) -> Float64:
    """Points (h, w, 3), camera frame, metres."""
    return np.asarray(unproject(camera, frame.depth_mm.astype(np.float32) / 1000), np.float64)
