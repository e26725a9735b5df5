"""Compiled forward kinematics with its exact Jacobian, and the damped least squares that poses a skeleton.

The same joints, angles and frames as ``skeleton.forward``, whose anatomical zero is the rest pose here:
``bones_m[j]`` is joint j seen from its parent with the limbs hanging. Inside this module angles are signed as
rotations (``skeleton`` counts flexion the same way on both sides). Pelvis and shoulders turn by rotation
vectors, because their Euler angles lock with a raised arm or a lying person.
"""

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from synth.skeleton import _SIGNS as ANGLE_SIGNS
from synth.skeleton import JOINTS, LIMITS_RAD, N_JOINTS, PARENTS, Float64, rotations

N_VARIABLES = 3 + 3 * N_JOINTS
"""Pelvis position, then three angles a joint."""
MARKER_SIGMA_M = 0.01
"""What a marker's residual is measured in: noise, soft tissue and the model's own error together."""
ROBUST_M = 0.08
"""Residual at which a marker's pull wanes (Geman & McClure 1987)."""

_PARENTS = PARENTS.astype(np.int64)
_BALL = np.array([j.name == "pelvis" or j.name.endswith("_shoulder") for j in JOINTS])
_LIMITS = np.sort(LIMITS_RAD * ANGLE_SIGNS[..., None], axis=-1)
_LIMITS[0] = (-np.inf, np.inf)


@dataclass(frozen=True)
class State:
    """A posed skeleton as the solver keeps it.

    pelvis_m: (3,) world. signed_rad: (J, 3) signed Euler angles. local: (J, 3, 3) the joints' rotations.
    """

    pelvis_m: Float64
    signed_rad: Float64
    local: Float64

    @staticmethod
    def of(angles_rad: Float64, pelvis_m: Float64) -> "State":
        """State of angle triples (J, 3) as ``skeleton`` counts them."""
        return State(pelvis_m.copy(), angles_rad * ANGLE_SIGNS, rotations(angles_rad))

    @property
    def angles_rad(self) -> Float64:
        """Angle triples (J, 3) as ``skeleton`` counts them; the pelvis' within half a turn."""
        angles = self.signed_rad * ANGLE_SIGNS
        angles[0] = (angles[0] + np.pi) % (2 * np.pi) - np.pi
        return np.asarray(angles)


@dataclass(frozen=True)
class Prior:
    """What holds a posture where markers do not: weights per squared radian and per squared metre.

    rest: (J,) pull to anatomical zero; hold: (J,) pull to the start; hold_pelvis: pull of its place.
    """

    rest: Float64
    hold: Float64
    hold_pelvis: float


def place(state: State, bones_m: Float64) -> tuple[Float64, Float64]:
    """Frames (J, 3, 3), which turn anatomical zero to the world, and joints (J, 3), world, metres."""
    frames, joints = _place(_PARENTS, state.local, bones_m, state.pelvis_m)
    return frames, joints


def markers_at(state: State, bones_m: Float64, marker_joint: NDArray[np.int64], offsets_m: Float64) -> Float64:
    """Where markers (M, 3) fixed to the joints ``marker_joint`` at ``offsets_m`` (M, 3) are, world, metres."""
    frames, joints = place(state, bones_m)
    return np.asarray(joints[marker_joint] + np.einsum("mij,mj->mi", frames[marker_joint], offsets_m))


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
        _PARENTS, _BALL, _LIMITS, pelvis, signed, local, bones_m, marker_joint, offsets_m, observed_m,
        weights / MARKER_SIGMA_M**2, prior.rest, prior.hold, prior.hold_pelvis, robust_m**2, steps,
    )  # fmt: skip
    return State(pelvis, signed, local), float(cost)


def normal_blocks(
    state: State,
    bones_m: Float64,
    marker_joint: NDArray[np.int64],
    offsets_m: Float64,
    observed_m: Float64,
    weights: Float64,
    prior: Prior,
    bone_basis: Float64,
    offset_basis: Float64,
) -> tuple[Float64, Float64, Float64, Float64]:
    """Second-order blocks of the cost in posture and shape, for fitting both over many frames.

    bone_basis (G, J, 3) and offset_basis (G, M, 3): metres per shape parameter; after the G parameters come
    three free coordinates a marker, in the frame of its joint: S = G + 3 M. Returns the blocks posture-posture
    (N, N), frozen angles cut out, posture-shape (N, S), shape-shape (S, S) and the gradient in shape (S,).
    """
    return _blocks(
        _PARENTS, _BALL, _LIMITS, state.pelvis_m, state.signed_rad, state.local, bones_m, marker_joint, offsets_m,
        observed_m, weights / MARKER_SIGMA_M**2, prior.rest, prior.hold, prior.hold_pelvis, ROBUST_M**2,
        bone_basis, offset_basis,
    )  # type: ignore[no-any-return] # fmt: skip


@numba.njit(cache=True)
def _place(parents, local, bones, pelvis):  # type: ignore[no-untyped-def] # pragma: no cover
    n = len(parents)
    frames = np.empty((n, 3, 3))
    joints = np.empty((n, 3))
    for j in range(n):
        p = parents[j]
        for a in range(3):
            if p < 0:
                joints[j, a] = pelvis[a]
                for b in range(3):
                    frames[j, a, b] = local[j, a, b]
            else:
                joints[j, a] = joints[p, a]
                for b in range(3):
                    joints[j, a] += frames[p, a, b] * bones[j, b]
                    frames[j, a, b] = 0.0
                    for c in range(3):
                        frames[j, a, b] += frames[p, a, c] * local[j, c, b]
    return frames, joints


@numba.njit(cache=True)
def _axes(parents, ball, frames, signed):  # type: ignore[no-untyped-def] # pragma: no cover
    """World axes (J, 3, 3) about which each of a joint's three variables turns it; rows are axes."""
    n = len(parents)
    axes = np.zeros((n, 3, 3))
    for j in range(n):
        p = parents[j]
        if p < 0:
            for k in range(3):
                axes[j, k, k] = 1.0
            continue
        f = frames[p]
        if ball[j]:
            axes[j] = f.T
            continue
        ca, sa = np.cos(signed[j, 0]), np.sin(signed[j, 0])
        cb, sb = np.cos(signed[j, 1]), np.sin(signed[j, 1])
        for i in range(3):
            axes[j, 0, i] = f[i, 0]
            axes[j, 1, i] = ca * f[i, 1] + sa * f[i, 2]
            axes[j, 2, i] = sb * f[i, 0] - sa * cb * f[i, 1] + ca * cb * f[i, 2]
    return axes


@numba.njit(cache=True)
def _euler(a, b, c, out):  # type: ignore[no-untyped-def] # pragma: no cover
    """Rx(a) Ry(b) Rz(c) into ``out``."""
    ca, sa, cb, sb, cc, sc = np.cos(a), np.sin(a), np.cos(b), np.sin(b), np.cos(c), np.sin(c)
    out[0, 0], out[0, 1], out[0, 2] = cb * cc, -cb * sc, sb
    out[1, 0], out[1, 1], out[1, 2] = ca * sc + sa * sb * cc, ca * cc - sa * sb * sc, -sa * cb
    out[2, 0], out[2, 1], out[2, 2] = sa * sc - ca * sb * cc, sa * cc + ca * sb * sc, ca * cb


@numba.njit(cache=True)
def _wrapped(x):  # type: ignore[no-untyped-def] # pragma: no cover
    return (x + np.pi) % (2 * np.pi) - np.pi


@numba.njit(cache=True)
def _settle(rotation, signed, limits):  # type: ignore[no-untyped-def] # pragma: no cover
    """Euler angles of a ball joint nearest to the ones before and inside the limits; clamps where none is."""
    best = np.inf
    chosen = np.zeros(3)
    b = np.arcsin(min(1.0, max(-1.0, rotation[0, 2])))
    if np.cos(b) > 1e-6:
        a = np.arctan2(-rotation[1, 2], rotation[2, 2])
        c = np.arctan2(-rotation[0, 1], rotation[0, 0])
    else:
        # Locked: only the sum of the outer angles counts; the first stays.
        a = signed[0]
        total = np.arctan2(rotation[1, 0], rotation[1, 1])
        c = total - a if b > 0 else total + a
    for twin in range(2):
        triple = (_wrapped(a + twin * np.pi), b if twin == 0 else _wrapped(np.pi - b), _wrapped(c + twin * np.pi))
        score = 0.0
        for k in range(3):
            beyond = max(0.0, limits[k, 0] - triple[k], triple[k] - limits[k, 1])
            score += 1e3 * beyond + _wrapped(triple[k] - signed[k]) ** 2
        if score < best:
            best = score
            for k in range(3):
                chosen[k] = triple[k]
    outside = False
    for k in range(3):
        inside = min(limits[k, 1], max(limits[k, 0], chosen[k]))
        outside |= inside != chosen[k]
        signed[k] = inside
    if outside:
        _euler(signed[0], signed[1], signed[2], rotation)


@numba.njit(cache=True)
def _turn(w, rotation):  # type: ignore[no-untyped-def] # pragma: no cover
    """exp(w) R in place (Rodrigues)."""
    angle = np.sqrt(w[0] ** 2 + w[1] ** 2 + w[2] ** 2)
    if angle < 1e-12:
        return
    x, y, z = w[0] / angle, w[1] / angle, w[2] / angle
    c, s = np.cos(angle), np.sin(angle)
    t = 1 - c
    e = np.array(
        (
            (c + t * x * x, t * x * y - s * z, t * x * z + s * y),
            (t * x * y + s * z, c + t * y * y, t * y * z - s * x),
            (t * x * z - s * y, t * y * z + s * x, c + t * z * z),
        )
    )
    result = np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            for k in range(3):
                result[i, j] += e[i, k] * rotation[k, j]
    rotation[:] = result


@numba.njit(cache=True)
def _solve(h, x):  # type: ignore[no-untyped-def] # pragma: no cover
    """Solve the positive definite system in place (Cholesky); faster than LAPACK's threads at this size."""
    n = len(x)
    for i in range(n):
        for j in range(i + 1):
            total = h[i, j]
            for k in range(j):
                total -= h[i, k] * h[j, k]
            h[i, j] = np.sqrt(max(total, 1e-12)) if i == j else total / h[j, j]
        for k in range(i):
            x[i] -= h[i, k] * x[k]
        x[i] /= h[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            x[i] -= h[k, i] * x[k]
        x[i] /= h[i, i]


@numba.njit(cache=True)
def _solve(h, x):  # type: ignore[no-untyped-def] # pragma: no cover
    """Solve the positive definite system in place (Cholesky); faster than LAPACK's threads at this size."""
    n = len(x)
    for i in range(n):
        for j in range(i + 1):
            total = h[i, j]
            for k in range(j):
                total -= h[i, k] * h[j, k]
            h[i, j] = np.sqrt(max(total, 1e-12)) if i == j else total / h[j, j]
        for k in range(i):
            x[i] -= h[i, k] * x[k]
        x[i] /= h[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            x[i] -= h[k, i] * x[k]
        x[i] /= h[i, i]


@numba.njit(cache=True)
def _chain(parents, j, chain):  # type: ignore[no-untyped-def] # pragma: no cover
    """Joints from ``j`` to the root into ``chain``; how many."""
    n = 0
    while j >= 0:
        chain[n] = j
        n += 1
        j = parents[j]
    return n


@numba.njit(cache=True)
def _marker_columns(chain, n, axes, joints, at, columns, index):  # type: ignore[no-untyped-def] # pragma: no cover
    """Derivative (3, K) of one marker in the K variables ``index`` that move it; returns K."""
    for k in range(3):
        index[k] = k
        for i in range(3):
            columns[i, k] = 1.0 if i == k else 0.0
    count = 3
    for link in range(n):
        j = chain[link]
        dx, dy, dz = at[0] - joints[j, 0], at[1] - joints[j, 1], at[2] - joints[j, 2]
        for k in range(3):
            ax, ay, az = axes[j, k, 0], axes[j, k, 1], axes[j, k, 2]
            columns[0, count] = ay * dz - az * dy
            columns[1, count] = az * dx - ax * dz
            columns[2, count] = ax * dy - ay * dx
            index[count] = 3 + 3 * j + k
            count += 1
    return count


@numba.njit(cache=True)
def _marker(frames, joints, j, offset, at):  # type: ignore[no-untyped-def] # pragma: no cover
    for i in range(3):
        at[i] = joints[j, i]
        for k in range(3):
            at[i] += frames[j, i, k] * offset[k]


@numba.njit(cache=True)
def _cost(frames, joints, mjoint, offsets, observed, weights, robust2):  # type: ignore[no-untyped-def] # pragma: no cover
    at = np.empty(3)
    total = 0.0
    for m in range(len(mjoint)):
        if weights[m] > 0:
            _marker(frames, joints, mjoint[m], offsets[m], at)
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
                total += rest[j] * signed[j, k] ** 2 + hold[j] * (signed[j, k] - start[j, k]) ** 2
    return total


@numba.njit(cache=True)
def _normal(  # type: ignore[no-untyped-def] # pragma: no cover
    parents, ball, limits, signed, start, drift, shift, frames, joints, mjoint, offsets, observed, weights,
    robust2, rest, hold, hold_pelvis, h, g,
):  # fmt: skip
    """Gauss-Newton matrix and gradient of the cost; angles that push against their limit are cut out."""
    axes = _axes(parents, ball, frames, signed)
    chain = np.empty(len(parents), np.int64)
    columns = np.empty((3, 3 + 3 * len(parents)))
    index = np.empty(3 + 3 * len(parents), np.int64)
    at = np.empty(3)
    h[:] = 0.0
    g[:] = 0.0
    for m in range(len(mjoint)):
        if weights[m] <= 0:
            continue
        _marker(frames, joints, mjoint[m], offsets[m], at)
        count = _marker_columns(chain, _chain(parents, mjoint[m], chain), axes, joints, at, columns, index)
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
            h[v, v] += rest[j] + hold[j]
            g[v] += rest[j] * signed[j, k] + hold[j] * (signed[j, k] - start[j, k])
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
    frames, joints = _place(parents, local, bones, pelvis)
    cost = _cost(frames, joints, mjoint, offsets, observed, weights, robust2) + _prior_cost(
        signed, start, drift, pelvis - origin, ball, rest, hold, hold_pelvis
    )
    damping = 1e-3
    for _ in range(steps):
        _normal(
            parents, ball, limits, signed, start, drift, pelvis - origin, frames, joints, mjoint, offsets, observed,
            weights, robust2, rest, hold, hold_pelvis, h, g,
        )  # fmt: skip
        improved = False
        for _ in range(8):
            damped = h.copy()
            for v in range(n):
                damped[v, v] += damping * h[v, v] + 1e-6
            step = -g
            _solve(damped, step)
            new_pelvis, new_signed, new_local, new_drift = pelvis.copy(), signed.copy(), local.copy(), drift.copy()
            _apply(step, ball, limits, new_pelvis, new_signed, new_local, new_drift)
            new_frames, new_joints = _place(parents, new_local, bones, new_pelvis)
            new_cost = _cost(new_frames, new_joints, mjoint, offsets, observed, weights, robust2) + _prior_cost(
                new_signed, start, new_drift, new_pelvis - origin, ball, rest, hold, hold_pelvis
            )
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
            _turn(step[3 + 3 * j : 6 + 3 * j], local[j])
            _settle(local[j], signed[j], limits[j])
        else:
            _euler(signed[j, 0], signed[j, 1], signed[j, 2], local[j])


@numba.njit(cache=True)
def _blocks(  # type: ignore[no-untyped-def] # pragma: no cover
    parents, ball, limits, pelvis, signed, local, bones, mjoint, offsets, observed, weights,
    rest, hold, hold_pelvis, robust2, bone_basis, offset_basis,
):  # fmt: skip
    n, groups, markers = 3 + 3 * len(parents), len(bone_basis), len(mjoint)
    size = groups + 3 * markers
    frames, joints = _place(parents, local, bones, pelvis)
    h, g = np.empty((n, n)), np.empty(n)
    zero = np.zeros_like(signed)
    _normal(
        parents, ball, limits, signed, signed, zero, np.zeros(3), frames, joints, mjoint, offsets, observed,
        weights, robust2, rest, hold, hold_pelvis, h, g,
    )  # fmt: skip
    axes = _axes(parents, ball, frames, signed)
    mixed, shape, gradient = np.zeros((n, size)), np.zeros((size, size)), np.zeros(size)
    chain = np.empty(len(parents), np.int64)
    columns, index = np.empty((3, n)), np.empty(n, np.int64)
    at, rows, which = np.empty(3), np.empty((3, groups + 3)), np.empty(groups + 3, np.int64)
    for m in range(markers):
        if weights[m] <= 0:
            continue
        j = mjoint[m]
        _marker(frames, joints, j, offsets[m], at)
        links = _chain(parents, j, chain)
        count = _marker_columns(chain, links, axes, joints, at, columns, index)
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
                    shape[which[a], which[b]] += x * rows[i, b]
                for b in range(count):
                    mixed[index[b], which[a]] += x * columns[i, b]
    for v in range(n):
        if h[v, v] == 1.0 and g[v] == 0.0:
            mixed[v, :] = 0.0
    return h, mixed, shape, gradient
