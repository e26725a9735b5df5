"""Bodies of standing people, from the numbers of ``synth/pose/standing_parameters.py``.

Inverse kinematics puts feet on the floor and hands to their places. The trunk's mass stands over the feet.
Limbs keep clear of each other. Constants are untuned unless a source is given.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np

from annotate.array_types import Float32, Float64
from synth.body.body import Body, pose
from synth.body.flesh import CHAINS, N_STATIONS, Flesh, flesh_of
from synth.body.inverse import FootGoal, place_hand, plant
from synth.body.skeleton import JOINT_ID, N_JOINTS, Posture, clamp, forward, turn
from synth.data_files import table, table_of
from synth.pose.settle import Pull, settle
from synth.pose.standing_parameters import OTHER, SIDES, Standing, carried
from synth.surface.furniture import FLOOR
from synth.surface.rasterize import Mesh

SIGN = {"left": 1.0, "right": -1.0}
BALANCE = 0.75  # of the trunk's shift forwards, made up for by the hips: the legs are a third of the mass
FOOT_HOLD = np.full(3, 0.5)  # share of the way, per axis and round, by which a foot is kept in its place
ARM_DRAW, SPREAD_RAD = np.full(3, 0.5), np.radians(20.0)  # the same of a hanging arm, and its start outside
HAND_SWING_M = 0.62  # from the shoulder to a hanging hand
_SPINE = [JOINT_ID[name] for name in ("spine_lower", "spine_middle", "spine_upper")]
_NECK = [JOINT_ID["neck"], JOINT_ID["head"]]
# Shares of the trunk's mass by joint, roughly Winter 2009 (table 4.1).
_MASSES = {"pelvis": 0.3, "spine_middle": 0.25, "spine_upper": 0.15, "neck": 0.2, "head": 0.1}


class Stood(NamedTuple):
    """Standing body: vertices float32 (V, 3), joints (J, 3), world, metres, and carried objects."""

    vertices_m: Float32
    joints_m: Float64
    things: list[Mesh]


def stand(body: Body, how: Standing) -> Stood:
    """Pose a standing body, with its lowest vertex on the floor, and give it the objects that it carries."""
    vertices, joints = pose(body, stood(body, how))
    up = np.array([0.0, 0.0, -FLOOR.give_m - float(vertices[:, 2].min())])
    vertices, joints = vertices + up.astype(np.float32), joints + up
    return Stood(vertices, joints, carried(how, joints))


def stood(body: Body, how: Standing) -> Posture:
    """Return the posture of ``stand``, before a vertical shift onto the floor."""
    return _Stander(flesh_of(body), how, body.height_cm / 170).posture()


@dataclass(frozen=True)
class _Foot:
    """Foot on the floor: position (3,) of its ankle when flat, yaw, and heel rise."""

    place_m: Float64
    yaw_rad: float
    heel_rad: float

    def rotation(self, more_rad: float) -> Float64:
        """Return the rotation (3, 3) to the world, with the heel raised by ``heel_rad + more_rad``."""
        return turn(2, self.yaw_rad) @ turn(0, self.heel_rad + more_rad)

    def ankle(self, flesh: Flesh, side: str, more_rad: float = 0.0) -> Float64:
        """Return the ankle's place (3,): a foot rolls over its toes, or backwards over its heel."""
        chain, joint = CHAINS[f"{side}_foot"], JOINT_ID[f"{side}_ankle"]
        y, radii = flesh.centres_m[chain, 1], flesh.radii_m[chain]
        heel = self.heel_rad + more_rad
        end = (y - radii).min() + 0.02 if heel > 0 else (y + radii).max()
        pivot = np.array([0.0, end - flesh.rest_joints_m[joint, 1], -flesh.rest_joints_m[joint, 2]])
        moved: Float64 = (turn(2, self.yaw_rad) - self.rotation(more_rad)) @ pivot
        return self.place_m + moved


@cache
def _gives() -> Float64:
    gives = np.zeros(N_STATIONS)
    for name, chain in CHAINS.items():
        kind = name.removeprefix("left_").removeprefix("right_")
        gives[chain] = table("poses/standing")["gives"].get(kind, 0.0)
    return gives


@dataclass(frozen=True)
class _Stander:
    """Procedure that poses a standing body; scale: its size relative to 1.70 m."""

    flesh: Flesh
    how: Standing
    scale: float

    def posture(self) -> Posture:
        feet = self._feet()
        posture, pulls = self._with_arms(self._on_feet(self._upper_body(), feet))
        pulls += [Pull(f"{side}_ankle", feet[side].ankle(self.flesh, side), FOOT_HOLD) for side in SIDES]
        firm = 1 - np.clip(self.how.legs["press"], 0.0, 1.4) * _gives()
        settled = settle(self.flesh._replace(radii_m=self.flesh.radii_m * firm), posture, [FLOOR], pulls)
        angles = settled.angles_rad.copy()
        for side in SIDES:
            # Hands that hang beside a thigh leave it by their gap.
            gap = max(self.how.arms[side].get("gap", 0.0), 0.0)
            angles[JOINT_ID[f"{side}_shoulder"], 1] += gap / HAND_SWING_M if gap else 0.0
        return Posture(clamp(angles), settled.pelvis_m)

    def _places(self, posture: Posture) -> tuple[Float64, Float64]:
        return forward(posture, self.flesh.rest_joints_m, self.flesh.aligned)

    def _length(self, start: int, end: int) -> np.float64:
        return np.float64(np.linalg.norm(self.flesh.rest_joints_m[end] - self.flesh.rest_joints_m[start]))

    def _upper_body(self) -> Float64:
        """Return angles (J, 3) of pelvis, spine and head; limbs at zero."""
        angles, legs, sign = np.zeros((N_JOINTS, 3)), self.how.legs, SIGN[self.how.stands]
        # The spine makes up for the pelvis' tilt, and a little more or less: lean.
        spine = (legs["bend"], -sign * (legs["lean"] + legs["tilt"]), legs["twist"])
        angles[_SPINE] = np.array(spine) / 3
        angles[_NECK] = np.array([legs["nod"] - 0.4 * legs["pitch"], legs["head_lean"], legs["turn"]]) / 2
        limited = clamp(np.radians(angles))
        limited[0] = np.radians([legs["pitch"], sign * legs["tilt"], 0.0])
        return limited

    def _feet(self) -> dict[str, _Foot]:
        """Return both feet by side, rotated relative to the pelvis."""
        legs, turned = self.how.legs, np.radians(self.how.legs["turned"])
        result = {}
        for side in SIDES:
            sign, kind = SIGN[side], "stand" if side == self.how.stands else "free"
            ahead = legs["ahead"] * (kind == "free")
            lift = max(legs["lift"], 0.0) * (kind == "free")
            place = self.scale * np.array([sign * legs["ankles"] / 2, -ahead, lift])
            place[2] += self.flesh.rest_joints_m[JOINT_ID[f"{side}_ankle"], 2]
            c, s = np.cos(-turned), np.sin(-turned)
            place[:2] = c * place[0] - s * place[1], s * place[0] + c * place[1]
            yaw = sign * np.radians(legs[f"{kind}_toe_out"]) - turned
            result[side] = _Foot(place, yaw, np.radians(legs[f"{kind}_heel"]))
        return result

    def _on_feet(self, angles: Float64, feet: Mapping[str, _Foot]) -> Posture:
        how = self.how
        _, joints = self._places(Posture(angles, np.zeros(3)))
        share = min(max(how.legs["weight"], 0.0), 1.0)
        over = share * feet[how.stands].place_m + (1 - share) * feet[OTHER[how.stands]].place_m
        mass = sum(m * joints[JOINT_ID[name]] for name, m in _MASSES.items())
        # The ankles are behind the middle of the feet.
        pelvis = over - BALANCE * np.asarray(mass) + (0.0, -0.02, 0.0)
        pelvis[2] = 0.0
        knees = {how.stands: how.legs["knee"], OTHER[how.stands]: 2.0}
        offs = {
            side: joints[JOINT_ID[f"{side}_hip"]] + pelvis - feet[side].ankle(self.flesh, side)
            for side in SIDES
        }
        pelvis[2] = min(
            feet[side].ankle(self.flesh, side)[2]
            + self._rise(side, off, knees[side])
            - joints[JOINT_ID[f"{side}_hip"], 2]
            for side, off in offs.items()
        )
        posture = Posture(angles, pelvis)
        for side in SIDES:
            posture = self._planted(posture, side, feet[side])
        return posture

    def _rise(self, side: str, off: Float64, knee_deg: float) -> float:
        """Return the hip's height over the ankle at a knee flexion. off: (3,), vector between them."""
        hip, knee, foot = (JOINT_ID[f"{side}_{name}"] for name in ("hip", "knee", "ankle"))
        thigh, shank = self._length(hip, knee), self._length(knee, foot)
        square = thigh**2 + shank**2 + 2 * thigh * shank * np.cos(np.radians(max(knee_deg, 2.0)))
        level = min(off[0] ** 2 + off[1] ** 2, 0.8 * square)
        return float(np.sqrt(square - level))

    def _planted(self, posture: Posture, side: str, foot: _Foot) -> Posture:
        """Return the posture with a foot on the floor; where the ankle's limit is exceeded, the heel rises
        instead.
        """
        heel, knee_out = 0.0, np.radians(self.how.legs["knee_out"])
        for _ in range(3):
            goal = FootGoal(foot.ankle(self.flesh, side, heel), foot.rotation(heel), knee_out)
            planted, beyond = plant(posture, self.flesh, side, goal)
            if beyond < 0.02:
                break
            heel += beyond
        return planted

    def _with_arms(self, posture: Posture) -> tuple[Posture, list[Pull]]:
        pulls = []
        frames, joints = self._places(posture)
        for side in SIDES:
            arm = self.how.arms[side]
            if "arm" in arm:
                posture, drawn = self._hung(posture, side, frames, joints)
                pulls += drawn
            else:
                target = self._target(side, frames, joints)
                posture = place_hand(posture, self.flesh, side, target, np.radians(arm["swivel"]))
                if arm.get("hold", 0.0) > 0:
                    pulls.append(Pull(f"{side}_wrist", target, np.full(3, arm["hold"])))
            angles = posture.angles_rad.copy()
            angles[JOINT_ID[f"{side}_elbow"], 2] = np.radians(arm.get("pronation", 0.0))
            wrist = [arm.get("wrist", 0.0), arm.get("wrist_spread", 0.0)]
            angles[JOINT_ID[f"{side}_wrist"], :2] = np.radians(wrist)
            posture = Posture(clamp(angles), posture.pelvis_m)
        return posture, pulls

    def _hung(
        self, posture: Posture, side: str, frames: Float64, joints: Float64
    ) -> tuple[Posture, list[Pull]]:
        """Return the posture with one hanging arm, and the pulls of elbow and wrist towards the body.

        The arm's flexion counts from the vertical. An arm with a gap to the body starts spread; only this arm
        has pulls.
        """
        arm, angles = self.how.arms[side], posture.angles_rad.copy()
        shoulder, chest = JOINT_ID[f"{side}_shoulder"], frames[JOINT_ID["spine_upper"]]
        forwards = np.degrees(np.arctan2(-chest[1, 2], chest[2, 2]))
        swing = arm.get("swing", 0.0) * (joints[JOINT_ID[f"{side}_ankle"], 1] - joints[0, 1])
        angles[shoulder] = np.radians((arm["arm"] + forwards + swing, arm["arm_spread"], arm["arm_twist"]))
        angles[shoulder + 1, 0] = np.radians(arm["elbow"])
        hung = Posture(clamp(angles), posture.pelvis_m)
        if "gap" not in arm:
            return hung, []
        _, places = self._places(hung)
        names = [f"{side}_elbow", f"{side}_wrist"]
        angles[shoulder, 1] += SPREAD_RAD
        drawn = [Pull(name, places[JOINT_ID[name]], ARM_DRAW) for name in names]
        return Posture(clamp(angles), posture.pelvis_m), drawn

    def _target(self, side: str, frames: Float64, joints: Float64) -> Float64:
        arm = self.how.arms[side]
        if "azimuth" in arm:
            azimuth, elevation = np.radians([arm["azimuth"], arm["elevation"]])
            level = np.cos(elevation)
            way = np.array(
                [SIGN[side] * level * np.sin(azimuth), -level * np.cos(azimuth), np.sin(elevation)]
            )
            shoulder, elbow, wrist = (JOINT_ID[f"{side}_{name}"] for name in ("shoulder", "elbow", "wrist"))
            length = self._length(shoulder, elbow) + self._length(elbow, wrist)
            far = float(np.clip(arm["distance"], 0.3, 0.99)) * length
            return np.asarray(joints[shoulder] + frames[JOINT_ID["spine_upper"]] @ (far * way))
        at = table_of(self.how.cast, "poses/standing")["hands"][self.how.hands[side]]["at"]
        origin, axes = _anchor(at, frames, joints, side)
        off = np.array([SIGN[side] * arm["out"], arm["back"], arm["up"]])
        return np.asarray(origin + axes @ (self.scale * off))


def _anchor(at: str, frames: Float64, joints: Float64, side: str) -> tuple[Float64, Float64]:
    """Return origin (3,) and axes (3, 3) of the frame in which a hand's position is given."""
    if at in ("knee", "ankle"):
        return joints[JOINT_ID[f"{side}_{at}"]], np.eye(3)
    if at == "head":
        return joints[JOINT_ID["head"]], frames[JOINT_ID["head"]]
    pair, carrier = {"chest": ("shoulder", "spine_upper"), "pelvis": ("hip", "pelvis")}[at]
    middle = (joints[JOINT_ID[f"left_{pair}"]] + joints[JOINT_ID[f"right_{pair}"]]) / 2
    return middle, frames[JOINT_ID[carrier]]
