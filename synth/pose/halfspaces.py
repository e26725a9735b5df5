"""Half-space constraints that a posture violates: flesh in flesh, flesh in furniture, joints away from
targets.

Each constraint is a row of ``Rows``: a point that has to move along a normal by a depth, perhaps relative to
a second point.
"""

from typing import NamedTuple

import numba
import numpy as np

from annotate.array_types import Float64, Int64
from synth.body.flesh import Flesh
from synth.surface.facets import Triple

SKIN_M = 0.004  # m; flesh is kept this far apart: its spheres are means, the skin is not round
PULL_STEP_M = 0.06  # m; greatest way of a pulled point a round
ROW_CAPACITY = 256  # half-spaces of a round; untuned
SOLID, NOTHING = -1, -2  # in place of a second point's joint: against furniture, or against nothing
_LAST_FIXED = 4  # joints up to the neck rest already; none of their limbs can give way to furniture


class Rows(NamedTuple):
    """Half-spaces (a named tuple because compiled code takes it): the first n rows count.

    normals: (n, 3); depths_m: (n,); points: (n, 2, 3), world; movers: (n, 2) the joint each point follows.
    """

    normals: Float64
    depths_m: Float64
    points: Float64
    movers: Int64


class Pulls(NamedTuple):
    """Joints (k,) pulled to targets; ends (k, 6): target and weight per axis."""

    joints: Int64
    ends: Float64


class Pairs(NamedTuple):
    """Pairs of chains of spheres that may touch.

    stations: (n, 4), first sphere and end (exclusive) of one chain, then of the other: indices in ``Flesh``.
    reach_m: (n,) distance of the chains' middle spheres beyond which the chains cannot touch.
    """

    stations: Int64
    reach_m: Float64


@numba.njit(cache=True)
def no_rows() -> Rows:
    n = ROW_CAPACITY
    return Rows(np.empty((n, 3)), np.empty(n), np.empty((n, 2, 3)), np.empty((n, 2), np.int64))


@numba.njit(cache=True)
def add_pulls(rows: Rows, n: int, positions: Float64, pulls: Pulls, strength: float) -> int:
    """Append half-spaces that pull joints to targets to the first n of ``rows``; return the new number."""
    pulled, ends = pulls.joints, pulls.ends
    for k in range(len(pulled)):
        way = (ends[k, :3] - positions[pulled[k]]) * ends[k, 3:]
        length = np.sqrt(np.dot(way, way))
        if length > 1e-6:
            rows.normals[n] = way / length
            rows.depths_m[n] = strength * min(length, PULL_STEP_M * np.max(ends[k, 3:]))
            rows.points[n, 0] = positions[pulled[k]]
            rows.movers[n, 0], rows.movers[n, 1] = pulled[k], NOTHING
            n += 1
    return n


@numba.njit(cache=True)
def pairs_of(pairs: Int64, flesh: Flesh) -> Pairs:
    """Return the pairs of chains with their reach on a body; chains are rigid."""
    result = np.empty(len(pairs))
    for r in range(len(pairs)):
        total = SKIN_M
        for lo, hi in ((pairs[r, 0], pairs[r, 1]), (pairs[r, 2], pairs[r, 3])):
            farthest = 0.0
            middle = flesh.centres_m[(lo + hi) // 2]
            for s in range(lo, hi):
                farthest = max(farthest, _distance(flesh.centres_m[s], middle) + flesh.radii_m[s])
            total += farthest
        result[r] = total
    return Pairs(pairs, result)


@numba.njit(cache=True)
def _distance(a: Float64, b: Float64) -> float:
    x, y, z = a[0] - b[0], a[1] - b[1], a[2] - b[2]
    return float(np.sqrt(x * x + y * y + z * z))


@numba.njit(cache=True)
def add_flesh(rows: Rows, n: int, pairs: Pairs, flesh: Flesh, stations: Float64) -> int:
    """Add half-spaces to ``rows`` that separate flesh from flesh; return the new number of rows.

    Each moves a station of one chain away from the nearest point of the other. n: rows so far. stations: (S,
    3), world.
    """
    for r in range(len(pairs.reach_m)):
        a_lo, a_hi, b_lo, b_hi = pairs.stations[r]
        if _distance(stations[(a_lo + a_hi) // 2], stations[(b_lo + b_hi) // 2]) > pairs.reach_m[r]:
            continue
        for s in range(a_lo, a_hi):
            depth, b, share = _deepest(s, b_lo, b_hi, flesh, stations)
            if depth <= 0 or n >= ROW_CAPACITY:
                continue
            near = rows.points[n, 1]
            for i in range(3):
                near[i] = stations[b, i] + share * (stations[b + 1, i] - stations[b, i])
            length = _distance(stations[s], near)
            if length > 1e-6:
                for i in range(3):
                    rows.normals[n, i] = (stations[s, i] - near[i]) / length
                    rows.points[n, 0, i] = stations[s, i]
                rows.depths_m[n] = depth
                rows.movers[n, 0], rows.movers[n, 1] = flesh.joints[s], flesh.joints[b]
                n += 1
    return n


@numba.njit(cache=True, fastmath=True)
def _deepest(s: int, lo: int, hi: int, flesh: Flesh, stations: Float64) -> tuple[float, int, float]:
    """Return the greatest depth of station s in the chain lo..hi, and its place in the chain.

    The place is the station before it, and the share of the way to the next station.
    """
    radii = flesh.radii_m
    px, py, pz = stations[s]
    deepest, where, share = 0.0, lo, 0.0
    for b in range(lo, hi - 1):
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
    return deepest, where, share


@numba.njit(cache=True)
def add_solids(rows: Rows, n: int, boxes: Float64, flesh: Flesh, stations: Float64) -> int:
    """Add half-spaces to ``rows`` that push limbs out of furniture; return the new number of rows.

    n: rows so far. boxes: (k, 17), packed ``Solid``s. stations: (S, 3), world.
    """
    for k in range(len(boxes)):
        give, bias, turn = boxes[k, 6], boxes[k, 7], boxes[k, 8:]
        for s in range(len(stations)):
            if flesh.joints[s] <= _LAST_FIXED:
                continue
            room = flesh.radii_m[s] - give
            x, y, z = stations[s, 0] - boxes[k, 0], stations[s, 1] - boxes[k, 1], stations[s, 2] - boxes[k, 2]
            off = (
                turn[0] * x + turn[3] * y + turn[6] * z,
                turn[1] * x + turn[4] * y + turn[7] * z,
                turn[2] * x + turn[5] * y + turn[8] * z,
            )
            half = (boxes[k, 3], boxes[k, 4], boxes[k, 5])
            outside = max(abs(off[0]) - half[0], abs(off[1]) - half[1], abs(off[2]) - half[2], 0.0)
            if outside >= max(room, 0.0) and outside > 0.0:
                continue
            depth, normal = _leave(off, half, bias)
            depth += room
            if depth > 0 and n < ROW_CAPACITY:
                for i in range(3):
                    along = turn[3 * i] * normal[0] + turn[3 * i + 1] * normal[1]
                    rows.normals[n, i] = along + turn[3 * i + 2] * normal[2]
                    rows.points[n, 0, i] = stations[s, i]
                rows.depths_m[n] = depth
                rows.movers[n, 0], rows.movers[n, 1] = flesh.joints[s], SOLID
                n += 1
    return n


@numba.njit(cache=True)
def _leave(off: Triple, half: Triple, bias: float) -> tuple[float, Triple]:
    """Return a point's depth in a box about the origin (negative: its distance), and the direction out.

    The direction up is taken if it is at most ``bias`` metres longer than the shortest.
    """
    x, y, z = abs(off[0]) - half[0], abs(off[1]) - half[1], abs(off[2]) - half[2]
    if max(x, y, z) > 0:
        a, b, c = max(x, 0.0), max(y, 0.0), max(z, 0.0)
        distance = np.sqrt(a * a + b * b + c * c)
        way = (np.sign(off[0]) * a, np.sign(off[1]) * b, np.sign(off[2]) * c)
        return -distance, (way[0] / distance, way[1] / distance, way[2] / distance)
    # Nothing leaves by the underside.
    up = off[2] - half[2]
    if max(x, y) - bias <= up:
        return -up, (0.0, 0.0, 1.0)
    if x >= y:
        return -x, (1.0 if off[0] >= 0 else -1.0, 0.0, 0.0)
    return -y, (0.0, 1.0 if off[1] >= 0 else -1.0, 0.0)
