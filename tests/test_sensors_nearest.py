"""The nearest points, beside looking at all of them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from sensors.rig.nearest import Nearest


@given(st.integers(0, 2**32 - 1), st.integers(1, 60), st.integers(1, 6), st.floats(0.05, 2))
def test_as_scipy_finds_them(seed, n, k, within):
    rng = np.random.default_rng(seed)
    points, places = rng.normal(0, 1, (n, 3)), rng.normal(0, 1, (17, 3))
    away, index = Nearest(points).query(places, k, within)
    expected, whose = cKDTree(points).query(places, k, distance_upper_bound=within)
    assert away.shape == index.shape == expected.shape
    edge = np.abs(np.where(np.isfinite(expected), expected, away) - within) < 1e-6
    assert np.allclose(away[~edge], expected[~edge], atol=1e-6)
    assert (index[~edge] == whose[~edge]).all()


@pytest.mark.parametrize("k", [1, 3])
def test_among_no_points_and_for_no_places_nothing_is_found(k):
    away, index = Nearest(np.zeros((0, 3))).query(np.zeros((4, 3)), k)
    assert np.isinf(away).all() and (index == 0).all() and len(away) == 4
    away, index = Nearest(np.zeros((5, 3))).query(np.zeros((0, 3)), k)
    assert len(away) == len(index) == 0


def test_equal_points_are_all_found():
    away, index = Nearest(np.ones((4, 2))).query(np.ones((1, 2)), 4)
    assert (away == 0).all() and sorted(index[0]) == [0, 1, 2, 3]
