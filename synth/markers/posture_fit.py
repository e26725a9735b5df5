"""The damped least squares that poses a skeleton to markers, and its derivative in the body's shape."""

# Numba types the compiled functions.
# ruff: noqa: ANN001, ANN202

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from synth.body.skeleton import Float64
from synth.markers.kinematics import (
    BALL,
    PARENT,
    SIGNED_LIMITS,
    State,
    axes_of,
    chain_of,
    euler_matrix,
    marker_at,
    marker_columns,
    place_compiled,
    settle,
    turn,
)

MARKER_SIGMA_M = 0.005
"""What a marker's residual is measured in: noise, soft tissue and the model's own error together."""
ROBUST_M = 0.08
"""Residual at which a marker's pull wanes (Geman & McClure 1987)."""


@dataclass(frozen=True)
class Prior:
    """What holds a posture where markers do not: weights per squared radian and per squared metre.

    rest: (J, 3) pull to anatomical zero; hold: (J,) pull to the start; hold_pelvis: pull of its place.
    """

    rest: Float64
    hold: Float64
    hold_pelvis: float


def fit_posture(
    start: State,
    bones_m: Float64,
    marker_joint: NDArray[np.int64],
    offsets_m: Float64,
    observed_m: Float64,
    weights: Float64,
    prior: Prior,
    *,
    steps: int,
    robust_m: float = ROBUST_M,
) -> tuple[State, float]:
    """Posture whose markers come nearest to the observed ones, inside the joint limits, and its cost.

    observed_m: (M, 3) world; weights: (M,), 0 where a marker is missing. Levenberg-Marquardt
    (Nocedal & Wright 2006, section 10.3), angles at a limit frozen while they push outwards.
    """
    pelvis, signed, local = start.pelvis_m.copy(), start.signed_rad.copy(), start.local.copy()
    cost = _fit(
        PARENT, BALL, SIGNED_LIMITS, pelvis, signed, local, bones_m, marker_joint, offsets_m, observed_m,
        weights / MARKER_SIGMA_M**2, prior.rest, prior.hold, prior.hold_pelvis, robust_m**2, steps,
    )  # fmt: skip
    return State(pelvis, signed, local), float(cost)


def shape_normal(
    state: State,
    bones_m: Float64,
    marker_joint: NDArray[np.int64],
    offsets_m: Float64,
    observed_m: Float64,
    weights: Float64,
    prior: Prior,
    bone_basis: Float64,
    offset_basis: Float64,
) -> tuple[Float64, Float64]:
    """Gauss-Newton matrix (S, S) and gradient (S,) of one frame's cost in shape, its posture following along.

    bone_basis (G, J, 3) and offset_basis (G, M, 3): metres per shape parameter; after the G parameters come
    three free coordinates a marker, in the frame of its joint: S = G + 3 M. The posture is eliminated by the
    Schur complement, as in bundle adjustment (Triggs et al. 2000, section 6.1).
    """
    matrix, gradient = _shape_normal(
        PARENT, BALL, SIGNED_LIMITS, state.pelvis_m, state.signed_rad, state.local, bones_m, marker_joint,
        offsets_m, observed_m, weights / MARKER_SIGMA_M**2, prior.rest, prior.hold, prior.hold_pelvis,
        ROBUST_M**2, bone_basis, offset_basis,
    )  # fmt: skip
    return matrix, gradient


@numba.njit(cache=True)
def _factor(h):  # type: ignore[no-untyped-def] # pragma: no cover
    """Cholesky factor in place; at this size faster than LAPACK, whose threads fight for the cores."""
    for i in range(len(h)):
        for j in range(i + 1):
            total = h[i, j]
            for k in range(j):
                total -= h[i, k] * h[j, k]
            h[i, j] = np.sqrt(max(total, 1e-12)) if i == j else total / h[j, j]


@numba.njit(cache=True)
def _solve(h, x):  # type: ignore[no-untyped-def] # pragma: no cover
    """Solve a positive definite system: the solution into ``x``, the factor into ``h``."""
    _factor(h)
    n = len(x)
    for i in range(n):
        for k in range(i):
            x[i] -= h[i, k] * x[k]
        x[i] /= h[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            x[i] -= h[k, i] * x[k]
        x[i] /= h[i, i]


@numba.njit(cache=True)
def _eliminate(h, g, mixed, matrix, gradient):  # type: ignore[no-untyped-def] # pragma: no cover
    """Schur complement: matrix -= B' A^-1 B, gradient -= B' A^-1 g, with A = ``h`` and B = ``mixed``."""
    _factor(h)
    n, size = mixed.shape
    for i in range(n):
        for k in range(i):
            g[i] -= h[i, k] * g[k]
            for s in range(size):
                mixed[i, s] -= h[i, k] * mixed[k, s]
        g[i] /= h[i, i]
        for s in range(size):
            mixed[i, s] /= h[i, i]
    for i in range(n):
        for s in range(size):
            x = mixed[i, s]
            if x != 0.0:
                gradient[s] -= x * g[i]
                for t in range(size):
                    matrix[s, t] -= x * mixed[i, t]


def solve_positive(matrix: Float64, right: Float64) -> Float64:
    """Solution (n,) of a positive definite system (n, n); leaves its arguments alone."""
    solution = right.copy()
    _solve(matrix.copy(), solution)
    return solution


@numba.njit(cache=True)
def _cost(frames, joints, mjoint, offsets, observed, weights, robust2):  # type: ignore[no-untyped-def] # pragma: no cover
    at = np.empty(3)
    total = 0.0
    for m in range(len(mjoint)):
        if weights[m] > 0:
            marker_at(frames, joints, mjoint[m], offsets[m], at)
            r2 = (at[0] - observed[m, 0]) ** 2 + (at[1] - observed[m, 1]) ** 2 + (at[2] - observed[m, 2]) ** 2
            total += weights[m] * r2 / (1 + r2 / robust2)
    return total


@numba.njit(cache=True)
def _prior_cost(signed, start, drift, shift, ball, rest, hold, hold_pelvis):  # type: ignore[no-untyped-def] # pragma: no cover
    total = hold_pelvis * (shift[0] ** 2 + shift[1] ** 2 + shift[2] ** 2)
    for j in range(len(ball)):
        for k in range(3):
            if ball[j]:
                total += hold[j] * drift[j, k] ** 2
            else:
                total += rest[j, k] * signed[j, k] ** 2 + hold[j] * (signed[j, k] - start[j, k]) ** 2
    return total


@numba.njit(cache=True)
def _normal(  # type: ignore[no-untyped-def] # pragma: no cover
    parents, ball, limits, signed, start, drift, shift, frames, joints, mjoint, offsets, observed, weights,
    robust2, rest, hold, hold_pelvis, h, g,
):  # fmt: skip
    """Gauss-Newton matrix and gradient of the cost; angles that push against their limit are cut out."""
    axes = axes_of(parents, ball, frames, signed)
    chain = np.empty(len(parents), np.int64)
    columns = np.empty((3, 3 + 3 * len(parents)))
    index = np.empty(3 + 3 * len(parents), np.int64)
    at = np.empty(3)
    h[:] = 0.0
    g[:] = 0.0
    for m in range(len(mjoint)):
        if weights[m] <= 0:
            continue
        marker_at(frames, joints, mjoint[m], offsets[m], at)
        count = marker_columns(chain, chain_of(parents, mjoint[m], chain), axes, joints, at, columns, index)
        rx, ry, rz = at[0] - observed[m, 0], at[1] - observed[m, 1], at[2] - observed[m, 2]
        w = weights[m] / (1 + (rx * rx + ry * ry + rz * rz) / robust2) ** 2
        for a in range(count):
            x, y, z = w * columns[0, a], w * columns[1, a], w * columns[2, a]
            g[index[a]] += x * rx + y * ry + z * rz
            for b in range(count):
                h[index[a], index[b]] += x * columns[0, b] + y * columns[1, b] + z * columns[2, b]
    for i in range(3):
        h[i, i] += hold_pelvis
        g[i] += hold_pelvis * shift[i]
    for j in range(len(parents)):
        for k in range(3):
            v = 3 + 3 * j + k
            if ball[j]:
                h[v, v] += hold[j]
                g[v] += hold[j] * drift[j, k]
                continue
            h[v, v] += rest[j, k] + hold[j]
            g[v] += rest[j, k] * signed[j, k] + hold[j] * (signed[j, k] - start[j, k])
            low, high = limits[j, k, 0] + 1e-9, limits[j, k, 1] - 1e-9
            if (signed[j, k] <= low and g[v] > 0) or (signed[j, k] >= high and g[v] < 0):
                h[v, :] = 0.0
                h[:, v] = 0.0
                h[v, v] = 1.0
                g[v] = 0.0


@numba.njit(cache=True)
def _fit(  # type: ignore[no-untyped-def] # pragma: no cover
    parents, ball, limits, pelvis, signed, local, bones, mjoint, offsets, observed, weights,
    rest, hold, hold_pelvis, robust2, steps,
):  # fmt: skip
    n = 3 + 3 * len(parents)
    start, origin = signed.copy(), pelvis.copy()
    drift = np.zeros_like(signed)
    h, g = np.empty((n, n)), np.empty(n)
    frames, joints = place_compiled(parents, local, bones, pelvis)
    cost = _cost(frames, joints, mjoint, offsets, observed, weights, robust2) + _prior_cost(
        signed, start, drift, pelvis - origin, ball, rest, hold, hold_pelvis
    )
    damping = 1e-3
    for _ in range(steps):
        _normal(
            parents, ball, limits, signed, start, drift, pelvis - origin, frames, joints, mjoint, offsets,
            observed, weights, robust2, rest, hold, hold_pelvis, h, g,
        )  # fmt: skip
        improved = False
        for _ in range(8):
            damped = h.copy()
            for v in range(n):
                damped[v, v] += damping * h[v, v] + 1e-6
            step = -g
            _solve(damped, step)
            new_pelvis, new_signed, new_local, new_drift = (
                pelvis.copy(),
                signed.copy(),
                local.copy(),
                drift.copy(),
            )
            _apply(step, ball, limits, new_pelvis, new_signed, new_local, new_drift)
            new_frames, new_joints = place_compiled(parents, new_local, bones, new_pelvis)
            new_cost = _cost(
                new_frames, new_joints, mjoint, offsets, observed, weights, robust2
            ) + _prior_cost(new_signed, start, new_drift, new_pelvis - origin, ball, rest, hold, hold_pelvis)
            if new_cost < cost:
                improved = True
                break
            damping = max(10 * damping, 1e-3)
        if not improved:
            break
        gain = cost - new_cost
        damping = max(1e-7, damping / 10)
        pelvis[:], signed[:], local[:], drift[:] = new_pelvis, new_signed, new_local, new_drift
        frames, joints, cost = new_frames, new_joints, new_cost
        if gain < 1e-4 * cost + 1e-9:
            break
    return cost


@numba.njit(cache=True)
def _apply(step, ball, limits, pelvis, signed, local, drift):  # type: ignore[no-untyped-def] # pragma: no cover
    for k in range(3):
        pelvis[k] += min(0.5, max(-0.5, step[k]))
    for j in range(len(ball)):
        for k in range(3):
            move = min(0.7, max(-0.7, step[3 + 3 * j + k]))
            if ball[j]:
                drift[j, k] += move
                step[3 + 3 * j + k] = move
            else:
                signed[j, k] = min(limits[j, k, 1], max(limits[j, k, 0], signed[j, k] + move))
        if ball[j]:
            turn(step[3 + 3 * j : 6 + 3 * j], local[j])
            settle(local[j], signed[j], limits[j])
        else:
            euler_matrix(signed[j, 0], signed[j, 1], signed[j, 2], local[j])


@numba.njit(cache=True)
def _shape_normal(  # type: ignore[no-untyped-def] # pragma: no cover
    parents, ball, limits, pelvis, signed, local, bones, mjoint, offsets, observed, weights,
    rest, hold, hold_pelvis, robust2, bone_basis, offset_basis,
):  # fmt: skip
    n, groups, markers = 3 + 3 * len(parents), len(bone_basis), len(mjoint)
    size = groups + 3 * markers
    frames, joints = place_compiled(parents, local, bones, pelvis)
    h, g = np.empty((n, n)), np.empty(n)
    zero = np.zeros_like(signed)
    _normal(
        parents, ball, limits, signed, signed, zero, np.zeros(3), frames, joints, mjoint, offsets, observed,
        weights, robust2, rest, hold, hold_pelvis, h, g,
    )  # fmt: skip
    axes = axes_of(parents, ball, frames, signed)
    mixed, matrix, gradient = np.zeros((n, size)), np.zeros((size, size)), np.zeros(size)
    chain = np.empty(len(parents), np.int64)
    columns, index = np.empty((3, n)), np.empty(n, np.int64)
    at, rows, which = np.empty(3), np.empty((3, groups + 3)), np.empty(groups + 3, np.int64)
    for m in range(markers):
        if weights[m] <= 0:
            continue
        j = mjoint[m]
        marker_at(frames, joints, j, offsets[m], at)
        links = chain_of(parents, j, chain)
        count = marker_columns(chain, links, axes, joints, at, columns, index)
        r = at - observed[m]
        w = weights[m] / (1 + (r[0] ** 2 + r[1] ** 2 + r[2] ** 2) / robust2) ** 2
        for i in range(3):
            for q in range(groups):
                which[q] = q
                rows[i, q] = 0.0
                for k in range(3):
                    rows[i, q] += frames[j, i, k] * offset_basis[q, m, k]
                for link in range(links - 1):
                    c = chain[link]
                    for k in range(3):
                        rows[i, q] += frames[parents[c], i, k] * bone_basis[q, c, k]
            for k in range(3):
                which[groups + k] = groups + 3 * m + k
                rows[i, groups + k] = frames[j, i, k]
        for a in range(groups + 3):
            for i in range(3):
                x = w * rows[i, a]
                gradient[which[a]] += x * r[i]
                for b in range(groups + 3):
                    matrix[which[a], which[b]] += x * rows[i, b]
                for b in range(count):
                    mixed[index[b], which[a]] += x * columns[i, b]
    for v in range(n):
        if h[v, v] == 1.0 and g[v] == 0.0:
            mixed[v, :] = 0.0
        h[v, v] += 1e-6
    _eliminate(h, g, mixed, matrix, gradient)
    return matrix, gradient
