"""Compiled forward kinematics with its exact derivative in every variable of a posture.

Joints, angles and frames are as in ``skeleton.forward``, with anatomical zero as the rest pose.
``bones_m[j]`` leads to joint j from its parent with the limbs hanging. Angles are signed as rotations
(``skeleton`` counts flexion the same way on both sides). Pelvis and shoulders turn by rotation vectors,
because their Euler angles lock with a raised arm or a lying person.
"""

from typing import NamedTuple

import numba
import numpy as np

from annotate.array_types import Bool, Float64, Int64
from synth.body.skeleton import JOINTS, LIMITS_RAD, PARENTS, rotations
from synth.body.skeleton import SIGNS as ANGLE_SIGNS


class Tree(NamedTuple):
    """Joint tree for compiled code.

    parents (J,): -1 for the root. ball (J,): joints that turn by rotation vectors. limits_rad (J, 3, 2): of
    the signed angles.
    """

    parents: Int64
    ball: Bool
    limits_rad: Float64


_LIMITS_RAD = np.sort(LIMITS_RAD * ANGLE_SIGNS[..., None], axis=-1)
_LIMITS_RAD[0] = (-np.inf, np.inf)
_BALL = np.array([joint.kind in ("pelvis", "shoulder") for joint in JOINTS])
TREE = Tree(PARENTS.astype(np.int64), _BALL, _LIMITS_RAD)


class State(NamedTuple):
    """Posed skeleton of the solver.

    pelvis_m: (3,) world. signed_rad: (J, 3) signed Euler angles. local: (J, 3, 3) joint rotations.
    """

    pelvis_m: Float64
    signed_rad: Float64
    local: Float64

    @staticmethod
    def of(angles_rad: Float64, pelvis_m: Float64) -> "State":
        """Return the state of angle triples (J, 3) in the sign convention of ``skeleton``."""
        return State(pelvis_m.copy(), angles_rad * ANGLE_SIGNS, rotations(angles_rad))

    @property
    def angles_rad(self) -> Float64:
        """Return angle triples (J, 3) in the sign convention of ``skeleton``; the pelvis' angles are within
        half a turn.
        """
        angles = self.signed_rad * ANGLE_SIGNS
        angles[0] = (angles[0] + np.pi) % (2 * np.pi) - np.pi
        return np.asarray(angles)


class Subject(NamedTuple):
    """Bones (J, 3) of a person, from parent to joint in anatomical zero, and markers.

    marker_joint: (M,) the joint of each marker; offsets_m: (M, 3) in the joint's frame at anatomical zero.
    """

    bones_m: Float64
    marker_joint: Int64
    offsets_m: Float64


def markers_at(state: State, subject: Subject) -> Float64:
    """Return the markers (M, 3) of a posed subject: world, metres."""
    frames, joints = joint_frames(TREE, state, subject.bones_m)
    turned = np.einsum("mij,mj->mi", frames[subject.marker_joint], subject.offsets_m)
    return np.asarray(joints[subject.marker_joint] + turned)


@numba.njit(cache=True)
def joint_frames(tree: Tree, state: State, bones_m: Float64) -> tuple[Float64, Float64]:
    """Return frames (J, 3, 3), from anatomical zero to the world, and joints (J, 3), world, metres."""
    n = len(tree.parents)
    frames = np.empty((n, 3, 3))
    joints = np.empty((n, 3))
    for j in range(n):
        p = tree.parents[j]
        for a in range(3):
            if p < 0:
                joints[j, a] = state.pelvis_m[a]
                for b in range(3):
                    frames[j, a, b] = state.local[j, a, b]
            else:
                joints[j, a] = joints[p, a]
                for b in range(3):
                    joints[j, a] += frames[p, a, b] * bones_m[j, b]
                    frames[j, a, b] = 0.0
                    for c in range(3):
                        frames[j, a, b] += frames[p, a, c] * state.local[j, c, b]
    return frames, joints


@numba.njit(cache=True)
def axes_of(tree: Tree, frames: Float64, signed: Float64) -> Float64:
    """Return the world axes (J, 3, 3) of each joint's three variables; rows are axes."""
    n = len(tree.parents)
    axes = np.zeros((n, 3, 3))
    for j in range(n):
        p = tree.parents[j]
        if p < 0:
            for k in range(3):
                axes[j, k, k] = 1.0
            continue
        f = frames[p]
        if tree.ball[j]:
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
def euler_matrix(a: float, b: float, c: float, out: Float64) -> None:
    """Write Rx(a) Ry(b) Rz(c) into ``out``."""
    ca, sa, cb, sb, cc, sc = np.cos(a), np.sin(a), np.cos(b), np.sin(b), np.cos(c), np.sin(c)
    out[0, 0], out[0, 1], out[0, 2] = cb * cc, -cb * sc, sb
    out[1, 0], out[1, 1], out[1, 2] = ca * sc + sa * sb * cc, ca * cc - sa * sb * sc, -sa * cb
    out[2, 0], out[2, 1], out[2, 2] = sa * sc - ca * sb * cc, sa * cc + ca * sb * sc, ca * cb


@numba.njit(cache=True)
def _wrapped(x: float) -> float:
    return (x + np.pi) % (2 * np.pi) - np.pi


@numba.njit(cache=True)
def limit_ball(rotation: Float64, signed: Float64, limits: Float64) -> None:
    """Write the Euler angles (3,) of a ball joint's rotation (3, 3) into ``signed``, which holds the previous
    triple.

    Of the triples inside the limits (3, 2), the nearest to the previous one is written. If there is none,
    both arguments are clamped.
    """
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
        triple = (
            _wrapped(a + twin * np.pi),
            b if twin == 0 else _wrapped(np.pi - b),
            _wrapped(c + twin * np.pi),
        )
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
        euler_matrix(signed[0], signed[1], signed[2], rotation)


@numba.njit(cache=True)
def turn(w: Float64, rotation: Float64) -> None:
    """Turn a rotation (3, 3) further by a rotation vector (3,), in place: exp(w) R (Rodrigues)."""
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


class Derivative(NamedTuple):
    """Derivative (3, K) of one marker in K variables: the first K columns; ``variables`` (V,) lists their
    indices.
    """

    columns: Float64
    variables: Int64


@numba.njit(cache=True)
def derive(tree: Tree, j: int, placed: tuple[Float64, Float64], at: Float64, into: Derivative) -> int:
    """Write the derivative of a marker's position in the joint angles above it; return the number K of
    variables.

    j: joint that carries the marker. placed: rotation axes (J, 3, 3) and positions (J, 3) of the joints. at:
    position (3,) of the marker. Positions in the world, metres.
    """
    axes, joints = placed
    columns, index = into
    for k in range(3):
        index[k] = k
        for i in range(3):
            columns[i, k] = 1.0 if i == k else 0.0
    count = 3
    while j >= 0:
        dx, dy, dz = at[0] - joints[j, 0], at[1] - joints[j, 1], at[2] - joints[j, 2]
        for k in range(3):
            ax, ay, az = axes[j, k, 0], axes[j, k, 1], axes[j, k, 2]
            columns[0, count] = ay * dz - az * dy
            columns[1, count] = az * dx - ax * dz
            columns[2, count] = ax * dy - ay * dx
            index[count] = 3 + 3 * j + k
            count += 1
        j = tree.parents[j]
    return count


@numba.njit(cache=True)
def marker_at(frames: Float64, joints: Float64, subject: Subject, m: int, at: Float64) -> None:
    """Write the place (3,) of marker m into ``at``: world, metres."""
    j, offset = subject.marker_joint[m], subject.offsets_m[m]
    for i in range(3):
        at[i] = joints[j, i]
        for k in range(3):
            at[i] += frames[j, i, k] * offset[k]


@numba.njit(cache=True)
def _factor(h: Float64) -> None:
    """Factorise a positive definite matrix in place (Cholesky).

    At this size this is faster than LAPACK, whose threads compete for the cores.
    """
    for i in range(len(h)):
        for j in range(i + 1):
            total = h[i, j]
            for k in range(j):
                total -= h[i, k] * h[j, k]
            h[i, j] = np.sqrt(max(total, 1e-12)) if i == j else total / h[j, j]


@numba.njit(cache=True)
def solve_in_place(h: Float64, x: Float64) -> None:
    """Solve a positive definite system: ``x`` becomes the solution, ``h`` the Cholesky factor."""
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
def eliminate(h: Float64, g: Float64, mixed: Float64, matrix: Float64, gradient: Float64) -> None:
    """Form the Schur complement: matrix -= B' A^-1 B, gradient -= B' A^-1 g, with A = ``h`` and B =
    ``mixed``."""
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
    """Solve a positive definite system (n, n) without changing the arguments."""
    solution = right.copy()
    solve_in_place(matrix.copy(), solution)
    return solution
