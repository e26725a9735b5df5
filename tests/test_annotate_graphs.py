"""Ways, sums and joins over supervoxels and pieces, beside scipy's sparse graphs."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components, dijkstra

from annotate.cloud.supervoxels import Supervoxels
from annotate.person.persons import _joined
from annotate.segmentation.bare import LONGEST_WAY_M, _away_m, _bare_steps
from annotate.segmentation.part_tree import _links, _weighted_sum

SEEDS = st.integers(0, 2**32 - 1)


def random_groups(rng: np.random.Generator, count: int) -> Supervoxels:
    pairs = np.sort(rng.integers(0, count, (3 * count, 2)), axis=1)
    edges = np.unique(pairs[pairs[:, 0] < pairs[:, 1]], axis=0).astype(np.int32)
    return Supervoxels(np.arange(count, dtype=np.int32), count, edges)


@given(SEEDS, st.integers(1, 40))
def test_ways_through_bare_supervoxels_are_the_shortest(seed, count):
    rng = np.random.default_rng(seed)
    groups, middle_m = random_groups(rng, count), rng.uniform(0, 0.2, (count, 3))
    bare, start = rng.random(count) < 0.7, rng.random(count) < 0.2
    a, b, length_m = _bare_steps(bare, groups, middle_m)
    found = _away_m((a, b, length_m), start)
    expected = np.full(count, LONGEST_WAY_M)
    if start.any():
        graph = csr_array((length_m, (a, b)), shape=(count, count))
        away_m = dijkstra(graph, indices=np.flatnonzero(start), min_only=True)
        expected = np.minimum(away_m, LONGEST_WAY_M)
    assert np.array_equal(found, expected)


@given(SEEDS, st.integers(1, 40))
def test_what_neighbours_say_is_summed_by_weight(seed, count):
    rng = np.random.default_rng(seed)
    said = rng.normal(0, 1, (count, 11))
    rows, columns, weight = _links(random_groups(rng, count))
    graph = csr_array((weight, (rows, columns)), shape=(count, count))
    assert np.allclose(_weighted_sum((rows, columns, weight), said), graph @ said, atol=1e-12)


@given(SEEDS, st.integers(1, 12), st.integers(1, 60))
def test_pieces_that_share_a_cluster_are_joined(seed, pieces, points):
    rng = np.random.default_rng(seed)
    labels = rng.integers(0, pieces, points).astype(np.int32)
    close = rng.integers(0, 15, points).astype(np.int32)
    found = _joined(labels, close, pieces)
    graph = coo_array((np.ones(points), (labels, pieces + close)), (pieces + 15, pieces + 15))
    expected = connected_components(graph, directed=False)[1][:pieces]
    same = found[:, None] == found
    assert (same == (expected[:, None] == expected)).all()
    assert (found <= np.arange(pieces)).all()
