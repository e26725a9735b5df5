"""Regions of a body's faces (``annotate.scheme.regions``): each of the paper's parts divided by planes.

Borders between the paper's parts cut faces exactly (`part_border`); borders within a part follow the edges of
the mesh, so that bodies and their images stay the same.
"""

from collections.abc import Iterator
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from annotate.array_types import Bool, Float64, UInt8
from annotate.parts import PAPER
from annotate.scheme.regions import Region
from synth.body.body import Body
from synth.body.skeleton import JOINT_ID

Points = Float64

# Borders of the head, foot and shoulder, as slopes; untuned, judged on pictures of all bodies.
_JAW = 0.55  # share of the way from the neck to the head joint at which the head begins
_JAW_SLOPE = 0.25  # rise of the border of head and neck from the chin backwards, metres a metre
_INSTEP_SLOPE = 0.5  # tilt of the ankle's border towards the toes
_SHOULDER_SLOPE = 0.7  # inward lean of the shoulder's border from the armpit up to the neck
_COLLAR = (
    0.45  # share of the way from the clavicle's inner end to the shoulder joint at which the shoulder begins
)
_RIBS = 0.2  # share of the way from the upper spine joint to the neck at which the chest begins
_NAVEL = 0.5  # share of the way from the middle to the upper spine joint at which the lower belly ends
# Shares of the length of hand and foot, wrist to fingertips and heel to toes, before fingers and toes.
_PALM, _SOLE = 0.56, 0.73


class _Division(NamedTuple):
    """Division of the paper's part that holds ``within``: faces flagged in ``beyond`` (F,) belong to
    ``region``.
    """

    within: Region
    region: Region
    beyond: Bool


def regions_of_faces(face_parts: UInt8, points_m: Points, joints_m: Float64) -> UInt8:
    """Return the region id (F,) of each face of a body or its clothes at rest.

    face_parts: (F,) the paper's part ids. points_m: (F, 3) middles of the faces. joints_m: (J, 3). All at
    rest, body frame.
    """
    regions = _WHOLE[face_parts]
    for division in _divisions(face_parts, points_m, joints_m):
        regions[(face_parts == PAPER.table[division.within]) & division.beyond] = division.region
    return regions


def _divisions(parts: UInt8, points: Points, joints_m: Float64) -> Iterator[_Division]:
    at = {name: joints_m[i] for name, i in JOINT_ID.items()}
    x, _, z = points.T
    jaw = at["neck"] + _JAW * (at["head"] - at["neck"])
    yield _Division(Region.HEAD, Region.NECK, ~_beyond(points, jaw, (0.0, -_JAW_SLOPE, 1.0)))
    middle, upper, top = (at[name][2] for name in ("spine_middle", "spine_upper", "neck"))
    yield _Division(Region.CHEST, Region.BELLY, z < upper + _RIBS * (top - upper))
    yield _Division(Region.CHEST, Region.LOWER_BELLY, z < middle + _NAVEL * (upper - middle))
    for side, sign in (("left", 1), ("right", -1)):
        clavicle, shoulder = at[f"{side}_clavicle"], at[f"{side}_shoulder"]
        collar = clavicle + _COLLAR * (shoulder - clavicle)
        yield _Division(
            Region.CHEST,
            Region.on(side, "shoulder"),
            _beyond(points, collar, (sign, 0.0, _SHOULDER_SLOPE)) & (sign * x > 0),
        )
        wrist, along = at[f"{side}_wrist"], at[f"{side}_wrist"] - at[f"{side}_elbow"]
        forearm, shank = Region.on(side, "forearm"), Region.on(side, "lower_leg")
        hand = _beyond(points, wrist, along)
        yield _Division(forearm, Region.on(side, "hand"), hand)
        own = hand & (parts == PAPER.table[forearm])
        yield _Division(forearm, Region.on(side, "fingers"), _end(points, own, along, _PALM))
        ankle, forwards = at[f"{side}_ankle"], np.array([0.0, -1.0, 0.0])
        foot = _beyond(points, ankle, (0.0, -_INSTEP_SLOPE, -1.0))
        yield _Division(shank, Region.on(side, "foot"), foot)
        own = foot & (parts == PAPER.table[shank])
        yield _Division(shank, Region.on(side, "toes"), _end(points, own, forwards, _SOLE))


def _beyond(points: Points, border_m: Float64, normal: Float64 | tuple[float, float, float]) -> Bool:
    return np.asarray((points - border_m) @ np.asarray(normal, np.float64) > 0)


def _end(points: Points, own: Bool, along: Float64, share: float) -> Bool:
    """Return flags (F,) of those ``own`` faces that lie beyond a share of their extent along a direction."""
    if not own.any():
        return own
    place = points @ along
    first, last = place[own].min(), place[own].max()
    return np.asarray(own & (place > first + share * (last - first)))


_WHOLE = np.zeros(256, np.uint8)
for _part in PAPER.parts:
    _WHOLE[_part.id] = min(_part.regions)


@lru_cache(maxsize=64)
def face_regions(body: Body) -> UInt8:
    """Return the region id (F,) of each face of a body."""
    middles = body.vertices_m[body.faces].mean(axis=1, dtype=np.float64)
    return regions_of_faces(body.face_parts, middles, body.joints_m)
