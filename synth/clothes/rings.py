"""Rings of cloth around both legs of a posed body.

A ring runs around both legs at one height of the rest pose, like a belt around two wheels. The ring stays
outside the posed flesh and hangs from the widest place above. Constants are untuned.
"""

from typing import NamedTuple

import numba
import numpy as np

from annotate.array_types import Float32, Float64, Int32
from synth.surface.facets import Triple, cross, dot, unit
from synth.surface.rasterize import EXACT

RING_M = 0.028  # from ring to ring at rest: a knee spans four
# Nodes about each leg, and between the legs in front and behind: from the front of the left leg round its
# back, along the back, round the right leg and along the front.
CAP, BRIDGE = 10, 6
NODES = 2 * (CAP + BRIDGE)
BACK, FRONT = CAP + BRIDGE // 2, 2 * CAP + 3 * BRIDGE // 2  # nodes in the middle between the legs
LINED = 4  # rings of the inside of a hem
SMOOTHING = 4  # rounds of averaging the rings' middles
REACH = 6  # rings up and down that set a ring's plane: rounds a bent knee
TURN = 10.0  # rings about the hips over which cloth turns from the pelvis to the legs
LIES = 1.5  # descent of cloth on top of flesh, metres a metre
LID = 0.7  # share of the lower lid's way down to the hem between the legs
LINING_M = 0.006  # from the outside of a hem to its inside
HAND_M = 0.015  # from cloth to a hand on it
NEAR_M = 0.35  # greatest distance of a hand on cloth from a leg's middle
CLEAR_M = 0.008  # from cloth to flesh, because chords would cut into it


class Carrier(NamedTuple):
    """Vertices of a body that carry cloth.

    held: (n,) vertices of trunk and legs; ring: (n,) their ring index, with a fraction; left: (n,) 1 in the
    left half, 0 in the right. arms: (m,) vertices that press cloth. hips: ring index of the hip joints, with
    a fraction.
    """

    held: Int32
    ring: Float32
    left: Float32
    arms: Int32
    hips: float


@numba.njit(cache=True, fastmath=EXACT)
def hung(vertices: Float32, down: Triple, carrier: Carrier, ease: Float32, flare: float) -> Float32:
    """Return the vertices ((R + LINED) NODES + 5, 3) of cloth on a posed body (V, 3), world, z up.

    Order: the outside by rings, the inside of the hem, centres of the closing lids. down: the pelvis'
    direction to the feet. ease: (R, NODES), distance from the flesh, metres. flare: widening, metres per
    metre.
    """
    rings = len(ease)
    middles = _leg_middles(vertices, carrier, rings)
    frames = _frames(middles, down, carrier.hips)
    flesh = np.zeros((rings, NODES), np.float32)
    _touch(flesh, vertices, carrier, middles, frames)
    flesh = np.maximum(flesh, _spread(flesh))
    radii = _hanging(flesh, ease, flare, frames)
    _give_way(radii, flesh, (vertices, carrier.arms), middles, frames)
    return _nodes(radii, middles, frames)


@numba.njit(cache=True, fastmath=EXACT)
def _leg_middles(vertices: Float32, carrier: Carrier, rings: int) -> Float64:
    """Return the means (R, 2, 3) of the right and the left leg's vertices near each ring."""
    middles, weight = np.zeros((rings, 2, 3)), np.full((rings, 2), 1e-9)
    held, ring, left = carrier.held, carrier.ring, carrier.left
    for n in range(len(held)):
        side = int(left[n])
        k = int(np.floor(ring[n]))
        for r in range(max(k, 0), min(k + 2, rings)):
            w = 1 - abs(ring[n] - r)
            weight[r, side] += w
            for i in range(3):
                middles[r, side, i] += w * vertices[held[n], i]
    for r in range(rings):
        for side in range(2):
            for i in range(3):
                middles[r, side, i] /= weight[r, side]
    for _ in range(SMOOTHING):
        before = middles.copy()
        for r in range(1, rings - 1):
            for side in range(2):
                for i in range(3):
                    near = before[r - 1, side, i] + before[r + 1, side, i]
                    middles[r, side, i] = 0.5 * before[r, side, i] + 0.25 * near
    return middles


@numba.njit(cache=True, fastmath=EXACT)
def _triple(vector: Float64) -> Triple:
    return (vector[0], vector[1], vector[2])


@numba.njit(cache=True, fastmath=EXACT)
def _frames(middles: Float64, pelvis: Triple, hips: float) -> Float64:
    """Return unit vectors (R, 2, 2, 3) by ring and leg: away from the other leg, and to the front.

    The two vectors span the ring's plane, perpendicular to the pelvis above and to the leg below.
    """
    rings = len(middles)
    frames = np.empty((rings, 2, 2, 3))
    for r in range(rings):
        above, below = max(r - REACH, 0), min(r + REACH, rings - 1)
        share = min(max((r - hips) / TURN + 0.5, 0.0), 1.0)
        right = _between(pelvis, unit(_triple(middles[below, 0] - middles[above, 0])), share)
        left = _between(pelvis, unit(_triple(middles[below, 1] - middles[above, 1])), share)
        across = unit(_triple(middles[r, 1] - middles[r, 0]))
        front = unit(cross((left[0] + right[0], left[1] + right[1], left[2] + right[2]), across))
        down = cross(across, front)
        for side in range(2):
            leg = left if side == 1 else right
            outwards, ahead = _turned(across, down, leg), _turned(front, down, leg)
            sign = 1 if side == 1 else -1
            for i in range(3):
                frames[r, side, 0, i], frames[r, side, 1, i] = sign * outwards[i], ahead[i]
    return frames


@numba.njit(cache=True, fastmath=EXACT)
def _between(start: Triple, end: Triple, share: float) -> Triple:
    a, b = 1 - share, share
    return unit((a * start[0] + b * end[0], a * start[1] + b * end[1], a * start[2] + b * end[2]))


@numba.njit(cache=True, fastmath=EXACT)
def _turned(vector: Triple, source: Triple, target: Triple) -> Triple:
    """Return a vector turned as the shortest rotation turns ``source`` into ``target``."""
    axis, cosine = cross(source, target), dot(source, target)
    aside = cross(axis, vector)
    share = dot(axis, vector) / max(1 + cosine, 0.05)
    return unit(
        (
            vector[0] * cosine + aside[0] + axis[0] * share,
            vector[1] * cosine + aside[1] + axis[1] * share,
            vector[2] * cosine + aside[2] + axis[2] * share,
        )
    )


@numba.njit(cache=True, fastmath=EXACT)
def _in_ring(point: Triple, side: int, middles: Float64, frames: Float64) -> tuple[float, float]:
    """Return a leg point's position in the ring (node index with a fraction), and the cloth radius that
    contains it.

    The radius also keeps the chord to the next ring outside the point.
    """
    a, b, square, along, length = 0.0, 0.0, 0.0, 0.0, 1e-9
    for i in range(3):
        off, core = point[i] - middles[side, i], middles[1 - side, i] - middles[side, i]
        a += off * frames[side, 0, i]
        b += off * frames[side, 1, i]
        square += off * off
        along += off * core
        length += core * core
    if a >= 0:
        turn = np.arctan2(a, b) / np.pi
        node = turn * CAP if side == 1 else CAP + BRIDGE + (1 - turn) * CAP
        away = np.sqrt(a * a + b * b)
    else:
        share = min(max(along / length, 0.0), 1.0)
        left = 1 - share if side == 1 else share
        ahead = _mixed(frames[1, 1], frames[0, 1], left)
        b, square = 0.0, 0.0
        for i in range(3):
            off = point[i] - left * middles[1, i] - (1 - left) * middles[0, i]
            b += off * ahead[i]
            square += off * off
        node = CAP + (1 - left) * BRIDGE if b < 0 else 2 * CAP + BRIDGE + left * BRIDGE
        away = abs(b)
    over = max(square - away * away, 0.0)
    return node, away + min(over / (away + 1e-3), away)


@numba.njit(cache=True, fastmath=EXACT)
def _mixed(a: Float64, b: Float64, share: float) -> Triple:
    other = 1 - share
    return unit((share * a[0] + other * b[0], share * a[1] + other * b[1], share * a[2] + other * b[2]))


@numba.njit(cache=True, fastmath=EXACT)
def _touch(flesh: Float32, vertices: Float32, carrier: Carrier, middles: Float64, frames: Float64) -> None:
    rings = len(flesh)
    held, ring, left = carrier.held, carrier.ring, carrier.left
    for n in range(len(held)):
        k, v = int(np.floor(ring[n])), held[n]
        point = (np.float64(vertices[v, 0]), np.float64(vertices[v, 1]), np.float64(vertices[v, 2]))
        for r in range(max(k, 0), min(k + 2, rings)):
            node, away = _in_ring(point, int(left[n]), middles[r], frames[r])
            j = int(node)
            for c in (j % NODES, (j + 1) % NODES):
                flesh[r, c] = max(flesh[r, c], np.float32(away))


@numba.njit(cache=True, fastmath=EXACT)
def _spread(radii: Float32) -> Float32:
    rings = len(radii)
    result = np.empty_like(radii)
    for r in range(rings):
        up, down = max(r - 1, 0), min(r + 1, rings - 1)
        for j in range(NODES):
            near = radii[r, j - 1] + radii[r, (j + 1) % NODES] + radii[up, j] + radii[down, j]
            result[r, j] = np.float32(0.25) * near
    return result


@numba.njit(cache=True, fastmath=EXACT)
def _hanging(flesh: Float32, ease: Float32, flare: float, frames: Float64) -> Float32:
    """Return the radii (R, NODES) of cloth that hangs from the widest place above. ease: distance from the
    flesh.
    """
    rings = len(flesh)
    radii = flesh + ease
    for r in range(2, rings):
        for j in range(NODES):
            rise = max(_outwards(j, frames[r])[2], 0.0)
            hung = radii[r - 1, j] + np.float32((flare - LIES * rise) * RING_M)
            radii[r, j] = max(radii[r, j], hung)
    smooth = _spread(radii)
    for r in range(2, rings):
        for j in range(NODES):
            radii[r, j] = max(flesh[r, j] + np.float32(CLEAR_M), (radii[r, j] + smooth[r, j]) / 2)
    return radii


@numba.njit(cache=True, fastmath=EXACT)
def _left_share(j: int) -> float:
    if j <= CAP:
        return 1.0
    if j < CAP + BRIDGE:
        return 1 - (j - CAP) / BRIDGE
    return 0.0 if j <= 2 * CAP + BRIDGE else (j - 2 * CAP - BRIDGE) / BRIDGE


@numba.njit(cache=True, fastmath=EXACT)
def _outwards(j: int, frames: Float64) -> Triple:
    share, turn = _left_share(j), 0.0
    if j <= CAP:
        turn = np.pi * j / CAP
    elif j < CAP + BRIDGE:
        turn = np.pi
    elif j <= 2 * CAP + BRIDGE:
        turn = np.pi * (1 - (j - CAP - BRIDGE) / CAP)
    a, b = np.sin(turn), np.cos(turn)
    x, y, z = 0.0, 0.0, 0.0
    for side in range(2):
        w, frame = share if side == 1 else 1 - share, frames[side]
        x += w * (a * frame[0, 0] + b * frame[1, 0])
        y += w * (a * frame[0, 1] + b * frame[1, 1])
        z += w * (a * frame[0, 2] + b * frame[1, 2])
    return unit((x, y, z))


@numba.njit(cache=True, fastmath=EXACT)
def _give_way(
    radii: Float32, flesh: Float32, body: tuple[Float32, Int32], middles: Float64, frames: Float64
) -> None:
    """Press the cloth under hands and forearms towards the flesh, in place. body: vertices, indices of the
    arms.
    """
    rings, (vertices, arms) = len(radii), body
    for n in range(len(arms)):
        v = arms[n]
        point = (np.float64(vertices[v, 0]), np.float64(vertices[v, 1]), np.float64(vertices[v, 2]))
        nearest, least, leg = -1, NEAR_M**2, 0
        for r in range(2, rings):
            for side in range(2):
                square = 0.0
                for i in range(3):
                    square += (point[i] - middles[r, side, i]) ** 2
                if square < least:
                    nearest, least, leg = r, square, side
        if nearest < 0:
            continue
        for r in range(max(nearest - 1, 2), min(nearest + 2, rings)):
            node, away = _in_ring(point, leg, middles[r], frames[r])
            for step in range(-1, 3):
                c = (int(node) + step) % NODES
                limit = max(np.float32(away - HAND_M), flesh[r, c] + np.float32(CLEAR_M))
                radii[r, c] = min(radii[r, c], limit)


@numba.njit(cache=True, fastmath=EXACT)
def _nodes(radii: Float32, middles: Float64, frames: Float64) -> Float32:
    """Return the vertices of the cloth's outside, of the inside of the hem, and of the closing lids.

    The lower lid lies near the hem, so that it stays hidden when legs are spread.
    """
    rings = len(radii)
    nodes = np.empty(((rings + LINED) * NODES + 5, 3), np.float32)
    for k in range(rings + LINED):
        r = k if k < rings else 2 * rings - 1 - k
        thin = 0.0 if k < rings else LINING_M
        for j in range(NODES):
            share, outwards = _left_share(j), _outwards(j, frames[r])
            for i in range(3):
                core = share * middles[r, 1, i] + (1 - share) * middles[r, 0, i]
                nodes[k * NODES + j, i] = core + (radii[r, j] - thin) * outwards[i]
    right, left = middles[rings - 1]
    for i in range(3):
        nodes[-5, i] = (middles[0, 0, i] + middles[0, 1, i]) / 2
        nodes[-4, i], nodes[-3, i] = right[i], left[i]
        for k, j in ((-2, BACK), (-1, FRONT)):
            nodes[k, i] = LID * nodes[rings * NODES + j, i] + (1 - LID) * (right[i] + left[i]) / 2
    return nodes
