"""One correction pays for many frames: what a person put right in one frame, put right in a neighbour.

The automatic labels make the same mistake in the same place of the body while the same cloth is seen in
the same light. So it is the corrections that travel, not the labels: every corrected point is moved along
with its part to the neighbouring frame, and a point there changes only where the corrected frame's points
nearest to it carried the very same automatic label and were changed.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from annotate.labels import FrameLabels
from annotate.parts import N_CLASSES, UNDEFINED
from annotate.rigid import Tagged, part_motions
from sensors.camera import Intrinsics, unproject
from sensors.errors import FormatError

VOTERS = 15
"""Corrected points that decide on one point."""
REACH_M = 0.06
"""A correction farther off than this says nothing."""
SPREAD_M = 0.02
"""How much nearer voters count more: the depth noise and what a rigid motion leaves of a soft body."""
MAJORITY = 0.6
"""Share of the votes that changes a point."""
LEAST_WEIGHT = 1.0
"""Least sum of votes: one voter about 1.5 spreads away."""
MARGIN_PX = 40
"""How far around the body the background has a say."""


@dataclass(frozen=True)
class Propagated:
    """A frame's parts after the corrections of its neighbour.

    parts: uint8 (h, w). confidence: float32 (h, w): of the votes where a part changed, else as it was.
    changed: bool (h, w).
    """

    parts: NDArray[np.uint8]
    confidence: NDArray[np.float32]
    changed: NDArray[np.bool_]


@dataclass(frozen=True)
class _Voters:
    """Points of the corrected frame at their place in the target frame, with tag and part (n,) each."""

    points_m: NDArray[np.float64]
    tags: NDArray[np.uint8]
    parts: NDArray[np.uint8]

    def of(self, tag: int) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
        """Points and parts of those tagged so; of all where the target has no label of its own."""
        chosen = self.tags == tag if tag != UNDEFINED else self.parts != UNDEFINED
        return self.points_m[chosen], self.parts[chosen]


def propagate(
    corrected: FrameLabels, automatic: FrameLabels, target: FrameLabels, camera: Intrinsics
) -> Propagated:
    """Carry the corrections of one frame over to another of the same person, near in time.

    corrected and automatic: the same frame after and before a person worked on it. target: the frame to
    be changed, as labelled automatically. camera: the undistorted depth camera of all three.
    Raises FormatError when corrected and automatic do not show the same depth image, or a frame is not
    the camera's.
    """
    if not corrected.parts.shape == target.parts.shape == camera.shape:
        raise FormatError(
            f"frames {corrected.frame_id} and {target.frame_id} are {corrected.parts.shape} and "
            f"{target.parts.shape}, the camera {camera.shape}; give frames of one camera"
        )
    if not np.array_equal(corrected.depth_mm, automatic.depth_mm):
        raise FormatError(
            f"frames {corrected.frame_id} and {automatic.frame_id} show other depth images; "
            "give one frame before and after its correction"
        )
    parts = target.parts.copy()
    confidence = np.ones(parts.shape, np.float32) if target.confidence is None else target.confidence.copy()
    mistaken = np.unique(automatic.parts[corrected.parts != automatic.parts]).tolist()
    if mistaken or (target.parts == UNDEFINED).any():
        near = _near_body(target.parts > 0) & (target.depth_mm > 0)
        points = _points(target, near, camera)
        tags = target.parts[near]
        voters = _voters(corrected, automatic, Tagged(points, tags), camera)
        chosen, share = _vote(points, tags, voters, {*mistaken, UNDEFINED})
        parts[near] = chosen
        confidence[near] = np.where(chosen != tags, share, confidence[near])
    return Propagated(parts, confidence, parts != target.parts)


def _voters(corrected: FrameLabels, automatic: FrameLabels, target: Tagged, camera: Intrinsics) -> _Voters:
    """The corrected frame's points, each moved with its true part; what is nobody stays where it is."""
    near = _near_body((automatic.parts > 0) | (corrected.parts > 0)) & (corrected.depth_mm > 0)
    points, tags, parts = _points(corrected, near, camera), automatic.parts[near], corrected.parts[near]
    moved = points.copy()
    for part, motion in enumerate(part_motions(Tagged(points, tags), parts, target)):
        moved[parts == part] = motion.apply(points[parts == part])
    return _Voters(moved, tags, parts)


def _vote(
    points_m: NDArray[np.float64], tags: NDArray[np.uint8], voters: _Voters, open_tags: set[int]
) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    """Part (n,) of every target point, and the share of votes for it; only points of open tags change."""
    chosen, share = tags.copy(), np.ones(len(tags), np.float32)
    for tag in open_tags:
        asked, (places, votes) = np.flatnonzero(tags == tag), voters.of(tag)
        if not asked.size or not (votes != tag).any():
            continue
        # Most of the background is far from any correction.
        away_m, _ = cKDTree(places[votes != tag]).query(points_m[asked], distance_upper_bound=REACH_M)
        asked = asked[np.isfinite(away_m)]
        away_m, index = cKDTree(places).query(points_m[asked], k=VOTERS, distance_upper_bound=REACH_M)
        weight = np.where(np.isfinite(away_m), np.exp(-0.5 * (away_m / SPREAD_M) ** 2), 0)
        vote = np.r_[votes, UNDEFINED][index]
        poll = np.stack([(weight * (vote == part)).sum(axis=1) for part in range(N_CLASSES)], axis=1)
        total, winner = poll.sum(axis=1), poll.argmax(axis=1)
        wins = poll.max(axis=1) / np.maximum(total, 1e-12)
        decided = (total > LEAST_WEIGHT) & (wins > MAJORITY)
        chosen[asked[decided]] = winner[decided]
        share[asked[decided]] = wins[decided]
    return chosen, share


def _near_body(body: NDArray[np.bool_]) -> NDArray[np.bool_]:
    size = 2 * MARGIN_PX + 1
    return np.asarray(cv2.dilate(body.astype(np.uint8), np.ones((size, size), np.uint8)) > 0)


def _points(frame: FrameLabels, mask: NDArray[np.bool_], camera: Intrinsics) -> NDArray[np.float64]:
    """Points (n, 3) of the masked pixels, camera frame, metres."""
    return np.asarray(unproject(camera, frame.depth_mm.astype(np.float32) / 1000)[mask], np.float64)
