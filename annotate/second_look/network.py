"""Network on a graph of supervoxels, with means over neighbours, patch and whole person as messages.

As in GraphSAGE (Hamilton et al. 2017); the forward pass is a few matrix products, so that labelling needs no
framework. Trained by ``annotate-cloud train-labels``.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from annotate.array_types import Float32, Float64, Index, Int32, Int64

MOST_DEVIATIONS = 5.0
"""Bound of a descriptor in standard deviations. Chosen by eye."""


@dataclass(frozen=True)
class GraphNetwork:
    """Weights float32 of F descriptors, H hidden values, R rounds and C classes.

    middle, spread: (F,), mean and standard deviation of the descriptors. enter (F + 1, H), rounds
    (R, 4 H + 1, H), leave (H + F + 1, C): matrices, each with its bias as the last row.
    """

    middle: Float32
    spread: Float32
    enter: Float32
    rounds: Float32
    leave: Float32

    def __call__(self, described: Float64, edges: Int32, patch: Index, sizes: Int64) -> Float64:
        """Probabilities (G, C) of the classes of G supervoxels.

        described: (G, F), descriptors. edges: (e, 2), pairs of neighbours. patch, sizes: (G,), patch and
        number of points of each.
        """
        scaled = np.clip((described - self.middle) / self.spread, -MOST_DEVIATIONS, MOST_DEVIATIONS)
        x = scaled.astype(np.float32)
        hidden = np.maximum(_dense(self.enter, x), 0)
        a, b = np.concatenate([edges, edges[:, ::-1]]).T
        near = _Means(a, np.ones(len(a), np.float32), len(x), b)
        patches = _Means(patch, sizes.astype(np.float32), int(patch.max(initial=-1)) + 1)
        whole = _Means(np.zeros_like(patch), sizes.astype(np.float32), 1)
        for matrix in self.rounds:
            messages = np.column_stack(
                [hidden, near(hidden), patches(hidden)[patch], np.repeat(whole(hidden), len(x), axis=0)]
            )
            hidden = hidden + np.maximum(_dense(matrix, messages), 0)
        score = _dense(self.leave, np.column_stack([hidden, x])).astype(np.float64)
        chance = np.exp(score - score.max(axis=1, keepdims=True))
        return np.asarray(chance / chance.sum(axis=1, keepdims=True))


class _Means:
    """Weighted means over groups of rows: group ``into[i]`` has row ``of[i]`` with weight ``weight[i]``."""

    def __init__(
        self, into: NDArray[np.integer], weight: Float32, count: int, of: NDArray[np.integer] | None = None
    ) -> None:
        order = np.argsort(into, kind="stable")
        self._of = order if of is None else of[order]
        self._weight = weight[order, None]
        self._into, self._start = np.unique(into[order], return_index=True)
        self._count = count
        self._total = np.bincount(into, weight, count).astype(np.float32)[self._into, None]

    def __call__(self, rows: Float32) -> Float32:
        """Means (count, k) of rows (n, k); 0 for an empty group."""
        mean = np.zeros((self._count, rows.shape[1]), np.float32)
        if len(self._start):
            total = np.add.reduceat(self._weight * rows[self._of], self._start, axis=0)
            mean[self._into] = total / self._total
        return mean


def _dense(matrix: Float32, rows: Float32) -> Float32:
    """Rows (n, k) times a matrix (k + 1, m), its last row added to each: (n, m)."""
    return np.asarray(rows @ matrix[:-1] + matrix[-1])
