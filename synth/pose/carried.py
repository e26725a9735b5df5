"""What standing people carry in their hands."""

import numpy as np

from annotate.array_types import Float64
from synth.body.skeleton import JOINT_ID, turn
from synth.pose.standing_parameters import SIDES, Standing
from synth.surface.furniture import Surface
from synth.surface.rasterize import Mesh, box


def carried(how: Standing, joints: Float64) -> list[Mesh]:
    """Boxes, trays and bags in the hands of somebody whose joints (J, 3) are there; world, metres."""
    wrists = {side: joints[JOINT_ID[f"{side}_wrist"]] for side in SIDES}
    across = wrists["left"] - wrists["right"]
    heading = turn(2, float(np.arctan2(across[1], across[0])))
    things = []
    for kind in ("box", "tray"):
        if how.hands["left"] == how.hands["right"] == kind:
            size = how.sizes_m[kind].copy()
            size[0] = np.clip(np.hypot(*across[:2]) + (-0.05 if kind == "box" else 0.12), 0.1, 0.6)
            middle = (wrists["left"] + wrists["right"]) / 2
            lift = size[2] / 2 + 0.03 if kind == "tray" else 0.0
            things.append(_block(size, middle + heading @ (0.0, -0.05 - size[1] / 2 + 0.06, lift), heading))
    for side in SIDES:
        if how.hands[side] == "bag":
            size = how.sizes_m["bag"]
            things.append(_block(size, wrists[side] - (0.0, 0.0, 0.12 + size[2] / 2), np.eye(3)))
    return things


def _block(size: Float64, centre: Float64, rotation: Float64) -> Mesh:
    half = tuple(size / 2)
    return box((-half[0], -half[1], -half[2]), half, Surface.TABLE).placed(rotation, centre)
