"""Propagation: the corrections of some frames applied to another frame of the same person, near in time.

Every point of the corrected frames moves with its part into the frame and votes on the points beside it. The
weight of a vote follows from the corrections there. Where nothing was corrected, a point's automatic label
stands unless its confidence is low: the same cloth in the same light was read rightly. Where something was
corrected, the corrected points decide, above all for points with the same automatic label. Where a part comes
to lie on points labelled background, and no background was near, they become the part.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from annotate.array_types import Bool, Float64, UInt8
from annotate.cleanup import without_islands
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.correction.appearance import Appearance
from annotate.correction.rigid import LabelledPoints, part_motions
from annotate.correction.votes import LEAST_WEIGHT, Candidates, Voters, gathered, poll, winners
from annotate.frame_labels import FrameLabels
from annotate.parts import BACKGROUND, N_CLASSES, UNDEFINED
from sensors.rig.camera import Intrinsics, unproject

FRAMES_VOTING = 3
"""Number of corrected frames that vote: one alone has not seen what the pose hid. Measured (virtual rig,
hard, seed 150, 10 frames): 0.991 right with three, 0.990 with one."""
FRAMES_COMPARED = 12
"""Number of corrected frames, the nearest in time, of which those vote whose automatic labels are most like
the frame's own: a laptop mistaken for the body comes back after frames without it. Measured (virtual rig,
normal, seed 150, 29 frames): 23 at 99 % by likeness, 20 by nearness alone."""
FADING = 0.8
"""Factor on the weight of each further voting frame. Untuned."""
MARGIN_PX = 40
"""Width of the background around the body that takes part, in pixels. Untuned."""
BESIDE_SHARE, BESIDE_M = 0.1, 0.08
"""Share of the votes that every part gets at its border, and the distance in metres over which it falls to
0.6: a hand moves to where no vote came from, or was missed before. Untuned."""
APPEARANCE_WEIGHT = 0.6
"""Weight of the appearance against the votes: neighbouring pixels are not independent. Untuned."""
LEAST_PX, LEAST_SHARE = 20, 1e-4
"""Least pixels of a part that gets a share beside it, and the least share of any part. Untuned."""


@dataclass(frozen=True)
class CorrectedFrame:
    """A frame before and after a person corrected or accepted it. cloud: its colours and temperatures."""

    automatic: FrameLabels
    corrected: FrameLabels
    cloud: ThermalCloud | None = None

    @property
    def changed(self) -> bool:
        """Whether any label was corrected."""
        return not np.array_equal(self.corrected.parts, self.automatic.parts)


def propagate(
    frames: Sequence[CorrectedFrame],
    target: FrameLabels,
    camera: Intrinsics,
    cloud: ThermalCloud | None = None,
) -> UInt8:
    """Parts (h, w) of a frame after the corrections of others of the same person, near in time.

    frames: the nearest first; of FRAMES_COMPARED, the FRAMES_VOTING most like the target vote. target: the
    frame to change, as labelled automatically. camera: the undistorted depth camera of all. cloud: colours
    and temperatures of the target.
    """
    frames = most_alike(frames[:FRAMES_COMPARED], target)
    if not any(frame.changed for frame in frames):
        return target.parts
    bodies = [target.parts, *(x.parts for each in frames for x in (each.automatic, each.corrected))]
    near = _near_body(bodies) & (target.depth_mm > 0)
    seen = [_voters(frame, FADING**n, camera) for n, frame in enumerate(frames)]
    body = LabelledPoints(_points_m(target, near, camera), target.parts[near])
    confidence = np.ones(len(body.automatic), np.float32)
    if target.confidence is not None:
        confidence = target.confidence[near]
    candidates = Candidates(body, confidence, Appearance.of(cloud, near))
    votes, voters = _polled_twice(seen, candidates)
    if candidates.appearance.colored.any():
        votes = _weighed(votes, voters, candidates, near, target.depth_mm / (1000 * camera.fx))
    parts = target.parts.copy()
    parts[near] = winners(votes, body.automatic)
    return _without_new_islands(parts, target)


def most_alike(frames: Sequence[CorrectedFrame], target: FrameLabels) -> list[CorrectedFrame]:
    """Return the frames that vote on a target: FRAMES_VOTING of them, the most alike first.

    Their automatic labels are most like the target's, because mistakes recur.
    """

    def unlike(frame: CorrectedFrame) -> float:
        labels, others = target.parts, frame.automatic.parts
        body = (labels != BACKGROUND) | (others != BACKGROUND)
        return float((labels != others).sum() / max(body.sum(), 1))

    return sorted(frames, key=unlike)[:FRAMES_VOTING]


def _polled_twice(seen: list[Voters], candidates: Candidates) -> tuple[Float64, Voters]:
    """Votes (n, classes) on the candidates, and the voters in their final positions."""
    body = candidates.body
    motions = [part_motions(LabelledPoints(v.points_m, v.automatic), v.parts, body) for v in seen]
    votes = poll(gathered(seen, motions), candidates)
    # The parts by vote give more exact motions than the automatic labels.
    voted = LabelledPoints(body.points_m, winners(votes, body.automatic))
    motions = [
        part_motions(LabelledPoints(v.points_m, v.parts), v.parts, voted, known)
        for v, known in zip(seen, motions, strict=True)
    ]
    voters = gathered(seen, motions)
    return poll(voters, candidates), voters


def _weighed(votes: Float64, voters: Voters, candidates: Candidates, near: Bool, pixel_m: Float64) -> Float64:
    """Votes (n, classes) weighed with appearance, which also shows parts in places without votes.

    near: bool (h, w), pixels of the candidates. pixel_m: float64 (h, w), size of a pixel there in metres.
    """
    total = votes.sum(axis=1)
    voted = np.full(near.shape, UNDEFINED, np.uint8)
    voted[near] = winners(votes, candidates.body.automatic)
    share = votes / np.maximum(total, LEAST_WEIGHT)[:, None] + LEAST_SHARE
    for part in range(N_CLASSES):
        own = voted == part
        if own.sum() >= LEAST_PX:
            away_px = cv2.distanceTransform((~own).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_3)
            share[:, part] += BESIDE_SHARE * np.exp(-0.5 * ((away_px * pixel_m)[near] / BESIDE_M) ** 2)
    likelihood = candidates.appearance.likelihood(voters.appearance, voters.parts)
    score = np.log(share) + APPEARANCE_WEIGHT * likelihood
    again = np.exp(score - score.max(axis=1, keepdims=True))
    # Without votes appearance alone decides, except for undefined points.
    undefined = candidates.body.automatic == UNDEFINED
    total = np.where(undefined, total, np.maximum(total, 2 * LEAST_WEIGHT))
    return np.asarray(again * (total / again.sum(axis=1))[:, None])


def _voters(frame: CorrectedFrame, weight: float, camera: Intrinsics) -> Voters:
    """Points of a corrected frame that vote: the body and its surroundings, except undefined points."""
    corrected = frame.corrected
    near = _near_body([frame.automatic.parts, corrected.parts])
    near &= (corrected.depth_mm > 0) & (corrected.parts != UNDEFINED) & ~_thin_changes(frame)
    automatic, parts = frame.automatic.parts[near], corrected.parts[near]
    points_m, appearance = _points_m(corrected, near, camera), Appearance.of(frame.cloud, near)
    return Voters(points_m, automatic, parts, np.full(len(parts), weight), appearance)


def _thin_changes(frame: CorrectedFrame) -> Bool:
    """Pixels (h, w) of borders shifted by one or two pixels, by hand or by an earlier propagation.

    They do not vote, or borders would drift from frame to frame.
    """
    changed = frame.corrected.parts != frame.automatic.parts
    blank = frame.corrected.depth_mm == 0
    thick = cv2.morphologyEx((changed | blank).astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    return np.asarray(changed & (thick == 0))


def _without_new_islands(parts: UInt8, target: FrameLabels) -> UInt8:
    """Parts (h, w) without the islands that the automatic labels did not have."""
    before = without_islands(target.parts, target.depth_mm) != target.parts
    return np.where(before & (parts == target.parts), parts, without_islands(parts, target.depth_mm))


def _near_body(parts: Sequence[UInt8]) -> Bool:
    """Pixels (h, w) within MARGIN_PX of the body in any of several labels (h, w)."""
    size = 2 * MARGIN_PX + 1
    body = np.any([p != BACKGROUND for p in parts], axis=0).astype(np.uint8)
    return np.asarray(cv2.dilate(body, np.ones((size, size), np.uint8)) > 0)


def _points_m(frame: FrameLabels, mask: Bool, camera: Intrinsics) -> Float64:
    """Points (n, 3) of the masked pixels, camera frame, metres."""
    return np.asarray(unproject(camera, frame.depth_mm.astype(np.float32) / 1000)[mask], np.float64)
