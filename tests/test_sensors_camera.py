"""Laws of the pinhole camera: round trips, and OpenCV as an oracle."""

from functools import cache

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sensors.errors import CalibrationError
from sensors.rig.camera import Intrinsics, distort, project, rays, undistort, unproject

# A real Kinect v2 (facts of its factory calibration).
KINECT = Intrinsics(
    512, 424, 365.150208, 365.150208, 253.9832, 211.093994, k1=0.0922871977, k2=-0.266797304, k3=0.0901915208
)
TANGENTIAL = Intrinsics(512, 424, 366.4, 367.1, 255.6, 204.0, k1=0.09, k2=-0.27, p1=1e-3, p2=-5e-4, k3=0.1)
CAMERAS = pytest.mark.parametrize("camera", [KINECT, TANGENTIAL, KINECT.undistorted()])

seeds = st.integers(0, 2**32 - 1)


@cache
def all_rays(camera: Intrinsics) -> np.ndarray:
    return rays(camera)


def points_in_view(camera: Intrinsics, seed: int, n: int = 50) -> np.ndarray:
    """Points (n, 3) that the camera sees, 0.5 to 4.5 m away."""
    rng = np.random.default_rng(seed)
    pixels = rng.integers([0, 0], [camera.width, camera.height], (n, 2))
    return all_rays(camera)[pixels[:, 1], pixels[:, 0]] * rng.uniform(0.5, 4.5, (n, 1))


@CAMERAS
@settings(deadline=None, max_examples=50)
@given(seed=seeds)
def test_project_agrees_with_opencv(camera, seed):
    points = points_in_view(camera, seed)
    still, lens = np.zeros(3), np.array(camera.distortion)
    expected, _ = cv2.projectPoints(points, still, still, camera.matrix, lens)
    np.testing.assert_allclose(project(camera, points), expected[:, 0], atol=1e-6)


@CAMERAS
@settings(deadline=None, max_examples=50)
@given(seed=seeds)
def test_undistort_agrees_with_opencv_and_inverts_distort(camera, seed):
    points = points_in_view(camera, seed)
    ideal = points[:, :2] / points[:, 2:]
    distorted = distort(camera, ideal)
    np.testing.assert_allclose(undistort(camera, distorted), ideal, atol=1e-8)
    # OpenCV stops after five iterations, hence the tolerance.
    oracle = cv2.undistortPoints(distorted[:, None], np.eye(3), np.array(camera.distortion))
    np.testing.assert_allclose(undistort(camera, distorted), oracle[:, 0], atol=5e-4)


@CAMERAS
def test_every_pixel_survives_unproject_and_project(camera):
    depth = np.random.default_rng(0).uniform(0.5, 4.5, camera.shape).astype(np.float32)
    depth[::7, ::5] = np.nan
    points = unproject(camera, depth)
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    seen = ~np.isnan(depth)
    np.testing.assert_array_equal(np.isnan(points).any(axis=-1), ~seen)
    np.testing.assert_array_equal(points[seen][:, 2], depth[seen])
    with pytest.raises(CalibrationError, match="640x480"):
        unproject(camera, np.ones((480, 640), np.float32))
    np.testing.assert_allclose(project(camera, points)[seen], np.stack([u, v], axis=-1)[seen], atol=2e-4)


@settings(deadline=None, max_examples=50)
@given(z=st.floats(max_value=0, allow_nan=False))
def test_points_behind_the_camera_have_no_pixel(z):
    assert np.isnan(project(KINECT, np.array([0.1, 0.1, z]))).all()


@pytest.mark.parametrize(
    "changes",
    [
        *({"width": 0}, {"width": 16.0}, {"width": None}, {"height": 8193}, {"height": "16"}, {"fx": 0.0}),
        *({"fx": [1, 2]}, {"fy": -1.0}, {"fy": "365"}, {"cx": float("nan")}, {"cx": None}, {"p2": 1j}),
        *({"k1": 10**400}, {"k3": float("inf")}),
    ],
)
def test_impossible_cameras_are_refused(changes):
    values = {"width": 512, "height": 424, "fx": 365.0, "fy": 365.0, "cx": 256.0, "cy": 212.0}
    with pytest.raises(CalibrationError, match="give"):
        Intrinsics(**{**values, **changes})


@pytest.mark.parametrize("number", [np.int64, np.uint16])
def test_numpy_s_numbers_are_numbers(number):
    camera = Intrinsics(number(512), number(424), np.float32(365), np.float64(365), np.int32(256), 212)
    assert camera == Intrinsics(512, 424, 365.0, 365.0, 256.0, 212.0)
