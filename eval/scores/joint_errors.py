"""Errors of a network's joints against true joints, in millimetres."""

import numpy as np

from annotate.array_types import Float64, UInt8
from annotate.frame_labels import FrameLabels
from annotate.labelset.labelled_frames import pinhole_of
from eval.scores.joint_visibility import HIDDEN, OUTSIDE, inside, visibility
from eval.scores.joints import IN_SKELETON, N_JOINTS
from sensors.errors import FormatError
from sensors.rig.camera import Intrinsics
from synth.body import skeleton

TRUE_JOINTS = "joints_mm"  # note of a frame
FARTHEST_MM = 100_000.0  # mm; joints farther from a camera are refused


def joint_errors_mm(predicted: FrameLabels, truth: FrameLabels, camera: Intrinsics) -> Float64:
    """Return the distance (15,) of each predicted joint from the true one, millimetres.

    NaN without true joints, infinite without predicted ones. camera: undistorted, of the whole image
    (``camera_of``). Raises FormatError for malformed true joints.
    """
    if TRUE_JOINTS not in truth.notes:
        return np.full(N_JOINTS, np.nan)
    predicted_mm = _predicted_mm(predicted, pinhole_of(truth, camera))
    return np.asarray(np.linalg.norm(predicted_mm - true_joints_mm(truth), axis=-1))


def joint_visibility(truth: FrameLabels, camera: Intrinsics) -> UInt8:
    """Return the visibility (15,) of the true joints, ids of ``VISIBILITIES``.

    Joints are hidden without true joints. camera, errors: as in ``joint_errors_mm``.
    """
    if TRUE_JOINTS not in truth.notes:
        return np.full(N_JOINTS, HIDDEN, np.uint8)
    true_mm = true_joints_mm(truth)
    seen = visibility(true_mm, truth.depth_mm, pinhole_of(truth, camera))
    return np.where(inside(true_mm, camera), seen, np.uint8(OUTSIDE))


def _predicted_mm(predicted: FrameLabels, camera: Intrinsics) -> Float64:
    """Return the network's joints (15, 3) of the subject, infinite without them."""
    note = predicted.notes.get("bearing")
    try:
        joints = np.array(note["joints_px"], np.float64)  # type: ignore[index]
    except (TypeError, KeyError, ValueError, OverflowError):
        joints = np.empty(0)
    if joints.shape != (N_JOINTS, 3) or not np.isfinite(joints).all():
        return np.full((N_JOINTS, 3), np.inf)
    u, v, z = joints.T
    return np.column_stack([(u - camera.cx) / camera.fx * z, (v - camera.cy) / camera.fy * z, z])


def true_joints_mm(truth: FrameLabels) -> Float64:
    """Return the true joints (15, 3), depth camera, millimetres. Raises FormatError if malformed."""
    return np.asarray(all_joints_mm(truth)[IN_SKELETON])


def all_joints_mm(truth: FrameLabels) -> Float64:
    """Return the true joints of the skeleton (J, 3); otherwise as ``true_joints_mm``."""
    joints_mm = noted_joints_mm(truth)
    if joints_mm is None:
        raise FormatError(
            f"frame {truth.frame_id}: field notes.joints_mm is malformed; give {skeleton.N_JOINTS} joints "
            "(x, y, z) in millimetres"
        )
    return joints_mm


def noted_joints_mm(frame: FrameLabels) -> Float64 | None:
    """Return the true joints of the skeleton (J, 3) in a frame's notes, depth camera, millimetres.

    None without joints and for malformed ones.
    """
    try:
        joints_mm = np.array(frame.notes[TRUE_JOINTS], np.float64)
    except (KeyError, TypeError, ValueError, OverflowError):
        return None
    usable = joints_mm.shape == (skeleton.N_JOINTS, 3) and (np.abs(joints_mm) <= FARTHEST_MM).all()
    return joints_mm if usable else None
