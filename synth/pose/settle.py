"""Settling: joint angles are changed as little as possible so that limbs do not penetrate each other or
furniture.

Contact violations give inequalities that are linear for a small step. Overlapping flesh has to separate, and
flesh inside furniture has to leave it. A hand has to reach its target, a limb at rest has to sink onto a
support. Each round projects the step onto one half-space after the other and onto the box of the joint limits
(cyclic projections; Bauschke & Borwein 1996). Contacts come last, so that they have priority. The result is
continuous in the given posture, except where a limb would pass through another. Constants are untuned.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numba
import numpy as np

from annotate.array_types import Bool, Float64, Int64
from synth.body.flesh import CHAINS, Flesh
from synth.body.skeleton import JOINT_ID, JOINTS, LIMITS_RAD, N_JOINTS, PARENTS, Posture, kinematics, place
from synth.data_files import table
from synth.pose.halfspaces import SOLID, Pulls, Rows, add_flesh, add_pulls, add_solids, no_rows, pairs_of
from synth.surface.furniture import Solid

ROUNDS = 18
PULL_ROUNDS = 9  # rounds that pull, ever less; after them only contacts act
SWEEPS = 5  # times each round goes over all half-spaces
CLEAR_M = 0.002  # overlap that is left alone once nothing pulls any more
ENTRY_CAPACITY = 36  # angles that can move the two points of one row: six joints on each side
STEP_LIMIT_RAD = 0.35  # greatest change of an angle a round: half-spaces are still near to linear
HEAVE_LIMIT_M = 0.05  # greatest lift of a body by an object under it


def _ancestors() -> Bool:
    """Return flags (J, J) [point's joint, joint]: True if turning the joint moves the point."""
    moves = np.zeros((N_JOINTS, N_JOINTS), bool)
    for i, parent in enumerate(PARENTS):
        moves[i] = moves[parent] if parent >= 0 else False
        moves[i, i] = True
    return moves


def _pairs() -> Int64:
    """Return the pairs of chains that may touch (n, 4): stations lo..hi of one, lo..hi of another."""
    rows = []
    for side, other, rules in (
        ("left", "right", "on_each_side"),
        ("right", "left", "on_each_side"),
        ("left", "right", "between_the_sides"),
    ):
        for rule in table("contacts")[rules]:
            a = CHAINS[f"{side}_{rule['chain']}"]
            for name in rule["touches"].split():
                b = CHAINS[name.replace("own_", f"{side}_").replace("other_", f"{other}_")]
                there = (b.start + rule.get("skip_there", 0), b.stop - rule.get("drop_there", 0))
                rows.append((a.start + rule.get("skip", 0), a.stop, *there))
    return np.array(rows, np.int64)


class Rules(NamedTuple):
    """Constants of all bodies, passed to compiled code, because its cache would keep outdated globals.

    limits_rad: (J, 3, 2). mobility: (J, 3). moved_by: (J, J) bool [point's joint, joint]. pairs: (n, 4).
    """

    limits_rad: Float64
    mobility: Float64
    moved_by: Bool
    pairs: Int64


_MOBILITY = np.array([table("joints")[joint.kind].get("mobility", (0.0, 0.0, 0.0)) for joint in JOINTS])
RULES = Rules(LIMITS_RAD, _MOBILITY, _ancestors(), _pairs())


@dataclass(frozen=True)
class Pull:
    """Pull of a joint towards a target. target_m: (3,) world; weight: (3,) share of the distance per axis and
    round.
    """

    joint: str
    target_m: Float64
    weight: Float64


def sink(joint: str, weight: float) -> Pull:
    """Return the pull of a joint straight down, onto a support."""
    return Pull(joint, np.array([0.0, 0.0, -10.0]), np.array([0.0, 0.0, weight]))


def settle(
    flesh: Flesh, posture: Posture, solids: list[Solid], pulls: list[Pull], heave: float = 0.0
) -> Posture:
    """Return the nearest posture whose limbs do not penetrate each other or the solids.

    Angles are clamped to their limits. The pelvis stays, but solids may lift the whole body by up to
    ``HEAVE_LIMIT_M``. heave: compliance of this lift, in rad^2/m^2 relative to a limb's 1.
    """
    boxes = np.array([s.packed() for s in solids]).reshape(-1, 17)
    joints = np.array([JOINT_ID[p.joint] for p in pulls], np.int64)
    ends = np.array([np.concatenate([p.target_m, p.weight]) for p in pulls]).reshape(-1, 6)
    angles, pelvis = posture.angles_rad.copy(), posture.pelvis_m.copy()
    _settle(RULES, angles, pelvis, _Surroundings(flesh, boxes, Pulls(joints, ends), heave))
    return Posture(angles, pelvis)


class _Surroundings(NamedTuple):
    """Flesh, boxes (k, 17) of furniture, pulls, and compliance of the whole body's lift."""

    flesh: Flesh
    boxes: Float64
    pulls: Pulls
    heave: float


class _Placed(NamedTuple):
    axes: Float64
    positions: Float64


@numba.njit(cache=True)
def _settle(rules: Rules, angles: Float64, pelvis: Float64, around: _Surroundings) -> None:
    room, heaved, flesh = no_rows(), 0.0, around.flesh
    pairs = pairs_of(rules.pairs, flesh)
    # The pelvis' own row is its orientation and free.
    for i in range(1, N_JOINTS):
        for a in range(3):
            angles[i, a] = min(max(angles[i, a], rules.limits_rad[i, a, 0]), rules.limits_rad[i, a, 1])
    for round_ in range(ROUNDS):
        pulling = round_ < PULL_ROUNDS
        axes, frames, positions = kinematics(angles, pelvis, flesh.rest_joints_m, flesh.aligned)
        stations = stations_m(flesh, frames, positions)
        n = add_pulls(room, 0, positions, around.pulls, 1 - round_ / PULL_ROUNDS) if pulling else 0
        n = add_flesh(room, n, pairs, flesh, stations)
        n = add_solids(room, n, around.boxes, flesh, stations)
        rows = Rows(room.normals[:n], room.depths_m[:n], room.points[:n], room.movers[:n])
        if n == 0 or (not pulling and np.max(rows.depths_m) < CLEAR_M):
            break
        # Not while limbs are drawn down, or they would lift the body off what it lies on.
        heave = 0.0 if pulling else around.heave
        step, rise = _project(rules, angles, _Placed(axes, positions), heave, rows)
        angles += step
        rise = min(rise, HEAVE_LIMIT_M - heaved)
        heaved += rise
        pelvis[2] += rise


@numba.njit(cache=True)
def stations_m(flesh: Flesh, frames: Float64, positions: Float64) -> Float64:
    """Return the positions (S, 3) of a body's stations, from the results of ``kinematics``."""
    stations = np.empty_like(flesh.centres_m)
    for s in range(len(stations)):
        j = flesh.joints[s]
        place(stations[s], positions[j], frames[j], flesh.centres_m[s], flesh.rest_joints_m[j])
    return stations


@numba.njit(cache=True)
def _gradient(rules: Rules, placed: _Placed, rows: Rows, r: int, entry: tuple[Int64, Float64]) -> int:
    """Write the gradient of a constraint, row ``r`` of ``rows``, in the joint angles; return its number of
    entries.

    entry: indices of the angles, and the separation of the row's points per radian.
    """
    n, axes, (where, value) = 0, placed.axes, entry
    u, v, w = rows.normals[r]
    for side in range(2):
        mover, first = rows.movers[r, side], n
        sign = 1.0 if side == 0 else -1.0
        for j in range(1, N_JOINTS):
            if mover < 0 or not rules.moved_by[mover, j]:
                continue
            x, y, z = rows.points[r, side] - placed.positions[j]
            p, q, s = y * w - z * v, z * u - x * w, x * v - y * u
            for a in range(3):
                if rules.mobility[j, a] > 0:
                    known = -1
                    for k in range(first):
                        known = k if where[k] == 3 * j + a else known
                    if known < 0:
                        known, n = n, n + 1
                        where[known], value[known] = 3 * j + a, 0.0
                    value[known] += sign * (axes[j, a, 0] * p + axes[j, a, 1] * q + axes[j, a, 2] * s)
    return n


@numba.njit(cache=True)
def _project(
    rules: Rules, angles: Float64, placed: _Placed, heave: float, rows: Rows
) -> tuple[Float64, float]:
    """Return the small step towards satisfying all rows: angles (J, 3) and upward shift of the whole body
    (m).

    heave: see ``settle``.
    """
    n = len(rows.depths_m)
    where, value = np.empty((n, ENTRY_CAPACITY), np.int64), np.empty((n, ENTRY_CAPACITY))
    count, size, up = np.empty(n, np.int64), np.empty(n), np.zeros(n)
    mobility, now = rules.mobility.ravel(), angles.ravel()
    low = np.maximum(rules.limits_rad[:, :, 0].copy().ravel() - now, -STEP_LIMIT_RAD)
    high = np.minimum(rules.limits_rad[:, :, 1].copy().ravel() - now, STEP_LIMIT_RAD)
    for r in range(n):
        count[r] = _gradient(rules, placed, rows, r, (where[r], value[r]))
        if rows.movers[r, 1] == SOLID:
            up[r] = max(rows.normals[r, 2], 0.0)
        size[r] = 1e-3 + heave * up[r] ** 2
        for k in range(count[r]):
            size[r] += mobility[where[r, k]] * value[r, k] ** 2
    step, rise = np.zeros(3 * N_JOINTS), 0.0
    for _ in range(SWEEPS):
        for r in range(n):
            left = rows.depths_m[r] - up[r] * rise
            for k in range(count[r]):
                left -= value[r, k] * step[where[r, k]]
            if left > 0:
                force = left / size[r]
                rise += heave * up[r] * force
                for k in range(count[r]):
                    i = where[r, k]
                    wanted = step[i] + force * mobility[i] * value[r, k]
                    step[i] = min(max(wanted, low[i]), high[i])
    return step.reshape(N_JOINTS, 3), rise
