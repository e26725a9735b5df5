"""Limbs of a skeleton: a segment for each region of the body, and distances of points from them."""

from typing import NamedTuple

import numpy as np

from annotate.array_types import Float32, Float64
from annotate.scheme.regions import N_REGIONS, Region
from annotate.witness.skeleton import JOINT, SIDES, Skeleton

ALONG = 0.5  # weight of a distance along the line of sight: depth of joints is less sure than their place


class Segment(NamedTuple):
    """Segment of a region: from a share ``start`` to a share ``end`` of the line between two joints.

    A pair of joints stands for the point at ``share`` between them.
    """

    a: tuple[str, str, float]
    b: tuple[str, str, float]
    start: float = 0.0
    end: float = 1.0


def _at(name: str) -> tuple[str, str, float]:
    return name, name, 0.0


def _across(share: float, width: float) -> Segment:
    """Return the segment across the trunk at a share of the way from the neck to the pelvis."""
    left, right = ((f"{side}_shoulder", f"{side}_hip", share) for side in SIDES)
    return Segment(left, right, 0.5 - width / 2, 0.5 + width / 2)


def _segments() -> dict[Region, Segment]:
    found = {
        Region.HEAD: Segment(_at("neck"), _at("head"), 0.7, 1.3),
        Region.NECK: Segment(_at("neck"), _at("head"), 0.1, 0.5),
        Region.CHEST: _across(0.2, 0.6),
        Region.BELLY: _across(0.5, 0.6),
        Region.LOWER_BELLY: _across(0.75, 0.7),
        Region.HIP: _across(1.0, 1.0),
    }
    for side in SIDES:
        ankle, toes = _at(f"{side}_ankle"), _at(f"{side}_toes")
        wrist, hand = _at(f"{side}_wrist"), _at(f"{side}_hand")
        shoulder, elbow = _at(f"{side}_shoulder"), _at(f"{side}_elbow")
        own = {
            "SHOULDER": Segment(_at("neck"), shoulder, 0.3, 0.9),
            "UPPER_ARM": Segment(shoulder, elbow),
            "FOREARM": Segment(elbow, wrist),
            "HAND": Segment(wrist, hand, 0.0, 0.9),
            "FINGERS": Segment(wrist, hand, 1.0, 1.8),
            "UPPER_LEG": Segment(_at(f"{side}_hip"), _at(f"{side}_knee")),
            "LOWER_LEG": Segment(_at(f"{side}_knee"), ankle),
            "FOOT": Segment(ankle, toes, 0.0, 0.8),
            "TOES": Segment(ankle, toes, 0.95, 1.15),
        }
        found |= {Region[f"{side.upper()}_{name}"]: segment for name, segment in own.items()}
    return found


SEGMENTS = tuple(segment for _, segment in sorted(_segments().items()))
"""Segments of the regions 1 to 24."""


def distances(points_m: Float32, skeleton: Skeleton) -> tuple[Float32, Float32]:
    """Return the distance (n, 24) of points (n, 3) from each region's segment, and the uncertainty (24,) of
    its joints, both in trunks. Unknown segments are NaN.
    """
    points = points_m.astype(np.float64)
    rays = points / np.linalg.norm(points, axis=1, keepdims=True)
    far, sd = np.zeros((len(points), N_REGIONS), np.float32), np.zeros(N_REGIONS, np.float32)
    for k, segment in enumerate(SEGMENTS):
        (start, start_sd), (end, end_sd) = (_place(one, skeleton) for one in (segment.a, segment.b))
        a, b = (start + share * (end - start) for share in (segment.start, segment.end))
        bone = b - a
        share = np.clip((points - a) @ bone / max(float(bone @ bone), 1e-9), 0, 1)
        off = points - (a + share[:, None] * bone)
        along = np.einsum("ij,ij->i", off, rays)
        square = np.einsum("ij,ij->i", off, off) - (1 - ALONG**2) * along**2
        far[:, k] = np.sqrt(np.maximum(square, 0)) / skeleton.trunk_m
        sd[k] = (start_sd + end_sd) / 2
    return far, sd


def _place(end: tuple[str, str, float], skeleton: Skeleton) -> tuple[Float64, float]:
    first, second, share = JOINT[end[0]], JOINT[end[1]], end[2]
    place = (1 - share) * skeleton.joints_m[first] + share * skeleton.joints_m[second]
    return place, float((1 - share) * skeleton.sd[first] + share * skeleton.sd[second])
