"""Joints of a frame's notes as COCO's key points (cocodataset.org, "Data format", 2)."""

from typing import Any

import numpy as np

from annotate.frame_labels import FrameLabels
from annotate.joint_names import BONES, JOINT_NAMES

LABELLED = 2  # COCO's flag of a visible key point; 0 is a point that is not given

SKELETON: dict[str, Any] = {
    "keypoints": list(JOINT_NAMES),
    "skeleton": [[JOINT_NAMES.index(joint) + 1 for joint in bone] for bone in BONES],
}
"""Fields of the category: names, and bones as pairs of numbers from 1."""


def keypoints_of(frame: FrameLabels) -> dict[str, Any]:
    """Return the fields of the subject's annotation, (column, row, flag) of each joint; {} without joints.

    Joints outside the image are not given. Raises FormatError for a malformed note ``bearing``.
    """
    note = frame.notes.get("bearing")
    if not isinstance(note, dict) or "joints_px" not in note:
        return {}
    try:
        joints = np.array(note["joints_px"], np.float64)
        if joints.shape != (len(JOINT_NAMES), 3):
            raise ValueError(f"shape {joints.shape}")
    except (TypeError, ValueError, OverflowError) as error:
        raise frame.error(
            f"note bearing.joints_px is malformed ({error}); give {len(JOINT_NAMES)} x 3 numbers"
        ) from error
    height, width = frame.parts.shape
    column, row = joints[:, 0], joints[:, 1]
    inside = (column >= 0) & (column <= width - 1) & (row >= 0) & (row <= height - 1)
    points = np.where(inside[:, None], np.column_stack([column, row, np.full(len(row), LABELLED)]), 0)
    return {"keypoints": points.ravel().round(2).tolist(), "num_keypoints": int(inside.sum())}
