"""Motion without a studio: what people do on a sofa, as smooth sequences of postures.

A moment of sitting is a vector of named numbers (``Sitting``). It is turned into a posture whose
pelvis rests on the seat, whose back meets the rest, whose feet stand on the floor and whose hands are
where they should be, with no limb in another or in the sofa.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from synth.body.body import Body, pose
from synth.body.flesh import flesh_of
from synth.body.skeleton import JOINT_ID, N_JOINTS, Float64, Posture, clamp, reach
from synth.pose.moment import Family, Spread
from synth.pose.settle import Pull, settle, sink
from synth.surface.furniture import FLOOR, Chair, Sofa

KNEE_ROOM_M = 0.07
"""Room for a calf between the knee joint and the seat's front edge."""
HAND_HOLD = np.full(3, 0.5)
"""How strongly a hand is drawn to its target."""


@dataclass(frozen=True)
class Sitting:
    """One moment of sitting; degrees and metres.

    Hands are wrist targets relative to the hip joints' middle, in the trunk-upright body frame scaled by the
    body's height / 1.7 m: x to the person's left, y back, z up.
    """

    slide: float  # m the pelvis sits in front of the back rest's reach
    recline: float  # pelvis pitch backwards
    bend: float  # trunk flexion forwards, spread over the spine
    lean: float  # sideways to the person's left
    twist: float
    nod: float
    turn: float
    left_thigh: float  # above the horizontal
    right_thigh: float
    left_spread: float
    right_spread: float
    left_hip_twist: float
    right_hip_twist: float
    left_knee: float  # flexion, positive
    right_knee: float
    left_hand_x: float
    left_hand_y: float
    left_hand_z: float
    right_hand_x: float
    right_hand_y: float
    right_hand_z: float
    left_swivel: float
    right_swivel: float
    pronation: float
    left_foot_sink: float  # in [0, 1]: how much the foot is let down to the floor
    right_foot_sink: float
    left_hand_sink: float  # likewise, to whatever lies under the hand
    right_hand_sink: float


_BASE: dict[str, Spread] = {
    "slide": (0.0, 0.06),
    "recline": (12.0, 6.0),
    "bend": (12.0, 8.0),
    "lean": (0.0, 4.0),
    "twist": (0.0, 6.0),
    "nod": (6.0, 10.0),
    "turn": (0.0, 18.0),
    "left_thigh": (4.0, 5.0),
    "right_thigh": (4.0, 5.0),
    "left_spread": (8.0, 8.0),
    "right_spread": (8.0, 8.0),
    "left_hip_twist": (0.0, 8.0),
    "right_hip_twist": (0.0, 8.0),
    "left_knee": (82.0, 14.0),
    "right_knee": (82.0, 14.0),
    "left_hand_x": (0.16, 0.05),
    "left_hand_y": (-0.32, 0.07),
    "left_hand_z": (0.12, 0.03),
    "right_hand_x": (-0.16, 0.05),
    "right_hand_y": (-0.32, 0.07),
    "right_hand_z": (0.12, 0.03),
    "left_swivel": (20.0, 12.0),
    "right_swivel": (20.0, 12.0),
    "pronation": (0.0, 30.0),
    "left_foot_sink": (0.6, 0.1),
    "right_foot_sink": (0.6, 0.1),
    "left_hand_sink": (0.5, 0.1),
    "right_hand_sink": (0.5, 0.1),
}
"""A person who just sits, hands on the thighs: aimed a little inside them, which contact forbids."""


def _hand(side: str, x: float, y: float, z: float, spread: float, rest: float = 0.0) -> dict[str, Spread]:
    sign = 1 if side == "left" else -1
    place = {f"{side}_hand_{k}": (v, spread) for k, v in zip("xyz", (sign * x, y, z), strict=True)}
    return {**place, f"{side}_hand_sink": (rest, 0.0)}


def _hands(x: float, y: float, z: float, spread: float, rest: float = 0.0) -> dict[str, Spread]:
    return {**_hand("left", x, y, z, spread, rest), **_hand("right", x, y, z, spread, rest)}


ACTIVITIES: dict[str, dict[str, Spread]] = {
    "resting": {},
    "drinking": {**_hand("right", 0.10, -0.30, 0.52, 0.07), "nod": (-4.0, 8.0)},
    "drinking_left": {**_hand("left", 0.10, -0.30, 0.52, 0.07), "nod": (-4.0, 8.0)},
    "reading": {**_hands(0.13, -0.40, 0.34, 0.05), "nod": (22.0, 8.0), "turn": (0.0, 8.0)},
    "gadget": {**_hands(0.08, -0.34, 0.26, 0.05), "nod": (24.0, 8.0), "bend": (22.0, 8.0)},
    "swinging_body": {"lean": (0.0, 14.0), "twist": (0.0, 16.0), "bend": (18.0, 16.0)},
    "swinging_arms": {
        **_hands(0.34, -0.30, 0.46, 0.18),
        "left_swivel": (25.0, 25.0),
        "right_swivel": (25.0, 25.0),
    },
    "arms_up": {**_hands(0.30, -0.12, 0.80, 0.14)},
    "arm_rests": {
        **_hands(0.36, -0.20, 0.24, 0.05, rest=0.5),
        "left_swivel": (40.0, 15.0),
        "right_swivel": (40.0, 15.0),
    },
    "swinging_legs": {
        "left_knee": (60.0, 28.0),
        "right_knee": (60.0, 28.0),
        "left_thigh": (12.0, 10.0),
        "right_thigh": (12.0, 10.0),
        "left_foot_sink": (0.0, 0.0),
        "right_foot_sink": (0.0, 0.0),
    },
    "legs_apart": {"left_spread": (28.0, 8.0), "right_spread": (28.0, 8.0)},
    "crossed_left": {
        "left_thigh": (26.0, 5.0),
        "left_spread": (-12.0, 4.0),
        "left_knee": (72.0, 12.0),
        "left_hip_twist": (8.0, 6.0),
        "left_foot_sink": (0.0, 0.0),
        "right_spread": (3.0, 4.0),
    },
    "crossed_right": {
        "right_thigh": (26.0, 5.0),
        "right_spread": (-12.0, 4.0),
        "right_knee": (72.0, 12.0),
        "right_hip_twist": (8.0, 6.0),
        "right_foot_sink": (0.0, 0.0),
        "left_spread": (3.0, 4.0),
    },
    "leaning_forward": {
        **_hands(0.14, -0.52, 0.14, 0.06, rest=0.5),
        "bend": (42.0, 12.0),
        "recline": (-8.0, 8.0),
    },
    "leaning_aside": {"lean": (0.0, 22.0), "turn": (0.0, 24.0)},
    "slumping": {
        **_hands(0.22, -0.10, 0.10, 0.06, rest=0.5),
        "slide": (0.18, 0.06),
        "recline": (32.0, 8.0),
        "bend": (24.0, 10.0),
        "nod": (26.0, 10.0),
        "lean": (0.0, 14.0),
        "left_knee": (60.0, 18.0),
        "right_knee": (60.0, 18.0),
    },
}
"""Per activity, what differs from just sitting (section 3.2 of the paper names the scenes)."""


SITTING: Family[Sitting] = Family(Sitting, _BASE, ACTIVITIES)
draw = SITTING.draw
moments = SITTING.moments


def sit(body: Body, seat: Sofa | Chair, moment: Sitting) -> tuple[NDArray[np.float32], Float64]:
    """Turn a moment into a body on a seat: vertices float32 (V, 3) and joints (J, 3), world, metres."""
    return pose(body, sitting_posture(body, seat, moment))


def sitting_posture(body: Body, seat: Sofa | Chair, moment: Sitting) -> Posture:
    """The posture of a moment: trunk on the seat, hands at their targets, feet on the floor, limbs clear."""
    flesh, scale = flesh_of(body), body.height_cm / 170
    posture = Posture(_sitting_angles(moment), np.zeros(3))
    vertices, joints = pose(body, posture)
    place = _rest_on(seat, vertices[flesh.trunk], joints, moment.slide)
    middle = (joints[JOINT_ID["left_hip"]] + joints[JOINT_ID["right_hip"]]) / 2 + place
    posture = Posture(posture.angles_rad, place)
    pulls = []
    for side in ("left", "right"):
        hand = middle + scale * np.array([getattr(moment, f"{side}_hand_{k}") for k in "xyz"])
        swivel = np.radians(getattr(moment, f"{side}_swivel"))
        posture = reach(posture, flesh.rest_joints_m, flesh.aligned, side, hand, swivel)
        down = getattr(moment, f"{side}_hand_sink")
        pulls.append(Pull(f"{side}_wrist", hand, HAND_HOLD * (1, 1, 1 - down)))
        pulls.append(sink(f"{side}_wrist", down))
        pulls.append(sink(f"{side}_ankle", getattr(moment, f"{side}_foot_sink")))
    return settle(flesh, posture, [FLOOR, *seat.solids()], pulls)


def _sitting_angles(moment: Sitting) -> Float64:
    angles = np.zeros((N_JOINTS, 3))
    angles[JOINT_ID["pelvis"]] = (-moment.recline, 0, 0)
    for joint in ("spine_lower", "spine_middle", "spine_upper"):
        angles[JOINT_ID[joint]] = np.array([moment.bend, moment.lean, moment.twist]) / 3
    for joint in ("neck", "head"):
        angles[JOINT_ID[joint]] = np.array([moment.nod, -moment.lean / 2, moment.turn]) / 2
    for side in ("left", "right"):
        thigh, spread, twist, knee = (
            getattr(moment, f"{side}_{k}") for k in ("thigh", "spread", "hip_twist", "knee")
        )
        # The thigh's height counts from the horizontal, whatever the pelvis does.
        angles[JOINT_ID[f"{side}_hip"]] = (90 + thigh - moment.recline, spread, twist)
        angles[JOINT_ID[f"{side}_knee"], 0] = -knee
        # Feet stay flat as far as the ankle lets them.
        angles[JOINT_ID[f"{side}_ankle"], 0] = knee - 90 - thigh
        angles[JOINT_ID[f"{side}_elbow"], 2] = moment.pronation
    pelvis = angles[0].copy()
    limited = clamp(np.radians(angles))
    limited[0] = np.radians(pelvis)
    return limited


def _rest_on(seat: Sofa | Chair, trunk: NDArray[np.float32], joints: Float64, slide: float) -> Float64:
    """Shift (3,) that puts the seat under the trunk, the back rest behind it, the knees before its edge."""
    up = seat.seat_height - seat.give_m - float(trunk[:, 2].min())
    gap = seat.back_y(trunk[:, 2] + up) - trunk[:, 1]
    leant_back = float(gap.min()) + seat.give_m - max(slide, 0.0)
    knees_free = -KNEE_ROOM_M - float(joints[_KNEES, 1].max())
    return np.array([0.0, min(leant_back, knees_free), up])


_KNEES = [JOINT_ID["left_knee"], JOINT_ID["right_knee"]]
