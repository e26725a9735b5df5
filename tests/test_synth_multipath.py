"""Light that bounces twice: corners read too deep, flat and convex surfaces read correctly."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sensors.rig.camera import Intrinsics
from synth.cameras.multipath import STRIDE, multipath_m

CAMERA = Intrinsics(192, 144, 180.0, 180.0, 95.5, 71.5)
X = (np.arange(192) - 95.5) / 180.0 + np.zeros((144, 1))


def wedge(distance_m, slope):
    """Two walls that meet in a vertical edge: a corner for slope > 0, a ridge below."""
    return (distance_m / (1 + slope * np.abs(X))).astype(np.float32)


@given(distance=st.floats(0.8, 4), slope=st.floats(-1.5, 0), reflectance=st.floats(0, 1))
@settings(max_examples=20, deadline=None)
def test_what_is_flat_or_bulges_reads_as_it_is(distance, slope, reflectance):
    assert np.abs(multipath_m(CAMERA, wedge(distance, slope), reflectance)).max() < 1e-4


def test_a_corner_reads_too_deep_most_near_its_edge_and_alike_on_both_sides():
    excess = multipath_m(CAMERA, wedge(2.5, 1.0), 0.5)
    row = excess[72]
    near, far = row[95 - 2 * STRIDE], row[95 - 6 * STRIDE]
    assert 0.01 < near < 0.1 and far < near / 2
    assert row == pytest.approx(row[::-1], abs=0.004)


@given(low=st.floats(0.05, 0.5), more=st.floats(0.05, 0.5))
@settings(max_examples=10, deadline=None)
def test_brighter_walls_send_more_astray(low, more):
    dull, bright = (multipath_m(CAMERA, wedge(2.5, 1.0), share).max() for share in (low, low + more))
    assert 0 < dull < bright


def test_it_is_the_sum_over_all_pairs_of_patches():
    """Against two loops in numpy, one wall facing another."""
    depth = wedge(2.0, 0.8)
    v, u = np.mgrid[STRIDE // 2 : 144 : STRIDE, STRIDE // 2 : 192 : STRIDE]
    rays = np.stack([(u - 95.5) / 180, (v - 71.5) / 180, np.ones(u.shape)], axis=-1)
    points = rays * depth[v, u, None]
    normal = np.cross(np.gradient(points, axis=1), np.gradient(points, axis=0))
    normal *= -np.sign((normal * points).sum(axis=2))[..., None] / np.linalg.norm(normal, axis=2)[..., None]
    p = (5, 3)
    away = np.linalg.norm(points, axis=2)
    total, k = 1.0 + 0j, 4 * np.pi * 80e6 / 299_792_458
    for q in np.ndindex(away.shape):
        gap = points[q] - points[p]
        r = np.linalg.norm(gap)
        cosines = max(normal[p] @ gap, 0) * max(-normal[q] @ gap, 0)
        if cosines > 0:
            area = (STRIDE * points[q][2]) ** 2 / 180**2
            share = 0.5 * area / away[q] ** 2 * cosines / r**2 / (np.pi * max(r**2, area))
            share /= -normal[p] @ points[p] / away[p] ** 3
            total += share * np.exp(1j * k * (away[q] + r - away[p]) / 2)
    expected = np.angle(total) / k / np.linalg.norm(rays[p])
    assert multipath_m(CAMERA, depth, 0.5)[v[p], u[p]] == pytest.approx(expected, rel=1e-3)


def test_nothing_stays_nothing():
    depth = wedge(2.5, 1.0)
    depth[:50] = np.nan
    excess = multipath_m(CAMERA, depth, 0.5)
    assert np.isnan(excess[:50]).all() and np.isfinite(excess[50:]).all()
