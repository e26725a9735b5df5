"""One correction pays for many frames: what people put right in some frames, put right in one near in time.

Every point of the corrected frames moves along with its part to the frame at hand and votes on the points
beside it. What its vote counts follows from what people did there. Where they had nothing to correct, a
point's automatic label stands, unless it doubted itself: the same cloth in the same light was read rightly.
Where they corrected, what lies there decides, most of all those points that the automatic labels called the
same. Where a part comes to lie on what is called the room, and no room was near, it is the part.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from annotate.cleanup import without_islands
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.correction.patch_colors import Looks
from annotate.correction.rigid import Tagged, part_motions
from annotate.correction.votes import LEAST_WEIGHT, Asked, Voters, gathered, poll, winners
from annotate.frame_labels import FrameLabels
from annotate.parts import BACKGROUND, N_CLASSES, UNDEFINED
from sensors.errors import FormatError
from sensors.rig.camera import Intrinsics, unproject

FRAMES = 3
"""Corrected frames that have a say: one alone has not seen what the pose hid (virtual rig, hard, seed 150, 10
frames: 0.991 right with three, 0.990 with one)."""
REMEMBERED = 12
"""The nearest in time, of which those have it whose automatic labels are most like the frame's own: a laptop
that was taken for the body comes back after frames without it (virtual rig, normal, seed 150, 29 frames: 23
at 99 % by likeness, 20 by nearness alone)."""
FADING = 0.8
"""How much less each further one of them counts."""
MARGIN_PX = 40
"""How far around the body the background has a say."""
ELSEWHERE, ELSEWHERE_M = 0.1, 0.08
"""Share of the votes that every part has on what lies beside it, fading so fast: a hand goes where no vote
came from, or was never found."""
BY_LOOKS = 0.6
"""What looks count against votes: neighbouring pixels of one cloth are no independent witnesses."""
LEAST_PX, LEAST_SHARE = 20, 1e-4
"""Pixels of a part from which something can lie beside it, and the least share of any part."""


@dataclass(frozen=True)
class Worked:
    """A frame before and after a person worked on it, or held it for right as it was. cloud: its colours and
    temperatures, if they are to be had.

    Raises FormatError unless both show the same depth image.
    """

    automatic: FrameLabels
    corrected: FrameLabels
    cloud: ThermalCloud | None = None

    def __post_init__(self) -> None:
        if not np.array_equal(self.corrected.depth_mm, self.automatic.depth_mm):
            raise FormatError(
                f"frames {self.corrected.frame_id} and {self.automatic.frame_id} show other depth images; "
                "give one frame before and after its correction"
            )

    @property
    def changed(self) -> bool:
        """Whether anything was put right."""
        return not np.array_equal(self.corrected.parts, self.automatic.parts)


@dataclass(frozen=True)
class Propagated:
    """A frame's parts after the corrections of others.

    parts: uint8 (h, w). confidence: float32 (h, w): share of the votes where a part changed, else as it was.
    changed: bool (h, w).
    """

    parts: NDArray[np.uint8]
    confidence: NDArray[np.float32]
    changed: NDArray[np.bool_]


def propagate(
    worked: Sequence[Worked], target: FrameLabels, camera: Intrinsics, cloud: ThermalCloud | None = None
) -> Propagated:
    """Carry the corrections of frames over to another of the same person, near in time.

    worked: the nearest first; of REMEMBERED, the FRAMES most like the target have a say. target: the frame
    to be changed, as labelled automatically. camera: the undistorted depth camera of all. cloud: colours and
    temperatures of the target. Raises FormatError when a frame is not the camera's.
    """
    for frame in (target, *(w.corrected for w in worked)):
        if frame.parts.shape != camera.shape:
            raise FormatError(
                f"frame {frame.frame_id} is {frame.parts.shape}, not one camera's {camera.shape}"
            )
    unchanged = np.ones(target.parts.shape, np.float32) if target.confidence is None else target.confidence
    parts, confidence = target.parts.copy(), unchanged.copy()
    worked = _most_alike(worked[:REMEMBERED], target)
    if any(w.changed for w in worked):
        bodies = [target.parts, *(x.parts for w in worked for x in (w.automatic, w.corrected))]
        near = _near_body(bodies) & (target.depth_mm > 0)
        seen = [_seen(w, FADING**n, camera) for n, w in enumerate(worked)]
        body = Tagged(_points_m(target, near, camera), target.parts[near])
        asked = Asked(body, unchanged[near], Looks.of(cloud, near))
        votes, voters = _elected(seen, asked)
        if asked.looks.colored.any():
            votes = _by_looks(votes, voters, asked, near, target.depth_mm / (1000 * camera.fx))
        parts[near], confidence[near] = _told(votes, asked)
        parts = _without_new_islands(parts, target)
    return Propagated(parts, confidence, parts != target.parts)


def _most_alike(worked: Sequence[Worked], target: FrameLabels) -> list[Worked]:
    """The frames that were labelled most like the target, the likest first: what was mistaken in them is
    mistaken in it too."""

    def unlike(frame: Worked) -> float:
        ours, theirs = target.parts, frame.automatic.parts
        body = (ours != BACKGROUND) | (theirs != BACKGROUND)
        return float((ours != theirs).sum() / max(body.sum(), 1))

    return sorted(worked, key=unlike)[:FRAMES]


def _elected(seen: list[Voters], asked: Asked) -> tuple[NDArray[np.float64], Voters]:
    """Votes (n, classes) on the points of the frame at hand, and those who gave them."""
    body = asked.body
    motions = [part_motions(Tagged(p.points_m, p.tags), p.parts, body) for p in seen]
    votes = poll(gathered(seen, motions), asked)
    # Names told by the votes move the parts more exactly than the automatic ones did.
    named = Tagged(body.points_m, winners(votes, body.tags))
    motions = [
        part_motions(Tagged(p.points_m, p.parts), p.parts, named, nearly)
        for p, nearly in zip(seen, motions, strict=True)
    ]
    voters = gathered(seen, motions)
    return poll(voters, asked), voters


def _by_looks(
    votes: NDArray[np.float64],
    voters: Voters,
    asked: Asked,
    near: NDArray[np.bool_],
    pixel_m: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Votes (n, classes) again, since looks tell what has come where no vote was given for it.

    near: bool (h, w), where the points lie. pixel_m: float64 (h, w), size of a pixel there.
    """
    total = votes.sum(axis=1)
    named = np.full(near.shape, UNDEFINED, np.uint8)
    named[near] = winners(votes, asked.body.tags)
    share = votes / np.maximum(total, LEAST_WEIGHT)[:, None] + LEAST_SHARE
    for part in range(N_CLASSES):
        own = named == part
        if own.sum() >= LEAST_PX:
            away_px = cv2.distanceTransform((~own).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_3)
            share[:, part] += ELSEWHERE * np.exp(-0.5 * ((away_px * pixel_m)[near] / ELSEWHERE_M) ** 2)
    score = np.log(share) + BY_LOOKS * asked.looks.likelihood(voters.looks, voters.parts)
    again = np.exp(score - score.max(axis=1, keepdims=True))
    # Where no vote came from, looks alone decide, but for what is undefined.
    heard = np.where(asked.body.tags == UNDEFINED, total, np.maximum(total, 2 * LEAST_WEIGHT))
    return np.asarray(again * (heard / again.sum(axis=1))[:, None])


def _told(votes: NDArray[np.float64], asked: Asked) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    """Parts and confidence (n,) of the points of the frame at hand."""
    names = winners(votes, asked.body.tags)
    share = (votes.max(axis=1) / np.maximum(votes.sum(axis=1), LEAST_WEIGHT)).astype(np.float32)
    return names, np.where(names == asked.body.tags, asked.confidence, share)


def _seen(worked: Worked, weight: float, camera: Intrinsics) -> Voters:
    """The points that have a say: of the body and its surroundings, as far as people said what they are."""
    corrected = worked.corrected
    near = _near_body([worked.automatic.parts, corrected.parts])
    near &= (corrected.depth_mm > 0) & (corrected.parts != UNDEFINED) & ~_thin(worked)
    tags, parts = worked.automatic.parts[near], corrected.parts[near]
    looks = Looks.of(worked.cloud, near)
    return Voters(_points_m(corrected, near, camera), tags, parts, np.full(len(parts), weight), looks)


def _thin(worked: Worked) -> NDArray[np.bool_]:
    """Where a border was shifted by a pixel or two (h, w), by a hand or by an earlier propagation: it says
    nothing, or borders would drift from frame to frame."""
    changed = worked.corrected.parts != worked.automatic.parts
    blank = worked.corrected.depth_mm == 0
    thick = cv2.morphologyEx((changed | blank).astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    return np.asarray(changed & (thick == 0))


def _without_new_islands(parts: NDArray[np.uint8], target: FrameLabels) -> NDArray[np.uint8]:
    """Parts (h, w) without the islands that were none before."""
    before = without_islands(target.parts, target.depth_mm) != target.parts
    return np.where(before & (parts == target.parts), parts, without_islands(parts, target.depth_mm))


def _near_body(parts: Sequence[NDArray[np.uint8]]) -> NDArray[np.bool_]:
    size = 2 * MARGIN_PX + 1
    body = np.any([p != BACKGROUND for p in parts], axis=0).astype(np.uint8)
    return np.asarray(cv2.dilate(body, np.ones((size, size), np.uint8)) > 0)


def _points_m(frame: FrameLabels, mask: NDArray[np.bool_], camera: Intrinsics) -> NDArray[np.float64]:
    """Points (n, 3) of the masked pixels, camera frame, metres."""
    return np.asarray(unproject(camera, frame.depth_mm.astype(np.float32) / 1000)[mask], np.float64)
