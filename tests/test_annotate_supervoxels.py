"""Laws of supervoxels and clusters, and naive twins of them."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from annotate import _pcl
from annotate.cloud.supervoxels import VOXEL_M, Supervoxels, clusters, supervoxels

RED, GREEN, BLUE = (220, 30, 40), (30, 200, 60), (40, 60, 220)


def patch(center_m, color, *, n=1500, width_m=0.4, seed=0):
    """A gently curved square of surface facing the camera, points (n, 3) and colours (n, 3)."""
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-width_m / 2, width_m / 2, (n, 2))
    depth = 0.5 * (xy**2).sum(axis=1) + rng.normal(0, 0.001, n)
    points = np.column_stack([xy, depth]) + center_m
    return points.astype(np.float32), np.tile(np.array(color, np.uint8), (n, 1))


def two_patches(gap_m=0.2):
    """A red and a blue patch side by side, gap_m apart, 1500 points each."""
    red, blue = patch((-0.2 - gap_m / 2, 0, 2), RED), patch((0.2 + gap_m / 2, 0, 2), BLUE, seed=1)
    return np.concatenate([red[0], blue[0]]), np.concatenate([red[1], blue[1]])


def same_partition(a: NDArray[np.int32], b: NDArray[np.int32]) -> bool:
    """Return whether two labelings split the points alike."""
    pairs = np.unique(np.column_stack([a, b]), axis=0)
    return len(pairs) == len(np.unique(a)) == len(np.unique(b))


clouds = st.builds(
    lambda n, scale, grid, seed: cloud_of(n, scale, grid, np.random.default_rng(seed)),
    st.integers(0, 300),
    st.floats(0.001, 3.0),
    st.booleans(),
    st.integers(0, 2**32 - 1),
)


def cloud_of(n, scale, grid, rng):
    """Random points; on a coarse lattice with duplicates, if `grid`."""
    points = rng.normal(size=(n, 3))
    points = np.round(points * 3) / 3 if grid else points
    return (points * scale).astype(np.float32), rng.integers(0, 256, (n, 3)).astype(np.uint8)


@settings(max_examples=40, deadline=None)
@given(clouds, st.floats(1.1, 6.0))
def test_supervoxels_partition_any_cloud(cloud, ratio):
    points, colors = cloud
    found = supervoxels(points, colors, seed_m=VOXEL_M * ratio)
    assert found.ids.shape == (len(points),)
    assert (found.ids >= 0).all()
    assert found.sizes.sum() == len(points)
    assert (found.sizes > 0).all()
    again = supervoxels(points, colors, seed_m=VOXEL_M * ratio)
    np.testing.assert_array_equal(found.ids, again.ids)
    np.testing.assert_array_equal(found.edges, again.edges)


def test_edges_join_touching_supervoxels_once_low_id_first():
    points, colors = two_patches()
    found = supervoxels(points, colors)
    assert (found.edges[:, 0] < found.edges[:, 1]).all()
    assert len(np.unique(found.edges, axis=0)) == len(found.edges)
    centroids = found.mean(points)
    lengths = np.linalg.norm(np.diff(centroids[found.edges], axis=1)[:, 0], axis=1)
    assert np.median(lengths) < 0.09
    graph = coo_array((np.ones(len(found.edges)), found.edges.T), shape=(found.count, found.count))
    assert connected_components(graph, directed=False)[0] == 2


@pytest.mark.parametrize("gap_m", [0.08, 0.2])
def test_blobs_apart_never_share_a_supervoxel(gap_m):
    points, colors = two_patches(gap_m)
    found = supervoxels(points, colors)
    assert not np.intersect1d(found.ids[:1500], found.ids[1500:]).size


def test_colour_parts_touching_patches():
    points, colors = patch((0, 0, 2), RED, n=4000)
    left = points[:, 0] < 0
    colors[left] = GREEN
    found = supervoxels(points, colors, color_weight=2.0)
    share = found.mean(left.astype(float))
    assert np.maximum(share, 1 - share)[found.ids].mean() > 0.97
    blind = supervoxels(points, colors, color_weight=0.0).mean(left)
    assert np.minimum(blind, 1 - blind).sum() > 2 * np.minimum(share, 1 - share).sum()


@pytest.mark.parametrize("shift_m", [(1, -2, 3), (500, 500, -500)])
def test_translation_keeps_supervoxels(shift_m):
    points, colors = two_patches()
    here = supervoxels(points, colors)
    there = supervoxels((points + np.array(shift_m)).astype(np.float32), colors)
    assert abs(here.count - there.count) <= 0.05 * here.count


def test_an_island_is_a_supervoxel_of_its_own():
    points, colors = patch((0, 0, 2), RED)
    island = np.array([[1, 1, 2], [1.001, 1, 2]], np.float32)
    found = supervoxels(np.concatenate([points, island]), np.concatenate([colors, colors[:2]]))
    assert found.ids[-1] == found.ids[-2]
    assert found.ids[-1] not in found.ids[:-2]


def test_points_without_a_reading_get_no_id():
    points, colors = two_patches()
    holes = np.arange(0, len(points), 7)
    whole = np.delete(points, holes, axis=0), np.delete(colors, holes, axis=0)
    points[holes, 1] = np.nan
    points[holes[::2], 2] = np.inf
    found = supervoxels(points, colors)
    assert (found.ids[holes] == -1).all()
    np.testing.assert_array_equal(np.delete(found.ids, holes), supervoxels(*whole).ids)
    assert np.isfinite(found.mean(points)).all()
    assert (clusters(points, tolerance_m=0.05)[holes] == -1).all()


@given(st.integers(0, 2**32 - 1), st.sampled_from([(), (3,), (2, 2)]))
@settings(max_examples=25, deadline=None)
def test_mean_is_the_mean_of_each_group(seed, shape):
    rng = np.random.default_rng(seed)
    ids = rng.permutation(np.concatenate([np.arange(9), rng.integers(-1, 9, 40)])).astype(np.int32)
    values = rng.normal(size=(len(ids), *shape))
    means = Supervoxels(ids, 9, np.empty((0, 2), np.int32)).mean(values)
    naive = np.stack([values[ids == i].mean(axis=0) for i in range(9)])
    np.testing.assert_allclose(means, naive, atol=1e-12)


@settings(max_examples=40, deadline=None)
@given(clouds, st.floats(0.01, 0.5))
def test_clusters_are_components_of_the_radius_graph(cloud, tolerance_m):
    points, _ = cloud
    found = clusters(points, tolerance_m=tolerance_m)
    if not len(points):
        assert not found.size
        return
    tree = cKDTree(points)
    pairs = tree.query_pairs(tolerance_m * 1.00001, output_type="ndarray")
    # Where a distance is the tolerance itself, rounding decides.
    assume(len(pairs) == len(tree.query_pairs(tolerance_m * 0.99999)))
    graph = coo_array((np.ones(len(pairs)), pairs.T), shape=(len(points), len(points)))
    _, naive = connected_components(graph, directed=False)
    assert same_partition(found, naive)
    assert (np.diff(np.bincount(found)) <= 0).all()


POINTS, COLORS = two_patches()
NAN = np.full((4, 3), np.nan, np.float32)
WEIGHTS = {"voxel_m": 0.012, "seed_m": 0.06, "spatial_weight": 0.4, "normal_weight": 1.0, "color_weight": 1.0}


@pytest.mark.parametrize(
    ("call", "arrays", "change", "words"),
    [
        *(
            (_pcl.supervoxels, (POINTS, COLORS), change, words)
            for change, words in [
                ({"voxel_m": 0.0}, "voxel_m is 0.0"),
                ({"voxel_m": float("nan")}, "voxel_m is nan"),
                ({"seed_m": -1.0}, "seed_m is -1.0"),
                ({"seed_m": 0.01}, "give more than voxel_m"),
                ({"color_weight": -0.5}, "color_weight is -0.5"),
                ({"voxel_m": 1e-7}, "larger voxels"),
            ]
        ),
        (_pcl.supervoxels, (POINTS[:4], COLORS[:3]), {}, "4 points but 3 colours"),
        (_pcl.euclidean_clusters, (NAN,), {"tolerance_m": 0.1, "min_size": 1}, "point 0 is not finite"),
        (_pcl.euclidean_clusters, (POINTS,), {"tolerance_m": 0.0, "min_size": 1}, "tolerance_m"),
        (_pcl.euclidean_clusters, (POINTS,), {"tolerance_m": 0.1, "min_size": 0}, "min_size"),
    ],
)
def test_the_binding_refuses_bad_sizes_and_arrays(call, arrays, change, words):
    options = WEIGHTS if call is _pcl.supervoxels else {}
    with pytest.raises(ValueError, match=words) as caught:
        call(*arrays, **{**options, **change})
    assert "\n" not in str(caught.value)


def test_a_real_person(shared_data):
    open3d = pytest.importorskip("open3d")
    cloud = open3d.t.io.read_point_cloud(str(shared_data / "pcl_person" / "person.pcd"))
    points = cloud.point.positions.numpy().astype(np.float32)
    points = points[np.isfinite(points).all(axis=1)]
    points = points[points[:, 2] < 1.2][::4]
    colors = np.zeros((len(points), 3), np.uint8)
    largest = clusters(points, tolerance_m=0.02) == 0
    assert largest.mean() > 0.5
    found = supervoxels(points[largest], colors[largest])
    away_m = np.linalg.norm(points[largest] - found.mean(points[largest])[found.ids], axis=1)
    assert away_m.max() < 0.12
    assert found.count > 50
