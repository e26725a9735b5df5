"""Recorded motion prepared for any body: heights over the floor, standing feet, seats, glitches, frame rates.

Constants are untuned unless a source is given.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numba
import numpy as np

from annotate.array_types import Bool, Float64, Int64
from synth.body.flesh import CHAINS, N_STATIONS, SOLE_M, Flesh, flesh_of
from synth.body.skeleton import JOINT_ID, euler_rad, kinematics, rotations
from synth.markers.motion_file import Motion
from synth.markers.person_fit import person_body
from synth.pose.settle import stations_m

# From joint to joint, percent of the body's mass: de Leva 1996, means of both sexes, rounded.
_SEGMENTS = [(JOINT_ID["head"], JOINT_ID["head"], 6.9), (JOINT_ID["pelvis"], JOINT_ID["neck"], 43.5)] + [
    (JOINT_ID[f"{side}_{start}"], JOINT_ID[f"{side}_{end}"], percent)
    for side in ("left", "right")
    for start, end, percent in (
        ("shoulder", "elbow", 2.7),
        ("elbow", "wrist", 2.2),
        ("hip", "knee", 14.3),
        ("knee", "ankle", 4.3),
        ("ankle", "ankle", 1.4),
    )
]
SEAT_RANGE = (0.2, 0.75)  # hips over ankles of a sitter, by the leg's length: from a low stool to a bar stool
THIGH_DIP = 0.6  # sine of a sitter's steepest thigh
HEEL_M = 0.06  # greatest distance of a standing person's mass behind the ankles
# shortest stay on a seat and fastest hips there: falls, jumps and kicks are out of balance too
SEATED_S, SEATED_M_S = 0.3, 0.3
FASTEST_TURN_RAD_S = 15.0  # of a pelvis: a figure skater's comes to it
FREE_FALL_M_S2 = (-16.0, -4.0)  # of a person in the air: gravity, and the error of a fit to few frames
SKIP_M = 0.12  # feet lifted less shuffle without a fall
GRAVITY_M_S2 = 9.81
FLIP_RAD = 1.5  # greater differences between two frames are two triples of one rotation
STILL_M_S, STILL_S = 0.35, 0.09
LIMP_M = 0.06
SPEED_S = 1 / 30  # time to either side over which a speed is measured: noise of shorter spans is not movement
TOUCH_M = 0.02  # flesh this near to the lowest may stand
FEET: tuple[Int64, Int64] = tuple(
    np.r_[CHAINS[f"{side}_foot"], CHAINS[f"{side}_foot_outside"]].astype(np.int64)
    for side in ("left", "right")
)
REST: Int64 = np.setdiff1d(np.arange(N_STATIONS), np.concatenate(FEET))  # stations of all other flesh


class Traces(NamedTuple):
    """Trajectory of a person: stations (F, S, 3) of the flesh, joints (F, J, 3), world, metres; radii
    (S,).
    """

    stations_m: Float64
    joints_m: Float64
    radii_m: Float64

    @staticmethod
    def of(flesh: Flesh, angles_rad: Float64, pelvis_m: Float64) -> "Traces":
        """Return the traces of a motion's angles (F, J, 3) and pelvis (F, 3) on a body."""
        # The kernel is compiled for contiguous arrays.
        traced = _trace(flesh, np.ascontiguousarray(angles_rad), np.ascontiguousarray(pelvis_m))
        return Traces(*traced, flesh.radii_m)


@dataclass(frozen=True, eq=False)
class Grounded:
    """Motion with its floor, prepared for any body.

    angles_rad: float64 (F, J, 3). path_m: float64 (F, 2), pelvis over the ground, world. clear_m: float64 (F,
    3), height over the floor of the lowest point of left foot, right foot and all else; 0 for a part on the
    floor. sits: bool (F,). sound: bool (F,), False for a glitch. leg_m: leg length of the recorded person.
    """

    angles_rad: Float64
    path_m: Float64
    clear_m: Float64
    sits: Bool
    sound: Bool
    leg_m: float
    frames_per_second: float

    def __len__(self) -> int:
        return len(self.angles_rad)


def ground(motion: Motion) -> Grounded:
    """Find the floor under a motion and the frames in which the person sits.

    Frames with physically impossible poses are replaced by interpolation.
    """
    flesh, rate = flesh_of(person_body(motion.bones_m)), motion.frames_per_second
    sound = np.ones(len(motion), np.bool_)
    for again in (True, True, False):
        traces = Traces.of(flesh, motion.angles_rad, motion.pelvis_m)
        clear, _ = clearance_m(traces, rate)
        wrong = _impossible(motion, traces, clear)
        if not again or not wrong.any() or not (sound & ~wrong).any():
            break
        sound &= ~wrong
        motion = bridged(motion, sound)
    sound &= ~wrong
    clear[~sound] -= clear[~sound].min(axis=1, keepdims=True)
    slow = _speed_m_s(traces.joints_m[:, JOINT_ID["pelvis"]], rate) < SEATED_M_S
    sits = _unbalanced(traces.joints_m, motion.leg_m) & slow & (clear[:, :2].min(axis=1) < LIMP_M)
    path = motion.pelvis_m[:, :2]
    return Grounded(motion.angles_rad, path, clear, lasting(sits, SEATED_S, rate), sound, motion.leg_m, rate)


def bridged(motion: Motion, sound: Bool) -> Motion:
    """Return the motion with all frames except the sound ones (F,) interpolated from their neighbours."""
    from scipy.spatial.transform import Rotation, Slerp

    at, frames = np.flatnonzero(sound), np.arange(len(motion))
    inside = np.clip(frames, at[0], at[-1])
    angles = np.apply_along_axis(lambda values: np.interp(frames, at, values[at]), 0, motion.angles_rad)
    if len(at) > 1:
        turns = Rotation.from_matrix(np.array([rotations(motion.angles_rad[f])[0] for f in at]))
        angles[:, 0] = euler_rad(Slerp(at, turns)(inside)) * (1, -1, 1)
    angles[sound] = motion.angles_rad[sound]
    pelvis = np.apply_along_axis(lambda values: np.interp(frames, at, values[at]), 0, motion.pelvis_m)
    return replace(motion, angles_rad=angles, pelvis_m=pelvis)


def _impossible(motion: Motion, traces: Traces, clear: Float64) -> Bool:
    """Return flags (F,) of frames beside impossibly fast turns, and of jumps without free fall."""
    from scipy.spatial.transform import Rotation

    frames, rate = len(motion), motion.frames_per_second
    wrong = np.zeros(frames, np.bool_)
    if frames < 3:
        return wrong
    turns = Rotation.from_matrix(np.array([rotations(angles)[0] for angles in motion.angles_rad]))
    fast = (turns[1:] * turns[:-1].inv()).magnitude() * rate > FASTEST_TURN_RAD_S
    wrong[1:] |= fast
    wrong[:-1] |= fast
    mass = mass_centre(traces.joints_m)[:, 2]
    for start, end in runs(clear.min(axis=1) > SKIP_M / 2):
        highest = clear[start:end].min(axis=1).max()
        if highest < SKIP_M:
            continue
        seconds = np.arange(end - start) / rate
        if end - start >= 5:
            falls = 2 * np.polyfit(seconds, mass[start:end], 2)[0]
            wrong[start:end] |= not FREE_FALL_M_S2[0] < falls < FREE_FALL_M_S2[1]
        else:
            # Feet that are drawn up are higher than the fall.
            wrong[start:end] |= highest > SKIP_M + GRAVITY_M_S2 * (seconds[-1] + 2 / rate) ** 2 / 8
    return wrong


def _speed_m_s(places_m: Float64, rate: float) -> Float64:
    frames = np.arange(len(places_m))
    reach = max(1, round(0.05 * rate))
    after, before = (np.clip(frames + k, 0, len(frames) - 1) for k in (reach, -reach))
    way = np.linalg.norm(places_m[after] - places_m[before], axis=1)
    return np.asarray(way * rate / np.maximum(after - before, 1))


def _unbalanced(joints_m: Float64, leg_m: float) -> Bool:
    """Return flags (F,) of frames with hips at a seat's height and the centre of mass behind the heels."""
    sides = ([JOINT_ID[f"{side}_{name}"] for side in ("left", "right")] for name in ("hip", "knee", "ankle"))
    hips, knees, ankles = (joints_m[:, ids] for ids in sides)
    ahead = (knees - hips).mean(axis=1)[:, :2]
    ahead /= np.maximum(np.linalg.norm(ahead, axis=1, keepdims=True), 1e-9)
    behind = ((ankles.mean(axis=1) - mass_centre(joints_m))[:, :2] * ahead).sum(axis=1)
    height = (hips - ankles)[..., 2] / leg_m
    dip = (hips - knees)[..., 2] / np.linalg.norm(hips - knees, axis=2)
    seated = ((height > SEAT_RANGE[0]) & (height < SEAT_RANGE[1]) & (np.abs(dip) < THIGH_DIP)).all(axis=1)
    return np.asarray(seated & (behind > HEEL_M))


def mass_centre(joints_m: Float64) -> Float64:
    """Return the body's centre of mass (..., 3) from joints (..., J, 3)."""
    middles = [
        percent * (joints_m[..., start, :] + joints_m[..., end, :]) / 2 for start, end, percent in _SEGMENTS
    ]
    return np.asarray(sum(middles) / sum(percent for _, _, percent in _SEGMENTS))


def resampled(motion: Motion, frames_per_second: float) -> Motion:
    """Return the motion at another frame rate: linear in angles, slerp for the pelvis; markers are
    dropped.
    """
    from scipy.spatial.transform import Rotation, Slerp

    frames = max(1, round((len(motion) - 1) / motion.frames_per_second * frames_per_second) + 1)
    at = np.minimum(np.arange(frames) * motion.frames_per_second / frames_per_second, len(motion) - 1)
    before = np.minimum(at.astype(int), max(0, len(motion) - 2))
    after = np.minimum(before + 1, len(motion) - 1)
    share = at - before

    def between(values: Float64) -> Float64:
        s = share.reshape(-1, *[1] * (values.ndim - 1))
        return np.asarray((1 - s) * values[before] + s * values[after])

    angles = between(motion.angles_rad)
    flips = np.abs(motion.angles_rad[after] - motion.angles_rad[before]) > FLIP_RAD
    nearest = np.where(share < 0.5, before, after)
    angles = np.where(flips.any(axis=2, keepdims=True), motion.angles_rad[nearest], angles)
    if len(motion) > 1:
        turns = Rotation.from_matrix(np.array([rotations(a)[0] for a in motion.angles_rad]))
        angles[:, 0] = euler_rad(Slerp(np.arange(len(motion)), turns)(at)) * (1, -1, 1)
    # Markers have no part in a resampled motion.
    report = replace(
        motion.report,
        names=(),
        error_m=np.empty((frames, 0), np.float32),
        status=np.empty((frames, 0), np.uint8),
    )
    return replace(
        motion,
        angles_rad=angles,
        pelvis_m=between(motion.pelvis_m),
        frames_per_second=frames_per_second,
        report=report,
    )


# greatest speed and least time of a standing foot: in the air, gravity allows it for 0.07 s
# greatest height of a standing foot over the lowest of the body: fitted skeletons limp by so much
# Stations of the left and of the right foot.


@numba.njit(cache=True)
def _trace(flesh: Flesh, angles_rad: Float64, pelvis_m: Float64) -> tuple[Float64, Float64]:
    frames = len(angles_rad)
    stations = np.empty((frames, *flesh.centres_m.shape))
    joints = np.empty((frames, *flesh.rest_joints_m.shape))
    for f in range(frames):
        _, turned, joints[f] = kinematics(angles_rad[f], pelvis_m[f], flesh.rest_joints_m, flesh.aligned)
        stations[f] = stations_m(flesh, turned, joints[f])
    return stations, joints


def lowest_m(stations_m: Float64, radii_m: Float64) -> Float64:
    """Return the lowest heights (..., 3) of left foot, right foot and all else, for stations (..., S, 3)."""
    bottom = stations_m[..., 2] - radii_m
    feet = [bottom[..., foot].min(axis=-1) + SOLE_M for foot in FEET]
    return np.stack([*feet, bottom[..., REST].min(axis=-1)], axis=-1)


def clearance_m(traces: Traces, frames_per_second: float) -> tuple[Float64, Float64]:
    """Return heights (F, 3) over the floor of both feet and all else, and the floor's height (F,).

    Recorded floors vary by centimetres, and a skeleton of other proportions stands above or below its
    person's floor. Therefore the floor is estimated in every frame, under the lowest still flesh. While flesh
    moves, the floor is interpolated between the contacts before and after.
    """
    lowest = lowest_m(traces.stations_m, traces.radii_m)
    bottom = lowest.min(axis=1)
    limp = LIMP_M if len(lowest) > 2 else LIMP_M / 2
    stands = _still(traces, frames_per_second) & (lowest < bottom[:, None] + limp)
    floor = _between(np.where(stands, lowest, np.inf).min(axis=1), stands.any(axis=1), bottom)
    under = np.stack([floor] * 3, axis=1)
    for foot in (0, 1):
        own = _between(lowest[:, foot], stands[:, foot], floor)
        under[:, foot] = np.clip(own, floor - LIMP_M, floor + LIMP_M)
    return np.maximum(lowest - under, 0.0), floor


def _still(traces: Traces, rate: float) -> Bool:
    stations = traces.stations_m
    frames = len(stations)
    if frames < 3:
        return np.ones((frames, 3), np.bool_)
    reach = max(1, round(SPEED_S * rate))
    after, before = (np.clip(np.arange(frames) + k, 0, frames - 1) for k in (reach, -reach))
    way = np.linalg.norm(stations[after] - stations[before], axis=2)
    speed = way * (rate / (after - before))[:, None]
    bottom = stations[..., 2] - traces.radii_m
    flags = np.empty((frames, 3), np.bool_)
    for group, of in enumerate((*FEET, REST)):
        low = bottom[:, of] < bottom[:, of].min(axis=1, keepdims=True) + TOUCH_M
        slowest = np.where(low, speed[:, of], np.inf).min(axis=1)
        flags[:, group] = lasting(slowest < STILL_M_S, STILL_S, rate)
    return flags


def runs(flags: Bool) -> Int64:
    """Return the first frame and the frame after the last (n, 2) of every run of True in flags (F,)."""
    return np.flatnonzero(np.diff(np.r_[False, flags, False])).reshape(-1, 2)


def lasting(flags: Bool, seconds: float, rate: float) -> Bool:
    """Return flags (F,) without runs shorter than ``seconds``; a recording of one frame stays."""
    kept = np.zeros_like(flags)
    for start, end in runs(flags):
        kept[start:end] = len(flags) < 3 or end - start >= min(seconds * rate, len(flags))
    return kept


def _between(values: Float64, known: Bool, otherwise: Float64) -> Float64:
    """Return known values (F,), interpolated linearly; without known values a low quantile of
    ``otherwise``.
    """
    if not known.any():
        return np.full(len(values), np.quantile(otherwise, 0.05))
    at = np.flatnonzero(known)
    return np.asarray(np.interp(np.arange(len(values)), at, values[at]))
