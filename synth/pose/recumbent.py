"""Lying in bed or fallen: supine, prone, on a side, curled up, half off the bed, on the floor."""

import numpy as np
from numpy.typing import NDArray

from synth.body.body import Body, pose
from synth.body.flesh import flesh_of
from synth.body.skeleton import JOINT_ID, Float64, Posture
from synth.pose.attitude import Attitude, both, mirrored, posture_of, pulls_of
from synth.pose.contact import height_to_rest, lift_needed
from synth.pose.moment import Family, Spread
from synth.pose.settle import settle
from synth.surface.furniture import FLOOR, Bed, Ground, Solid

HEAD_FROM_EDGE_M = 0.20
"""The head joint lies this far from the bed's upper end where ``along`` is 0: in the middle of the pillow."""
HEAVE = 0.03
"""An arm under a lying body lifts the body more readily than it yields."""

_BASE: dict[str, Spread] = {
    "heading": (0.0, 4.0),
    "pitch": (-90.0, 2.0),
    "roll": (0.0, 6.0),
    "off": (0.0, 0.12),
    "along": (0.05, 0.05),
    "bend": (4.0, 5.0),
    "lean": (0.0, 6.0),
    "twist": (0.0, 5.0),
    "nod": (14.0, 8.0),
    "turn": (0.0, 20.0),
    **both("hip", 4.0, 5.0),
    **both("spread", 9.0, 6.0),
    **both("hip_twist", 12.0, 10.0),
    **both("knee", 6.0, 6.0),
    **both("ankle", -20.0, 10.0),
    **both("arm", 4.0, 10.0),
    **both("arm_spread", 22.0, 10.0),
    **both("arm_twist", 0.0, 20.0),
    **both("elbow", 22.0, 14.0),
    **both("pronation", 0.0, 30.0),
    "head_sink": (0.5, 0.05),
    **both("leg_sink", 0.6, 0.1),
    **both("arm_sink", 0.6, 0.1),
}
"""A person on the back, arms beside the body."""

_LEFT: dict[str, Spread] = {
    "along": (0.10, 0.04),
    "roll": (88.0, 6.0),
    "bend": (14.0, 8.0),
    "nod": (10.0, 8.0),
    "turn": (0.0, 12.0),
    **both("hip", 42.0, 16.0),
    **both("knee", 58.0, 18.0),
    **both("spread", 2.0, 4.0),
    **both("hip_twist", 0.0, 6.0),
    "left_arm": (74.0, 16.0),
    "right_arm": (52.0, 16.0),
    "left_arm_spread": (-4.0, 4.0),
    "right_arm_spread": (12.0, 8.0),
    **both("elbow", 58.0, 22.0),
}
_FOETAL: dict[str, Spread] = {
    **_LEFT,
    "bend": (48.0, 9.0),
    "nod": (30.0, 8.0),
    **both("hip", 92.0, 9.0),
    **both("knee", 108.0, 10.0),
    "left_arm": (64.0, 10.0),
    "right_arm": (56.0, 10.0),
    **both("elbow", 104.0, 14.0),
}
_PRONE: dict[str, Spread] = {
    "roll": (180.0, 6.0),
    "nod": (-6.0, 5.0),
    "turn": (62.0, 8.0),
    "bend": (0.0, 4.0),
    **both("hip", 0.0, 4.0),
    **both("hip_twist", 4.0, 8.0),
    **both("ankle", -46.0, 4.0),
    **both("arm_spread", 34.0, 9.0),
    **both("arm", 0.0, 8.0),
}
_ARM_UNDER_HEAD: dict[str, Spread] = {
    "left_arm": (120.0, 12.0),
    "left_arm_spread": (30.0, 8.0),
    "left_arm_twist": (-40.0, 12.0),
    "left_elbow": (112.0, 12.0),
}
_KNEE_UP: dict[str, Spread] = {
    "left_hip": (48.0, 8.0),
    "left_knee": (88.0, 10.0),
    "left_spread": (6.0, 6.0),
    "left_hip_twist": (0.0, 6.0),
    "left_ankle": (-18.0, 6.0),
    "left_leg_sink": (0.0, 0.0),
}
_LEG_OVER_EDGE: dict[str, Spread] = {
    "off": (0.78, 0.08),
    "left_hip": (-8.0, 5.0),
    "left_spread": (34.0, 6.0),
    "left_knee": (72.0, 14.0),
    "left_arm": (-4.0, 8.0),
    "left_arm_spread": (48.0, 12.0),
    "left_elbow": (14.0, 10.0),
}
_RECOVERY: dict[str, Spread] = {
    **_LEFT,
    "along": (0.2, 0.04),
    "roll": (101.0, 5.0),
    "left_arm": (132.0, 10.0),
    "left_elbow": (70.0, 20.0),
    "left_hip": (10.0, 8.0),
    "left_knee": (16.0, 10.0),
    "right_hip": (74.0, 10.0),
    "right_knee": (84.0, 10.0),
}
_FALLEN_SIDE: dict[str, Spread] = {
    **_LEFT,
    "roll": (92.0, 7.0),
    "left_arm": (116.0, 18.0),
    "left_elbow": (30.0, 20.0),
    "right_arm": (50.0, 22.0),
    "left_hip": (22.0, 16.0),
    "right_hip": (58.0, 16.0),
    "heading": (0.0, 40.0),
    "nod": (0.0, 8.0),
}
_FALLEN_PRONE: dict[str, Spread] = {
    **_PRONE,
    "heading": (0.0, 40.0),
    "left_arm": (96.0, 24.0),
    "left_arm_spread": (60.0, 16.0),
    "left_elbow": (60.0, 22.0),
    "right_arm_spread": (40.0, 16.0),
    "left_spread": (24.0, 10.0),
    "left_knee": (34.0, 16.0),
    "left_hip": (24.0, 10.0),
}

IN_BED: dict[str, dict[str, Spread]] = {
    "supine": {},
    "supine_hands_on_belly": {
        **both("arm", 12.0, 6.0),
        **both("arm_spread", 16.0, 5.0),
        **both("arm_twist", -52.0, 10.0),
        **both("elbow", 84.0, 10.0),
    },
    "supine_arms_up": {
        "along": (0.24, 0.04),
        **both("arm", 128.0, 12.0),
        **both("arm_spread", 40.0, 8.0),
        **both("arm_twist", -30.0, 12.0),
        **both("elbow", 84.0, 18.0),
    },
    "supine_arm_under_head_left": _ARM_UNDER_HEAD,
    "supine_arm_under_head_right": mirrored(_ARM_UNDER_HEAD),
    "supine_spread": {
        **both("arm_spread", 72.0, 14.0),
        **both("spread", 24.0, 7.0),
        **both("elbow", 26.0, 18.0),
    },
    "supine_knee_up_left": _KNEE_UP,
    "supine_knee_up_right": mirrored(_KNEE_UP),
    "supine_knees_up": {**_KNEE_UP, **mirrored(_KNEE_UP)},
    "supine_legs_crossed": {
        "left_hip": (12.0, 4.0),
        "left_spread": (-10.0, 3.0),
        "right_spread": (-2.0, 3.0),
    },
    "lateral_left": _LEFT,
    "lateral_right": mirrored(_LEFT),
    "foetal_left": _FOETAL,
    "foetal_right": mirrored(_FOETAL),
    "recovery_left": _RECOVERY,
    "recovery_right": mirrored(_RECOVERY),
    "prone": _PRONE,
    "prone_arms_up": {
        **_PRONE,
        "along": (0.24, 0.04),
        **both("arm", 128.0, 10.0),
        **both("arm_spread", 44.0, 10.0),
        **both("elbow", 84.0, 16.0),
    },
    "prone_knee_drawn_up": {
        **_PRONE,
        "left_hip": (58.0, 12.0),
        "left_spread": (38.0, 6.0),
        "left_knee": (74.0, 14.0),
        "left_hip_twist": (20.0, 8.0),
    },
    "half_off_left": _LEG_OVER_EDGE,
    "half_off_right": mirrored(_LEG_OVER_EDGE),
    "across_bed": {
        "heading": (90.0, 10.0),
        "off": (0.72, 0.08),
        "along": (0.45, 0.12),
        **both("hip", 2.0, 5.0),
        **both("knee", 76.0, 12.0),
        **both("arm_spread", 45.0, 20.0),
    },
}
"""Recumbent scenes in bed (section 4.4 of the paper: supine, lateral and other positions)."""

FALLEN: dict[str, dict[str, Spread]] = {
    "fallen_supine": {
        "heading": (0.0, 40.0),
        "twist": (0.0, 12.0),
        "nod": (2.0, 8.0),
        **both("arm_spread", 58.0, 24.0),
        **both("elbow", 44.0, 26.0),
        **both("hip", 14.0, 10.0),
        **both("knee", 28.0, 18.0),
    },
    "fallen_left": _FALLEN_SIDE,
    "fallen_right": mirrored(_FALLEN_SIDE),
    "fallen_prone_left": _FALLEN_PRONE,
    "fallen_prone_right": mirrored(_FALLEN_PRONE),
}
"""Fallen on the floor."""

RECUMBENT: Family[Attitude] = Family(Attitude, _BASE, {**IN_BED, **FALLEN})


def lie(body: Body, support: Bed | Ground, moment: Attitude) -> tuple[NDArray[np.float32], Float64]:
    """Turn a moment into a lying body: vertices float32 (V, 3) and joints (J, 3), world, metres.

    The trunk rests on the support, sunk in by its give; limbs and head sink until something carries them.
    """
    _, vertices, joints = _laid(body, support, moment)
    up = lift_needed(vertices, _carriers(support))
    return vertices + np.array([0, 0, up], np.float32), joints + np.array([0, 0, up])


def lying_posture(body: Body, support: Bed | Ground, moment: Attitude) -> Posture:
    """The posture ``lie`` poses."""
    settled, vertices, _ = _laid(body, support, moment)
    up = lift_needed(vertices, _carriers(support))
    return Posture(settled.angles_rad, settled.pelvis_m + np.array([0, 0, up]))


def _carriers(support: Bed | Ground) -> list[Solid]:
    """Floor and mattress."""
    return [FLOOR, *support.solids()[:1]]


def _laid(
    body: Body, support: Bed | Ground, moment: Attitude
) -> tuple[Posture, NDArray[np.float32], Float64]:
    flesh, posture = flesh_of(body), posture_of(moment)
    vertices, joints = pose(body, posture)
    place = _place(support, moment, joints)
    place[2] = height_to_rest(vertices[flesh.trunk] + place.astype(np.float32), _carriers(support))
    solids = [FLOOR, *support.solids()]
    settled = settle(flesh, Posture(posture.angles_rad, place), solids, pulls_of(moment), HEAVE)
    return settled, *pose(body, settled)


def _place(support: Bed | Ground, moment: Attitude, joints: Float64) -> Float64:
    """Where the pelvis lies: the head on the pillow of a bed, its middle over the ground's origin."""
    half = support.length / 2 - HEAD_FROM_EDGE_M if isinstance(support, Bed) else 0.8
    aside = moment.off * (support.width / 2 if isinstance(support, Bed) else 0.5)
    spine = joints[JOINT_ID["head"]] - joints[JOINT_ID["pelvis"]]
    return np.array([aside, half - float(np.hypot(spine[0], spine[1])) - moment.along, 0.0])
