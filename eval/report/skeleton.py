"""Drawing of a person's joints, facing and posture over the depth image."""

import cv2
import numpy as np

from annotate.array_types import UInt8
from annotate.crop import Crop
from annotate.parts import PART_ID, PARTS
from eval.network.body_state import BodyState
from eval.scores.joints import JOINT

LINES = (
    ("head", "neck", "head"),
    ("neck", "pelvis", "torso"),
    *(
        (a if a in JOINT else f"{side}_{a}", f"{side}_{b}", part if part in PART_ID else f"{side}_{part}")
        for side in ("left", "right")
        for a, b, part in (
            ("neck", "shoulder", "torso"),
            ("shoulder", "elbow", "upper_arm"),
            ("elbow", "wrist", "forearm"),
            ("pelvis", "hip", "hip"),
            ("hip", "knee", "upper_leg"),
            ("knee", "ankle", "lower_leg"),
        )
    ),
)
"""Joints that are connected, and the part whose colour the line has."""
WHITE = (255, 255, 255)
SCALE = 8
"""Steps of a pixel in which lines are placed: OpenCV's shift of 3 bits."""


def draw_bearing(picture: UInt8, crop: Crop, bearing: BodyState) -> UInt8:
    """Return an RGB picture (n, n, 3) of a crop with the skeleton in part colours, the facing and the
    posture.

    The circle shows the person from above, with the camera at its bottom; the line points to where the person
    faces.
    """
    drawn, side = np.ascontiguousarray(picture), picture.shape[0]
    at = (bearing.joints_px[:, :2] + 0.5 - (crop.left, crop.top)) * side / crop.side - 0.5
    steps = np.rint(at.clip(-side, 2 * side) * SCALE).astype(int)
    for a, b, part in LINES:
        first, last = steps[JOINT[a]].tolist(), steps[JOINT[b]].tolist()
        cv2.line(drawn, first, last, PARTS[PART_ID[part]].rgb, 2, cv2.LINE_AA, 3)
    for joint in steps.tolist():
        cv2.circle(drawn, (joint[0], joint[1]), 2 * SCALE, WHITE, -1, cv2.LINE_AA, 3)
    middle, radius = np.array([side - 18, side - 18]), 12
    cv2.circle(drawn, middle.tolist(), radius, WHITE, 1, cv2.LINE_AA)
    # A camera on the person's left sees them face to its left.
    ahead = np.array([-np.sin(np.radians(bearing.facing_deg)), np.cos(np.radians(bearing.facing_deg))])
    tip = np.rint(middle + radius * bearing.facing_sure * ahead).astype(int)
    cv2.line(drawn, middle.tolist(), tip.tolist(), WHITE, 2, cv2.LINE_AA)
    cv2.putText(drawn, bearing.name, (4, side - 6), cv2.FONT_HERSHEY_SIMPLEX, 0.4, WHITE, 1, cv2.LINE_AA)
    return drawn
