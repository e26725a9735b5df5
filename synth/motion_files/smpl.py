"""SMPL's joints, and where they are by the rotations of an AMASS file.

AMASS holds rotations alone; the lengths of the bones follow from SMPL's body model, whose licence forbids to
ship it. The rotations of all joints are stated about the axes of one T-pose, so they turn any body that has
SMPL's joints in a T-pose: here the reference body of this project.
"""

import numpy as np
from scipy.spatial.transform import Rotation

from annotate.array_types import Float64
from sensors.errors import FormatError
from synth.body.body import reference_body
from synth.body.skeleton import JOINT_ID, N_JOINTS, Posture, alignment, forward

_OURS = {
    "Pelvis": "pelvis", "L_Hip": "left_hip", "R_Hip": "right_hip", "Spine1": "spine_lower",
    "L_Knee": "left_knee", "R_Knee": "right_knee", "Spine2": "spine_middle",
    "L_Ankle": "left_ankle", "R_Ankle": "right_ankle", "Spine3": "spine_upper",
    "L_Foot": "", "R_Foot": "", "Neck": "neck", "L_Collar": "left_clavicle", "R_Collar": "right_clavicle",
    "Head": "head", "L_Shoulder": "left_shoulder", "R_Shoulder": "right_shoulder",
    "L_Elbow": "left_elbow", "R_Elbow": "right_elbow", "L_Wrist": "left_wrist", "R_Wrist": "right_wrist",
    "L_Hand": "", "R_Hand": "",
}  # fmt: skip
"""Our joint at the place of each of SMPL's 24, in SMPL's order; "" for its two points on each limb's end."""
SMPL_JOINTS = tuple(_OURS)
SMPL_PARENTS = np.array(
    [-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 20, 21], np.int64
)
SMPL_COUNTS = (22, 24)
"""Joints of SMPL without and with the knuckles."""
BODY = 22
"""Joints whose rotations come first in SMPL, SMPL+H and SMPL-X."""
_FOOT_M, _HAND_M = (0.0, -0.06, 0.13), 0.085
"""Ball of the foot from the ankle, knuckles from the wrist, along SMPL's axes and the arm. Untuned."""


def joints_of_rotations(poses: Float64, root_m: Float64) -> Float64:
    """Return the places (F, 22, 3) of SMPL's joints, metres, in the file's axes.

    poses: (F, 3 n) axis-angle rotations of n joints, 22 and more. root_m: (F, 3). Raises FormatError when
    their shapes are others.
    """
    frames = len(poses)
    if poses.ndim != 2 or poses.shape[1] < 3 * BODY or poses.shape[1] % 3 or root_m.shape != (frames, 3):
        raise FormatError(
            f"poses are {poses.shape} and trans {root_m.shape}; give (F, 66 or more) and (F, 3)"
        )
    rest = _t_pose_m()
    turns = [Rotation.from_rotvec(poses[:, 3 * j : 3 * j + 3]) for j in range(BODY)]
    places = np.empty((frames, BODY, 3))
    places[:, 0] = root_m
    for j in range(1, BODY):
        parent = int(SMPL_PARENTS[j])
        places[:, j] = places[:, parent] + turns[parent].apply(rest[j] - rest[parent])
        turns[j] = turns[parent] * turns[j]
    return places


def _t_pose_m() -> Float64:
    """Return SMPL's joints (24, 3) on the reference body in a T-pose: x to its left, y up, z ahead."""
    body = reference_body()
    angles = np.zeros((N_JOINTS, 3))
    for side in ("left", "right"):
        angles[JOINT_ID[f"{side}_shoulder"], 1] = np.pi / 2
    _, joints = forward(Posture(angles, np.zeros(3)), body.joints_m, alignment(body.joints_m))
    ours = joints @ np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    places = np.array([ours[JOINT_ID[name]] if name else np.zeros(3) for name in _OURS.values()])
    for j, name in enumerate(SMPL_JOINTS):
        if name.endswith("Foot"):
            places[j] = places[SMPL_PARENTS[j]] + _FOOT_M
        elif name.endswith("Hand"):
            places[j] = places[SMPL_PARENTS[j]] + [_HAND_M if name[0] == "L" else -_HAND_M, 0, 0]
    return places
