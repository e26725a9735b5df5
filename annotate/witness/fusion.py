"""Fusion of a depth network's part probabilities with the distances of points from a witness's limbs.

p(region | point) is proportional to q^trust times a likelihood of the distance d from the point to the
region's limb. Here q = (1 - doubt) p(part of the region | depth) + doubt / k, with k parts. The likelihood is
exp(bias) (1 + (max(d - radius, 0) / spread)^2)^-weight, Student's t with a flat middle. ``tools.fit.witness``
fits the numbers on simulated people with a witness that errs.
"""

import json
from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files

import numpy as np

from annotate.array_types import Float32, Float64
from annotate.scheme.regions import N_REGIONS, Region
from annotate.scheme.scheme import Scheme
from annotate.witness.limbs import distances
from annotate.witness.skeleton import HALF_THICK, JOINT, Skeleton

UNKNOWN = -1.5  # log likelihood of a limb with unknown joints: between its own points and others; untuned
HEAD_NEAR = 0.35  # trunks about a witness's head; untuned
HEAD_LEAST = 0.3  # mean probability of the head there, below which the witness is wrong; untuned
HEAD_PX = 5  # points of a head by depth; untuned
KINDS = tuple(dict.fromkeys(region.label.removeprefix("left_").removeprefix("right_") for region in Region))
KIND = np.array([KINDS.index(region.label.removeprefix("left_").removeprefix("right_")) for region in Region])
"""Kind of each region 1 to 24: its name without the side."""


@dataclass(frozen=True, eq=False)
class Spreads:
    """Parameters by ``KINDS``: radius and spread in trunks, weight and bias; trust: exponent of the depth
    network's probabilities; doubt: share of points at which any part is as likely.
    """

    radius: Float64
    spread: Float64
    weight: Float64
    bias: Float64
    trust: float
    doubt: float

    def log_likelihood(self, far: Float32, sd: Float32) -> Float32:
        """Return the log likelihood (n, 24) of distances (n, 24) with joints' uncertainty (24,), in trunks.

        A limb with unknown joints has the likelihood ``UNKNOWN``.
        """
        wide = np.hypot(self.spread[KIND], sd)
        off = np.maximum(far - self.radius[KIND], 0) / wide
        likely = self.bias[KIND] - self.weight[KIND] * np.log1p(off**2)
        return np.where(np.isfinite(likely), likely, UNKNOWN).astype(np.float32)


@cache
def shipped_spreads() -> Spreads:
    """Return the parameters that ship with the package."""
    fields = json.loads(files("annotate").joinpath("witness/spreads.json").read_text())
    radius, spread, weight, bias = (
        np.array([fields["kinds"][kind][name] for kind in KINDS], np.float64)
        for name in ("radius", "spread", "weight", "bias")
    )
    return Spreads(radius, spread, weight, bias, float(fields["trust"]), float(fields["doubt"]))


def fused(planes: Float32, own: Scheme, points_m: Float32, skeleton: Skeleton, spreads: Spreads) -> Float32:
    """Return probabilities (24, n) of the regions at points (n, 3), depth camera, metres.

    planes: probabilities (k, n) of the depth network's classes there, in the scheme ``own``.
    """
    likely = spreads.log_likelihood(*distances(points_m, skeleton))
    chance = doubted(depth_chance(planes, own), own, spreads.doubt)
    return _normalised(np.float32(spreads.trust) * np.log(chance) + likely.T)


def depth_chance(planes: Float32, own: Scheme) -> Float32:
    """Return the probability (24, n) of each region's part, from probabilities (k, n) by class."""
    return planes[own.class_table[own.table[1 : N_REGIONS + 1]]]


def doubted(chance: Float32, own: Scheme, doubt: float) -> Float32:
    """Return probabilities of parts mixed with the even distribution over the scheme's classes."""
    return np.asarray((1 - doubt) * chance + doubt / len(own.class_ids), np.float32)


def _normalised(score: Float32) -> Float32:
    share = np.exp(score - score.max(axis=0))
    return np.asarray(share / share.sum(axis=0), np.float32)


def in_scheme(regions: Float32, scheme: Scheme) -> Float32:
    """Return probabilities (k, n) of a scheme's classes from (24, n) of the regions."""
    sums = np.zeros((len(scheme.class_ids), regions.shape[1]), np.float32)
    for region, plane in enumerate(regions, start=1):
        sums[scheme.class_table[scheme.table[region]]] += plane
    return sums


def head_by_depth(skeleton: Skeleton, points_m: Float32, chance: Float32) -> Skeleton:
    """Return the skeleton with its head at the depth network's head, if the witness's head is elsewhere.

    Blurred faces displace the witness's head. points_m: (n, 3). chance: (n,), the depth network's probability
    of the head.
    """
    at = skeleton.joints_m[JOINT["head"]]
    near = np.linalg.norm(points_m - at, axis=1) < HEAD_NEAR * skeleton.trunk_m
    sure = chance > 0.5
    if (near.any() and chance[near].mean() > HEAD_LEAST) or sure.sum() < HEAD_PX:
        return skeleton
    surface = np.median(points_m[sure], axis=0).astype(np.float64)
    joints_m = skeleton.joints_m.copy()
    joints_m[JOINT["head"]] = surface * (1 + HALF_THICK["head"] * skeleton.trunk_m / np.linalg.norm(surface))
    return replace(skeleton, joints_m=joints_m)
