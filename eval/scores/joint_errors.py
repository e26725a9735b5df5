"""Errors of a network's joints against true joints, in millimetres.

MPJPE is the mean distance without alignment; PCK@d is the share within d (PCK@10 cm: "mAP@10 cm" of ITOP).
Joints inside the depth image are scored, hidden joints too.
"""

from typing import Any

import numpy as np

from annotate.array_types import Float64
from annotate.frame_labels import FrameLabels
from annotate.labelset.labelled_frames import pinhole_of
from eval.scores.joints import IN_SKELETON, JOINT_NAMES, N_JOINTS
from sensors.errors import FormatError
from sensors.rig.camera import Intrinsics, project
from synth.body import skeleton

WITHIN_MM = (50.0, 100.0, 150.0)
TRUE_JOINTS = "joints_mm"  # note of a frame
FARTHEST_MM = 100_000.0  # mm; joints farther from a camera are refused


def joint_errors_mm(predicted: FrameLabels, truth: FrameLabels, camera: Intrinsics) -> Float64:
    """Return the distance (15,) of each predicted joint from the true one, millimetres; NaN if not scored.

    camera: undistorted, of the whole image (``camera_of``). Raises FormatError for malformed true joints.
    """
    if TRUE_JOINTS not in truth.notes:
        return np.full(N_JOINTS, np.nan)
    true_mm = true_joints_mm(truth)
    pixels = project(camera, true_mm)
    inside = np.all((pixels >= -0.5) & (pixels < np.array(camera.shape[::-1]) - 0.5), axis=-1)
    errors = np.linalg.norm(_predicted_mm(predicted, pinhole_of(truth, camera)) - true_mm, axis=-1)
    return np.where(inside, errors, np.nan)


def _predicted_mm(predicted: FrameLabels, camera: Intrinsics) -> Float64:
    """Return the network's joints (15, 3) of the subject, NaN without them."""
    note = predicted.notes.get("bearing")
    try:
        joints = np.array(note["joints_px"], np.float64)  # type: ignore[index]
    except (TypeError, KeyError, ValueError):
        joints = np.empty(0)
    if joints.shape != (N_JOINTS, 3) or not np.isfinite(joints).all():
        return np.full((N_JOINTS, 3), np.nan)
    u, v, z = joints.T
    return np.column_stack([(u - camera.cx) / camera.fx * z, (v - camera.cy) / camera.fy * z, z])


def true_joints_mm(truth: FrameLabels) -> Float64:
    """Return the true joints (15, 3), depth camera, millimetres. Raises FormatError if malformed."""
    try:
        joints = np.array(truth.notes[TRUE_JOINTS], np.float64)
    except (TypeError, ValueError):
        joints = np.empty(0)
    if joints.shape != (skeleton.N_JOINTS, 3) or not (np.abs(joints) <= FARTHEST_MM).all():
        raise FormatError(
            f"frame {truth.frame_id}: field notes.joints_mm is malformed; give {skeleton.N_JOINTS} joints "
            "(x, y, z) in millimetres"
        )
    return np.asarray(joints[IN_SKELETON])


def summary(errors_mm: Float64) -> dict[str, Any]:
    """Return scores of joint errors (F, 15) as JSON; None for joints without a scored frame."""
    return {
        "frames": int((~np.isnan(errors_mm)).any(axis=1).sum()),
        **_scores(errors_mm),
        "by_joint": {name: _scores(errors_mm[:, i]) for i, name in enumerate(JOINT_NAMES)},
    }


def _scores(errors_mm: Float64) -> dict[str, Any]:
    scored = errors_mm[~np.isnan(errors_mm)]
    within = {f"pck_{d:.0f}mm": float((scored <= d).mean()) if len(scored) else None for d in WITHIN_MM}
    return {
        "scored": len(scored),
        "mpjpe_mm": float(scored.mean()) if len(scored) else None,
        **within,
    }
