"""A whole body by its joint angles: the moments that recumbent and upright poses share.

Their numbers are described in ``synth/data/poses/recumbent.toml``; flexion is forwards, a knee's positive.
"""

import numpy as np
from scipy.spatial.transform import Rotation

from annotate.array_types import Float64
from synth.body.skeleton import JOINT_ID, N_JOINTS, Posture, clamp
from synth.pose.moment import Moment
from synth.pose.settle import Pull, sink


def posture_of(moment: Moment) -> Posture:
    """Posture of a moment inside all joint limits, the pelvis at the origin, nothing yet carried."""
    angles = np.zeros((N_JOINTS, 3))
    for joint in ("spine_lower", "spine_middle", "spine_upper"):
        angles[JOINT_ID[joint]] = np.array([moment["bend"], moment["lean"], moment["twist"]]) / 3
    for joint in ("neck", "head"):
        angles[JOINT_ID[joint]] = np.array([moment["nod"], 0.0, moment["turn"]]) / 2
    for side in ("left", "right"):
        at = {name: moment[f"{side}_{name}"] for name in _LIMB_FIELDS}
        angles[JOINT_ID[f"{side}_hip"]] = (at["hip"], at["spread"], at["hip_twist"])
        angles[JOINT_ID[f"{side}_knee"], 0] = -at["knee"]
        angles[JOINT_ID[f"{side}_ankle"], 0] = at["ankle"]
        # Beyond a right angle the arm's height is the shoulder girdle's too.
        lift = max(at["arm"] - 90, at["arm_spread"] - 60, 0) / 4
        angles[JOINT_ID[f"{side}_clavicle"], 1] = lift
        angles[JOINT_ID[f"{side}_shoulder"]] = (at["arm"], at["arm_spread"], at["arm_twist"])
        angles[JOINT_ID[f"{side}_elbow"]] = (at["elbow"], 0, at["pronation"])
    return Posture(_with_pelvis(clamp(np.radians(angles)), moment), np.zeros(3))


_LIMB_FIELDS = (
    "hip", "spread", "hip_twist", "knee", "ankle", "arm", "arm_spread", "arm_twist", "elbow", "pronation",
)  # fmt: skip


def _with_pelvis(angles: Float64, moment: Moment) -> Float64:
    """Angles (J, 3) with the pelvis turned by roll about the long axis, then pitch, then heading."""
    turn = Rotation.from_euler("ZXZ", [moment["heading"], moment["pitch"], moment["roll"]], degrees=True)
    angles[0] = turn.as_euler("XYZ")
    angles[0, 1] *= -1  # the pelvis' abduction turns by Ry(-abduction)
    return angles


def pulls_of(moment: Moment) -> list[Pull]:
    """Pulls of gravity on head and limbs."""
    pulls = [sink("head", moment["head_sink"])]
    for side in ("left", "right"):
        leg, arm = moment[f"{side}_leg_sink"], moment[f"{side}_arm_sink"]
        pulls += [sink(f"{side}_knee", leg), sink(f"{side}_ankle", leg)]
        pulls += [sink(f"{side}_elbow", arm), sink(f"{side}_wrist", arm)]
    return [pull for pull in pulls if pull.weight[2] > 0.02]
