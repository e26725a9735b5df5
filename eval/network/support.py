"""What heights above the floor tell of a person: whether floor or furniture carries them, and who stands."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from annotate.array_types import Float32, UInt8
from annotate.parts import PART_ID
from annotate.person.planes import Plane
from annotate.posture import POSTURES
from eval.network.body_state import Bearing
from eval.scores.joints import JOINT
from sensors.rig.camera import Intrinsics

MOST_TILT = 0.64
"""Least cosine between the floor's normal and the upright camera's own up: it may look 50 degrees up or down.
Chosen by eye."""
BELOW_M, MOST_BELOW = 0.15, 0.02
"""Metres below a plane, and the most of a cloud's points so far below the floor, by reflections. Chosen by
eye."""
STEP_M = 0.25
"""Height in metres of a person's lowest part from which furniture carries them: seats and beds are at
0.4 to 0.6, who sits or lies on the floor is seen from some 0.05 up. Chosen by eye."""
LOW_SHARE, LEAST_POINTS = 0.1, 20
"""Share of a part's points below its height, which leaves out stray ones; least points. Chosen by eye."""
STANDING_HIPS, LEAST_HIPS_M = 0.51, 0.35
"""Least height of a standing person's hips, as a share of that of the head: it is 0.57 (Drillis and Contini
1966) of adults, less of small children, and 0.44 on a seat. Hips that are nearer to the floor than so many
metres tell nothing: it may be a table's top. Chosen by eye."""
_TRUNK, _LEGS = ("torso", "hip"), ("left_lower_leg", "right_lower_leg")
CARRIED = {"sitting": _TRUNK, "lying": _TRUNK}
"""Parts that lie on what carries a person, by posture; all others stand or kneel on their lower legs."""


def support_of(posture: str, parts: UInt8, points_m: Float32, floor: Plane | None) -> str:
    """ "floor", "furniture", or "" where the cloud shows no floor or not the parts that matter.

    parts: (h, w), of one person. points_m: (h, w, 3), frame of an upright camera, NaN = no reading. floor: of
    ``floor_of``. A person on a bed that hides the whole floor seems to lie on the floor.
    """
    carried = np.isin(parts, [PART_ID[name] for name in CARRIED.get(posture, _LEGS)])
    points = points_m[carried & np.isfinite(points_m[..., 2])]
    if floor is None or len(points) < LEAST_POINTS:
        return ""
    height_m = float(np.quantile(points @ floor.normal, LOW_SHARE)) - floor.offset_m
    return "floor" if height_m < STEP_M else "furniture"


def by_height(bearing: Bearing, camera: Intrinsics, floor: Plane | None) -> Bearing:
    """A bearing that does not stand where the hips are too low: whose legs a blanket hides seems to stand.

    camera: the undistorted depth camera. floor: of ``floor_of``; None = nothing is known.
    """
    if floor is None:
        return bearing
    height_m = bearing.joints_mm(camera) @ floor.normal / 1000 - floor.offset_m
    if not LEAST_HIPS_M < height_m[JOINT["pelvis"]] < STANDING_HIPS * height_m[JOINT["head"]]:
        return bearing
    others = bearing.posture.copy()
    others[POSTURES.index("standing")] = 0
    return replace(bearing, posture=others / others.sum()) if others.any() else bearing


def floor_of(planes: Sequence[Plane], points_m: Float32) -> Plane | None:
    """The largest plane that faces up and has nothing beneath it; points_m: (h, w, 3), NaN = no reading."""
    some = points_m[::2, ::2].reshape(-1, 3)
    some = some[np.isfinite(some[:, 2])]
    upward = [plane for plane in planes if -plane.normal[1] > MOST_TILT]
    floors = [p for p in upward if np.mean(some @ p.normal < p.offset_m - BELOW_M) < MOST_BELOW]
    return max(floors, key=lambda plane: plane.area_m2, default=None)
