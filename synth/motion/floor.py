"""Floor under a motion: standing phases of each foot, and heights over the floor.

Constants are untuned unless a source is given.
"""

from typing import NamedTuple

import numba
import numpy as np

from annotate.array_types import Bool, Float64, Int64
from synth.body.flesh import CHAINS, N_STATIONS, SOLE_M, Flesh
from synth.body.skeleton import kinematics
from synth.pose.settle import stations_m

# greatest speed and least time of a standing foot: in the air, gravity allows it for 0.07 s
STILL_M_S, STILL_S = 0.35, 0.09
# greatest height of a standing foot over the lowest of the body: fitted skeletons limp by so much
LIMP_M = 0.06
SPEED_S = 1 / 30  # time to either side over which a speed is measured: noise of shorter spans is not movement
TOUCH_M = 0.02  # flesh this near to the lowest may stand
# Stations of the left and of the right foot.
FEET: tuple[Int64, Int64] = tuple(
    np.r_[CHAINS[f"{side}_foot"], CHAINS[f"{side}_foot_outside"]].astype(np.int64)
    for side in ("left", "right")
)
REST: Int64 = np.setdiff1d(np.arange(N_STATIONS), np.concatenate(FEET))  # stations of all other flesh


class Traces(NamedTuple):
    """Path of a person: stations (F, S, 3) of the flesh, joints (F, J, 3), world, metres; radii (S,)."""

    stations_m: Float64
    joints_m: Float64
    radii_m: Float64

    @staticmethod
    def of(flesh: Flesh, angles_rad: Float64, pelvis_m: Float64) -> "Traces":
        """Return the traces of a motion's angles (F, J, 3) and pelvis (F, 3) on a body."""
        return Traces(*_trace(flesh, angles_rad, pelvis_m), flesh.radii_m)


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
    """Return the heights (..., 3) of the lowest of both feet and all else, of stations (..., S, 3)."""
    bottom = stations_m[..., 2] - radii_m
    feet = [bottom[..., foot].min(axis=-1) + SOLE_M for foot in FEET]
    return np.stack([*feet, bottom[..., REST].min(axis=-1)], axis=-1)


def clearance_m(traces: Traces, frames_per_second: float) -> tuple[Float64, Float64]:
    """Return heights (F, 3) over the floor of both feet and all else, and the floor's height (F,).

    Recorded floors wobble by centimetres, and a skeleton of other proportions stands above or below its
    person's floor. So the floor is found anew at every moment, under still flesh near the lowest. Moving
    flesh is as high as it is over a line between the stands before and after.
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
    """Return the first frame, and the one behind the last (n, 2), of every run of flags (F,)."""
    return np.flatnonzero(np.diff(np.r_[False, flags, False])).reshape(-1, 2)


def lasting(flags: Bool, seconds: float, rate: float) -> Bool:
    """Clear the runs of flags (F,) that are shorter than this; single poses stay."""
    kept = np.zeros_like(flags)
    for start, end in runs(flags):
        kept[start:end] = len(flags) < 3 or end - start >= min(seconds * rate, len(flags))
    return kept


def _between(values: Float64, known: Bool, otherwise: Float64) -> Float64:
    """Return known values (F,) with lines between; a low quantile of ``otherwise`` without known values."""
    if not known.any():
        return np.full(len(values), np.quantile(otherwise, 0.05))
    at = np.flatnonzero(known)
    return np.asarray(np.interp(np.arange(len(values)), at, values[at]))
