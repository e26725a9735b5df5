"""Persons from votes: pixels whose votes agree with a centre, and with the middle of those pixels.

A vote is an estimate of the middle of the pixel's person. So the middle of a whole person's pixels is where
their votes meet. The votes of a limb alone meet beside the limb; it belongs to the person whose pixels,
together with the limb's, have their middle there. Constants are untuned unless a source is given.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numba import njit
from scipy.spatial import cKDTree

from annotate.array_types import Bool, Float32, Index, UInt8
from annotate.person.detection.odds import Evidence

VOTE_M = 0.1  # scatter of votes for one middle
PEAKS_M = 0.25  # least distance of two peaks of votes; of 70 persons 0 split, 4 joined (0.15: 1, 4)
STRAY_M = 0.7  # reach of a person's votes for stray ones; 0.25 finds 1 % fewer persons that are cut out
MOST_VOTES = 500  # that decide on the middles, for speed
MOST_PERSONS = 255  # in a frame, because an image of persons is 8-bit
NEAR_M, FAR_SHARE = 0.08, 0.25  # error of a vote: at its pixel, and more by the vote's length
MOST_ERROR = 3.0  # bound of a vote's error over the expected one
LEAST_GAIN = 0.5  # expected errors, for two peaks to be one person; 0 joins 1 % more persons who are two


class Voters(NamedTuple):
    """Pixels that vote: votes (n, 3) and points (n, 3) in metres, surface areas (n,) in m2, log odds (n,)."""

    votes_m: Float32
    points_m: Float32
    surface_m2: Float32
    odds: Float32

    def chosen(self, index: slice | Index | Bool) -> "Voters":
        """Return the voters at an index, as contiguous arrays, for which the kernels are compiled."""
        return Voters(*(np.ascontiguousarray(values[index]) for values in self))


class Groups(NamedTuple):
    """Groups of voters who agree on a middle: a sample of the voters, the group (n,) of each, from 0 on, and
    the groups' evidence.
    """

    sample: Voters
    number: Index
    evidence: list[Evidence]

    def assigned(self, votes_m: Float32, kept: Sequence[int]) -> UInt8:
        """Return the person number (n,) of votes (n, 3) in metres, 0 = no person.

        kept: groups that are a person, in the order of the persons' numbers from 1 on. Votes of others belong
        to the nearest person, if near.
        """
        if not kept:
            return np.zeros(len(votes_m), np.uint8)
        person = np.zeros(len(self.evidence), np.uint8)
        person[list(kept)] = np.arange(1, len(kept) + 1)
        among = np.flatnonzero(person[self.number])
        _, nearest = cKDTree(self.sample.votes_m[among]).query(votes_m, distance_upper_bound=STRAY_M)
        return np.asarray(np.append(person[self.number[among]], 0)[nearest], np.uint8)


def grouped(voters: Voters) -> Groups:
    """Return the groups of voters whose votes agree."""
    step = 1 + len(voters.votes_m) // MOST_VOTES
    some = voters.chosen(np.s_[::step])
    if not len(some.odds):
        return Groups(some, np.zeros(0, np.intp), [])
    group = _peaks(some.votes_m, some.surface_m2 * step)
    _join(some.votes_m, some.points_m, group)
    numbers, group = np.unique(group, return_inverse=True)
    evidence = [_evidence(some.chosen(group == k), step) for k in range(len(numbers))]
    return Groups(some, group, evidence)


def _evidence(voters: Voters, step: int) -> Evidence:
    """Return the evidence of every ``step``-th voter of a group."""
    surface_m2 = float(voters.surface_m2.sum())
    mean_odds = float(voters.surface_m2 @ voters.odds) / max(surface_m2, 1e-9)
    return Evidence(mean_odds, step * surface_m2)


def _peaks(votes_m: Float32, weight: Float32) -> Index:
    """Return the number (n,) of each vote's density peak, from 0 on."""
    leader = _leaders(votes_m, weight)
    while (leader[leader] != leader).any():
        leader = leader[leader]
    return np.unique(leader, return_inverse=True)[1]


@njit(cache=True, nogil=True)
def _leaders(votes: Float32, weight: Float32) -> Index:
    """Return for each vote the index (n,) of the nearest vote of higher density within ``PEAKS_M``; its own
    index at a density peak.
    """
    density, leader = np.zeros(len(votes), np.float32), np.arange(len(votes))
    for i in range(len(votes)):
        for j in range(len(votes)):
            square = np.float32(0)
            for axis in range(3):
                square += (votes[i, axis] - votes[j, axis]) ** 2
            if square < np.float32((4 * VOTE_M) ** 2):
                density[i] += weight[j] * np.exp(square * np.float32(-0.5 / VOTE_M**2))
    for i in range(len(votes)):
        least = np.float32(PEAKS_M**2)
        for j in range(len(votes)):
            if density[j] > density[i] or (density[j] == density[i] and j < i):
                square = np.float32(0)
                for axis in range(3):
                    square += (votes[i, axis] - votes[j, axis]) ** 2
                if square <= least:
                    least, leader[i] = square, j
    return leader


@njit(cache=True, nogil=True)
def _join(votes: Float32, points: Float32, person: Index) -> None:
    """Join peaks of one person in ``person`` (n,), the pair with the greatest gain first.

    Gain: errors of two peaks apart less their error together, by pixel of the smaller peak.
    """
    sizes = np.bincount(person)
    error = np.zeros((len(sizes), len(sizes)))  # of two peaks together, of one on the diagonal
    for j in range(len(sizes)):
        for i in range(j + 1):
            error[i, j] = _error(votes, points, person, (i, j))
    while True:
        best, pair = LEAST_GAIN, (-1, -1)
        for j in range(len(sizes)):
            for i in range(j):
                if sizes[i] > 0 and sizes[j] > 0:
                    less = error[i, i] + error[j, j] - error[i, j]
                    if less > best * min(sizes[i], sizes[j]):
                        best, pair = less / min(sizes[i], sizes[j]), (i, j)
        i, j = pair
        if i < 0:
            return
        person[person == j] = i
        sizes[i], sizes[j] = sizes[i] + sizes[j], 0
        for k in range(len(sizes)):
            if sizes[k] > 0:
                error[min(i, k), max(i, k)] = _error(votes, points, person, (min(i, k), max(i, k)))


@njit(cache=True, nogil=True)
def _error(votes: Float32, points: Float32, person: Index, pair: tuple[int, int]) -> float:
    """Return the summed errors of the votes of two peaks as if their pixels were one whole person.

    The unit is the expected error of a vote. As in training, the middle of pixels is the mean ray at the mean
    depth.
    """
    ray, depth, count = np.zeros(3), 0.0, 0
    for n in range(len(votes)):
        if person[n] == pair[0] or person[n] == pair[1]:
            ray += points[n] / points[n, 2]
            depth += points[n, 2]
            count += 1
    middle, total = ray * depth / max(count, 1) ** 2, 0.0
    for n in range(len(votes)):
        if person[n] == pair[0] or person[n] == pair[1]:
            length, square = 0.0, 0.0
            for axis in range(3):
                length += (votes[n, axis] - points[n, axis]) ** 2
                square += (votes[n, axis] - middle[axis]) ** 2
            total += min(np.sqrt(square) / (NEAR_M + FAR_SHARE * np.sqrt(length)), MOST_ERROR)
    return total
