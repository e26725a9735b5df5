"""Components on the pixel grid against naive twins."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from annotate.cloud.grid import components


def joined(depth, a, b, jump=0.025):
    near = max(abs(a[0] - b[0]), abs(a[1] - b[1])) <= 2
    return near and abs(depth[a] - depth[b]) <= np.float32(jump) * min(depth[a], depth[b])


def naive_components(mask, depth):
    labels, count = np.zeros(mask.shape, int), 0
    for start in zip(*np.nonzero(mask), strict=True):
        if labels[start]:
            continue
        count += 1
        labels[start], todo = count, [start]
        while todo:
            here = todo.pop()
            for other in zip(*np.nonzero(mask & (labels == 0)), strict=True):
                if joined(depth, here, other):
                    labels[other] = count
                    todo.append(other)
    return labels, count


def random_grid(seed):
    rng = np.random.default_rng(seed)
    depth = rng.choice([1.0, 1.02, 1.04, 2.0], (9, 11)).astype(np.float32)
    return rng.random((9, 11)) < rng.uniform(0.1, 0.9), depth


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**6))
def test_components_equal_a_plain_search(seed):
    mask, depth = random_grid(seed)
    labels, count = components(mask, depth)
    expected, expected_count = naive_components(mask, depth)
    np.testing.assert_array_equal(labels, expected)
    assert count == expected_count


def test_a_surface_with_most_pixels_missing_holds_together():
    rng = np.random.default_rng(0)
    mask = rng.random((80, 80)) < 0.4
    labels, _ = components(mask, np.ones(mask.shape, np.float32))
    assert np.bincount(labels[mask]).max() > 0.98 * mask.sum()
