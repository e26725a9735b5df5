"""Surface that supports a person (floor or furniture), found by heights above the floor. Constants are
untuned.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from annotate.array_types import Float32, UInt8
from annotate.parts import PAPER
from annotate.person.planes import Plane
from annotate.posture import POSTURES
from annotate.scheme.regions import Region
from annotate.scheme.scheme import Scheme
from eval.network.body_state import BodyState
from eval.scores.joints import JOINT
from sensors.rig.camera import Intrinsics

MOST_TILT = 0.64  # least cosine of the floor's normal and the camera's own up: 50 degrees up or down
BELOW_M, MOST_BELOW = 0.15, 0.02  # reflections: share of the points that may lie so far below the floor
STEP_M = 0.25  # height of the lowest part from which furniture carries the person: seats are at 0.4 to 0.6
LOW_SHARE, LEAST_POINTS = 0.1, 20  # share of the points below a part's height; least points
STANDING_HIPS = 0.51  # of the head's height; 0.57 in standing adults (Drillis and Contini 1966), 0.44 seated
LEAST_HIPS_M = 0.35  # above the floor; nearer hips decide nothing, because the floor may be a table's top
_TRUNK = (
    *(Region.CHEST, Region.BELLY, Region.LOWER_BELLY, Region.HIP),
    *(Region.LEFT_SHOULDER, Region.RIGHT_SHOULDER),
)
_LEGS = tuple(
    Region[f"{side}_{name}"] for side in ("LEFT", "RIGHT") for name in ("LOWER_LEG", "FOOT", "TOES")
)
CARRIED = {"sitting": _TRUNK, "lying": _TRUNK}
"""Regions that lie on the support, by posture; in other postures the lower legs and feet."""


def support_of(
    posture: str, parts: UInt8, points_m: Float32, floor: Plane | None, scheme: Scheme = PAPER
) -> str:
    """Return "floor", "furniture", or "" where the cloud shows no floor or too little of the parts.

    parts: (h, w), of one person, ids of ``scheme``. points_m: (h, w, 3), frame of an upright camera, NaN = no
    reading. floor: result of ``floor_of``. On a bed that hides the whole floor the result is "floor".
    """
    carried = np.isin(parts, scheme.ids_of(CARRIED.get(posture, _LEGS)))
    points = points_m[carried & np.isfinite(points_m[..., 2])]
    if floor is None or len(points) < LEAST_POINTS:
        return ""
    height_m = float(np.quantile(points @ floor.normal, LOW_SHARE)) - floor.offset_m
    return "floor" if height_m < STEP_M else "furniture"


def exclude_standing(state: BodyState, camera: Intrinsics, floor: Plane | None) -> BodyState:
    """Return a state with probability 0 of "standing" where the hips are too low, e.g. with legs below a
    blanket.

    camera: the undistorted depth camera. floor: result of ``floor_of``; None leaves the state unchanged.
    """
    if floor is None:
        return state
    height_m = state.joints_mm(camera) @ floor.normal / 1000 - floor.offset_m
    if not LEAST_HIPS_M < height_m[JOINT["pelvis"]] < STANDING_HIPS * height_m[JOINT["head"]]:
        return state
    others = state.posture.copy()
    others[POSTURES.index("standing")] = 0
    return replace(state, posture=others / others.sum()) if others.any() else state


def floor_of(planes: Sequence[Plane], points_m: Float32) -> Plane | None:
    """Return the largest upward plane with almost no points below; points_m: (h, w, 3), NaN = no reading."""
    some = points_m[::2, ::2].reshape(-1, 3)
    some = some[np.isfinite(some[:, 2])]
    upward = [plane for plane in planes if -plane.normal[1] > MOST_TILT]
    floors = [p for p in upward if np.mean(some @ p.normal < p.offset_m - BELOW_M) < MOST_BELOW]
    return max(floors, key=lambda plane: plane.area_m2, default=None)
