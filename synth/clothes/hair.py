"""Hair, caps and hats: a head's skin lifted to a smooth shell, which long hair goes on down from."""

import numpy as np

from annotate.array_types import Float32
from synth.body.skeleton import JOINT_ID
from synth.clothes.attire import Hair
from synth.clothes.cover import Fitting, ramp
from synth.clothes.skin_map import Limb
from synth.clothes.tube import slack_m

BROW = 0.55
"""Hair begins at this share of the way from the head's joint to its top."""
EARS_MM = 8.0
"""Thinner hair lets the ears stand out; that twice as thick covers them."""
FALL_GIVE = 0.25
"""Hair that falls draws in by this much a metre."""
BUN_RAD = 0.45
"""Half the angle over which a bun stands out from the head's middle."""


def put_on_hair(fitting: Fitting, hair: Hair) -> None:
    """Lift the head's skin where hair or a hat is; lay long hair on nape and back."""
    places, points = fitting.places, fitting.body.vertices_m
    joint = fitting.body.joints_m[JOINT_ID["head"]].astype(np.float32)
    top = points[:, 2].max()
    skull = (places.limb == Limb.HEAD) & (points[:, 2] > joint[2])
    box = points[skull]
    middle = np.array([0, (box[:, 1].min() + box[:, 1].max()) / 2 + 0.01, joint[2] + 0.45 * (top - joint[2])])
    off = points - middle.astype(np.float32)
    away = np.linalg.norm(off, axis=1)
    around = np.arctan2(off[:, 0], -off[:, 1])
    brow = joint[2] + np.float32(BROW) * (top - joint[2])
    above = np.clip((points[:, 2] - brow) / np.float32(0.012), 0, 1)
    behind = ramp(np.abs(around), 1.3, 1.7)
    falls = behind * ramp(places.level, hair.fall - 0.03, hair.fall + 0.02)
    own = (places.limb == Limb.HEAD) | ((places.limb == Limb.TRUNK) & (np.abs(points[:, 0]) < 0.13))
    mask = np.where(own, np.maximum(np.where(skull, above, 0), falls), 0).astype(np.float32)
    fitting.dark[mask > 0.5] = hair.dark
    flat = np.hypot(off[:, 0], off[:, 1])
    out = off / np.maximum(away, np.float32(0.02))[:, None]
    level = np.stack([off[:, 0], off[:, 1], np.zeros_like(flat)], axis=1)
    level /= np.maximum(flat, np.float32(0.02))[:, None]
    shell = slack_m(-out[:, 2] * np.float32(0.1), around, away, skull, 9.0)
    over_ears = np.clip((hair.lift_mm - EARS_MM) / EARS_MM, 0, 1)
    fitting.let_hang(over_ears * mask * np.where(skull, above + behind, 0).clip(0, 1), shell, out)
    fall = slack_m(-points[:, 2], around, flat, own & (mask > 0) & (points[:, 2] < middle[2]), FALL_GIVE)
    fitting.let_hang(np.where(points[:, 2] < middle[2], mask, 0), fall, level)
    fitting.hang_m[:] += (mask * np.float32(hair.lift_mm / 1000))[:, None] * np.where(
        skull[:, None], out, fitting.normals
    )
    _bulges(fitting, hair, out, np.where(skull, np.float32(1), 0), brow, around)


def _bulges(fitting: Fitting, hair: Hair, out: Float32, skull: Float32, brow: float, around: Float32) -> None:
    """A bun behind, or a cap's peak before the brow."""
    if hair.bulge_mm:
        tilt = 0.2 + fitting.folds[0] * 0.3
        place = np.array([0, np.cos(tilt), np.sin(tilt)], np.float32)
        angle = np.arccos(np.clip(out @ place, -1, 1))
        height = skull * np.sqrt(np.clip(1 - (angle / BUN_RAD) ** 2, 0, 1)) * np.float32(hair.bulge_mm / 1000)
        fitting.hang_m[:] += height[:, None] * place
    if hair.peak_mm:
        band = np.clip(1.5 - np.abs(fitting.body.vertices_m[:, 2] - brow) / np.float32(0.008), 0, 1)
        front = skull * band * np.sqrt(np.clip(np.cos(1.4 * around), 0, 1)) * (np.abs(around) < 1.1)
        fitting.hang_m[:] += (front * np.float32(hair.peak_mm / 1000))[:, None] * np.array(
            [0, -1, -0.2], np.float32
        )
