"""Hair, caps and hats: a head's skin lifted to a smooth shell, which long hair goes on down from."""

from typing import NamedTuple

import numpy as np

from annotate.array_types import Bool, Float32, UInt8
from synth.body.body import Body
from synth.body.skeleton import JOINT_ID
from synth.clothes.attire import Hair
from synth.clothes.cover import Fitting, ramp
from synth.clothes.skin_map import Limb
from synth.clothes.tube import slack_m

BROW = 0.55
"""Hair begins at this share of the way from the head's joint to its top."""
HALF_BACK_M = 0.13
"""Hair falls on the back no farther to the side than this."""
EARS_MM = 8.0
"""Thinner hair lets the ears stand out; that twice as thick covers them."""
FALL_GIVE = 0.25
"""Hair that falls draws in by this much a metre."""
BUN_RAD = 0.45
"""Half the angle over which a bun stands out from the head's middle."""
PEAK_RAD, PEAK_HALF_M = 1.1, 0.008
"""How far round the brow a cap's peak goes, and half its height where it begins."""


class _Head(NamedTuple):
    """Places of vertices (V,) about the middle of the skull at rest.

    skull: those of the head above its joint. off_m: (V, 3) from the middle; away_m: its length. around_rad:
    0 in front, a quarter turn on the left. brow_m: height at which hair begins.
    """

    skull: Bool
    off_m: Float32
    away_m: Float32
    around_rad: Float32
    brow_m: float


def _head(body: Body, limb: UInt8) -> _Head:
    points, joint = body.vertices_m, body.joints_m[JOINT_ID["head"]].astype(np.float32)
    top = points[:, 2].max()
    skull = (limb == Limb.HEAD) & (points[:, 2] > joint[2])
    depth = points[skull, 1]
    middle = [0, (depth.min() + depth.max()) / 2 + 0.01, joint[2] + 0.45 * (top - joint[2])]
    off = points - np.array(middle, np.float32)
    away = np.linalg.norm(off, axis=1)
    around = np.arctan2(off[:, 0], -off[:, 1])
    return _Head(skull, off, away, around, float(joint[2] + BROW * (top - joint[2])))


def put_on_hair(fitting: Fitting, hair: Hair) -> None:
    """Lift the head's skin where hair or a hat is; lay long hair on nape and back."""
    places, z = fitting.places, fitting.body.vertices_m[:, 2]
    head = _head(fitting.body, places.limb)
    above = np.where(head.skull, np.clip((z - np.float32(head.brow_m)) / np.float32(0.012), 0, 1), 0)
    falls = ramp(np.abs(head.around_rad), 1.3, 1.7) * ramp(places.level, hair.fall - 0.03, hair.fall + 0.02)
    on_back = (places.limb == Limb.TRUNK) & (np.abs(fitting.body.vertices_m[:, 0]) < HALF_BACK_M)
    own = (places.limb == Limb.HEAD) | on_back
    mask = np.where(own, np.maximum(above, falls), 0).astype(np.float32)
    fitting.dark[mask > 0.5] = hair.dark
    out = np.asarray(head.off_m / np.maximum(head.away_m, 0.02)[:, None], np.float32)
    over_ears = np.float32(np.clip((hair.lift_mm - EARS_MM) / EARS_MM, 0, 1))
    shell = slack_m(-out[:, 2] * np.float32(0.1), head.around_rad, head.away_m, head.skull, 9.0)
    fitting.let_hang(over_ears * np.where(head.skull, mask, 0), shell, out)
    _fall(fitting, head, mask)
    # It gets thinner towards its ends.
    thins = np.where(head.skull, 1, ramp(places.level, hair.fall - 0.03, hair.fall + 0.15))
    lift = (mask * thins * np.float32(hair.lift_mm / 1000)).astype(np.float32)
    fitting.hang_m[:] += lift[:, None] * np.where(head.skull[:, None], out, fitting.normals)
    if hair.bulge_mm:
        _bun(fitting, head, out, hair.bulge_mm)
    if hair.peak_mm:
        _peak(fitting, head, hair.peak_mm)


def _fall(fitting: Fitting, head: _Head, mask: Float32) -> None:
    """Let hair below the skull's middle hang from its widest place, where the mask (V,) is 1."""
    low = head.off_m[:, 2] < 0
    flat = np.hypot(head.off_m[:, 0], head.off_m[:, 1])
    level = np.asarray(head.off_m * (1, 1, 0) / np.maximum(flat, 0.02)[:, None], np.float32)
    slack = slack_m(-head.off_m[:, 2].copy(), head.around_rad, flat, (mask > 0) & low, FALL_GIVE)
    fitting.let_hang(np.where(low, mask, 0), slack, level)


def _bun(fitting: Fitting, head: _Head, out: Float32, bulge_mm: float) -> None:
    """A half sphere that stands off the back of the head, as high as the folds' noise has it."""
    tilt = 0.2 + 0.3 * fitting.folds[0]
    place = np.array([0, np.cos(tilt), np.sin(tilt)], np.float32)
    angle = np.arccos(np.clip(out @ place, -1, 1))
    height = np.sqrt(np.clip(1 - (angle / BUN_RAD) ** 2, 0, 1)) * np.float32(bulge_mm / 1000)
    fitting.hang_m[:] += np.where(head.skull, height, 0)[:, None] * place


def _peak(fitting: Fitting, head: _Head, peak_mm: float) -> None:
    """A shelf before the brow."""
    off = np.abs(fitting.body.vertices_m[:, 2] - np.float32(head.brow_m)) / np.float32(PEAK_HALF_M)
    round_the_brow = np.cos(np.clip(head.around_rad * (np.pi / 2 / PEAK_RAD), -np.pi / 2, np.pi / 2))
    reach = np.where(head.skull, np.clip(1.5 - off, 0, 1) * np.sqrt(np.maximum(round_the_brow, 0)), 0)
    ahead = np.array([0, -1, -0.2], np.float32)
    fitting.hang_m[:] += (reach * np.float32(peak_mm / 1000)).astype(np.float32)[:, None] * ahead
