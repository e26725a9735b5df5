"""Crouching, kneeling, getting up and standing: unusual poses on the floor, or in front of a seat."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from synth.body.body import Body, pose
from synth.body.flesh import flesh_of
from synth.body.skeleton import Float64, Posture
from synth.pose.attitude import Attitude, both, mirrored, posture_of, pulls_of
from synth.pose.contact import height_to_rest
from synth.pose.moment import Family, Spread
from synth.pose.settle import settle
from synth.surface.furniture import FLOOR, Chair, Sofa

SEAT_GAP_M = 0.02
"""Legs in front of a seat keep this far from it."""

_BASE: dict[str, Spread] = {
    "heading": (0.0, 10.0),
    "pitch": (2.0, 3.0),
    "roll": (0.0, 0.0),
    "off": (0.0, 0.1),
    "along": (0.05, 0.05),
    "bend": (6.0, 6.0),
    "lean": (0.0, 5.0),
    "twist": (0.0, 8.0),
    "nod": (6.0, 10.0),
    "turn": (0.0, 20.0),
    **both("hip", 4.0, 4.0),
    **both("spread", 6.0, 4.0),
    **both("hip_twist", 6.0, 6.0),
    **both("knee", 6.0, 4.0),
    **both("ankle", 0.0, 0.0),
    **both("arm", 8.0, 10.0),
    **both("arm_spread", 14.0, 6.0),
    **both("arm_twist", 0.0, 14.0),
    **both("elbow", 22.0, 12.0),
    **both("pronation", 0.0, 30.0),
    "head_sink": (0.0, 0.0),
    **both("leg_sink", 0.0, 0.0),
    **both("arm_sink", 0.0, 0.0),
}
"""A person who just stands. ``ankle`` counts from the sole level on the floor."""

_HALF_KNEEL: dict[str, Spread] = {
    "pitch": (4.0, 4.0),
    "left_hip": (88.0, 6.0),
    "left_knee": (92.0, 6.0),
    "right_hip": (-4.0, 5.0),
    "right_knee": (92.0, 6.0),
    "right_ankle": (-72.0, 8.0),
    "right_leg_sink": (0.5, 0.05),
    "left_leg_sink": (0.5, 0.05),
}
_ALL_FOURS: dict[str, Spread] = {
    "pitch": (76.0, 6.0),
    "bend": (6.0, 8.0),
    "nod": (-18.0, 10.0),
    **both("hip", 82.0, 8.0),
    **both("knee", 90.0, 8.0),
    **both("ankle", -136.0, 6.0),
    **both("arm", 84.0, 8.0),
    **both("arm_spread", 6.0, 5.0),
    **both("elbow", 10.0, 6.0),
    **both("leg_sink", 0.5, 0.05),
    **both("arm_sink", 0.5, 0.05),
}

UPRIGHT: Family[Attitude] = Family(
    Attitude,
    _BASE,
    {
        "standing": {},
        "stooping": {
            "pitch": (38.0, 12.0),
            "bend": (40.0, 12.0),
            **both("hip", 40.0, 12.0),
            **both("knee", 16.0, 8.0),
            **both("arm", 70.0, 16.0),
        },
        "crouching": {
            "pitch": (36.0, 7.0),
            "bend": (36.0, 10.0),
            **both("hip", 112.0, 6.0),
            **both("spread", 14.0, 6.0),
            **both("knee", 115.0, 6.0),
            **both("arm", 66.0, 14.0),
            **both("elbow", 50.0, 22.0),
        },
        "cowering": {
            "pitch": (34.0, 6.0),
            "bend": (52.0, 10.0),
            "nod": (30.0, 8.0),
            **both("hip", 106.0, 5.0),
            **both("knee", 116.0, 5.0),
            **both("arm", 62.0, 8.0),
            **both("arm_twist", -40.0, 10.0),
            **both("elbow", 110.0, 12.0),
        },
        "kneeling": {
            "pitch": (2.0, 5.0),
            **both("hip", 2.0, 5.0),
            **both("knee", 92.0, 5.0),
            **both("ankle", -140.0, 6.0),
            **both("leg_sink", 0.5, 0.05),
        },
        "kneeling_on_heels": {
            "pitch": (10.0, 5.0),
            "bend": (14.0, 8.0),
            **both("hip", 74.0, 8.0),
            **both("knee", 134.0, 5.0),
            **both("ankle", -130.0, 6.0),
            **both("arm", 30.0, 10.0),
            **both("elbow", 40.0, 14.0),
            **both("leg_sink", 0.5, 0.05),
        },
        "half_kneeling_left": _HALF_KNEEL,
        "half_kneeling_right": mirrored(_HALF_KNEEL),
        "all_fours": _ALL_FOURS,
        "getting_up": {
            "pitch": (40.0, 8.0),
            "bend": (26.0, 8.0),
            "nod": (-10.0, 10.0),
            **both("hip", 92.0, 12.0),
            **both("knee", 80.0, 14.0),
            **both("arm", 62.0, 14.0),
            **both("elbow", 26.0, 12.0),
        },
        "half_risen": {
            "pitch": (28.0, 8.0),
            "bend": (20.0, 8.0),
            **both("hip", 52.0, 10.0),
            **both("knee", 46.0, 10.0),
            **both("arm", 34.0, 14.0),
        },
        "getting_up_from_floor": {
            **_HALF_KNEEL,
            "pitch": (24.0, 8.0),
            "bend": (24.0, 8.0),
            "left_arm": (66.0, 8.0),
        },
    },
)
"""Poses on one's own legs. Getting up glides from one of them to the next, up to standing."""


def rise(body: Body, seat: Sofa | Chair | None, moment: Attitude) -> tuple[NDArray[np.float32], Float64]:
    """Turn a moment into a body on the floor: vertices float32 (V, 3) and joints (J, 3), world, metres.

    The lowest skin stands on the floor; with a seat behind, the legs keep before its front edge (y = 0).
    """
    _, vertices, joints, shift = _placed(body, seat, moment)
    return vertices + shift.astype(np.float32), joints + shift


def upright_posture(body: Body, seat: Sofa | Chair | None, moment: Attitude) -> Posture:
    """The posture ``rise`` poses."""
    settled, _, _, shift = _placed(body, seat, moment)
    return Posture(settled.angles_rad, settled.pelvis_m + shift)


def _placed(
    body: Body, seat: Sofa | Chair | None, moment: Attitude
) -> tuple[Posture, NDArray[np.float32], Float64, Float64]:
    """The settled posture, its vertices and joints, and the shift (3,) that brings them before the seat."""
    flesh, posture = flesh_of(body), posture_of(_soles_level(moment))
    vertices, joints = pose(body, posture)
    place = np.array([moment.off / 2, -moment.along, height_to_rest(vertices, [FLOOR])])
    solids = [FLOOR]
    if seat is not None:
        place[1] = min(place[1], -SEAT_GAP_M - _behind(vertices, place[2], seat))
        solids += seat.solids()
    settled = settle(flesh, Posture(posture.angles_rad, place), solids, pulls_of(moment))
    vertices, joints = pose(body, settled)
    shift = np.array([0.0, 0.0, height_to_rest(vertices, [FLOOR])])
    if seat is not None:
        shift[1] = min(0.0, -_behind(vertices, shift[2], seat))
    return settled, vertices, joints, shift


def _behind(vertices: NDArray[np.float32], up: float, seat: Sofa | Chair) -> float:
    """The rearmost y of what is lower than the seat when lifted by ``up``."""
    return float(vertices[vertices[:, 2] + up < seat.seat_height, 1].max(initial=-10.0))


def _soles_level(moment: Attitude) -> Attitude:
    """Ankles as they have to be for level soles, plus what the moment asks for."""
    level = {
        f"{side}_ankle": getattr(moment, f"{side}_knee") - getattr(moment, f"{side}_hip") + moment.pitch
        + getattr(moment, f"{side}_ankle")
        for side in ("left", "right")
    }  # fmt: skip
    return replace(moment, **level)
