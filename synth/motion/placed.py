"""Motion on any body, in one frame or as a smooth whole: feet as in the motion, limbs without collisions.

Constants are untuned.
"""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from annotate.array_types import Float64, Int64
from synth.body.body import Body, pose
from synth.body.flesh import Flesh, flesh_of
from synth.body.skeleton import JOINT_ID, JOINTS, LIMITS_RAD, Posture, clamp, euler_rad, forward, rotations
from synth.markers.person_fit import leg_length_m, zero_bones
from synth.motion.grounded import Grounded, lowest_m
from synth.pose.pose_parameters import Posed
from synth.pose.postures import height_to_rest, rest_on
from synth.pose.settle import Pull, settle, stations_m
from synth.surface.furniture import FLOOR, Chair, Seat, Solid

HOVER_M = 0.02  # a foot lifted by less is drawn to the floor, by 7 mm at most
STEP_M = 0.05  # a foot this much higher than the other decides less and less about the height of the hips
FOOT_HOLD = 0.5  # share of the way, per axis and round, by which a standing foot is drawn back
ASTRAY_M = 0.015  # tolerated distance of a standing foot from its height
OUT_OF_REACH_M = 0.06  # a foot farther from the floor lies or hangs
LEANS_RAD = (0.0, 0.2, 0.4, 0.6)  # of a trunk backwards, tried in this order
LEAN_COST_M = 0.05  # gain in a foot's distance that is worth a lean of one radian
_LEGS = [[JOINT_ID[f"{side}_{name}"] for name in ("hip", "knee", "ankle")] for side in ("left", "right")]
LEASH_M = 0.8  # greatest way from the middle: longer walks are drawn together
STRIDE_S = 0.5  # time over which a way is a walk rather than swaying
CALM_S = 0.06  # time over which contacts begin and end
TRIED_SITS = 8  # seated frames whose median height a seat has


def stand(body: Body, grounded: Grounded, frame: int) -> Posed:
    """Pose a body as in one frame, over the origin and facing -y: vertices float32 (V, 3), joints (J, 3),
    metres.

    Feet that stand in the motion stand on the floor. Airborne feet have their recorded height, scaled to the
    body's legs. Limbs do not touch each other or the floor.
    """
    turn = -heading_rad(grounded.angles_rad[frame, 0])
    posture, wanted = standing(body, grounded, frame, turn)
    return pose(body, cleared(body, posture, wanted, [FLOOR]))


def cleared(body: Body, posture: Posture, wanted_m: Float64, solids: list[Solid]) -> Posture:
    """Return a posture without collisions, its lowest point at the least of the heights ``wanted_m``.

    posture, wanted_m: results of ``standing``.
    """
    low = wanted_m.min()
    airborne = np.array([0.0, 0.0, low])
    placed, goal = _trunk_up(body, _moved(posture, -airborne)), (wanted_m - low)[:2]
    near, feet = _near(wanted_m)[:2], _feet(body)
    best, least = placed, np.inf
    for _ in range(3):
        placed = _settled(body, placed, goal, near, solids)
        vertices, _ = pose(body, placed)
        up = np.array([0.0, 0.0, height_to_rest(vertices, [FLOOR])])
        placed = _moved(placed, up)
        high = np.array([vertices[foot, 2].min() for foot in feet]) + up[2] - (wanted_m - low)[:2]
        astray = float((near * high).max())
        if astray < least:
            best, least = placed, astray
        if not ASTRAY_M < astray < OUT_OF_REACH_M:
            break
        # Thighs that part, and skin that stands out, leave a foot in the air: hips lower, the other leg bent.
        goal = goal - high
        lower = _trunk_up(body, _moved(placed, np.array([0.0, 0.0, -astray])))
        placed = _bent(flesh_of(body), lower, wanted_m - low)
    return _moved(best, airborne)


def _trunk_up(body: Body, posture: Posture) -> Posture:
    """Return the posture, raised as a whole until the trunk is above the floor."""
    vertices, _ = pose(body, posture)
    sunk = -FLOOR.give_m - float(vertices[flesh_of(body).trunk, 2].min())
    return _moved(posture, np.array([0.0, 0.0, max(sunk, 0.0)]))


@lru_cache(maxsize=16)
def _feet(body: Body) -> list[Int64]:
    return [np.flatnonzero(body.strongest_joints == ankle) for _, _, ankle in _LEGS]


def take_seat(body: Body, grounded: Grounded, frame: int, seat: Seat) -> tuple[Posed, Seat]:
    """Pose a body as in a seated frame, like ``stand``; also return the seat, as high as in the motion."""
    trunk = flesh_of(body).trunk
    posture, wanted = standing(body, grounded, frame, -heading_rad(grounded.angles_rad[frame, 0]))
    vertices, joints = pose(body, posture)
    fitting = replace(seat, height=float(vertices[trunk, 2].min()) + seat.give_m)
    placed = _moved(posture, rest_on(fitting, vertices[trunk], joints, 0.0))
    goal, solids = (wanted - wanted.min())[:2], [FLOOR, *fitting.solids()]
    return pose(body, _settled(body, placed, goal, _near(wanted)[:2], solids)), fitting


def _settled(body: Body, posture: Posture, goal_m: Float64, near: Float64, solids: list[Solid]) -> Posture:
    """Return the posture without collisions, feet pulled to heights (2,) with weights (2,).

    Several leans of the trunk are tried, because the belly may keep the feet from their heights.
    """
    flesh = flesh_of(body)
    best, least = posture, np.inf
    for lean in LEANS_RAD:
        leant = _leaning(posture, lean)
        _, joints = forward(leant, flesh.rest_joints_m, flesh.aligned)
        missing = goal_m - _lowest(flesh, leant)[:2]
        pulls = []
        for foot, leg in enumerate(_LEGS):
            if near[foot] > 0.02:
                goal = joints[leg[2]] + np.array([0.0, 0.0, missing[foot]])
                pulls.append(Pull(JOINTS[leg[2]].name, goal, np.full(3, FOOT_HOLD * near[foot])))
        settled = settle(flesh, leant, solids, pulls)
        astray = float((near * np.abs(goal_m - _lowest(flesh, settled)[:2])).max())
        if astray + LEAN_COST_M * lean < least:
            best, least = settled, astray + LEAN_COST_M * lean
        if astray < ASTRAY_M:
            break
    return best


def _leaning(posture: Posture, back_rad: float) -> Posture:
    if back_rad == 0:
        return posture
    angles = posture.angles_rad.copy()
    tilt = np.eye(3)
    tilt[1:, 1:] = np.cos(back_rad) * np.eye(2) + np.sin(back_rad) * np.array([[0.0, 1.0], [-1.0, 0.0]])
    angles[0] = _angles_of(_rotation(angles[0]) @ tilt)
    for hip, _, _ in _LEGS:
        angles[hip, 0] -= back_rad
    return Posture(angles, posture.pelvis_m)


def standing(body: Body, grounded: Grounded, frame: int, turn_rad: float) -> tuple[Posture, Float64]:
    """Return a frame's posture, pelvis over the origin, limbs not yet separated, and heights (3,).

    Heights over the floor of left foot, right foot and all else. turn_rad: rotation about the vertical.
    """
    scale = leg_length_m(zero_bones(body.joints_m)) / grounded.leg_m
    wanted = scale * hovering(grounded.clear_m[frame])
    angles = clamp(grounded.angles_rad[frame])
    angles[0] = _turned(grounded.angles_rad[frame, 0], turn_rad)
    return feet_to(flesh_of(body), Posture(angles, np.zeros(3)), wanted), wanted


def heading_rad(pelvis_rad: Float64) -> float:
    """Return the angle about the vertical from -y to the front of a pelvis with these angles (3,)."""
    x, y, _ = -_rotation(pelvis_rad)[:, 1]
    return float(np.arctan2(x, -y))


def _rotation(pelvis_rad: Float64) -> Float64:
    angles = np.zeros_like(LIMITS_RAD[..., 0])
    angles[0] = pelvis_rad
    return np.asarray(rotations(angles)[0])


def _angles_of(rotation: Float64) -> Float64:
    from scipy.spatial.transform import Rotation

    return np.asarray(euler_rad(Rotation.from_matrix(rotation)) * (1, -1, 1))


def _turned(pelvis_rad: Float64, turn_rad: float) -> Float64:
    c, s = np.cos(turn_rad), np.sin(turn_rad)
    return _angles_of(np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ _rotation(pelvis_rad))


def _moved(posture: Posture, way_m: Float64) -> Posture:
    return Posture(posture.angles_rad, posture.pelvis_m + way_m)


def _near(wanted_m: Float64) -> Float64:
    """Return a weight for each height (3,): 1 for the lowest, less for higher ones."""
    return np.asarray(np.exp(-(((wanted_m - wanted_m.min()) / (2 * STEP_M)) ** 2)))


def hovering(clear_m: Float64) -> Float64:
    """Return the heights, lowered to about 0 if they are some millimetres, because recorded standing feet are
    never still.
    """
    return np.asarray(clear_m * (1 - np.exp(-clear_m / HOVER_M)))


def feet_to(flesh: Flesh, posture: Posture, wanted_m: Float64) -> Posture:
    """Return the posture with hips and knees bent so that the feet reach their heights.

    wanted_m: (3,) height of left foot, right foot and all else over the floor.
    """
    lowest = _lowest(flesh, posture)
    # Only bending brings a foot nearer: the hips go down to where the lower of the two feet arrives.
    rise = wanted_m - lowest + (wanted_m - wanted_m.min()) ** 2 / STEP_M
    raised = _moved(posture, np.array([0.0, 0.0, rise.min()]))
    return _bent(flesh, raised, wanted_m)


def _bent(flesh: Flesh, posture: Posture, wanted_m: Float64) -> Posture:
    """Return the posture with legs bent or stretched so that feet near the floor reach their heights."""
    bent = Posture(posture.angles_rad.copy(), posture.pelvis_m)
    near = _near(wanted_m)
    goal = (1 - near) * _lowest(flesh, bent) + near * wanted_m
    for _ in range(3):
        missing = goal - _lowest(flesh, bent)
        for foot, leg in enumerate(_LEGS):
            _bend(flesh, bent.angles_rad, leg, missing[foot])
    return bent


def _lowest(flesh: Flesh, posture: Posture) -> Float64:
    frames, joints = forward(posture, flesh.rest_joints_m, flesh.aligned)
    return lowest_m(stations_m(flesh, frames, joints), flesh.radii_m)


def _bend(flesh: Flesh, angles: Float64, leg: list[int], rise_m: float) -> None:
    """Bend a leg in place so that its foot rises; the foot's pitch and the leg's direction stay."""
    hip, knee, ankle = leg
    rest = flesh.rest_joints_m
    thigh, shank = (float(np.linalg.norm(rest[b] - rest[a])) for a, b in ((hip, knee), (knee, ankle)))
    _, joints = forward(Posture(angles, np.zeros(3)), rest, flesh.aligned)
    line = joints[ankle] - joints[hip]
    longest = 0.9995 * (thigh + shank)
    length = min(float(np.linalg.norm(line)), longest)
    down = max(-float(line[2]) / length, 0.3)
    new = float(np.clip(length - rise_m / down, abs(thigh - shank) + 0.02, longest))
    knee_before, hip_before = _triangle(thigh, shank, length)
    knee_after, hip_after = _triangle(thigh, shank, new)
    angles[knee, 0] -= knee_after - knee_before
    angles[hip, 0] += hip_after - hip_before
    angles[ankle, 0] += (knee_after - knee_before) - (hip_after - hip_before)
    for joint in leg:
        angles[joint, 0] = np.clip(angles[joint, 0], *LIMITS_RAD[joint, 0])


def _triangle(thigh: float, shank: float, reach: float) -> tuple[float, float]:
    at_knee = (thigh**2 + shank**2 - reach**2) / (2 * thigh * shank)
    at_hip = (thigh**2 + reach**2 - shank**2) / (2 * thigh * reach)
    return float(np.pi - np.arccos(np.clip(at_knee, -1, 1))), float(np.arccos(np.clip(at_hip, -1, 1)))


@dataclass(frozen=True, eq=False)
class Performance:
    """Postures of every frame in a room. A sitting person faces -y from a seat; otherwise the middle of the
    path is at the origin.
    """

    body: Body
    postures: tuple[Posture, ...]
    seat: Seat | None


def perform(body: Body, grounded: Grounded) -> Performance:
    seat, place, turn = _stage(body, grounded)
    way = _way(body, grounded, turn)
    way += (place - way[grounded.sits].mean(axis=0)) if seat is not None else 0.0
    solids = [FLOOR, *(seat.solids() if seat is not None else [])]
    raw, settled = [], []
    for f in range(len(grounded)):
        posture, wanted = standing(body, grounded, f, turn)
        posture = replace(posture, pelvis_m=posture.pelvis_m + np.append(way[f], 0.0))
        raw.append(posture)
        settled.append(cleared(body, posture, wanted, solids))
    return Performance(body, _calmed(raw, settled, grounded.frames_per_second), seat)


def _stage(body: Body, grounded: Grounded) -> tuple[Seat | None, Float64, float]:
    """Return the seat or None, the pelvis' position (2,) on it or 0, and the body's turn to face -y."""
    frames = np.flatnonzero(grounded.sits) if grounded.sits.any() else np.arange(len(grounded))
    headings = np.array([heading_rad(grounded.angles_rad[f, 0]) for f in frames])
    turn = -float(np.arctan2(np.sin(headings).mean(), np.cos(headings).mean()))
    if not grounded.sits.any():
        return None, np.zeros(2), turn
    trunk, places, heights = flesh_of(body).trunk, [], []
    for f in frames[:: -(-len(frames) // TRIED_SITS)]:
        posture, _ = standing(body, grounded, int(f), turn)
        vertices, joints = pose(body, posture)
        heights.append(float(vertices[trunk, 2].min()))
        seat = replace(Chair(), height=heights[-1] + Chair().give_m)
        places.append((posture.pelvis_m + rest_on(seat, vertices[trunk], joints, 0.0))[:2])
    height = float(np.median(heights)) + Chair().give_m
    return replace(Chair(), height=height), np.median(places, axis=0), turn


def _way(body: Body, grounded: Grounded, turn: float) -> Float64:
    """Return the pelvis' path (F, 2), scaled to the body's legs; long walks are compressed to fit the
    room.
    """
    from scipy.ndimage import gaussian_filter1d

    scale = leg_length_m(zero_bones(body.joints_m)) / grounded.leg_m
    c, s = np.cos(turn), np.sin(turn)
    way = scale * grounded.path_m @ np.array([[c, s], [-s, c]])
    line = gaussian_filter1d(way, STRIDE_S * grounded.frames_per_second, axis=0, mode="nearest")
    middle = (line.min(axis=0) + line.max(axis=0)) / 2
    farthest = float(np.linalg.norm(line - middle, axis=1).max())
    return np.asarray(way - line + (line - middle) * min(1.0, LEASH_M / max(farthest, 1e-9)))


def _calmed(raw: list[Posture], settled: list[Posture], rate: float) -> tuple[Posture, ...]:
    from scipy.ndimage import gaussian_filter1d

    given, angles = (np.array([posture.angles_rad for posture in some]) for some in (raw, settled))
    pelvis = np.array([posture.pelvis_m for posture in settled])
    change = (angles - given + np.pi) % (2 * np.pi) - np.pi
    calm = given + gaussian_filter1d(change, CALM_S * rate, axis=0, mode="nearest")
    pelvis[:, 2] = gaussian_filter1d(pelvis[:, 2], CALM_S * rate / 2, mode="nearest")
    return tuple(Posture(a, p) for a, p in zip(calm, pelvis, strict=True))
