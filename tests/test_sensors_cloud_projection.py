"""Laws of a cloud's projection: its pixels are found, the nearest points shown, hidden ones have none."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from sensors.importers.clouds.organised_camera import grid_camera
from sensors.importers.clouds.pixel_lattice import find_line
from sensors.importers.clouds.projection import (
    KINECT_V2,
    pixels_of,
    project_cloud,
    shift_into_view,
    spacing_m,
)
from sensors.rig.camera import Intrinsics, project, unproject
from tests.helpers.cloud_files import ball

law = settings(deadline=None, max_examples=40)


@given(
    pinhole=st.tuples(st.floats(200, 700), st.floats(200, 700), st.floats(0, 1), st.floats(0, 1)),
    seed=st.integers(0, 99),
)
@law
def test_the_pixels_of_a_camera_are_found(pinhole, seed):
    """And noise of a millimetre at most does not hide them; noise alone has none."""
    fx, fy, cx, cy = pinhole
    rng = np.random.default_rng(seed)
    u, v, z = rng.integers(0, 300, 3000), rng.integers(0, 200, 3000), rng.uniform(1.5, 4, 3000)
    for focal, centre, pixel in ((fx, cx, u - 150), (fy, cy, v - 100)):
        line = find_line((pixel - centre) / focal)
        assert line.focal_px == pytest.approx(focal, rel=1e-6)
        assert (line.centre_px - centre + 0.5) % 1 == pytest.approx(0.5, abs=1e-4)
        rounded = find_line(np.round((pixel - centre) / focal * z, 3) / z)
        assert rounded is not None and rounded.focal_px == pytest.approx(focal, rel=1e-3)
    assert find_line(rng.uniform(-0.6, 0.6, 3000)) is None


@given(
    pinhole=st.tuples(st.floats(20, 60), st.floats(20, 60), st.floats(5, 25), st.floats(5, 20)),
    seed=st.integers(0, 99),
)
@law
def test_the_fit_finds_the_camera_of_a_grid(pinhole, seed):
    camera = Intrinsics(32, 24, *pinhole)
    depth = np.random.default_rng(seed).uniform(0.5, 4.5, camera.shape)
    found = grid_camera("cloud", unproject(camera, depth).astype(np.float64), None)
    np.testing.assert_allclose(found.intrinsics.matrix, camera.matrix, rtol=1e-4, atol=1e-4)
    assert found.residual_px < 1e-3 and found.how == "camera axes"


def test_a_ball_hides_its_far_side_and_has_no_holes():
    points = ball(60_000)
    shown = project_cloud(points, KINECT_V2, 0.01)
    depth = np.where(shown >= 0, points[shown, 2], np.nan)
    assert np.nanmax(depth) < 2.06
    centre = project(KINECT_V2, np.array([0.1, 0.2, 2.0]))
    inside = np.hypot(*(np.indices(depth.shape)[::-1] - centre[:, None, None])) < 0.95 * 365.15 * 0.3 / 2
    assert np.isfinite(depth[inside]).all()
    assert np.isfinite(depth).sum() < 1.15 * np.pi * (365.15 * 0.3 / 2) ** 2


def test_the_nearest_point_is_shown_and_points_behind_it_have_no_pixel():
    """The first against the naive loop."""
    points = np.random.default_rng(0).uniform([-1, -1, 1], [1, 1, 3], (3000, 3))
    camera = Intrinsics(20, 20, 10.0, 10.0, 9.5, 9.5)
    depth = np.full(camera.shape, np.inf)
    for x, y, z in points:
        u, v = round(10 * x / z + 9.5), round(10 * y / z + 9.5)
        if 0 <= u < 20 and 0 <= v < 20:
            depth[v, u] = min(depth[v, u], z)
    shown = project_cloud(points, camera, 0.0)
    np.testing.assert_array_equal(np.where(shown >= 0, points[shown, 2], np.inf), depth)
    points = np.array([[0, 0, 2.0], [0, 0, 2.02], [0, 0, 2.2], [0, 0, -1.0], [9, 9, 1.0], [np.nan, 0, 1]])
    depth = np.full(KINECT_V2.shape, np.nan)
    depth[211, 254] = 2.0
    pixels = pixels_of(points, KINECT_V2, depth)
    np.testing.assert_array_equal(pixels >= 0, [True, True, False, False, False, False])


@given(points=arrays(np.float64, (30, 3), elements=st.floats(-50, 50)))
@law
def test_any_cloud_is_moved_into_view(points):
    pixels = project(KINECT_V2, points + shift_into_view(points, KINECT_V2))
    assert (pixels >= -1e-6).all()
    assert (pixels <= np.array([KINECT_V2.width, KINECT_V2.height]) - 1 + 1e-6).all()


def test_equal_points_change_no_spacing():
    points = ball(500)
    assert spacing_m(np.repeat(points, 7, axis=0)) == spacing_m(points)
    assert spacing_m(np.ones((9, 3)) + 1e-12 * np.arange(9)[:, None]) == 0
