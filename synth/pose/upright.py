"""Crouching, kneeling, getting up and standing: unusual poses on the floor, or in front of a seat."""

import numpy as np

from annotate.array_types import Float32
from synth.body.body import Body, pose
from synth.body.flesh import flesh_of
from synth.body.skeleton import Posture
from synth.pose.attitude import posture_of, pulls_of
from synth.pose.contact import height_to_rest
from synth.pose.moment import Behaviour, Moment, Posed, pose_families
from synth.pose.settle import settle
from synth.surface.furniture import FLOOR, Seat

SEAT_GAP_M = 0.02
"""Distance of legs from a seat behind them. Chosen by eye."""

UPRIGHT = pose_families("upright")["upright"]


def on_legs(seat: Seat | None, *activities: str) -> Behaviour:
    """Doing these activities, by default all of the family, on the floor, perhaps before a seat."""
    chosen = activities or tuple(UPRIGHT.activities)
    return Behaviour(UPRIGHT, chosen, lambda body, moment: rise(body, seat, moment))


def rise(body: Body, seat: Seat | None, moment: Moment) -> Posed:
    """A body on the floor: vertices float32 (V, 3) and joints (J, 3) of a moment, world, metres.

    The lowest skin stands on the floor; with a seat behind, the legs keep before its front edge (y = 0).
    """
    flesh, posture = flesh_of(body), posture_of(_soles_level(moment))
    vertices, joints = pose(body, posture)
    place = np.array([moment["off"] / 2, -moment["along"], height_to_rest(vertices, [FLOOR])])
    solids = [FLOOR]
    if seat is not None:
        place[1] = min(place[1], -SEAT_GAP_M - _behind(vertices, place[2], seat))
        solids += seat.solids()
    settled = settle(flesh, Posture(posture.angles_rad, place), solids, pulls_of(moment))
    vertices, joints = pose(body, settled)
    shift = np.array([0.0, 0.0, height_to_rest(vertices, [FLOOR])])
    if seat is not None:
        shift[1] = min(0.0, -_behind(vertices, shift[2], seat))
    return vertices + shift.astype(np.float32), joints + shift


def _behind(vertices: Float32, up: float, seat: Seat) -> float:
    """The rearmost y of what is lower than the seat when lifted by ``up``."""
    return float(vertices[vertices[:, 2] + up < seat.height, 1].max(initial=-10.0))


def _soles_level(moment: Moment) -> Moment:
    """A moment whose ankles count from level soles."""
    level = {
        f"{side}_ankle": moment[f"{side}_knee"] - moment[f"{side}_hip"] + moment["pitch"]
        + moment[f"{side}_ankle"]
        for side in ("left", "right")
    }  # fmt: skip
    return {**moment, **level}
