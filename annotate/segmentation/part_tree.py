"""Beliefs about supervoxels, made to agree with the body: its part tree and how far parts reach."""

import numpy as np

from annotate.array_types import Float64, Int32
from annotate.cloud.supervoxels import Supervoxels
from annotate.parts import BODY_PARTS, NEIGHBOURS

SAME, JOINED, TOUCHING = 0.0, -1.2, -2.4
"""Log compatibility of two touching supervoxels: the same part, anatomical neighbours, a chance contact."""
SMOOTHING = 0.6
ROUNDS = 6
REACH_M = np.array([0.17, 0.28, 0.22, 0.22, 0.27, 0.27, 0.22, 0.3, 0.3, 0.35, 0.35])
"""How far each part reaches from its middle: half the segment lengths of a tall man (Drillis & Contini 1966:
upper arm 0.186 of the stature, forearm with hand 0.254, thigh 0.245, shank with foot 0.285) and a margin."""
STRAYING = 1.5
"""Log cost of a supervoxel one reach further from a part's middle than the part reaches; it grows squared."""
LEAST_POINTS = 40
"""A part's middle is known from this many points on."""

_N = len(BODY_PARTS)
_Links = tuple[Int32, Int32, Float64]
"""Pairs of touching supervoxels, sorted: who heeds, whom, how much."""


def settle(
    unary: Float64,
    groups: Supervoxels,
    centroids_m: Float64,
    start: Float64 | None = None,
    rounds: int = ROUNDS,
) -> Float64:
    """Mean-field belief (G, 11) of a Potts-like field whose costs follow the body's part tree.

    unary: (G, 11) log evidence. centroids_m: (G, 3). start: an earlier belief, whose parts' middles hold
    what strays. Source: Kraehenbuehl & Koltun 2011, the sparse case; each round is damped, so it settles.
    """
    if start is None:
        belief = softmax(unary)
    else:
        belief, unary = start, unary + _near_its_part(start, groups, centroids_m)
    links = _links(groups)
    for _ in range(rounds):
        belief = 0.5 * belief + 0.5 * softmax(unary + _heeded(links, belief @ _COMPATIBILITY))
    return belief


def softmax(x: Float64) -> Float64:
    """Probabilities (n, k) from log scores (n, k)."""
    e = np.exp(x - x.max(axis=1, keepdims=True))
    return np.asarray(e / e.sum(axis=1, keepdims=True))


def _links(groups: Supervoxels) -> _Links:
    """How much each supervoxel heeds each touching one."""
    a, b = groups.edges.T
    degree = np.bincount(np.r_[a, b], minlength=groups.count)
    # More neighbours do not mean more knowledge: their sum is tempered.
    weight = SMOOTHING * 4 / np.maximum(degree, 4)
    rows, columns = np.r_[a, b], np.r_[b, a]
    order = np.lexsort((columns, rows))
    return rows[order], columns[order], weight[rows[order]]


def _heeded(links: _Links, said: Float64) -> Float64:
    """What those that touch it say (G, n) to each supervoxel, by how much it heeds them: (G, n)."""
    rows, columns, weight = links
    heard = np.zeros_like(said)
    first = np.flatnonzero(np.diff(rows, prepend=-1))
    if first.size:
        heard[rows[first]] = np.add.reduceat(weight[:, None] * said[columns], first, axis=0)
    return heard


def _near_its_part(belief: Float64, groups: Supervoxels, centroids_m: Float64) -> Float64:
    """Log cost (G, 11) of lying farther from a part's middle than it reaches."""
    cost = np.zeros_like(belief)
    mass = (belief * (belief > 0.5)) * groups.sizes[:, None]
    for part in np.flatnonzero(mass.sum(axis=0) >= LEAST_POINTS):
        middle_m = middle_of(mass[:, part], centroids_m, REACH_M[part])
        away_m = np.linalg.norm(centroids_m - middle_m, axis=1)
        cost[:, part] = -STRAYING * np.maximum(away_m / REACH_M[part] - 1, 0) ** 2
    return cost


def middle_of(weight: Float64, centroids_m: Float64, reach_m: float) -> Float64:
    """Middle (3,) of what has the weights (G,), by mean shift: a stray island does not pull it away."""
    middle_m = weight @ centroids_m / weight.sum()
    for _ in range(3):
        away_m = np.linalg.norm(centroids_m - middle_m, axis=1)
        near = weight * np.exp(-((away_m / reach_m) ** 2)) + 1e-9 * weight.max()
        middle_m = near @ centroids_m / near.sum()
    return np.asarray(middle_m)


def _compatibility() -> Float64:
    table = np.full((_N, _N), TOUCHING)
    for i in range(_N):
        for j in range(_N):
            if frozenset((i + 1, j + 1)) in NEIGHBOURS:
                table[i, j] = JOINED
    np.fill_diagonal(table, SAME)
    return table


_COMPATIBILITY = _compatibility()
