"""Candidates for persons in an image at the finder's focal length: pixels whose votes agree.

Constants are untuned.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np

from annotate.array_types import Bool, Float32, UInt8
from annotate.person.detection.odds import Evidence
from annotate.person.detection.verifier import crop_input, person_odds
from annotate.person.detection.votes import MOST_PERSONS, Groups, Voters, grouped

LEAST_ODDS = -3.0  # least log odds by the first stage of a candidate that the second stage rates
MOST_RATED = 16  # rated candidates of an image, 1 ms each; further ones keep the odds of the first stage


@dataclass(frozen=True)
class Candidates:
    """Candidates for persons in an image.

    depth_m: (h, w), 0 = no reading. odds: (h, w), log odds of being a person. focal_px: of columns and rows.
    votes_m: votes (n, 3) of every second likely pixel, depth camera's frame. groups: of votes that agree.
    evidence: of each group, in their order.
    """

    depth_m: Float32
    odds: Float32
    focal_px: tuple[float, float]
    votes_m: Float32
    groups: Groups
    evidence: list[Evidence]

    @classmethod
    def of(
        cls, depth_m: Float32, odds: Float32, focal_px: tuple[float, float], voters: Voters
    ) -> "Candidates":
        """Return the candidates among the voters, every second likely pixel."""
        groups = grouped(voters)
        return cls(depth_m, odds, focal_px, voters.votes_m, groups, groups.evidence)

    @cached_property
    def likely(self) -> Bool:
        """Return flags (h, w) of pixels more likely on a person than not."""
        return np.asarray((self.odds > 0) & (self.depth_m > 0), np.bool_)

    def owners(self, kept: Sequence[int]) -> UInt8:
        """Return the person number (h, w) of pixels, 0 = no person. kept: groups that are the persons."""
        voting = self.likely[::2, ::2]
        whose = np.zeros(self.likely.shape, np.uint8)
        whose[::2, ::2][voting] = self.groups.assigned(self.votes_m, kept)
        # Every second pixel votes; pixels between take their neighbours' person.
        between = cv2.dilate(whose, np.ones((3, 3), np.uint8))
        return np.where(whose > 0, whose, np.where(self.likely, between, 0)).astype(np.uint8)

    def with_one_surer(self, more: float) -> "Candidates":
        """Return candidates of pixels whose log odds are ``more`` too high, except for the likeliest group.

        Someone cut the background away, so there is one person; others need evidence of their own.
        """
        surest = max(range(len(self.evidence)), key=lambda k: self.evidence[k].odds, default=-1)
        lower = (known._replace(mean_odds=known.mean_odds - more) for known in self.evidence)
        evidence = [self.evidence[k] if k == surest else known for k, known in enumerate(lower)]
        return replace(self, evidence=evidence)

    def best(self, least_odds: float, most: int = MOST_PERSONS) -> tuple[list[int], list[Evidence]]:
        """Return the likeliest groups of at least ``least_odds``, at most ``most``, and their evidence."""
        surest = sorted(range(len(self.evidence)), key=lambda k: -self.evidence[k].odds)[:most]
        kept = sorted(k for k in surest if self.evidence[k].odds >= least_odds)
        return kept, [self.evidence[k] for k in kept]

    def masks(self) -> Mapping[int, Bool]:
        """Return the pixels (h, w) by group, of groups with pixels that the second stage rates."""
        chosen, _ = self.best(LEAST_ODDS, MOST_RATED)
        whose = self.owners(chosen)
        return {k: whose == number for number, k in enumerate(chosen, start=1) if (whose == number).any()}

    def crop(self, mask: Bool) -> Float32:
        """Return the second stage's input (6, SIDE, SIDE) for a candidate's pixels (h, w)."""
        return crop_input(self.depth_m, self.odds, mask, self.focal_px)


def rated(candidates: Candidates) -> Candidates:
    """Return candidates with the evidence of the second stage."""
    masks = candidates.masks()
    if not masks:
        return candidates
    evidence = list(candidates.evidence)
    found = person_odds(np.stack([candidates.crop(mask) for mask in masks.values()]))
    for k, shape_odds in zip(masks, found.tolist(), strict=True):
        evidence[k] = evidence[k]._replace(shape_odds=shape_odds)
    return replace(candidates, evidence=evidence)
