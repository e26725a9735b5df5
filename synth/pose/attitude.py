"""A whole body by its joint angles: the moment that recumbent and upright poses share."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from synth.body.skeleton import JOINT_ID, N_JOINTS, Float64, Posture, clamp
from synth.pose.moment import Spread
from synth.pose.settle import Pull, sink


@dataclass(frozen=True)
class Attitude:
    """One moment of a body; degrees and metres. Flexion is forwards, a knee's counts positive.

    The pelvis turns by ``roll`` about the body's long axis (90: left side towards its back), then by
    ``pitch`` (90 forwards: face down), then by ``heading`` about the vertical. ``sink`` numbers in [0, 1] say
    how much a limb gives in to gravity until something carries it.
    """

    heading: float
    pitch: float
    roll: float
    off: float  # to the left; 1 is the edge of a bed, half a metre elsewhere
    along: float  # m towards the feet when lying, away from the furniture when upright
    bend: float  # trunk flexion forwards, spread over the spine
    lean: float
    twist: float
    nod: float
    turn: float
    left_hip: float
    right_hip: float
    left_spread: float
    right_spread: float
    left_hip_twist: float
    right_hip_twist: float
    left_knee: float
    right_knee: float
    left_ankle: float
    right_ankle: float
    left_arm: float
    right_arm: float
    left_arm_spread: float
    right_arm_spread: float
    left_arm_twist: float
    right_arm_twist: float
    left_elbow: float
    right_elbow: float
    left_pronation: float
    right_pronation: float
    head_sink: float
    left_leg_sink: float
    right_leg_sink: float
    left_arm_sink: float
    right_arm_sink: float


def both(name: str, mean: float, deviation: float) -> dict[str, Spread]:
    """The same spread on the left and the right."""
    return {f"left_{name}": (mean, deviation), f"right_{name}": (mean, deviation)}


def mirrored(spreads: dict[str, Spread]) -> dict[str, Spread]:
    """The same activity with left and right exchanged."""
    other = {"left": "right", "right": "left"}
    turned = {"heading", "roll", "off", "lean", "twist", "turn"}
    result = {}
    for name, (mean, deviation) in spreads.items():
        side, _, rest = name.partition("_")
        key = f"{other[side]}_{rest}" if side in other else name
        result[key] = (-mean if name in turned else mean, deviation)
    return result


def posture_of(moment: Attitude) -> Posture:
    """Joint angles of a moment inside all limits, the pelvis at the origin, nothing yet carried."""
    angles = np.zeros((N_JOINTS, 3))
    for joint in ("spine_lower", "spine_middle", "spine_upper"):
        angles[JOINT_ID[joint]] = np.array([moment.bend, moment.lean, moment.twist]) / 3
    for joint in ("neck", "head"):
        angles[JOINT_ID[joint]] = np.array([moment.nod, 0.0, moment.turn]) / 2
    for side in ("left", "right"):
        at = {name: getattr(moment, f"{side}_{name}") for name in _LIMB_FIELDS}
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


def _with_pelvis(angles: Float64, moment: Attitude) -> Float64:
    turn = Rotation.from_euler("ZXZ", [moment.heading, moment.pitch, moment.roll], degrees=True)
    angles[0] = turn.as_euler("XYZ")
    angles[0, 1] *= -1  # the pelvis' abduction turns by Ry(-abduction)
    return angles


def pulls_of(moment: Attitude) -> list[Pull]:
    """What gravity draws down."""
    pulls = [sink("head", moment.head_sink)]
    for side in ("left", "right"):
        leg, arm = getattr(moment, f"{side}_leg_sink"), getattr(moment, f"{side}_arm_sink")
        pulls += [sink(f"{side}_knee", leg), sink(f"{side}_ankle", leg)]
        pulls += [sink(f"{side}_elbow", arm), sink(f"{side}_wrist", arm)]
    return [pull for pull in pulls if pull.weight[2] > 0.02]
