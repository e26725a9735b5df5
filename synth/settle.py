"""Settling: joint angles moved as little as needed so that no limb is in another or in the furniture.

A posture is asked for; what it violates are inequalities that are linear for a small step: flesh that
overlaps has to part, flesh inside furniture has to leave it, a hand has to come to its target, a limb at
rest has to sink until something carries it. Each round projects the step onto one half-space after the
other and onto the box of the joint limits (cyclic projections, Kaczmarz 1937; Bauschke & Borwein 1996), contacts
last, so that they win. The result depends continuously on the posture asked for, but where a limb
would have to pass through another.
"""

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from synth.flesh import CHAINS, Flesh, Int64
from synth.scene import Solid
from synth.skeleton import JOINT_ID, JOINTS, LIMITS_RAD, N_JOINTS, PARENTS, Float64, Posture, kinematics

ROUNDS = 18
PULL_ROUNDS = 9
"""Linearisations, and how many of them pull, ever less; after them only contacts act."""
SKIN_M = 0.004
"""Flesh is kept this far apart: its spheres are means, the skin is not round."""
PULL_STEP_M = 0.06
"""A pull moves its point by no more than this a round."""
SWEEPS = 5
"""Times each round goes over all half-spaces."""
CLEAR_M = 0.002
"""Overlap that is left alone once nothing pulls any more."""
MAX_ROWS = 256
MAX_ENTRIES = 36
"""Angles that can move the two points of one row: six joints on each side."""
MAX_STEP_RAD = 0.35
MAX_HEAVE_M = 0.05
"""What lies under a body lifts it by no more than this."""


def _mobility() -> Float64:
    """(J, 3) how readily an angle gives way: limbs before the trunk, and no joint about a hinge it has not."""
    by_kind = {
        "clavicle": (0.1, 0.15, 0.1),
        "shoulder": (1.0, 1.0, 1.0),
        "elbow": (1.0, 0.0, 0.1),
        "wrist": (0.5, 0.5, 0.0),
        "hip": (0.7, 0.7, 0.7),
        "knee": (1.0, 0.0, 0.0),
        "ankle": (0.5, 0.2, 0.0),
        "neck": (0.2, 0.2, 0.1),
        "head": (0.2, 0.2, 0.1),
    }
    return np.array([by_kind.get(joint.name.rpartition("_")[2], (0.0, 0.0, 0.0)) for joint in JOINTS])


def _ancestors() -> NDArray[np.bool_]:
    """[point's joint, joint]: whether turning the joint moves the point."""
    moves = np.zeros((N_JOINTS, N_JOINTS), bool)
    for i, parent in enumerate(PARENTS):
        moves[i] = moves[parent] if parent >= 0 else False
        moves[i, i] = True
    return moves


_HAND = ("hand", "thumb_side")


def _pairs() -> Int64:
    """(n, 4) stations lo..hi of one chain against the flesh over stations lo..hi of another.

    Neighbours by anatomy are left out near the joint they share, where skin folds.
    """
    slices = [name for name in CHAINS if name.startswith("slice")]
    rows = []

    def against(a: str, b: str, a_from: int = 0, b_from: int = 0, b_drop: int = 0) -> None:
        rows.append((CHAINS[a].lo + a_from, CHAINS[a].hi, CHAINS[b].lo + b_from, CHAINS[b].hi - b_drop))

    for side, other in (("left", "right"), ("right", "left")):
        for limb in ("upper_arm", "forearm", *_HAND):
            for i, trunk in enumerate(slices):
                first = 0 if limb != "upper_arm" else (2 if i >= 5 else 1)
                against(f"{side}_{limb}", trunk, first)
            for leg in ("thigh", "shank", "foot"):
                for s in (side, other):
                    against(f"{side}_{limb}", f"{s}_{leg}", 1 if limb == "upper_arm" else 0)
        against(f"{side}_upper_arm", "head", 1)
        for limb in ("forearm", *_HAND):
            against(f"{side}_{limb}", "head")
            against(f"{side}_{limb}", "neck")
            against(f"{side}_{limb}", f"{other}_upper_arm")
        for half in _HAND:
            against(f"{side}_{half}", f"{other}_forearm")
            against(f"{side}_{half}", f"{side}_upper_arm")
            against(f"{side}_{half}", f"{other}_hand")
        against(f"{side}_forearm", f"{side}_upper_arm", 2, 0, 2)
        for trunk in slices:
            against(f"{side}_shank", trunk)
            against(f"{side}_foot", trunk)
        for trunk in slices[2:]:
            against(f"{side}_thigh", trunk, 2)
        against(f"{side}_shank", f"{side}_thigh", 2, 0, 1)
        against(f"{side}_foot", f"{side}_thigh")
        against(f"{side}_shank", f"{other}_thigh")
        against(f"{side}_foot", f"{other}_thigh")
        for half in ("foot", "foot_outside"):
            against(f"{side}_{half}", f"{other}_shank")
            against(f"{side}_{half}", f"{other}_foot")
        against(f"{side}_foot_outside", f"{other}_thigh")
    for a, b in (("thumb_side", "thumb_side"), ("forearm", "forearm"), ("shank", "shank")):
        against(f"left_{a}", f"right_{b}")
    against("left_thigh", "right_thigh", 1, 1)
    return np.array(rows, np.int64)


Rules = tuple[Float64, Int64, Float64, NDArray[np.bool_]]
_RULES: Rules = (LIMITS_RAD, _pairs(), _mobility(), _ancestors())
"""Joint limits, pairs, mobility and ancestors: handed to compiled code, whose cache would keep old globals."""


@dataclass(frozen=True)
class Pull:
    """A joint drawn to a place. target_m: (3,) world; weight: (3,) share of the way per axis and round."""

    joint: str
    target_m: Float64
    weight: Float64


def sink(joint: str, weight: float) -> Pull:
    """A joint drawn straight down, until something carries it."""
    return Pull(joint, np.array([0.0, 0.0, -10.0]), np.array([0.0, 0.0, weight]))


def settle(
    flesh: Flesh, posture: Posture, solids: list[Solid], pulls: list[Pull], heave: float = 0.0
) -> Posture:
    """The posture nearest to the one asked for whose limbs keep clear of each other and of the solids.

    Angles come back inside their limits. The pelvis stays, but that solids may lift the whole body as readily as
    ``heave`` (rad^2/m^2 beside a limb's 1) says.
    """
    boxes = np.array([s.packed() for s in solids]).reshape(-1, 17)
    pulled = np.array([JOINT_ID[p.joint] for p in pulls], np.int64)
    ends = np.array([np.concatenate([p.target_m, p.weight]) for p in pulls]).reshape(-1, 6)
    angles, pelvis = posture.angles_rad.copy(), posture.pelvis_m.copy()
    _settle(
        _RULES, angles, pelvis, heave, flesh.rest_joints_m, flesh.aligned, flesh.centres_m,
        flesh.radii_m, flesh.joints, boxes, pulled, ends,
    )  # fmt: skip
    return Posture(angles, pelvis)


@numba.njit(cache=True)
def _settle(rules: Rules, angles: Float64, pelvis: Float64, heave: float, rest: Float64, aligned: Float64, centres: Float64, radii: Float64, joints: Int64, boxes: Float64, pulled: Int64, ends: Float64) -> None:  # fmt: skip # pragma: no cover
    normals = np.empty((MAX_ROWS, 3))
    depths = np.empty(MAX_ROWS)
    # Each row pushes point a (joint row[0]) along the normal, and point b against it;
    # -1 is a solid, -2 nothing.
    points = np.empty((MAX_ROWS, 2, 3))
    movers = np.empty((MAX_ROWS, 2), np.int64)
    stations = np.empty_like(centres)
    limits, pairs, heaved = rules[0], rules[1], 0.0
    reaches = _reaches(pairs, centres, radii)
    for i in range(1, N_JOINTS):
        for a in range(3):
            angles[i, a] = min(max(angles[i, a], limits[i, a, 0]), limits[i, a, 1])
    for round_ in range(ROUNDS):
        axes, frames, positions = kinematics(angles, pelvis, rest, aligned)
        for s in range(len(centres)):
            j = joints[s]
            stations[s] = positions[j] + frames[j] @ (centres[s] - rest[j])
        n = 0
        if round_ < PULL_ROUNDS:
            n = _pull_rows(positions, pulled, ends, 1 - round_ / PULL_ROUNDS, normals, depths, points, movers, n)
        n = _flesh_rows(pairs, reaches, stations, radii, joints, normals, depths, points, movers, n)
        n = _solid_rows(stations, radii, joints, boxes, normals, depths, points, movers, n)
        if n == 0 or (round_ >= PULL_ROUNDS and np.max(depths[:n]) < CLEAR_M):
            break
        # Not while limbs are drawn down, or they would lift the body off what it lies on.
        lift = heave if round_ >= PULL_ROUNDS else 0.0
        step, rise = _project(rules, angles, axes, positions, lift, normals, depths, points, movers, n)
        angles += step
        rise = min(rise, MAX_HEAVE_M - heaved)
        heaved += rise
        pelvis[2] += rise


@numba.njit(cache=True)
def _pull_rows(positions: Float64, pulled: Int64, ends: Float64, strength: float, normals: Float64, depths: Float64, points: Float64, movers: Int64, n: int) -> int:  # fmt: skip # pragma: no cover
    for k in range(len(pulled)):
        way = (ends[k, :3] - positions[pulled[k]]) * ends[k, 3:]
        length = np.sqrt(np.dot(way, way))
        if length > 1e-6:
            normals[n] = way / length
            depths[n] = strength * min(length, PULL_STEP_M * np.max(ends[k, 3:]))
            points[n, 0] = positions[pulled[k]]
            movers[n, 0], movers[n, 1] = pulled[k], -2
            n += 1
    return n


@numba.njit(cache=True)
def _reaches(pairs: Int64, centres: Float64, radii: Float64) -> Float64:  # pragma: no cover
    """(n,) how near the middle stations of a pair have to come before its flesh can touch; chains are rigid."""
    result = np.empty(len(pairs))
    for r in range(len(pairs)):
        total = SKIN_M
        for lo, hi in ((pairs[r, 0], pairs[r, 1]), (pairs[r, 2], pairs[r, 3])):
            farthest = 0.0
            for s in range(lo, hi):
                off = centres[s] - centres[(lo + hi) // 2]
                farthest = max(farthest, np.sqrt(np.dot(off, off)) + radii[s])
            total += farthest
        result[r] = total
    return result


@numba.njit(cache=True, fastmath=True)
def _flesh_rows(pairs: Int64, reaches: Float64, stations: Float64, radii: Float64, joints: Int64, normals: Float64, depths: Float64, points: Float64, movers: Int64, n: int) -> int:  # fmt: skip # pragma: no cover
    for r in range(len(pairs)):
        a_lo, a_hi, b_lo, b_hi = pairs[r]
        a, b = (a_lo + a_hi) // 2, (b_lo + b_hi) // 2
        dx, dy, dz = stations[a, 0] - stations[b, 0], stations[a, 1] - stations[b, 1], stations[a, 2] - stations[b, 2]
        if dx * dx + dy * dy + dz * dz > reaches[r] ** 2:
            continue
        for s in range(a_lo, a_hi):
            px, py, pz = stations[s]
            deepest, where, share = 0.0, -1, 0.0
            for b in range(b_lo, b_hi - 1):
                ax, ay, az = stations[b]
                dx, dy, dz = stations[b + 1, 0] - ax, stations[b + 1, 1] - ay, stations[b + 1, 2] - az
                t = ((px - ax) * dx + (py - ay) * dy + (pz - az) * dz) / (dx * dx + dy * dy + dz * dz + 1e-12)
                t = min(max(t, 0.0), 1.0)
                ex, ey, ez = px - ax - t * dx, py - ay - t * dy, pz - az - t * dz
                touch = radii[s] + radii[b] + t * (radii[b + 1] - radii[b]) + SKIN_M
                squared = ex * ex + ey * ey + ez * ez
                if squared < touch * touch:
                    depth = touch - np.sqrt(squared)
                    if depth > deepest:
                        deepest, where, share = depth, b, t
            if where >= 0 and n < MAX_ROWS:
                near = stations[where] + share * (stations[where + 1] - stations[where])
                way = stations[s] - near
                length = np.sqrt(way[0] ** 2 + way[1] ** 2 + way[2] ** 2)
                if length < 1e-6:
                    continue
                normals[n] = way / length
                depths[n] = deepest
                points[n, 0], points[n, 1] = stations[s], near
                movers[n, 0], movers[n, 1] = joints[s], joints[where]
                n += 1
    return n


@numba.njit(cache=True)
def _solid_rows(stations: Float64, radii: Float64, joints: Int64, boxes: Float64, normals: Float64, depths: Float64, points: Float64, movers: Int64, n: int) -> int:  # fmt: skip # pragma: no cover
    for k in range(len(boxes)):
        centre, half, give, bias = boxes[k, :3], boxes[k, 3:6], boxes[k, 6], boxes[k, 7]
        turn = np.ascontiguousarray(boxes[k, 8:]).reshape(3, 3)
        for s in range(len(stations)):
            if joints[s] <= 4:
                # Trunk and neck are laid down before; no limb of theirs could give way.
                continue
            off = turn.T @ (stations[s] - centre)
            depth, normal = _leave(off, half, bias)
            depth += radii[s] - give
            if depth > 0 and n < MAX_ROWS:
                normals[n] = turn @ normal
                depths[n] = depth
                points[n, 0] = stations[s]
                movers[n, 0], movers[n, 1] = joints[s], -1
                n += 1
    return n


@numba.njit(cache=True)
def _leave(off: Float64, half: Float64, bias: float) -> tuple[float, Float64]:  # pragma: no cover
    """How deep a point lies in a box about the origin (negative: how far from it), and the way out.

    The way up is taken where it is no more than ``bias`` longer than the shortest.
    """
    normal = np.zeros(3)
    beyond = np.abs(off) - half
    outside = np.maximum(beyond, 0.0)
    distance = np.sqrt(np.dot(outside, outside))
    if distance > 0:
        normal[:] = np.sign(off) * outside / distance
        return -distance, normal
    # Nothing leaves by the underside.
    beyond[2] = off[2] - half[2]
    axis = int(np.argmax(beyond))
    if beyond[axis] - bias < off[2] - half[2]:
        normal[2] = 1.0
        return half[2] - off[2], normal
    normal[axis] = 1.0 if off[axis] >= 0 else -1.0
    return -beyond[axis], normal


@numba.njit(cache=True, fastmath=True)
def _row(rules: Rules, axes: Float64, positions: Float64, normal: Float64, points: Float64, movers: Int64, where: Int64, value: Float64) -> int:  # fmt: skip # pragma: no cover
    """How far the points part along the normal per radian of each angle that moves them; returns how many."""
    mobility, moved_by = rules[2], rules[3]
    n = 0
    for side in range(2):
        mover = movers[side]
        if mover < 0:
            continue
        first = n
        for j in range(1, N_JOINTS):
            if not moved_by[mover, j]:
                continue
            x, y, z = points[side] - positions[j]
            for a in range(3):
                if mobility[j, a] == 0:
                    continue
                u, v, w = axes[j, a]
                rate = normal[0] * (v * z - w * y) + normal[1] * (w * x - u * z) + normal[2] * (u * y - v * x)
                known = -1
                for k in range(first if side == 1 else 0):
                    if where[k] == 3 * j + a:
                        known = k
                if known >= 0:
                    value[known] -= rate
                else:
                    where[n], value[n] = 3 * j + a, rate if side == 0 else -rate
                    n += 1
    return n


@numba.njit(cache=True, fastmath=True)
def _project(rules: Rules, angles: Float64, axes: Float64, positions: Float64, heave: float, normals: Float64, depths: Float64, points: Float64, movers: Int64, n: int) -> tuple[Float64, float]:  # fmt: skip # pragma: no cover
    """The small step towards satisfying all rows: angles (J, 3) and how far the whole body rises (m)."""
    where = np.empty((n, MAX_ENTRIES), np.int64)
    value = np.empty((n, MAX_ENTRIES))
    count = np.empty(n, np.int64)
    size = np.empty(n)
    limits, mobility, now = rules[0], rules[2].ravel(), angles.ravel()
    low = np.maximum(limits[:, :, 0].copy().ravel() - now, -MAX_STEP_RAD)
    high = np.minimum(limits[:, :, 1].copy().ravel() - now, MAX_STEP_RAD)
    up = np.zeros(n)
    for r in range(n):
        count[r] = _row(rules, axes, positions, normals[r], points[r], movers[r], where[r], value[r])
        if movers[r, 1] == -1:
            up[r] = max(normals[r, 2], 0.0)
        size[r] = 1e-3 + heave * up[r] ** 2
        for k in range(count[r]):
            size[r] += mobility[where[r, k]] * value[r, k] ** 2
    step, rise = np.zeros(3 * N_JOINTS), 0.0
    for _ in range(SWEEPS):
        for r in range(n):
            left = depths[r] - up[r] * rise
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
