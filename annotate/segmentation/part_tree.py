"""Beliefs (G, 11) about supervoxels, smoothed by the body's part tree and the reach of its parts."""

import numpy as np

from annotate.array_types import Float64, Int32
from annotate.cloud.supervoxels import Supervoxels
from annotate.parts import BODY_PARTS, NEIGHBOURS

SAME_PART, JOINED, TOUCHING = 0.0, -1.2, -2.4
"""Log compatibility of two touching supervoxels of one part, of anatomical neighbours, of others. Chosen by
eye."""
SMOOTHING, TREE_ROUNDS = 0.6, 6
"""Weight of one touching supervoxel, for up to four of them, and rounds of mean field. Chosen by eye."""
PART_REACH_M = np.array([0.17, 0.28, 0.22, 0.22, 0.27, 0.27, 0.22, 0.3, 0.3, 0.35, 0.35])
"""Reach (11,) of each part from its middle in metres: half the segment lengths of a tall man (Drillis &
Contini 1966: upper arm 0.186 of the stature, forearm with hand 0.254, thigh 0.245, shank with foot 0.285) and
a margin."""
STRAYING, LEAST_MIDDLE_POINTS = 1.5, 40
"""Log cost of a supervoxel one reach beyond its part's reach, growing with the square; points of a part below
which its middle is unknown. Chosen by eye."""

_IDS = [part.id for part in BODY_PARTS]
_BESIDE = [[frozenset((a, b)) in NEIGHBOURS for a in _IDS] for b in _IDS]
_COMPATIBILITY = np.where(_BESIDE, JOINED, TOUCHING)
np.fill_diagonal(_COMPATIBILITY, SAME_PART)
_Links = tuple[Int32, Int32, Float64]
"""Pairs of touching supervoxels (e,), sorted: receiver, sender, weight."""


def tree_belief(unary: Float64, groups: Supervoxels, centroids_m: Float64, start: Float64) -> Float64:
    """Mean-field belief (G, 11) of a Potts-like field whose costs follow the body's part tree.

    unary: (G, 11), log evidence. centroids_m: (G, 3), metres. start: (G, 11), an earlier belief, which gives
    the parts' middles. Source: Kraehenbuehl & Koltun 2011, the sparse case; rounds are damped, for
    convergence.
    """
    belief, unary = start, unary + _straying_cost(start, groups, centroids_m)
    links = _links(groups)
    for _ in range(TREE_ROUNDS):
        belief = 0.5 * belief + 0.5 * softmax(unary + _weighted_sum(links, belief @ _COMPATIBILITY))
    return belief


def softmax(x: Float64) -> Float64:
    """Probabilities (n, k) from log scores (n, k)."""
    e = np.exp(x - x.max(axis=1, keepdims=True))
    return np.asarray(e / e.sum(axis=1, keepdims=True))


def _links(groups: Supervoxels) -> _Links:
    """Links from each supervoxel to each touching one."""
    a, b = groups.edges.T
    degree = np.bincount(np.r_[a, b], minlength=groups.count)
    # More neighbours are no more independent evidence: their sum is bounded.
    weight = SMOOTHING * 4 / np.maximum(degree, 4)
    rows, columns = np.r_[a, b], np.r_[b, a]
    order = np.lexsort((columns, rows))
    return rows[order], columns[order], weight[rows[order]]


def _weighted_sum(links: _Links, values: Float64) -> Float64:
    """Sum (G, k) of the values (G, k) of each supervoxel's touching ones, by the links' weights."""
    rows, columns, weight = links
    total = np.zeros_like(values)
    first = np.flatnonzero(np.diff(rows, prepend=-1))
    if first.size:
        total[rows[first]] = np.add.reduceat(weight[:, None] * values[columns], first, axis=0)
    return total


def _straying_cost(belief: Float64, groups: Supervoxels, centroids_m: Float64) -> Float64:
    """Log cost (G, 11), 0 or less, of lying beyond a part's reach from its middle."""
    cost = np.zeros_like(belief)
    mass = (belief * (belief > 0.5)) * groups.sizes[:, None]
    for part in np.flatnonzero(mass.sum(axis=0) >= LEAST_MIDDLE_POINTS):
        middle_m = middle_of(mass[:, part], centroids_m, PART_REACH_M[part])
        away_m = np.linalg.norm(centroids_m - middle_m, axis=1)
        cost[:, part] = -STRAYING * np.maximum(away_m / PART_REACH_M[part] - 1, 0) ** 2
    return cost


def middle_of(weight: Float64, centroids_m: Float64, reach_m: float) -> Float64:
    """Middle (3,) in metres of centroids (G, 3) with weights (G,), by mean shift: islands have no pull."""
    middle_m = weight @ centroids_m / weight.sum()
    for _ in range(3):
        away_m = np.linalg.norm(centroids_m - middle_m, axis=1)
        near = weight * np.exp(-((away_m / reach_m) ** 2)) + 1e-9 * weight.max()
        middle_m = near @ centroids_m / near.sum()
    return np.asarray(middle_m)
