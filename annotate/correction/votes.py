"""How the points of corrected frames, moved to where they went, vote on what the points of another are."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from annotate.correction.patch_colors import N_COLORS, Looks
from annotate.correction.rigid import Tagged
from annotate.parts import BACKGROUND, N_CLASSES, UNDEFINED
from sensors.rig.nearest import Nearest
from sensors.rig.rig_calibration import Pose

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
"""Pixels and doubt that every automatic label of every colour begins with, before any was seen corrected."""
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


@dataclass(frozen=True)
class Voters:
    """Points (n, 3) of corrected frames in metres, their automatic tags and their parts (n,), how much each
    counts (n,), and what they look like."""

    points_m: NDArray[np.float64]
    tags: NDArray[np.uint8]
    parts: NDArray[np.uint8]
    weight: NDArray[np.float64]
    looks: Looks

    def moved(self, motions: list[Pose]) -> NDArray[np.float64]:
        """Each point (n, 3) moved with its part."""
        moved = self.points_m.copy()
        for part in np.unique(self.parts).tolist():
            own = self.parts == part
            moved[own] = motions[part].apply(self.points_m[own])
        return moved


@dataclass(frozen=True)
class Asked:
    """The points that are voted on. confidence: float32 (n,) of their tags."""

    body: Tagged
    confidence: NDArray[np.float32]
    looks: Looks


def gathered(seen: Sequence[Voters], motions: Sequence[list[Pose]]) -> Voters:
    """All voters at their place in the frame at hand."""
    return Voters(
        np.concatenate([p.moved(m) for p, m in zip(seen, motions, strict=True)]),
        np.concatenate([p.tags for p in seen]),
        np.concatenate([p.parts for p in seen]),
        np.concatenate([p.weight for p in seen]),
        Looks.joined([p.looks for p in seen]),
    )


def poll(voters: Voters, asked: Asked) -> NDArray[np.float64]:
    """Votes (n, classes) on the points, their own automatic label's among them."""
    body = asked.body
    weight, index, nearest_m = _beside(voters, asked)
    tags, parts, own = voters.tags[index], voters.parts[index], body.tags[:, None]
    of_tag = _doubt_of_tags(voters, asked)
    total, empty = weight.sum(axis=1), body.tags == BACKGROUND
    doubt = np.maximum((weight * (tags != parts)).sum(axis=1) / np.maximum(total, 1e-3), TAG_DOUBT * of_tag)
    # How sure the room is of itself nobody says.
    doubt = np.maximum(doubt, np.where(empty, 0, OWN_DOUBT * (1 - asked.confidence)))
    doubt = np.clip(doubt, LEAST_DOUBT, 1)
    alone = (weight * ((tags == own) | (parts == own))).sum(axis=1) <= STRANGE * total
    strange = alone & ~empty & (of_tag >= SEEN_DOUBT) & (total > LEAST_WEIGHT)
    doubt[strange | (alone & empty & (nearest_m < COVERED_M)) | (body.tags == UNDEFINED)] = 1.0
    # A limb may have come where the room was: what is strange is another part, if anything.
    weight[strange[:, None] & (parts == BACKGROUND)] = 0.0
    weight *= np.where(tags == own, 1.0, np.minimum(MOST_OTHERWISE, OTHERWISE * doubt)[:, None])
    votes = np.stack([(weight * (parts == part)).sum(axis=1) for part in range(N_CLASSES)], axis=1)
    named = np.flatnonzero(body.tags != UNDEFINED)
    votes[named, body.tags[named]] += OWN / doubt[named]
    return votes


def winners(votes: NDArray[np.float64], tags: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The parts (n,) with most votes, the tags where hardly any vote was given."""
    return np.where(votes.sum(axis=1) > LEAST_WEIGHT, votes.argmax(axis=1), tags).astype(np.uint8)


def _beside(
    voters: Voters, asked: Asked
) -> tuple[NDArray[np.float64], NDArray[np.intp], NDArray[np.float64]]:
    """What the voters beside every point count (n, VOTERS), which they are, how far the nearest is (n,)."""
    away_m, index = Nearest(voters.points_m).query(asked.body.points_m, VOTERS, within=REACH_M)
    there = np.isfinite(away_m)
    index, nearest_m = np.where(there, index, 0), np.where(there[:, :1], away_m[:, :1], REACH_M)
    weight = np.exp(-0.5 * (np.where(there, away_m, np.inf) ** 2 - nearest_m**2) / SPREAD_M**2)
    weight *= np.exp(-0.5 * (nearest_m / FAR_M) ** 2) * voters.weight[index]
    weight *= asked.looks.resemblance(voters.looks, index)
    return weight, index, nearest_m[:, 0]


def _doubt_of_tags(voters: Voters, asked: Asked) -> NDArray[np.float64]:
    """How often each point's automatic tag was wrong (n,) on voters of its colour."""

    def cell(tags: NDArray[np.uint8], looks: Looks) -> NDArray[np.int64]:
        return np.minimum(tags, N_CLASSES).astype(np.int64) * N_COLORS + looks.bins

    cells, size = cell(voters.tags, voters.looks), (N_CLASSES + 1) * N_COLORS
    seen = np.bincount(cells, minlength=size) + SEEN_PX
    wrong = np.bincount(cells, voters.tags != voters.parts, size) + SEEN_DOUBT * SEEN_PX
    return np.asarray((wrong / seen)[cell(asked.body.tags, asked.looks)])
