"""Shoes: thickened feet without toes, on soles."""

import numpy as np

from annotate.array_types import Float32, Int64
from synth.body.skeleton import JOINT_ID
from synth.clothes.attire import Shoes
from synth.clothes.skin_map import LEGS
from synth.clothes.tops_trousers import Fitting, between, ramp
from synth.clothes.tube import slack_m

AXIS_M = 0.03  # height of a foot's axis
ANKLE_M = (0.05, 0.085)  # heights between foot and shank
SOLE_EDGE_M = (0.012, 0.035)  # top of the sole, and of skin that moves down with it
GIVE = 1.5  # narrowing towards the toes, metres a metre: follows the instep
TOES = 2  # spanned sectors, to hide gaps between toes


def put_on_shoes(fitting: Fitting, shoes: Shoes) -> None:
    """Add shoes to the fitting: over the feet, and over the lower legs up to the shaft's end."""
    legs = np.isin(fitting.places.limb, LEGS)
    shaft = np.where(legs, between(fitting.places.along, shoes.shaft, 9), 0).astype(np.float32)
    for side in ("left", "right"):
        own = np.flatnonzero(fitting.body.strongest_joints == JOINT_ID[f"{side}_ankle"])
        shaft[own] = 0
        fitting.dark[own] = shoes.dark
        _foot(fitting, own, fitting.body.joints_m[JOINT_ID[f"{side}_ankle"]].astype(np.float32), shoes)
    fitting.lay(shaft, shoes.shaft_mm, 1.0, shoes.dark)


def _foot(fitting: Fitting, own: Int64, ankle: Float32, shoes: Shoes) -> None:
    points = fitting.body.vertices_m[own]
    ahead = points.mean(axis=0) - ankle
    ahead[2] = 0
    ahead /= np.linalg.norm(ahead)
    off = points - ankle
    along = off @ ahead
    across, up = off[:, 0] - along * ahead[0], points[:, 2] - np.float32(AXIS_M)
    away = np.hypot(across, up)
    slack = slack_m((along, np.arctan2(across, up), away), np.ones(len(own), bool), GIVE, TOES)
    # Cloth stands off the shank above the ankle, off the foot below.
    high = ramp(points[:, 2], *ANKLE_M)
    thick = (1 - high) * (slack + np.float32(shoes.upper_mm / 1000))
    fitting.hang_m[own] += (high * np.float32(shoes.shaft_mm / 1000))[:, None] * fitting.normals[own]
    near = np.maximum(away, np.float32(0.01))
    fitting.hang_m[own] += thick[:, None] * np.stack([across / near, np.zeros_like(up), up / near], axis=1)
    end = np.abs(along - along.mean()) / (np.ptp(along) / 2)
    reach = np.sign(along - along.mean()) * np.clip(10 * end - 9, 0, 1) * np.float32(shoes.upper_mm / 1000)
    fitting.hang_m[own] += reach[:, None] * ahead
    _sole(fitting, own, np.float32(shoes.sole_mm / 1000))


def _sole(fitting: Fitting, own: Int64, sole: np.float32) -> None:
    z = fitting.body.vertices_m[own, 2]
    low, high = SOLE_EDGE_M
    share = np.clip((np.float32(high) - z) / np.float32(high - low), 0, 1)
    lowered = z + fitting.hang_m[own, 2] - share * sole
    fitting.hang_m[own, 2] = np.where(share >= 1, -sole, np.maximum(lowered, -sole)) - z
