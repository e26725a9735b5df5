"""Positive definite systems of equations, compiled: solved, or some of their unknowns eliminated."""

import numba
import numpy as np

from annotate.array_types import Float64


@numba.njit(cache=True)
def _factor(h: Float64) -> None:
    """Cholesky factor in place; at this size faster than LAPACK, whose threads fight for the cores."""
    for i in range(len(h)):
        for j in range(i + 1):
            total = h[i, j]
            for k in range(j):
                total -= h[i, k] * h[j, k]
            h[i, j] = np.sqrt(max(total, 1e-12)) if i == j else total / h[j, j]


@numba.njit(cache=True)
def solve_in_place(h: Float64, x: Float64) -> None:
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
def eliminate(h: Float64, g: Float64, mixed: Float64, matrix: Float64, gradient: Float64) -> None:
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
    solve_in_place(matrix.copy(), solution)
    return solution
