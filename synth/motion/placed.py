"""A frame of a motion on any body: its angles, feet where the motion's are, limbs clear of each other."""

import numpy as np

from annotate.array_types import Float64
from synth.body.body import Body, pose
from synth.body.flesh import Flesh, flesh_of
from synth.body.skeleton import JOINT_ID, LIMITS_RAD, Posture, clamp, forward
from synth.markers.person_fit import leg_length_m, zero_bones
from synth.motion.floor import lowest_m
from synth.motion.grounded import Grounded
from synth.pose.moment import Posed
from synth.pose.postures import height_to_rest
from synth.pose.settle import settle, stations_m
from synth.surface.furniture import FLOOR, Seat, Solid

HOVER_M = 0.02
"""A foot that is lifted by less is drawn to the floor, by 7 mm at most. Chosen by eye."""
STEP_M = 0.05
"""A foot so much higher than the other decides less and less about the height of the hips. Chosen by eye."""
_LEGS = [[JOINT_ID[f"{side}_{name}"] for name in ("hip", "knee", "ankle")] for side in ("left", "right")]


def stand(body: Body, grounded: Grounded, frame: int, seat: Seat | None = None) -> Posed:
    """A body in one frame: vertices float32 (V, 3) and joints (J, 3), the pelvis over the origin, metres.

    What stands in the motion stands on the floor, what is in the air is as high over it, scaled to the body's
    legs.
    """
    flesh = flesh_of(body)
    scale = leg_length_m(zero_bones(body.joints_m)) / grounded.leg_m
    wanted = scale * hovering(grounded.clear_m[frame])
    angles = clamp(grounded.angles_rad[frame])
    angles[0] = grounded.angles_rad[frame, 0]
    posture = feet_to(flesh, Posture(angles, np.zeros(3)), wanted)
    carriers: list[Solid] = [FLOOR]
    airborne = float(wanted.min())
    lifted = Posture(posture.angles_rad, posture.pelvis_m - np.array([0, 0, airborne]))
    settled = settle(flesh, lifted, carriers, [])
    vertices, joints = pose(body, settled)
    up = np.array([0.0, 0.0, height_to_rest(vertices, carriers) + airborne])
    return vertices + up.astype(np.float32), joints + up


def hovering(clear_m: Float64) -> Float64:
    """Heights over the floor, those of millimetres brought down to it: no recorded foot keeps still."""
    return np.asarray(clear_m * (1 - np.exp(-clear_m / HOVER_M)))


def feet_to(flesh: Flesh, posture: Posture, wanted_m: Float64) -> Posture:
    """The posture with its hips at the height at which its feet come to theirs, and knees bent as it takes.

    wanted_m: (3,) height of left foot, right foot and all else over the floor.
    """
    soles = _soles(flesh, posture)
    # Only bending brings a foot nearer: the hips go down to where the lower of the two feet arrives.
    rise = wanted_m - soles + (wanted_m - wanted_m.min()) ** 2 / STEP_M
    up = float(rise.min())
    angles = posture.angles_rad.copy()
    pelvis = posture.pelvis_m + np.array([0, 0, up])
    for foot, leg in enumerate(_LEGS):
        missing = wanted_m[foot] - soles[foot] - up
        weight = np.exp(-(((wanted_m[foot] - wanted_m.min()) / (2 * STEP_M)) ** 2))
        for _ in range(3):
            _bend(flesh, angles, leg, weight * missing)
            missing = wanted_m[foot] - _soles(flesh, Posture(angles, pelvis))[foot]
    return Posture(angles, pelvis)


def _soles(flesh: Flesh, posture: Posture) -> Float64:
    frames, joints = forward(posture, flesh.rest_joints_m, flesh.aligned)
    return lowest_m(stations_m(flesh, frames, joints), flesh.radii_m)


def _bend(flesh: Flesh, angles: Float64, leg: list[int], rise_m: float) -> None:
    """Bend (or stretch) a leg so that its foot rises by so much, the foot's pitch and the leg's line kept."""
    hip, knee, ankle = leg
    rest = flesh.rest_joints_m
    thigh, shank = (float(np.linalg.norm(rest[b] - rest[a])) for a, b in ((hip, knee), (knee, ankle)))
    _, joints = forward(Posture(angles, np.zeros(3)), rest, flesh.aligned)
    line = joints[ankle] - joints[hip]
    length = float(np.linalg.norm(line))
    down = max(-float(line[2]) / length, 0.3)
    shorter = float(np.clip(length - rise_m / down, abs(thigh - shank) + 0.02, 0.9995 * (thigh + shank)))

    def folded(reach: float) -> tuple[float, float]:
        """Bend of the knee, and angle between thigh and the line from hip to ankle."""
        knee_cos = (thigh**2 + shank**2 - reach**2) / (2 * thigh * shank)
        hip_cos = (thigh**2 + reach**2 - shank**2) / (2 * thigh * reach)
        return float(np.pi - np.arccos(np.clip(knee_cos, -1, 1))), float(np.arccos(np.clip(hip_cos, -1, 1)))

    bent, lean = folded(shorter)
    bent_before, lean_before = folded(min(length, 0.9995 * (thigh + shank)))
    angles[knee, 0] -= bent - bent_before
    angles[hip, 0] += lean - lean_before
    angles[ankle, 0] += (bent - bent_before) - (lean - lean_before)
    for joint in leg:
        angles[joint, 0] = np.clip(angles[joint, 0], *LIMITS_RAD[joint, 0])
