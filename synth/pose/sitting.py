"""Sitting: postures whose pelvis rests on a seat, whose back meets the rest and whose hands are at
their targets (``synth/data/poses/sitting.toml``), with no limb in another or in the seat.
"""

import numpy as np

from annotate.array_types import Float32, Float64
from synth.body.body import Body, pose
from synth.body.flesh import flesh_of
from synth.body.skeleton import JOINT_ID, N_JOINTS, Posture, clamp, reach
from synth.pose.moment import Behaviour, Moment, Posed, pose_families
from synth.pose.settle import Pull, settle, sink
from synth.surface.furniture import FLOOR, Seat

KNEE_ROOM_M = 0.07
"""Room for a calf between the knee joint and the seat's front edge. Chosen by eye."""
HAND_HOLD = np.full(3, 0.5)
"""Share of the way, per axis and round, by which a hand is drawn to its target. Chosen by eye."""

SITTING = pose_families("sitting")["sitting"]


def on_seat(seat: Seat, *activities: str) -> Behaviour:
    """Doing these activities, by default all of the family, on a seat."""
    chosen = activities or tuple(SITTING.activities)
    return Behaviour(SITTING, chosen, lambda body, moment: sit(body, seat, moment))


def sit(body: Body, seat: Seat, moment: Moment) -> Posed:
    """A body on a seat: vertices float32 (V, 3) and joints (J, 3) of a moment, world, metres.

    The trunk rests on the seat, hands are at their targets, feet on the floor, limbs clear.
    """
    flesh, scale = flesh_of(body), body.height_cm / 170
    posture = Posture(_sitting_angles(moment), np.zeros(3))
    vertices, joints = pose(body, posture)
    place = _rest_on(seat, vertices[flesh.trunk], joints, moment["slide"])
    middle = (joints[JOINT_ID["left_hip"]] + joints[JOINT_ID["right_hip"]]) / 2 + place
    posture = Posture(posture.angles_rad, place)
    pulls = []
    for side in ("left", "right"):
        hand = middle + scale * np.array([moment[f"{side}_hand_{k}"] for k in "xyz"])
        swivel = np.radians(moment[f"{side}_swivel"])
        posture = reach(posture, flesh.rest_joints_m, flesh.aligned, side, hand, swivel)
        down = moment[f"{side}_hand_sink"]
        pulls.append(Pull(f"{side}_wrist", hand, HAND_HOLD * (1, 1, 1 - down)))
        pulls.append(sink(f"{side}_wrist", down))
        pulls.append(sink(f"{side}_ankle", moment[f"{side}_foot_sink"]))
    return pose(body, settle(flesh, posture, [FLOOR, *seat.solids()], pulls))


def _sitting_angles(moment: Moment) -> Float64:
    angles = np.zeros((N_JOINTS, 3))
    angles[JOINT_ID["pelvis"]] = (-moment["recline"], 0, 0)
    for joint in ("spine_lower", "spine_middle", "spine_upper"):
        angles[JOINT_ID[joint]] = np.array([moment["bend"], moment["lean"], moment["twist"]]) / 3
    for joint in ("neck", "head"):
        angles[JOINT_ID[joint]] = np.array([moment["nod"], -moment["lean"] / 2, moment["turn"]]) / 2
    for side in ("left", "right"):
        thigh, spread, twist, knee = (moment[f"{side}_{k}"] for k in ("thigh", "spread", "hip_twist", "knee"))
        # The thigh's height counts from the horizontal, whatever the pelvis does.
        angles[JOINT_ID[f"{side}_hip"]] = (90 + thigh - moment["recline"], spread, twist)
        angles[JOINT_ID[f"{side}_knee"], 0] = -knee
        # Feet stay flat as far as the ankle lets them.
        angles[JOINT_ID[f"{side}_ankle"], 0] = knee - 90 - thigh
        angles[JOINT_ID[f"{side}_elbow"], 2] = moment["pronation"]
    pelvis = angles[0].copy()
    limited = clamp(np.radians(angles))
    limited[0] = np.radians(pelvis)
    return limited


def _rest_on(seat: Seat, trunk: Float32, joints: Float64, slide: float) -> Float64:
    """Shift (3,) that puts the seat under the trunk, the back rest behind it, the knees before its edge."""
    up = seat.height - seat.give_m - float(trunk[:, 2].min())
    gap = seat.back_y(trunk[:, 2] + up) - trunk[:, 1]
    leant_back = float(gap.min()) + seat.give_m - max(slide, 0.0)
    knees_free = -KNEE_ROOM_M - float(joints[_KNEES, 1].max())
    return np.array([0.0, min(leant_back, knees_free), up])


_KNEES = [JOINT_ID["left_knee"], JOINT_ID["right_knee"]]
