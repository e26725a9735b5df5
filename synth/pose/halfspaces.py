"""Half-spaces that a posture violates: flesh in flesh, flesh in furniture, and joints drawn to places.

Each is a row of ``Rows``: a point that has to move along a normal by a depth, perhaps against a second point.
"""

from typing import NamedTuple

import numba
import numpy as np

from annotate.array_types import Float64, Int64
from synth.body.flesh import Flesh

SKIN_M = 0.004
"""Flesh is kept this far apart: its spheres are means, the skin is not round."""
PULL_STEP_M = 0.06
"""A pull moves its point by no more than this a round."""
ROW_CAPACITY = 256
"""Half-spaces that a round regards; further ones wait for the next. Chosen by eye."""
SOLID, NOTHING = -1, -2
"""In place of a second point's joint: the first pushes against furniture, or against nothing at all."""
_LAST_FIXED = 4
"""Joints up to the neck are laid down before; no limb of theirs could give way to furniture."""


class Rows(NamedTuple):
    """Half-spaces (a named tuple, which compiled code takes): the first n rows count.

    normals: (n, 3); depths_m: (n,); points: (n, 2, 3), world; movers: (n, 2) the joint each point follows.
    """

    normals: Float64
    depths_m: Float64
    points: Float64
    movers: Int64


@numba.njit(cache=True)
def no_rows() -> Rows:
    """Room for ``ROW_CAPACITY`` rows."""
    n = ROW_CAPACITY
    return Rows(np.empty((n, 3)), np.empty(n), np.empty((n, 2, 3)), np.empty((n, 2), np.int64))


@numba.njit(cache=True)
def add_pulls(rows: Rows, n: int, positions: Float64, pulled: Int64, ends: Float64, strength: float) -> int:
    """Rows that draw joints to places; ends (k, 6): target and weight per axis. Returns the new count."""
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
def reaches_m(pairs: Int64, flesh: Flesh) -> Float64:
    """Distances (n,) of the middle stations of a pair at which its flesh may touch; chains are rigid."""
    result = np.empty(len(pairs))
    for r in range(len(pairs)):
        total = SKIN_M
        for lo, hi in ((pairs[r, 0], pairs[r, 1]), (pairs[r, 2], pairs[r, 3])):
            farthest = 0.0
            for s in range(lo, hi):
                off = flesh.centres_m[s] - flesh.centres_m[(lo + hi) // 2]
                farthest = max(farthest, np.sqrt(np.dot(off, off)) + flesh.radii_m[s])
            total += farthest
        result[r] = total
    return result


@numba.njit(cache=True)
def add_flesh(rows: Rows, n: int, pairs: Int64, reaches: Float64, flesh: Flesh, stations: Float64) -> int:
    """Rows that part flesh from flesh: each station of one chain against the nearest place of the other."""
    for r in range(len(pairs)):
        a_lo, a_hi, b_lo, b_hi = pairs[r]
        apart = stations[(a_lo + a_hi) // 2] - stations[(b_lo + b_hi) // 2]
        if apart[0] ** 2 + apart[1] ** 2 + apart[2] ** 2 > reaches[r] ** 2:
            continue
        for s in range(a_lo, a_hi):
            depth, near, joint = _deepest(s, b_lo, b_hi, flesh, stations)
            way = stations[s] - near
            length = np.sqrt(np.dot(way, way))
            if depth > 0 and length > 1e-6 and n < ROW_CAPACITY:
                rows.normals[n] = way / length
                rows.depths_m[n] = depth
                rows.points[n, 0], rows.points[n, 1] = stations[s], near
                rows.movers[n, 0], rows.movers[n, 1] = flesh.joints[s], joint
                n += 1
    return n


@numba.njit(cache=True, fastmath=True)
def _deepest(s: int, lo: int, hi: int, flesh: Flesh, stations: Float64) -> tuple[float, Float64, int]:
    """How deep station s is in the flesh over stations lo..hi, the place on the axis, and its joint."""
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
    near = stations[where] + share * (stations[where + 1] - stations[where])
    return deepest, near, flesh.joints[where]


@numba.njit(cache=True)
def add_solids(rows: Rows, n: int, boxes: Float64, flesh: Flesh, stations: Float64) -> int:
    """Rows that push limbs out of furniture; boxes (k, 17): packed ``Solid``s."""
    for k in range(len(boxes)):
        centre, half, give, bias = boxes[k, :3], boxes[k, 3:6], boxes[k, 6], boxes[k, 7]
        turn = np.ascontiguousarray(boxes[k, 8:]).reshape(3, 3)
        for s in range(len(stations)):
            if flesh.joints[s] <= _LAST_FIXED:
                continue
            room = flesh.radii_m[s] - give
            x, y, z = stations[s] - centre
            off = np.empty(3)
            outside = 0.0
            for i in range(3):
                off[i] = turn[0, i] * x + turn[1, i] * y + turn[2, i] * z
                outside = max(outside, abs(off[i]) - half[i])
            if outside >= max(room, 0.0) and outside > 0.0:
                continue
            depth, normal = _leave(off, half, bias)
            depth += room
            if depth > 0 and n < ROW_CAPACITY:
                rows.normals[n] = turn @ normal
                rows.depths_m[n] = depth
                rows.points[n, 0] = stations[s]
                rows.movers[n, 0], rows.movers[n, 1] = flesh.joints[s], SOLID
                n += 1
    return n


@numba.njit(cache=True)
def _leave(off: Float64, half: Float64, bias: float) -> tuple[float, Float64]:
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
