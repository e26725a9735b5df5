"""Votes of corrected points on the parts of another frame's points, after they were moved into that frame."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from annotate.array_types import Float32, Float64, Index, Int64, UInt8
from annotate.correction.appearance import N_COLORS, Appearance
from annotate.correction.rigid import LabelledPoints
from annotate.parts import BACKGROUND, N_CLASSES, UNDEFINED
from sensors.rig.rig_calibration import Pose

VOTERS = 15
"""Number of nearest corrected points that vote on one point. Untuned."""
REACH_M = 0.1
"""Largest distance of a voter, in metres. Untuned."""
SPREAD_M = 0.015
"""Distance beyond the nearest voter at which a vote's weight falls to 0.6, in metres: depth noise, and how
far cloth departs from rigid motion. Untuned."""
FAR_M = 0.04
"""Distance of the nearest voter at which all votes' weights fall to 0.6, in metres. Untuned."""
LEAST_WEIGHT = 0.5
"""Least sum of votes that changes a point. Untuned."""
OWN_VOTE = 0.1
"""Votes for the point's automatic label, divided by the doubt about it. Untuned."""
OTHER_LABEL, OTHER_LABEL_LIMIT = 5.0, 0.6
"""Weight of a voter whose automatic label differs from the point's, per unit of doubt, and its upper limit.
Untuned."""
LEAST_DOUBT = 0.01
"""Lower limit of the doubt about an automatic label. Untuned."""
PRIOR_PX, PRIOR_DOUBT = 50.0, 0.05
"""Pixels, and their share of errors, that every label of every colour starts with. Untuned."""
LABEL_DOUBT = 0.5
"""Weight of a label's share of errors anywhere; errors beside the point count in full. Untuned."""
CONFIDENCE_DOUBT = 0.5
"""Weight of the labelling's own doubt. Measured (virtual rig): hard, seed 150, 15 frames: 7 at 99 % with it,
5 without; normal, seed 152, 29 frames: 19 and 18."""
STRANGE_SHARE = 0.02
"""Largest share of votes for a point's own label at which the label is strange there: it is then ignored,
unless it was right wherever it was corrected, which means that the limb moved farther than its motion. Chosen
by eye."""
COVERED_M = 0.02
"""Distance of a part's voter, in metres, within which background without background voters is strange: a hand
that the labelling missed. Untuned."""


@dataclass(frozen=True)
class Voters:
    """Corrected points. points_m: float64 (n, 3); automatic, parts: uint8 (n,), labels before and after the
    correction; weight: float64 (n,); appearance: of the n points."""

    points_m: Float64
    automatic: UInt8
    parts: UInt8
    weight: Float64
    appearance: Appearance

    def moved(self, motions: list[Pose]) -> Float64:
        """Points (n, 3), each moved by the motion of its part."""
        moved = self.points_m.copy()
        for part in np.unique(self.parts).tolist():
            own = self.parts == part
            moved[own] = motions[part].apply(self.points_m[own])
        return moved


@dataclass(frozen=True)
class Candidates:
    """Points of a frame whose parts are voted on. confidence: float32 (n,) of their automatic labels."""

    body: LabelledPoints
    confidence: Float32
    appearance: Appearance


def gathered(seen: Sequence[Voters], motions: Sequence[list[Pose]]) -> Voters:
    """Voters of several frames as one, each frame's points moved by its motions."""
    return Voters(
        np.concatenate([voters.moved(poses) for voters, poses in zip(seen, motions, strict=True)]),
        np.concatenate([voters.automatic for voters in seen]),
        np.concatenate([voters.parts for voters in seen]),
        np.concatenate([voters.weight for voters in seen]),
        Appearance.joined([voters.appearance for voters in seen]),
    )


def poll(voters: Voters, candidates: Candidates) -> Float64:
    """Votes (n, classes) on the candidates, including those for their own automatic labels."""
    own = candidates.body.automatic
    weight, index, nearest_m = _neighbours(voters, candidates)
    labels, parts = voters.automatic[index], voters.parts[index]
    error_share = _error_shares(voters, candidates)
    total, empty = weight.sum(axis=1), own == BACKGROUND
    own_share = (weight * ((labels == own[:, None]) | (parts == own[:, None]))).sum(axis=1)
    alone = own_share <= STRANGE_SHARE * total
    strange = alone & ~empty & (error_share >= PRIOR_DOUBT) & (total > LEAST_WEIGHT)
    corrected_share = (weight * (labels != parts)).sum(axis=1) / np.maximum(total, 1e-3)
    doubt = np.maximum(corrected_share, LABEL_DOUBT * error_share)
    # The confidence is about the body alone: it does not apply to background.
    doubt = np.maximum(doubt, np.where(empty, 0, CONFIDENCE_DOUBT * (1 - candidates.confidence)))
    doubt = np.clip(doubt, LEAST_DOUBT, 1)
    doubt[strange | (alone & empty & (nearest_m < COVERED_M)) | (own == UNDEFINED)] = 1.0
    # A limb may have moved to where background was: a strange label means another part.
    weight[strange[:, None] & (parts == BACKGROUND)] = 0.0
    of_other = np.minimum(OTHER_LABEL_LIMIT, OTHER_LABEL * doubt)
    weight *= np.where(labels == own[:, None], 1.0, of_other[:, None])
    votes = np.stack([(weight * (parts == part)).sum(axis=1) for part in range(N_CLASSES)], axis=1)
    named = np.flatnonzero(own != UNDEFINED)
    votes[named, own[named]] += OWN_VOTE / doubt[named]
    return votes


def winners(votes: Float64, automatic: UInt8) -> UInt8:
    """Parts (n,) with most votes; the automatic labels where the votes are below LEAST_WEIGHT."""
    return np.where(votes.sum(axis=1) > LEAST_WEIGHT, votes.argmax(axis=1), automatic).astype(np.uint8)


def _neighbours(voters: Voters, candidates: Candidates) -> tuple[Float64, Index, Float64]:
    """Weights and indices (n, VOTERS) of the voters beside each candidate, and nearest distances (n,)."""
    away_m, index = cKDTree(voters.points_m).query(
        candidates.body.points_m, VOTERS, distance_upper_bound=REACH_M
    )
    found = np.isfinite(away_m)
    index, nearest_m = np.where(found, index, 0), np.where(found[:, :1], away_m[:, :1], REACH_M)
    weight = np.exp(-0.5 * (np.where(found, away_m, np.inf) ** 2 - nearest_m**2) / SPREAD_M**2)
    weight *= np.exp(-0.5 * (nearest_m / FAR_M) ** 2) * voters.weight[index]
    weight *= candidates.appearance.resemblance(voters.appearance, index)
    return weight, index, nearest_m[:, 0]


def _error_shares(voters: Voters, candidates: Candidates) -> Float64:
    """Share of errors (n,) of each candidate's automatic label among voters of its colour."""

    def cell(labels: UInt8, appearance: Appearance) -> Int64:
        return np.minimum(labels, N_CLASSES).astype(np.int64) * N_COLORS + appearance.bins

    cells, size = cell(voters.automatic, voters.appearance), (N_CLASSES + 1) * N_COLORS
    seen = np.bincount(cells, minlength=size) + PRIOR_PX
    wrong = np.bincount(cells, voters.automatic != voters.parts, size) + PRIOR_DOUBT * PRIOR_PX
    return np.asarray((wrong / seen)[cell(candidates.body.automatic, candidates.appearance)])
