"""Sides of a person's joints, taken from the parts: a suit tells left from right, a network may not."""

import numpy as np

from annotate.array_types import UInt8
from annotate.parts import PART_ID
from eval.network.body_state import Bearing
from eval.scores.joints import JOINT

LIMBS = {
    "left_elbow": ("left_upper_arm", "left_forearm"),
    "left_wrist": ("left_forearm",),
    "left_knee": ("left_upper_leg", "left_lower_leg"),
    "left_ankle": ("left_lower_leg",),
}
"""Joints that lie in the parts of one side, and these."""
REACH_PX = 4
"""Pixels around a joint in which its parts are looked for: a wrist's thickness at 2 m. Chosen by eye."""


def sided(bearing: Bearing, parts: UInt8) -> Bearing:
    """The bearing, exchanged where more joints lie in parts (h, w) of the other side than of their own."""
    own = other = 0
    for joint, limbs in LIMBS.items():
        for side, twin in (("left", "right"), ("right", "left")):
            u, v = bearing.joints_px[JOINT[joint.replace("left", side)], :2].round().astype(np.int64)
            top, left = max(0, v - REACH_PX), max(0, u - REACH_PX)
            near = set(parts[top : max(0, v + REACH_PX), left : max(0, u + REACH_PX)].ravel().tolist())
            own += not near.isdisjoint(PART_ID[part.replace("left", side)] for part in limbs)
            other += not near.isdisjoint(PART_ID[part.replace("left", twin)] for part in limbs)
    return bearing.exchanged() if other > own else bearing
