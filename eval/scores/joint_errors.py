"""Joints found from labels against the truth's: errors frame by frame, PCK and MPJPE.

The variant: of the fifteen joints of ``joints.JOINT_NAMES``, those whose true place lies inside the depth
image are scored, hidden ones too. MPJPE is the mean distance over the scored joints that were found, without
any alignment; PCK@d the share of all scored joints found within d, so that a joint not found is a miss. The
"mAP@10 cm" of ITOP is in effect this PCK@10 cm.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from annotate.array_types import Float64
from annotate.frame_labels import FrameLabels
from annotate.labelset.labelled_frames import pinhole_of
from eval.scores.joints import EVIDENCE, IN_SKELETON, JOINT_NAMES, N_JOINTS, joint_evidence
from eval.scores.skeleton_fit import fit_skeletons
from sensors.errors import FormatError
from sensors.rig.camera import Intrinsics, project
from synth.body import skeleton

WITHIN_MM = (50.0, 100.0, 150.0)
"""Distances of the PCK."""
TRUE_JOINTS = "joints_mm"
"""The note that names a frame's true joints."""
FARTHEST_MM = 100_000.0
"""No joint is further from a camera than that; chosen by eye."""


OBSERVED = np.dtype(
    [
        ("known", np.bool_),
        ("evidence", EVIDENCE),
        ("truth_mm", np.float64, (N_JOINTS, 3)),
        ("inside", np.bool_, N_JOINTS),
    ]
)
"""A frame beside its true joints: whether these are known, their evidence in its labels, their places in the
depth camera's frame, millimetres, and which of them lie inside the depth image."""

Observed = NDArray[np.void]


def observe(predicted: FrameLabels, truth: FrameLabels, camera: Intrinsics) -> Observed:
    """OBSERVED (): a frame's evidence of its joints in the predicted parts, and their true places.

    camera: undistorted, of the whole image (``camera_of``). Raises FormatError for malformed notes.
    """
    observed = np.zeros((), OBSERVED)
    if TRUE_JOINTS in truth.notes:
        joints = true_joints_mm(truth)
        pixels = project(camera, joints)
        observed["known"], observed["truth_mm"] = True, joints
        observed["inside"] = np.all((pixels >= -0.5) & (pixels < np.array(camera.shape[::-1]) - 0.5), axis=-1)
        own = pinhole_of(truth, camera)
        observed["evidence"] = joint_evidence(predicted.parts, predicted.depth_mm, own)
    return observed


def true_joints_mm(truth: FrameLabels) -> Float64:
    """Joints (15, 3) that the truth notes, depth camera, millimetres. Raises FormatError if malformed."""
    try:
        joints = np.array(truth.notes[TRUE_JOINTS], np.float64)
    except (TypeError, ValueError):
        joints = np.empty(0)
    if joints.shape != (skeleton.N_JOINTS, 3) or not (np.abs(joints) <= FARTHEST_MM).all():
        raise FormatError(
            f"frame {truth.frame_id}: its note 'joints_mm' is malformed; give {skeleton.N_JOINTS} joints "
            "(x, y, z) in millimetres"
        )
    return np.asarray(joints[IN_SKELETON])


def joint_errors_mm(observed: Observed, persons: Sequence[str]) -> Float64:
    """Distances (F, 15) of the joints found from the true ones, millimetres. observed: (F,).

    persons: who is seen in each frame. NaN where a joint is not scored: outside the image, or a frame without
    true joints; infinite where it is scored but was not found.
    """
    errors = np.full((len(observed), N_JOINTS), np.nan)
    scored = np.flatnonzero(observed["known"])
    known = observed[scored]
    found = fit_skeletons(known["evidence"], [persons[i] for i in scored.tolist()])
    for i, seen, joints in zip(scored, known, found, strict=True):
        distance = np.linalg.norm(joints - seen["truth_mm"], axis=-1)
        errors[i, seen["inside"]] = np.where(np.isnan(distance), np.inf, distance)[seen["inside"]]
    return errors


def summary(errors_mm: Float64) -> dict[str, Any]:
    """Scores of joint errors (F, 15) as JSON has them; None where nothing was scored or found."""
    return {
        "frames": int((~np.isnan(errors_mm)).any(axis=1).sum()),
        **_scores(errors_mm),
        "by_joint": {name: _scores(errors_mm[:, i]) for i, name in enumerate(JOINT_NAMES)},
    }


def _scores(errors_mm: Float64) -> dict[str, Any]:
    scored = errors_mm[~np.isnan(errors_mm)]
    found = scored[np.isfinite(scored)]
    return {
        "scored": len(scored),
        "found": len(found),
        "mpjpe_mm": float(found.mean()) if len(found) else None,
        **{f"pck_{d:.0f}mm": float((scored <= d).mean()) if len(scored) else None for d in WITHIN_MM},
    }
