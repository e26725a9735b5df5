"""Bodies of standing people, computed from the numbers of ``synth/pose/standing_parameters.py``.

Feet are put on the floor and hands to their places by inverse kinematics, the trunk's mass stands over the
feet, and no limb is in another.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np

from annotate.array_types import Float32, Float64
from synth.body.body import Body, pose
from synth.body.flesh import CHAINS, N_STATIONS, Flesh, flesh_of
from synth.body.inverse import place_hand, plant
from synth.body.skeleton import JOINT_ID, N_JOINTS, Posture, clamp, forward, turn
from synth.data_files import table
from synth.pose.settle import Pull, settle
from synth.pose.standing_parameters import OTHER, SIDES, Standing, carried
from synth.surface.furniture import FLOOR
from synth.surface.rasterize import Mesh

SIGN = {"left": 1.0, "right": -1.0}
BALANCE = 0.75
"""Share of the trunk's shift forwards that the hips make up for: the legs below are a third of the mass."""
FOOT_HOLD = np.array([0.5, 0.5, 0.5])
"""Share of the way, per axis and round of settling, by which a foot is kept in its place. Chosen by eye."""
ARM_DRAW, SPREAD_RAD = np.full(3, 0.5), np.radians(20.0)
"""Share of the way, per axis and round, by which a hanging arm is drawn to the body, from so far outside."""
_SPINE = [JOINT_ID[name] for name in ("spine_lower", "spine_middle", "spine_upper")]
_NECK = [JOINT_ID["neck"], JOINT_ID["head"]]
_MASSES = {"pelvis": 0.3, "spine_middle": 0.25, "spine_upper": 0.15, "neck": 0.2, "head": 0.1}
"""Shares of the trunk's mass by joint, roughly those of Winter 2009 (table 4.1)."""


class Stood(NamedTuple):
    """A standing body: vertices float32 (V, 3), joints (J, 3), world, metres, and what it carries."""

    vertices_m: Float32
    joints_m: Float64
    things: list[Mesh]


def stand(body: Body, how: Standing) -> Stood:
    """A body on the floor, its pelvis facing -y, its feet about the origin."""
    vertices, joints = pose(body, stood(body, how))
    up = np.array([0.0, 0.0, -FLOOR.give_m - float(vertices[:, 2].min())])
    vertices, joints = vertices + up.astype(np.float32), joints + up
    return Stood(vertices, joints, carried(how, joints))


def stood(body: Body, how: Standing) -> Posture:
    """Its posture, up to a shift onto the floor."""
    flesh, scale = flesh_of(body), body.height_cm / 170
    feet = _feet(flesh, how, scale)
    posture = _on_feet(flesh, how, _upper_body(how), feet)
    posture, pulls = _with_arms(flesh, how, posture, scale)
    pulls += [Pull(f"{side}_ankle", feet[side].ankle(flesh, side, 0.0), FOOT_HOLD) for side in SIDES]
    soft = flesh._replace(radii_m=flesh.radii_m * (1 - np.clip(how.legs["press"], 0.0, 1.4) * _gives()))
    settled = settle(soft, posture, [FLOOR], pulls)
    return _hands_off(how, settled, scale)


@cache
def _gives() -> Float64:
    """Share of the radius at each station (S,) that gives to other flesh."""
    gives = np.zeros(N_STATIONS)
    for name, chain in CHAINS.items():
        gives[chain] = table("poses/standing")["gives"].get(
            name.removeprefix("left_").removeprefix("right_"), 0.0
        )
    return gives


def _upper_body(how: Standing) -> Float64:
    """Angles (J, 3) of pelvis, spine and head; limbs at zero."""
    angles, legs, sign = np.zeros((N_JOINTS, 3)), how.legs, SIGN[how.stands]
    # The spine makes up for the pelvis' tilt, and a little more or less: lean.
    spine = (legs["bend"], -sign * (legs["lean"] + legs["tilt"]), legs["twist"])
    angles[_SPINE] = np.array(spine) / 3
    angles[_NECK] = np.array([legs["nod"] - 0.4 * legs["pitch"], legs["head_lean"], legs["turn"]]) / 2
    limited = clamp(np.radians(angles))
    limited[0] = np.radians([legs["pitch"], sign * legs["tilt"], 0.0])
    return limited


@dataclass(frozen=True)
class Foot:
    """A foot on the floor. place_m: (3,) where its ankle would stand were it flat; yaw_rad; heel_rad: up."""

    place_m: Float64
    yaw_rad: float
    heel_rad: float

    def rotation(self, more_rad: float) -> Float64:
        """Rotation (3, 3) to the world, the heel raised by ``more_rad`` above its own."""
        return turn(2, self.yaw_rad) @ turn(0, self.heel_rad + more_rad)

    def ankle(self, flesh: Flesh, side: str, more_rad: float) -> Float64:
        """Place (3,) of the ankle: a foot rolls over its toes, or backwards over its heel."""
        chain, joint = CHAINS[f"{side}_foot"], JOINT_ID[f"{side}_ankle"]
        y, radii = flesh.centres_m[chain, 1], flesh.radii_m[chain]
        heel = self.heel_rad + more_rad
        end = (y - radii).min() + 0.02 if heel > 0 else (y + radii).max()
        pivot = np.array([0.0, end - flesh.rest_joints_m[joint, 1], -flesh.rest_joints_m[joint, 2]])
        moved: Float64 = (turn(2, self.yaw_rad) - self.rotation(more_rad)) @ pivot
        return self.place_m + moved


def _feet(flesh: Flesh, how: Standing, scale: float) -> dict[str, Foot]:
    """Both feet by side; the turn of the pelvis against them turns them the other way."""
    legs, turned = how.legs, np.radians(how.legs["turned"])
    result = {}
    for side in SIDES:
        sign, kind = SIGN[side], "stand" if side == how.stands else "free"
        ahead = legs["ahead"] * (kind == "free")
        lift = max(legs["lift"], 0.0) * (kind == "free")
        place = scale * np.array([sign * legs["ankles"] / 2, -ahead, lift])
        place[2] += flesh.rest_joints_m[JOINT_ID[f"{side}_ankle"], 2]
        c, s = np.cos(-turned), np.sin(-turned)
        place[:2] = c * place[0] - s * place[1], s * place[0] + c * place[1]
        yaw = sign * np.radians(legs[f"{kind}_toe_out"]) - turned
        result[side] = Foot(place, yaw, np.radians(legs[f"{kind}_heel"]))
    return result


def _on_feet(flesh: Flesh, how: Standing, angles: Float64, feet: Mapping[str, Foot]) -> Posture:
    """The posture whose pelvis is over the feet and whose feet are in their places.

    Where an ankle cannot bend so far, the heel comes up instead.
    """
    posture = Posture(angles, np.zeros(3))
    _, joints = forward(posture, flesh.rest_joints_m, flesh.aligned)
    share = min(max(how.legs["weight"], 0.0), 1.0)
    over = share * feet[how.stands].place_m + (1 - share) * feet[OTHER[how.stands]].place_m
    mass = sum(m * joints[JOINT_ID[name]] for name, m in _MASSES.items())
    # The ankles are behind the middle of the feet.
    pelvis = over - BALANCE * np.asarray(mass) + (0.0, -0.02, 0.0)
    pelvis[2] = 0.0
    ankles = {side: feet[side].ankle(flesh, side, 0.0) for side in SIDES}
    knees = {how.stands: how.legs["knee"], OTHER[how.stands]: 2.0}
    pelvis[2] = min(_height_over(flesh, joints, pelvis, side, ankles[side], knees[side]) for side in SIDES)
    posture = Posture(angles, pelvis)
    for side in SIDES:
        posture = _planted(flesh, posture, side, feet[side], np.radians(how.legs["knee_out"]))
    return posture


def _height_over(
    flesh: Flesh, joints: Float64, pelvis: Float64, side: str, ankle: Float64, knee_deg: float
) -> float:
    """Height of the pelvis at which a leg stands on its ankle with that much flexion of the knee."""
    hip, knee, foot = (JOINT_ID[f"{side}_{name}"] for name in ("hip", "knee", "ankle"))
    rest = flesh.rest_joints_m
    thigh, shank = np.linalg.norm(rest[knee] - rest[hip]), np.linalg.norm(rest[foot] - rest[knee])
    square = thigh**2 + shank**2 + 2 * thigh * shank * np.cos(np.radians(max(knee_deg, 2.0)))
    off = joints[hip] + pelvis - ankle
    level = min(off[0] ** 2 + off[1] ** 2, 0.8 * square)
    return float(ankle[2] + np.sqrt(square - level) - joints[hip, 2])


def _planted(flesh: Flesh, posture: Posture, side: str, foot: Foot, knee_out_rad: float) -> Posture:
    heel = 0.0
    for _ in range(3):
        ankle, rotation = foot.ankle(flesh, side, heel), foot.rotation(heel)
        planted, beyond = plant(
            posture, flesh.rest_joints_m, flesh.aligned, side, ankle, rotation, knee_out_rad
        )
        if beyond < 0.02:
            break
        heel += beyond
    return planted


def _with_arms(flesh: Flesh, how: Standing, posture: Posture, scale: float) -> tuple[Posture, list[Pull]]:
    """The posture with both hands in their places, and pulls that keep them there while it settles."""
    pulls = []
    frames, joints = forward(posture, flesh.rest_joints_m, flesh.aligned)
    for side in SIDES:
        arm = how.arms[side]
        elbow, wrist = JOINT_ID[f"{side}_elbow"], JOINT_ID[f"{side}_wrist"]
        if "arm" in arm:
            posture, drawn = _hung(flesh, how, posture, frames, joints, side)
            pulls += drawn
        else:
            target = _target(flesh, how, frames, joints, side, scale)
            swivel = np.radians(arm["swivel"])
            posture = place_hand(posture, flesh.rest_joints_m, flesh.aligned, side, target, swivel)
            if arm.get("hold", 0.0) > 0:
                pulls.append(Pull(f"{side}_wrist", target, np.full(3, arm["hold"])))
        angles = posture.angles_rad.copy()
        angles[elbow, 2] = np.radians(arm.get("pronation", 0.0))
        angles[wrist, :2] = np.radians([arm.get("wrist", 0.0), arm.get("wrist_spread", 0.0)])
        posture = Posture(clamp(angles), posture.pelvis_m)
    return posture, pulls


def _hung(
    flesh: Flesh, how: Standing, posture: Posture, frames: Float64, joints: Float64, side: str
) -> tuple[Posture, list[Pull]]:
    """The posture with one arm hanging; flexion counts from the vertical, whatever the trunk does.

    An arm with a gap comes from outside: it starts spread, and pulls draw it to its place, so that it ends
    beside trunk and thigh and not in them.
    """
    arm, angles, shoulder = how.arms[side], posture.angles_rad.copy(), JOINT_ID[f"{side}_shoulder"]
    chest = frames[JOINT_ID["spine_upper"]]
    forwards = np.degrees(np.arctan2(-chest[1, 2], chest[2, 2]))
    pelvis, foot = joints[0], joints[JOINT_ID[f"{side}_ankle"]]
    swing = arm.get("swing", 0.0) * (foot[1] - pelvis[1])
    angles[shoulder] = np.radians((arm["arm"] + forwards + swing, arm["arm_spread"], arm["arm_twist"]))
    angles[shoulder + 1, 0] = np.radians(arm["elbow"])
    hung = Posture(clamp(angles), posture.pelvis_m)
    if "gap" not in arm:
        return hung, []
    _, places = forward(hung, flesh.rest_joints_m, flesh.aligned)
    drawn = [
        Pull(f"{side}_{name}", places[JOINT_ID[f"{side}_{name}"]], ARM_DRAW) for name in ("elbow", "wrist")
    ]
    angles[shoulder, 1] += SPREAD_RAD
    return Posture(clamp(angles), posture.pelvis_m), drawn


def _target(
    flesh: Flesh, how: Standing, frames: Float64, joints: Float64, side: str, scale: float
) -> Float64:
    """Place (3,) of a wrist in the world."""
    arm = how.arms[side]
    if "azimuth" in arm:
        azimuth, elevation = np.radians([arm["azimuth"], arm["elevation"]])
        level = np.cos(elevation)
        way = np.array([SIGN[side] * level * np.sin(azimuth), -level * np.cos(azimuth), np.sin(elevation)])
        shoulder, elbow, wrist = (JOINT_ID[f"{side}_{name}"] for name in ("shoulder", "elbow", "wrist"))
        rest = flesh.rest_joints_m
        length = np.linalg.norm(rest[elbow] - rest[shoulder]) + np.linalg.norm(rest[wrist] - rest[elbow])
        far = float(np.clip(arm["distance"], 0.3, 0.99)) * length
        return np.asarray(joints[shoulder] + frames[JOINT_ID["spine_upper"]] @ (far * way))
    at = table("poses/standing")["hands"][how.hands[side]]["at"]
    origin, axes = _anchor(at, frames, joints, side)
    off = np.array([SIGN[side] * arm["out"], arm["back"], arm["up"]])
    return np.asarray(origin + axes @ (scale * off))


def _anchor(at: str, frames: Float64, joints: Float64, side: str) -> tuple[Float64, Float64]:
    """Origin (3,) and axes (3, 3) that a hand's place counts from."""
    if at in ("knee", "ankle"):
        return joints[JOINT_ID[f"{side}_{at}"]], np.eye(3)
    if at == "head":
        return joints[JOINT_ID["head"]], frames[JOINT_ID["head"]]
    pair, carrier = {"chest": ("shoulder", "spine_upper"), "pelvis": ("hip", "pelvis")}[at]
    middle = (joints[JOINT_ID[f"left_{pair}"]] + joints[JOINT_ID[f"right_{pair}"]]) / 2
    return middle, frames[JOINT_ID[carrier]]


def _hands_off(how: Standing, posture: Posture, scale: float) -> Posture:
    """Hands that hang beside a thigh leave it by their gap."""
    angles = posture.angles_rad.copy()
    for side in SIDES:
        gap = max(how.arms[side].get("gap", 0.0), 0.0)
        angles[JOINT_ID[f"{side}_shoulder"], 1] += gap / 0.62 if gap else 0.0
    return Posture(clamp(angles), posture.pelvis_m)
