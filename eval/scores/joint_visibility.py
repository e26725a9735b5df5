"""Visibility of true joints in the true depth image.

A joint is outside where its pixel lies beyond the border of the camera's image. A joint inside is visible
where the joint's nearest pixel has a reading of the body around the joint. Such a reading lies at most
``REACH_MM`` in front of the joint, because a joint is inside the body, and at most ``BEHIND_MM`` behind it.
All other joints are hidden, by another thing or part, or without a reading.
"""

from types import MappingProxyType

import numpy as np

from annotate.array_types import Bool, Float64, UInt8, UInt16
from eval.scores.joints import JOINT_NAMES
from sensors.rig.camera import Intrinsics, project

VISIBILITIES = ("hidden", "visible", "outside")
HIDDEN, VISIBLE, OUTSIDE = range(3)
REACH_MM = MappingProxyType(
    {"head": 120.0, "neck": 190.0, "pelvis": 220.0, "shoulder": 210.0, "elbow": 90.0}
    | {"wrist": 70.0, "hip": 270.0, "knee": 120.0, "ankle": 90.0}
)
"""Thickness of the body in front of a joint, mm: 90 % of the readings of the parts that meet at the joint are
nearer to it (540 development images of five presets)."""
BEHIND_MM = 60.0  # mm; readings behind a joint by noise; the real people's score.py has the same
REACHES_MM = np.array([REACH_MM[name.split("_")[-1]] for name in JOINT_NAMES])
"""``REACH_MM`` of each joint (15,)."""


def inside(true_mm: Float64, camera: Intrinsics) -> Bool:
    """Return whether joints (15, 3), millimetres, lie inside a camera's image (15,)."""
    pixels = project(camera, true_mm)
    return np.asarray(((pixels >= -0.5) & (pixels < np.array(camera.shape[::-1]) - 0.5)).all(axis=-1))


def visibility(true_mm: Float64, depth_mm: UInt16, pinhole: Intrinsics) -> UInt8:
    """Return ``HIDDEN`` or ``VISIBLE`` for true joints (15, 3), millimetres.

    depth_mm: (h, w), 0 = no reading; pinhole: of its pixels. Joints beyond the image are hidden.
    """
    own = inside(true_mm, pinhole)
    u, v = np.floor(np.where(own[:, None], project(pinhole, true_mm), 0.0) + 0.5).astype(np.intp).T
    reading_mm = depth_mm[v, u].astype(np.float64)
    in_front_mm = true_mm[:, 2] - reading_mm
    near = (in_front_mm <= REACHES_MM) & (in_front_mm >= -BEHIND_MM)
    return np.where(own & (reading_mm > 0) & near, VISIBLE, HIDDEN).astype(np.uint8)
