"""One correction pays for many frames: what a person put right in one frame, put right in a neighbour.

The automatic labels make the same mistake in the same place of the body while the same cloth is seen in
the same light. So it is the corrections that travel, not the labels: every corrected point is moved along
with its part to the neighbouring frame, and a point there changes only where the corrected frame's points
nearest to it carried the very same automatic label and were changed, or where none of them has its name.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from annotate.cleanup import without_islands
from annotate.labels import FrameLabels
from annotate.parts import BACKGROUND, BODY_PARTS, N_CLASSES, UNDEFINED
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
STRANGE = 0.02
"""Share of the votes up to which nothing near has a point's own name."""
RENAMINGS = 2
"""Times that the motions are found again with the names so far (of 27 hard pairs: 0.947 right without, 0.964
after one, 0.967 after two)."""
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

    def of_body(self) -> "_Voters":
        """Those that are a part of the person."""
        own = (self.parts != BACKGROUND) & (self.parts != UNDEFINED)
        return _Voters(self.points_m[own], self.tags[own], self.parts[own])

    def near_corrections(self, tag: int) -> "_Voters":
        """Those with one tag that were corrected, and those near enough to have a say beside them."""
        own = np.flatnonzero(self.tags == tag)
        corrected = self.points_m[own[self.parts[own] != tag]]
        away_m, _ = cKDTree(corrected).query(self.points_m[own], distance_upper_bound=2 * REACH_M)
        own = own[np.isfinite(away_m)]
        return _Voters(self.points_m[own], self.tags[own], self.parts[own])


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
    near = _near_body(target.parts > 0) & (target.depth_mm > 0)
    points, parts = _points(target, near, camera), target.parts.copy()
    voters = _voters(corrected, automatic, Tagged(points, target.parts[near]), camera)
    confidence = np.ones(parts.shape, np.float32) if target.confidence is None else target.confidence.copy()
    for tag in np.unique(automatic.parts[corrected.parts != automatic.parts]).tolist():
        asked = near & (target.parts == tag)
        _ask(asked, points[asked[near]], voters.near_corrections(tag), parts, confidence)
    # What has no label, or is an island by now, takes the label of what is nearest, whatever it was called.
    asked = near & ((parts == UNDEFINED) | (without_islands(parts, target.depth_mm) != parts))
    _ask(asked, points[asked[near]], voters, parts, confidence)
    # A colour read wrongly names a limb differently in every frame, so that no correction has its name: what
    # bears a name that nothing near it has is called what they are. With its true name it moves better.
    for _ in range(RENAMINGS):
        voters = _voters(corrected, corrected, Tagged(points, parts[near]), camera)
        asked = near & np.isin(parts, [part.id for part in BODY_PARTS])
        _ask(asked, points[asked[near]], voters.of_body(), parts, confidence, STRANGE)
    return Propagated(parts, confidence, parts != target.parts)


def _voters(corrected: FrameLabels, automatic: FrameLabels, target: Tagged, camera: Intrinsics) -> _Voters:
    """The corrected frame's points, each moved with its true part; what is nobody stays where it is."""
    near = _near_body((automatic.parts > 0) | (corrected.parts > 0)) & (corrected.depth_mm > 0)
    points, tags, parts = _points(corrected, near, camera), automatic.parts[near], corrected.parts[near]
    moved = points.copy()
    for part, motion in enumerate(part_motions(Tagged(points, tags), parts, target)):
        moved[parts == part] = motion.apply(points[parts == part])
    return _Voters(moved, tags, parts)


def _ask(
    asked: NDArray[np.bool_],
    points_m: NDArray[np.float64],
    voters: _Voters,
    parts: NDArray[np.uint8],
    confidence: NDArray[np.float32],
    own_share: float = 1.0,
) -> None:
    """Give the asked pixels (h, w), at these points (n, 3), the part that the voters agree on, in place.

    own_share: only those whose own part has no larger share of the votes.
    """
    if not len(points_m) or not len(voters.parts):
        return
    away_m, index = cKDTree(voters.points_m).query(points_m, k=VOTERS, distance_upper_bound=REACH_M)
    weight = np.where(np.isfinite(away_m), np.exp(-0.5 * (away_m / SPREAD_M) ** 2), 0)
    vote = np.r_[voters.parts, UNDEFINED][index]
    poll = np.stack([(weight * (vote == part)).sum(axis=1) for part in range(N_CLASSES)], axis=1)
    total, most = poll.sum(axis=1), poll.max(axis=1)
    won = (total > LEAST_WEIGHT) & (most > MAJORITY * total) & (poll.argmax(axis=1) != parts[asked])
    own = np.take_along_axis(poll, np.minimum(parts[asked], N_CLASSES - 1)[:, None].astype(np.intp), 1)[:, 0]
    won &= own <= own_share * total
    pixels = np.flatnonzero(asked)[won]
    parts.ravel()[pixels] = poll.argmax(axis=1)[won]
    confidence.ravel()[pixels] = (most / np.maximum(total, LEAST_WEIGHT))[won]


def _near_body(body: NDArray[np.bool_]) -> NDArray[np.bool_]:
    size = 2 * MARGIN_PX + 1
    return np.asarray(cv2.dilate(body.astype(np.uint8), np.ones((size, size), np.uint8)) > 0)


def _points(frame: FrameLabels, mask: NDArray[np.bool_], camera: Intrinsics) -> NDArray[np.float64]:
    """Points (n, 3) of the masked pixels, camera frame, metres."""
    return np.asarray(unproject(camera, frame.depth_mm.astype(np.float32) / 1000)[mask], np.float64)
