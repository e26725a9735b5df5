"""Hair, caps and hats: the head's skin is displaced to a smooth shell; long hair hangs below."""

from typing import NamedTuple

import numpy as np

from annotate.array_types import Bool, Float32, Int64, UInt8
from synth.body.body import Body
from synth.body.skeleton import JOINT_ID
from synth.clothes.attire import Hair
from synth.clothes.skin_map import Limb
from synth.clothes.tops_trousers import SLACK_LIMIT_M, Fitting, ramp
from synth.clothes.tube import slack_m

BROW = 0.55  # hairline: share of the way from the head's joint to its top
HALF_BACK_M = 0.13  # half width of hair on the back
EARS_MM = 8.0  # thickness of hair with visible ears; twice that covers them
FALL_GIVE = 0.25  # narrowing of falling hair, metres a metre
BUN_RAD = 0.45  # half the angle of a bun
PEAK_RAD, PEAK_HALF_M = 1.1, 0.008  # half angle and half thickness of a cap's peak


class _Head(NamedTuple):
    """Vertices ``own`` (n,) of head, neck and upper back, relative to the centre of the skull at rest.

    skull: centre, relative to the head's joint. off_m: (n, 3), offset with direction ``out`` and length
    ``away_m``. around_rad: 0 in front, a quarter turn on the left. over_brow_m: height above the hairline.
    """

    own: Int64
    skull: Bool
    off_m: Float32
    out: Float32
    away_m: Float32
    around_rad: Float32
    over_brow_m: Float32


def _head(body: Body, limb: UInt8) -> _Head:
    on_back = (limb == Limb.TRUNK) & (np.abs(body.vertices_m[:, 0]) < HALF_BACK_M)
    own = np.flatnonzero((limb == Limb.HEAD) | on_back)
    points, joint = body.vertices_m[own], body.joints_m[JOINT_ID["head"]].astype(np.float32)
    top = points[:, 2].max()
    skull = (limb[own] == Limb.HEAD) & (points[:, 2] > joint[2])
    depth = points[skull, 1]
    middle = [0, (depth.min() + depth.max()) / 2 + 0.01, joint[2] + 0.45 * (top - joint[2])]
    off = points - np.array(middle, np.float32)
    away = np.linalg.norm(off, axis=1)
    out = off / np.maximum(away, np.float32(0.02))[:, None]
    over_brow = points[:, 2] - (joint[2] + np.float32(BROW) * (top - joint[2]))
    return _Head(own, skull, off, out, away, np.arctan2(off[:, 0], -off[:, 1]), over_brow)


def put_on_hair(fitting: Fitting, hair: Hair) -> None:
    """Add the displacements of hair, a cap or a hat to the fitting, with long hair on nape and back."""
    head = _head(fitting.body, fitting.places.limb)
    level = fitting.places.level[head.own]
    above = np.where(head.skull, np.clip(head.over_brow_m / np.float32(0.012), 0, 1), 0)
    falls = ramp(np.abs(head.around_rad), 1.3, 1.7) * ramp(level, hair.fall - 0.03, hair.fall + 0.02)
    mask = np.maximum(above, falls).astype(np.float32)
    fitting.dark[head.own[mask > 0.5]] = hair.dark
    over_ears = np.float32(np.clip((hair.lift_mm - EARS_MM) / EARS_MM, 0, 1))
    shell = slack_m((-head.out[:, 2] * np.float32(0.1), head.around_rad, head.away_m), head.skull, 9.0)
    thins = np.where(head.skull, 1, ramp(level, hair.fall - 0.03, hair.fall + 0.15))
    outwards = np.where(head.skull[:, None], head.out, fitting.normals[head.own])
    moved = _moved(over_ears * np.where(head.skull, mask, 0) * shell, head.out)
    moved += _moved(mask * thins * (hair.lift_mm / 1000), outwards) + _fall(head, mask)
    if hair.bulge_mm:
        moved += _bun(head, hair.bulge_mm / 1000, 0.2 + 0.3 * float(fitting.folds[0]))
    if hair.peak_mm:
        moved += _peak(head, hair.peak_mm / 1000)
    fitting.hang_m[head.own] += moved


def _moved(by_m: Float32, direction: Float32) -> Float32:
    return np.asarray(by_m[:, None] * direction, np.float32)


def _fall(head: _Head, mask: Float32) -> Float32:
    """Return displacements (n, 3) of hair that hangs from the widest part of the skull."""
    low = head.off_m[:, 2] < 0
    flat = np.hypot(head.off_m[:, 0], head.off_m[:, 1])
    slack = slack_m((-head.off_m[:, 2], head.around_rad, flat), (mask > 0) & low, FALL_GIVE)
    flattened = head.off_m * np.array([1, 1, 0], np.float32)
    level = np.asarray(flattened / np.maximum(flat, 0.02)[:, None], np.float32)
    return _moved(np.where(low, mask * np.minimum(slack, SLACK_LIMIT_M), 0), level)


def _bun(head: _Head, bulge_m: float, tilt_rad: float) -> Float32:
    """Return displacements (n, 3) of a half sphere at the back of the head, raised by ``tilt_rad``."""
    place = np.array([0, np.cos(tilt_rad), np.sin(tilt_rad)], np.float32)
    angle = np.arccos(np.clip(head.out @ place, -1, 1))
    height = bulge_m * np.sqrt(np.clip(1 - (angle / BUN_RAD) ** 2, 0, 1))
    return _moved(np.where(head.skull, height, 0), place)


def _peak(head: _Head, peak_m: float) -> Float32:
    round_the_brow = np.cos(np.clip(head.around_rad * (np.pi / 2 / PEAK_RAD), -np.pi / 2, np.pi / 2))
    band = np.clip(1.5 - np.abs(head.over_brow_m) / PEAK_HALF_M, 0, 1)
    reach = np.where(head.skull, peak_m * band * np.sqrt(np.maximum(round_the_brow, 0)), 0)
    return _moved(reach, np.array([0, -1, -0.2], np.float32))
