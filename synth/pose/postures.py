"""Sitting, lying, crouching and standing: bodies posed by moments (pose parameters) that rest on their
support.

``synth/data/poses`` describes the parameters; flexion is forwards, a knee's positive. Limbs do not touch each
other or the furniture. Constants are untuned.
"""

from functools import cache
from typing import NamedTuple

import numba
import numpy as np
from scipy.spatial.transform import Rotation

from annotate.array_types import Float32, Float64
from synth.body.body import Body, pose
from synth.body.flesh import flesh_of
from synth.body.inverse import reach
from synth.body.skeleton import JOINT_ID, N_JOINTS, Posture, clamp
from synth.data_files import TRAINING, Cast
from synth.pose.pose_parameters import Behaviour, Moment, Posed, PoseFamily, pose_families
from synth.pose.settle import Pull, settle, sink
from synth.surface.furniture import FLOOR, Bed, Ground, Seat, Solid

KNEE_ROOM_M = 0.07  # for a calf between the knee joint and the seat's front edge
HAND_HOLD = np.full(3, 0.5)  # share of the way, per axis and round, by which a hand is drawn to its target

_SPINE = [JOINT_ID[name] for name in ("spine_lower", "spine_middle", "spine_upper")]
_NECK, _KNEES = [JOINT_ID["neck"], JOINT_ID["head"]], [JOINT_ID["left_knee"], JOINT_ID["right_knee"]]


class Poses(NamedTuple):
    """Pose families of a cast."""

    sitting: PoseFamily
    in_bed: PoseFamily
    fallen: PoseFamily
    slumped: PoseFamily
    upright: PoseFamily


@cache
def poses_of(cast: Cast) -> Poses:
    """Return a cast's pose families."""
    lying = pose_families("recumbent", cast)
    sitting, upright = (pose_families(name, cast)[name] for name in ("sitting", "upright"))
    return Poses(sitting, lying["in_bed"], lying["fallen"], lying["slumped"], upright)


SITTING, IN_BED, FALLEN, SLUMPED, UPRIGHT = poses_of(TRAINING)


def on_seat(seat: Seat, *activities: str, cast: Cast = TRAINING) -> Behaviour:
    """Return the behaviour of a seated person.

    activities: a cast's sitting activities to choose from; none = all.
    """
    family = poses_of(cast).sitting
    chosen = activities or tuple(family.activities)
    return Behaviour(family, chosen, lambda body, moment: sit(body, seat, moment))


def sit(body: Body, seat: Seat, moment: Moment) -> Posed:
    """Pose a body on a seat at a moment: vertices float32 (V, 3) and joints (J, 3), world, metres.

    The trunk rests on the seat, hands are at their targets, feet on the floor, limbs without collisions.
    """
    flesh, scale = flesh_of(body), body.height_cm / 170
    posture = Posture(_sitting_angles(moment), np.zeros(3))
    trunk, joints = pose(body, posture, flesh.trunk)
    place = rest_on(seat, trunk, joints, moment["slide"])
    middle = (joints[JOINT_ID["left_hip"]] + joints[JOINT_ID["right_hip"]]) / 2 + place
    posture = Posture(posture.angles_rad, place)
    pulls = []
    for side in ("left", "right"):
        hand = middle + scale * np.array([moment[f"{side}_hand_{k}"] for k in "xyz"])
        swivel = np.radians(moment[f"{side}_swivel"])
        posture = reach(posture, flesh, side, hand, swivel)
        down = moment[f"{side}_hand_sink"]
        pulls.append(Pull(f"{side}_wrist", hand, HAND_HOLD * (1, 1, 1 - down)))
        pulls.append(sink(f"{side}_wrist", down))
        pulls.append(sink(f"{side}_ankle", moment[f"{side}_foot_sink"]))
    return pose(body, settle(flesh, posture, [FLOOR, *seat.solids()], pulls))


def _sitting_angles(moment: Moment) -> Float64:
    angles = np.zeros((N_JOINTS, 3))
    angles[JOINT_ID["pelvis"]] = (-moment["recline"], 0, 0)
    angles[_SPINE] = np.array([moment["bend"], moment["lean"], moment["twist"]]) / 3
    angles[_NECK] = np.array([moment["nod"], -moment["lean"] / 2, moment["turn"]]) / 2
    for side in ("left", "right"):
        thigh, spread, twist, knee = (moment[f"{side}_{k}"] for k in ("thigh", "spread", "hip_twist", "knee"))
        # The thigh's height counts from the horizontal, whatever the pelvis does.
        angles[JOINT_ID[f"{side}_hip"]] = (90 + thigh - moment["recline"], spread, twist)
        angles[JOINT_ID[f"{side}_knee"], 0] = -knee
        # Feet stay flat as far as the ankle lets them.
        angles[JOINT_ID[f"{side}_ankle"], 0] = knee - 90 - thigh
        angles[JOINT_ID[f"{side}_elbow"], 2] = moment["pronation"]
    limited = clamp(np.radians(angles))
    limited[0] = np.radians(angles[0])
    return limited


def rest_on(seat: Seat, trunk: Float32, joints: Float64, slide: float) -> Float64:
    """Return the shift (3,) that puts the trunk on the seat, the back at the back rest, knees in front of the
    edge.

    slide: metres by which the person sits further forward.
    """
    up = seat.height - seat.give_m - float(trunk[:, 2].min())
    gap = seat.back_y(trunk[:, 2] + up) - trunk[:, 1]
    leant_back = float(gap.min()) + seat.give_m - max(slide, 0.0)
    knees_free = -KNEE_ROOM_M - float(joints[_KNEES, 1].max())
    return np.array([0.0, min(leant_back, knees_free), up])


# from the head joint to the bed's upper end where ``along`` is 0: the middle of the pillow
HEAD_FROM_EDGE_M = 0.20
HEAVE = 0.03  # rad^2/m^2; readiness of the body to rise off an arm under it, beside a limb's 1


def in_bed(bed: Bed, cast: Cast = TRAINING) -> Behaviour:
    """Return the behaviour of a cast's activities in a bed."""
    family = poses_of(cast).in_bed
    return Behaviour(family, tuple(family.activities), lambda body, moment: lie(body, bed, moment))


def lie(body: Body, support: Bed | Ground, moment: Moment) -> Posed:
    """Pose a lying body at a moment: vertices float32 (V, 3) and joints (J, 3), world, metres.

    The trunk rests on the support and sinks in by its softness; limbs and head sink until they are supported.
    """
    vertices, joints = pose(body, lain(body, support, moment))
    up = lift_needed(vertices, _carriers(support))
    return vertices + np.array([0, 0, up], np.float32), joints + np.array([0, 0, up])


def lain(body: Body, support: Bed | Ground, moment: Moment) -> Posture:
    """Return the posture of ``lie``, before the last vertical shift onto the support."""
    flesh, posture = flesh_of(body), posture_of_moment(moment)
    trunk, joints = pose(body, posture, flesh.trunk)
    place = _place(support, moment, joints)
    place[2] = height_to_rest(trunk + place.astype(np.float32), _carriers(support))
    solids = [FLOOR, *support.solids()]
    return settle(flesh, Posture(posture.angles_rad, place), solids, pulls_of(moment), HEAVE)


def _carriers(support: Bed | Ground) -> list[Solid]:
    return [FLOOR, *support.solids()[:1]]


def _place(support: Bed | Ground, moment: Moment, joints: Float64) -> Float64:
    """Return the pelvis' position (3,), at height 0, with the head near the support's upper end."""
    half = support.length / 2 - HEAD_FROM_EDGE_M
    spine = joints[JOINT_ID["head"]] - joints[JOINT_ID["pelvis"]]
    along = half - float(np.hypot(spine[0], spine[1])) - moment["along"]
    return np.array([moment["off"] * (support.width / 2), along, 0.0])


SEAT_GAP_M = 0.02  # from legs to a seat behind them


def on_legs(seat: Seat | None, *activities: str, cast: Cast = TRAINING) -> Behaviour:
    """Return the behaviour of a person on the floor.

    seat: seat behind the person, or None. activities: a cast's activities to choose from; none = all.
    """
    family = poses_of(cast).upright
    chosen = activities or tuple(family.activities)
    return Behaviour(family, chosen, lambda body, moment: rise(body, seat, moment))


def rise(body: Body, seat: Seat | None, moment: Moment) -> Posed:
    """Pose a body on its legs at a moment: vertices float32 (V, 3) and joints (J, 3), world, metres.

    The lowest vertex is on the floor; the legs stay in front of a seat's front edge (y = 0).
    """
    vertices, joints = pose(body, risen(body, seat, moment))
    shift = np.array([0.0, 0.0, height_to_rest(vertices, [FLOOR])])
    if seat is not None:
        shift[1] = min(0.0, -_behind(vertices, shift[2], seat))
    return vertices + shift.astype(np.float32), joints + shift


def risen(body: Body, seat: Seat | None, moment: Moment) -> Posture:
    """Return the posture of ``rise``, before a small shift onto the floor and off the seat."""
    flesh, posture = flesh_of(body), posture_of_moment(_soles_level(moment))
    vertices, _ = pose(body, posture)
    place = np.array([moment["off"] / 2, -moment["along"], height_to_rest(vertices, [FLOOR])])
    solids = [FLOOR]
    if seat is not None:
        place[1] = min(place[1], -SEAT_GAP_M - _behind(vertices, place[2], seat))
        solids += seat.solids()
    return settle(flesh, Posture(posture.angles_rad, place), solids, pulls_of(moment))


def _behind(vertices: Float32, up: float, seat: Seat) -> float:
    return float(vertices[vertices[:, 2] + up < seat.height, 1].max(initial=-10.0))


def _soles_level(moment: Moment) -> Moment:
    level = {
        f"{side}_ankle": moment[f"{side}_knee"] - moment[f"{side}_hip"] + moment["pitch"]
        + moment[f"{side}_ankle"]
        for side in ("left", "right")
    }  # fmt: skip
    return {**moment, **level}


def posture_of_moment(moment: Moment) -> Posture:
    """Return the posture of a moment, inside all joint limits, the pelvis at the origin, without contact."""
    angles = np.zeros((N_JOINTS, 3))
    angles[_SPINE] = np.array([moment["bend"], moment["lean"], moment["twist"]]) / 3
    angles[_NECK] = np.array([moment["nod"], 0.0, moment["turn"]]) / 2
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
    limited = clamp(np.radians(angles))
    # Roll about the long axis, then pitch, then heading; the pelvis' abduction turns by Ry(-abduction).
    turn = Rotation.from_euler("ZXZ", [moment["heading"], moment["pitch"], moment["roll"]], degrees=True)
    limited[0] = turn.as_euler("XYZ") * (1, -1, 1)
    return Posture(limited, np.zeros(3))


_LIMB_FIELDS = (
    "hip", "spread", "hip_twist", "knee", "ankle", "arm", "arm_spread", "arm_twist", "elbow", "pronation",
)  # fmt: skip


def pulls_of(moment: Moment) -> list[Pull]:
    """Return the pulls of gravity on head and limbs, by a moment's parameters."""
    pulls = [sink("head", moment["head_sink"])]
    for side in ("left", "right"):
        leg, arm = moment[f"{side}_leg_sink"], moment[f"{side}_arm_sink"]
        pulls += [sink(f"{side}_knee", leg), sink(f"{side}_ankle", leg)]
        pulls += [sink(f"{side}_elbow", arm), sink(f"{side}_wrist", arm)]
    return [pull for pull in pulls if pull.weight[2] > 0.02]


def height_to_rest(vertices_m: Float32, carriers: list[Solid]) -> float:
    """Return the shift upwards (m, may be negative) that puts vertices (V, 3) on the upright solids under
    them.

    The critical vertex ends as deep in the highest solid below as this solid's softness ``give_m``.
    """
    tops = [(*solid.low[:2], *solid.high[:2], solid.high[2] - solid.give_m) for solid in carriers]
    return float(_height_to_rest(vertices_m, np.array(tops)))


@numba.njit(cache=True)
def _height_to_rest(vertices: Float32, tops: Float64) -> float:
    """Return ``height_to_rest``. tops: (k, 5), least x and y, greatest x and y, and supporting height."""
    rise = -np.inf
    for v in range(len(vertices)):
        x, y, top = vertices[v, 0], vertices[v, 1], -np.inf
        for k in range(len(tops)):
            if tops[k, 0] < x < tops[k, 2] and tops[k, 1] < y < tops[k, 3]:
                top = max(top, tops[k, 4])
        rise = max(rise, top - vertices[v, 2])
    return rise


def lift_needed(vertices_m: Float32, carriers: list[Solid]) -> float:
    """Return the shift upwards (m) after which no vertex (V, 3) is deeper in a solid than its softness
    ``give_m``.

    A vertex nearer to a side of the solid than to its top is ignored, because it would leave by the side.
    """
    rise = 0.0
    for solid in carriers:
        below = solid.high[2] - vertices_m[:, 2]
        sunk = below > solid.give_m
        through_top = below[sunk] <= solid.depth_m(vertices_m[sunk]) + 1e-6
        if through_top.any():
            rise = max(rise, float(below[sunk][through_top].max()) - solid.give_m)
    return rise
