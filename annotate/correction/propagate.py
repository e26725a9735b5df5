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
from annotate.correction.rigid import Tagged, part_motions
from annotate.labels import FrameLabels
from annotate.parts import BACKGROUND, N_CLASSES, UNDEFINED
from sensors.calibration import Pose
from sensors.camera import Intrinsics, unproject
from sensors.errors import FormatError
from sensors.nearest import Nearest

FRAMES = 3
"""Corrected frames that have a say: one alone has not seen what the pose hid (virtual rig, hard, seed 150, 10
frames: 0.991 right with three, 0.990 with one)."""
REMEMBERED = 12
"""The nearest in time, of which those have it whose automatic labels are most like the frame's own: a laptop
that was taken for the body comes back after frames without it (virtual rig, normal, seed 150, 29 frames: 23
at 99 % by likeness, 20 by nearness alone)."""
FADING = 0.8
"""How much less each further one of them counts."""
VOTERS = 15
"""Corrected points that decide on one point."""
REACH_M = 0.1
"""A correction farther off than this says nothing."""
SPREAD_M = 0.015
"""How much nearer voters count more than others: the depth noise and what a rigid motion leaves of cloth."""
FAR_M = 0.04
"""How much less voters count that are far altogether."""
LEAST_WEIGHT = 0.5
"""Least sum of votes: less leaves a point as it is."""
OWN = 0.1
"""Votes that the automatic label has, over the doubt about it."""
OTHERWISE = 5.0
"""What a voter called otherwise than the point counts, times the doubt; at most MOST_OTHERWISE."""
MOST_OTHERWISE = 0.6
LEAST_DOUBT = 0.01
SEEN_PX, SEEN_DOUBT = 50.0, 0.05
"""Pixels and doubt that every automatic label begins with, before any was seen corrected."""
TAG_DOUBT = 0.5
"""How much the doubt about a tag counts that was wrong anywhere; beside the point it counts in full."""
OWN_DOUBT = 0.5
"""How much what the automatic label doubted itself counts (virtual rig, hard, seed 150, 15 frames: 7 at 99 %
with it, 5 without; normal, seed 152, 29 frames: 19 and 18)."""
STRANGE = 0.02
"""Share of the votes up to which nothing near has a point's own name: then the name is worth nothing, unless
it was right wherever it was seen: that limb moved farther than was found out."""
COVERED_M = 0.02
"""Background that a part has come to lie on, nearer than this, and no background near: a hand was missed."""
MARGIN_PX = 40
"""How far around the body the background has a say."""


@dataclass(frozen=True)
class Worked:
    """A frame before and after a person worked on it, or held it for right as it was.

    Raises FormatError unless both show the same depth image.
    """

    automatic: FrameLabels
    corrected: FrameLabels

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


@dataclass(frozen=True)
class _Points:
    """Points (n, 3) of a corrected frame in metres, their automatic tags and their parts (n,), and how much
    each counts."""

    points_m: NDArray[np.float64]
    tags: NDArray[np.uint8]
    parts: NDArray[np.uint8]
    weight: NDArray[np.float64]

    def moved(self, motions: list[Pose]) -> NDArray[np.float64]:
        """Each point moved with its part."""
        moved = self.points_m.copy()
        for part in np.unique(self.parts).tolist():
            own = self.parts == part
            moved[own] = motions[part].apply(self.points_m[own])
        return moved


def propagate(worked: Sequence[Worked], target: FrameLabels, camera: Intrinsics) -> Propagated:
    """Carry the corrections of frames over to another of the same person, near in time.

    worked: the nearest first; of REMEMBERED, the FRAMES most like the target have a say. target: the frame
    to be changed, as labelled automatically. camera: the undistorted depth camera of all. Raises FormatError
    when a frame is not the camera's.
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
        parts[near], confidence[near] = _elected(seen, body, unchanged[near])
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


def _elected(
    seen: list[_Points], body: Tagged, confidence: NDArray[np.float32]
) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    """Parts and confidence (n,) of the points of the frame at hand."""
    motions = [part_motions(Tagged(p.points_m, p.tags), p.parts, body) for p in seen]
    poll = _poll(_voters(seen, motions), body, confidence)
    # Names told by the votes move the parts more exactly than the automatic ones did.
    named = Tagged(body.points_m, _winners(poll, body.tags))
    motions = [
        part_motions(Tagged(p.points_m, p.parts), p.parts, named, nearly)
        for p, nearly in zip(seen, motions, strict=True)
    ]
    poll = _poll(_voters(seen, motions), body, confidence)
    names = _winners(poll, body.tags)
    share = (poll.max(axis=1) / np.maximum(poll.sum(axis=1), LEAST_WEIGHT)).astype(np.float32)
    return names, np.where(names == body.tags, confidence, share)


def _winners(poll: NDArray[np.float64], tags: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The parts (n,) with most votes, the tags where hardly any vote was given."""
    return np.where(poll.sum(axis=1) > LEAST_WEIGHT, poll.argmax(axis=1), tags).astype(np.uint8)


def _voters(seen: list[_Points], motions: list[list[Pose]]) -> _Points:
    """All points at their place in the frame at hand."""
    return _Points(
        np.concatenate([p.moved(m) for p, m in zip(seen, motions, strict=True)]),
        np.concatenate([p.tags for p in seen]),
        np.concatenate([p.parts for p in seen]),
        np.concatenate([p.weight for p in seen]),
    )


def _poll(voters: _Points, body: Tagged, confidence: NDArray[np.float32]) -> NDArray[np.float64]:
    """Votes (n, classes) on the body's points, their own automatic label's among them."""
    weight, index, nearest_m = _beside(voters, body)
    tags, parts, own = voters.tags[index], voters.parts[index], body.tags[:, None]
    of_tag = _doubt_of_tags(voters)[body.tags]
    total, empty = weight.sum(axis=1), body.tags == BACKGROUND
    doubt = np.maximum((weight * (tags != parts)).sum(axis=1) / np.maximum(total, 1e-3), TAG_DOUBT * of_tag)
    # How sure the room is of itself nobody says.
    doubt = np.clip(np.maximum(doubt, np.where(empty, 0, OWN_DOUBT * (1 - confidence))), LEAST_DOUBT, 1)
    alone = (weight * ((tags == own) | (parts == own))).sum(axis=1) <= STRANGE * total
    strange = alone & ~empty & (of_tag >= SEEN_DOUBT)
    doubt[strange | (alone & empty & (nearest_m < COVERED_M)) | (body.tags == UNDEFINED)] = 1.0
    # A limb may have come where the room was: what is strange is another part, if anything.
    weight[strange[:, None] & (parts == BACKGROUND)] = 0.0
    weight *= np.where(tags == own, 1.0, np.minimum(MOST_OTHERWISE, OTHERWISE * doubt)[:, None])
    poll = np.stack([(weight * (parts == part)).sum(axis=1) for part in range(N_CLASSES)], axis=1)
    named = np.flatnonzero(body.tags != UNDEFINED)
    poll[named, body.tags[named]] += OWN / doubt[named]
    return poll


def _beside(
    voters: _Points, body: Tagged
) -> tuple[NDArray[np.float64], NDArray[np.intp], NDArray[np.float64]]:
    """What the voters beside every point count (n, VOTERS), which they are, how far the nearest is (n,)."""
    away_m, index = Nearest(voters.points_m).query(body.points_m, VOTERS, within=REACH_M)
    there = np.isfinite(away_m)
    index, nearest_m = np.where(there, index, 0), np.where(there[:, :1], away_m[:, :1], REACH_M)
    weight = np.exp(-0.5 * (np.where(there, away_m, np.inf) ** 2 - nearest_m**2) / SPREAD_M**2)
    weight *= np.exp(-0.5 * (nearest_m / FAR_M) ** 2) * voters.weight[index]
    return weight, index, nearest_m[:, 0]


def _doubt_of_tags(voters: _Points) -> NDArray[np.float64]:
    """How often each automatic tag (256,) was wrong."""
    seen = np.bincount(voters.tags, minlength=256) + SEEN_PX
    wrong = np.bincount(voters.tags, voters.tags != voters.parts, 256) + SEEN_DOUBT * SEEN_PX
    return np.asarray(wrong / seen)


def _seen(worked: Worked, weight: float, camera: Intrinsics) -> _Points:
    """The points that have a say: of the body and its surroundings, as far as people said what they are."""
    corrected = worked.corrected
    near = _near_body([worked.automatic.parts, corrected.parts])
    near &= (corrected.depth_mm > 0) & (corrected.parts != UNDEFINED) & ~_thin(worked)
    tags, parts = worked.automatic.parts[near], corrected.parts[near]
    return _Points(_points_m(corrected, near, camera), tags, parts, np.full(len(parts), weight))


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
