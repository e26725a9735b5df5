"""Damped least squares for a skeleton's posture from markers, with derivatives in the body's shape."""

from typing import NamedTuple

import numba
import numpy as np

from annotate.array_types import Float64
from synth.markers.kinematics import (
    TREE,
    Derivative,
    State,
    Subject,
    Tree,
    axes_of,
    derive,
    eliminate,
    euler_matrix,
    joint_frames,
    limit_ball,
    marker_at,
    solve_in_place,
    turn,
)

MARKER_SIGMA_M = 0.005  # noise, soft tissue and the model's error together; untuned
ROBUST_M = 0.08  # residual from which a marker's pull weakens (Geman & McClure 1987); untuned


class Prior(NamedTuple):
    """Prior of a posture, for degrees of freedom that markers leave open: weights per squared radian and
    squared metre.

    rest: (J, 3), towards anatomical zero; hold: (J,), towards the start; hold_pelvis: towards the pelvis'
    position at the start.
    """

    rest: Float64
    hold: Float64
    hold_pelvis: float


class Observed(NamedTuple):
    """Markers (M, 3) of one frame, world, metres, and weights (M,), 0 where missing.

    robust_m: residual above which a marker's weight decreases.
    """

    markers_m: Float64
    weights: Float64
    robust_m: float = ROBUST_M


class _Start(NamedTuple):
    """Start of a fit: signed angles (J, 3), pelvis (3,). drift (J, 3): rotation of the ball joints since the
    start.
    """

    signed_rad: Float64
    pelvis_m: Float64
    drift: Float64


class _Target(NamedTuple):
    """``Observed`` in compiled code: markers (M, 3), weights (M,) per squared metre, squared residual."""

    markers_m: Float64
    weights: Float64
    robust2: float


class _Problem(NamedTuple):
    tree: Tree
    subject: Subject
    target: _Target
    prior: Prior


class _System(NamedTuple):
    h: Float64
    g: Float64


class Basis(NamedTuple):
    """Metres per shape parameter: bones (G, J, 3) and markers (G, M, 3)."""

    bones: Float64
    offsets: Float64


def fit_posture(
    start: State, subject: Subject, observed: Observed, prior: Prior, *, steps: int
) -> tuple[State, float]:
    """Return the posture with the least distance to the observed markers, inside the joint limits, and its
    cost.

    Levenberg-Marquardt (Nocedal & Wright 2006, section 10.3); an angle at its limit is fixed while its step
    points outwards.
    """
    state = State(*(array.copy() for array in start))
    return state, float(_fit(_problem(subject, observed, prior), state, steps))


def shape_normal(
    state: State, subject: Subject, observed: Observed, prior: Prior, basis: Basis
) -> tuple[Float64, Float64]:
    """Return Gauss-Newton matrix (S, S) and gradient (S,) of one frame's cost in the shape parameters.

    After the G parameters of the basis come three free coordinates per marker, in its joint's frame: S = G +
    3 M. The posture is eliminated by the Schur complement, as in bundle adjustment (Triggs et al. 2000,
    section 6.1).
    """
    matrix, gradient = _shape_normal(_problem(subject, observed, prior), state, basis)
    return matrix, gradient


def _problem(subject: Subject, observed: Observed, prior: Prior) -> _Problem:
    weights, robust2 = observed.weights / MARKER_SIGMA_M**2, observed.robust_m**2
    return _Problem(TREE, subject, _Target(observed.markers_m, weights, robust2), prior)


@numba.njit(cache=True)
def _cost(problem: _Problem, state: State, start: _Start, placed: tuple[Float64, Float64]) -> float:
    """Return the cost of the markers' residuals and of the prior. placed: frames and joints."""
    tree, subject, target, prior = problem
    frames, joints = placed
    at = np.empty(3)
    total = 0.0
    for m in range(len(subject.marker_joint)):
        if target.weights[m] > 0:
            marker_at(frames, joints, subject, m, at)
            goal = target.markers_m[m]
            r2 = (at[0] - goal[0]) ** 2 + (at[1] - goal[1]) ** 2 + (at[2] - goal[2]) ** 2
            total += target.weights[m] * r2 / (1 + r2 / target.robust2)
    shift = state.pelvis_m - start.pelvis_m
    held = prior.hold_pelvis * (shift[0] ** 2 + shift[1] ** 2 + shift[2] ** 2)
    for j in range(len(tree.ball)):
        for k in range(3):
            if tree.ball[j]:
                held += prior.hold[j] * start.drift[j, k] ** 2
            else:
                angle = state.signed_rad[j, k]
                held += prior.rest[j, k] * angle**2 + prior.hold[j] * (angle - start.signed_rad[j, k]) ** 2
    cost: float = total + held
    return cost


@numba.njit(cache=True)
def _normal(
    problem: _Problem, state: State, start: _Start, placed: tuple[Float64, Float64], system: _System
) -> None:
    """Write the normal equations of the cost into ``system``; angles whose step exceeds their limit are
    removed.
    """
    tree, subject, target, prior = problem
    (frames, joints), (h, g) = placed, system
    n = len(tree.parents)
    axes, signed = axes_of(tree, frames, state.signed_rad), state.signed_rad
    columns, index, at = np.empty((3, 3 + 3 * n)), np.empty(3 + 3 * n, np.int64), np.empty(3)
    h[:] = 0.0
    g[:] = 0.0
    for m in range(len(subject.marker_joint)):
        if target.weights[m] <= 0:
            continue
        marker_at(frames, joints, subject, m, at)
        count = derive(tree, subject.marker_joint[m], (axes, joints), at, Derivative(columns, index))
        goal = target.markers_m[m]
        rx, ry, rz = at[0] - goal[0], at[1] - goal[1], at[2] - goal[2]
        w = target.weights[m] / (1 + (rx * rx + ry * ry + rz * rz) / target.robust2) ** 2
        for a in range(count):
            x, y, z = w * columns[0, a], w * columns[1, a], w * columns[2, a]
            g[index[a]] += x * rx + y * ry + z * rz
            for b in range(count):
                h[index[a], index[b]] += x * columns[0, b] + y * columns[1, b] + z * columns[2, b]
    shift = state.pelvis_m - start.pelvis_m
    for i in range(3):
        h[i, i] += prior.hold_pelvis
        g[i] += prior.hold_pelvis * shift[i]
    for j in range(n):
        for k in range(3):
            v = 3 + 3 * j + k
            if tree.ball[j]:
                h[v, v] += prior.hold[j]
                g[v] += prior.hold[j] * start.drift[j, k]
                continue
            rest, hold = prior.rest[j, k], prior.hold[j]
            h[v, v] += rest + hold
            g[v] += rest * signed[j, k] + hold * (signed[j, k] - start.signed_rad[j, k])
            low, high = tree.limits_rad[j, k, 0] + 1e-9, tree.limits_rad[j, k, 1] - 1e-9
            if (signed[j, k] <= low and g[v] > 0) or (signed[j, k] >= high and g[v] < 0):
                h[v, :] = 0.0
                h[:, v] = 0.0
                h[v, v] = 1.0
                g[v] = 0.0


@numba.njit(cache=True)
def _fit(problem: _Problem, state: State, steps: int) -> float:
    tree, bones_m = problem.tree, problem.subject.bones_m
    n = 3 + 3 * len(tree.parents)
    start = _Start(state.signed_rad.copy(), state.pelvis_m.copy(), np.zeros_like(state.signed_rad))
    h, g = np.empty((n, n)), np.empty(n)
    placed = joint_frames(tree, state, bones_m)
    cost = _cost(problem, state, start, placed)
    damping = 1e-3
    for _ in range(steps):
        _normal(problem, state, start, placed, _System(h, g))
        improved = False
        for _ in range(8):
            damped = h.copy()
            for v in range(n):
                damped[v, v] += damping * h[v, v] + 1e-6
            step = -g
            solve_in_place(damped, step)
            new = State(state.pelvis_m.copy(), state.signed_rad.copy(), state.local.copy())
            new_start = _Start(start.signed_rad, start.pelvis_m, start.drift.copy())
            _apply(tree, step, new, new_start.drift)
            new_placed = joint_frames(tree, new, bones_m)
            new_cost = _cost(problem, new, new_start, new_placed)
            if new_cost < cost:
                improved = True
                break
            damping = max(10 * damping, 1e-3)
        if not improved:
            break
        gain = cost - new_cost
        damping = max(1e-7, damping / 10)
        state.pelvis_m[:], state.signed_rad[:], state.local[:] = new.pelvis_m, new.signed_rad, new.local
        start.drift[:] = new_start.drift
        placed, cost = new_placed, new_cost
        if gain < 1e-4 * cost + 1e-9:
            break
    return cost


@numba.njit(cache=True)
def _apply(tree: Tree, step: Float64, state: State, drift: Float64) -> None:
    """Add a step (V,), bounded per variable, to a state and to its drift."""
    for k in range(3):
        state.pelvis_m[k] += min(0.5, max(-0.5, step[k]))
    for j in range(len(tree.ball)):
        signed, limits = state.signed_rad[j], tree.limits_rad[j]
        for k in range(3):
            move = min(0.7, max(-0.7, step[3 + 3 * j + k]))
            if tree.ball[j]:
                drift[j, k] += move
                step[3 + 3 * j + k] = move
            else:
                signed[k] = min(limits[k, 1], max(limits[k, 0], signed[k] + move))
        if tree.ball[j]:
            turn(step[3 + 3 * j : 6 + 3 * j], state.local[j])
            limit_ball(state.local[j], signed, limits)
        else:
            euler_matrix(signed[0], signed[1], signed[2], state.local[j])


@numba.njit(cache=True)
def _shape_normal(problem: _Problem, state: State, basis: Basis) -> tuple[Float64, Float64]:
    tree, subject, target, _ = problem
    n, groups, markers = 3 + 3 * len(tree.parents), len(basis.bones), len(subject.marker_joint)
    size = groups + 3 * markers
    frames, joints = joint_frames(tree, state, subject.bones_m)
    h, g = np.empty((n, n)), np.empty(n)
    start = _Start(state.signed_rad, state.pelvis_m, np.zeros_like(state.signed_rad))
    _normal(problem, state, start, (frames, joints), _System(h, g))
    axes = axes_of(tree, frames, state.signed_rad)
    mixed, matrix, gradient = np.zeros((n, size)), np.zeros((size, size)), np.zeros(size)
    columns, index = np.empty((3, n)), np.empty(n, np.int64)
    at, rows, which = np.empty(3), np.empty((3, groups + 3)), np.empty(groups + 3, np.int64)
    for m in range(markers):
        if target.weights[m] <= 0:
            continue
        j = subject.marker_joint[m]
        marker_at(frames, joints, subject, m, at)
        count = derive(tree, j, (axes, joints), at, Derivative(columns, index))
        r = at - target.markers_m[m]
        w = target.weights[m] / (1 + (r[0] ** 2 + r[1] ** 2 + r[2] ** 2) / target.robust2) ** 2
        for i in range(3):
            for q in range(groups):
                which[q] = q
                rows[i, q] = 0.0
                for k in range(3):
                    rows[i, q] += frames[j, i, k] * basis.offsets[q, m, k]
                c = j
                while tree.parents[c] >= 0:
                    for k in range(3):
                        rows[i, q] += frames[tree.parents[c], i, k] * basis.bones[q, c, k]
                    c = tree.parents[c]
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
    eliminate(h, g, mixed, matrix, gradient)
    return matrix, gradient
