"""Fusion and undistortion: the naive twins, closed forms, and what an occluded point must never get."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from annotate.cloud.coarse import CoarseFuser
from annotate.cloud.fuse import Fuser
from annotate.cloud.visibility import PointView
from bench.fuse import CALIBRATION, fuse_naive, random_scene
from sensors.calibration_files.kinect2_factory import KINECT2_COLOR, KINECT2_DEPTH
from sensors.errors import CalibrationError, FormatError
from sensors.rig.camera import Intrinsics, project, unproject
from sensors.rig.frame import RigFrame
from sensors.rig.rig_calibration import Pose, RigCalibration
from tests.helpers.undistortion_twin import undistort_scalar

DEPTH = Intrinsics(96, 80, 70.0, 70.0, 47.3, 39.8)
COLOR = Intrinsics(320, 260, 207.0, 207.0, 160.2, 129.4)
THERMAL = Intrinsics(40, 34, 24.0, 24.0, 19.4, 16.6)
RIG = RigCalibration(
    *(DEPTH, COLOR, Pose(np.eye(3), np.array([-0.05, 0.0, 0.0]))),
    *(THERMAL, Pose(np.eye(3), np.array([0.02, 0.06, 0.0]))),
)
OTHER_UNIT = Intrinsics(
    512, 424, 368.10, 368.10, 262.5, 206.0, k1=0.0891, k2=-0.2709, k3=0.0993, p1=1e-3, p2=-2e-3
)


def wall(z_mm=2000, camera=DEPTH):
    return np.full(camera.shape, z_mm, np.uint16)


def box_before_wall():
    depth = wall(2500)
    depth[20:60, 30:60] = 1200
    return depth


@pytest.mark.parametrize("seed", [1, 2])
def test_equals_the_naive_twin_bit_for_bit(seed):
    scene = random_scene(seed)
    fused, naive = Fuser(CALIBRATION).fuse(*scene), fuse_naive(CALIBRATION, *scene)
    assert fused.color_valid.mean() > 0.5 and np.isfinite(fused.temperature_c).mean() > 0.5
    for name in ("depth_mm", "color_rgb", "color_valid"):
        np.testing.assert_array_equal(getattr(fused, name), getattr(naive, name))
    for name in ("points_m", "temperature_c"):
        np.testing.assert_array_equal(getattr(fused, name), getattr(naive, name))


def test_points_and_projections_agree_with_the_double_precision_camera():
    depth, _, _ = random_scene(4)
    cloud = Fuser(CALIBRATION).fuse(depth)
    metres = np.where(cloud.valid, cloud.depth_mm / 1000, np.nan)
    np.testing.assert_allclose(cloud.points_m, unproject(cloud.camera, metres), rtol=1e-6, atol=1e-7)
    view = PointView.of_color(CALIBRATION.depth, CALIBRATION.color, CALIBRATION.color_from_depth)
    found = view.project(cloud.points_m[..., 2])
    expected = project(CALIBRATION.color, CALIBRATION.color_from_depth.apply(cloud.points_m))
    inside = np.isfinite(found.ahead_m)
    assert inside.mean() > 0.5
    np.testing.assert_allclose(found.column[inside], expected[inside, 0], atol=2e-3)
    np.testing.assert_allclose(found.row[inside], expected[inside, 1], atol=2e-3)


def test_a_point_takes_the_colour_painted_at_its_projection():
    v, u = np.mgrid[: COLOR.height, : COLOR.width]
    color = np.stack([u // 2, v, (u + v) % 256], axis=-1).astype(np.uint8)
    cloud = Fuser(RIG).fuse(wall(), color)
    position = np.floor(project(COLOR, RIG.color_from_depth.apply(cloud.points_m)) + 0.5).astype(int)
    inside = ((position >= 0) & (position < (COLOR.width, COLOR.height))).all(axis=-1)
    np.testing.assert_array_equal(cloud.color_valid, inside)
    column, row = position[inside].T
    np.testing.assert_array_equal(cloud.color_rgb[inside], color[row, column])
    assert not cloud.color_rgb[~inside].any()


def test_bilinear_temperature_is_exact_on_a_ramp():
    v, u = np.mgrid[: THERMAL.height, : THERMAL.width].astype(np.float32)
    cloud = Fuser(RIG).fuse(wall(), None, 20 + 0.25 * u + 0.125 * v)
    position = project(THERMAL, RIG.thermal_from_depth.apply(cloud.points_m))
    # A thermal pixel on which no point falls, beside the cloud, says nothing about the cloud.
    low = np.maximum(position.min(axis=(0, 1)) + 1, 0)
    high = np.minimum(position.max(axis=(0, 1)) - 1, (THERMAL.width - 1, THERMAL.height - 1))
    inside = ((position >= low) & (position <= high)).all(axis=-1)
    expected = 20 + 0.25 * position[..., 0] + 0.125 * position[..., 1]
    np.testing.assert_allclose(cloud.temperature_c[inside], expected[inside], atol=1e-3)


def test_occluded_points_never_take_the_foregrounds_colour():
    depth = box_before_wall()
    near = depth == 1200
    # Paint red every colour pixel on which a point of the box falls, blue the rest.
    points = RIG.color_from_depth.apply(Fuser(RIG).fuse(depth).points_m)
    column, row = np.floor(project(COLOR, points) + 0.5).astype(int)[near].T
    color = np.zeros((*COLOR.shape, 3), np.uint8) + np.uint8([0, 0, 255])
    color[row, column] = (255, 0, 0)
    cloud = Fuser(RIG).fuse(depth, color)
    np.testing.assert_array_equal(cloud.color_rgb[near & cloud.color_valid], [[255, 0, 0]] * near.sum())
    behind = cloud.color_valid & ~near
    np.testing.assert_array_equal(cloud.color_rgb[behind, 0], 0)
    assert (~cloud.color_valid & ~near).any(), "parallax hides some of the wall"


def test_the_foregrounds_heat_is_never_copied_onto_the_wall():
    depth = box_before_wall()
    near = depth == 1200
    # Every thermal pixel that sees any of the box is a mixture, as on a real silhouette.
    corners = project(THERMAL, RIG.thermal_from_depth.apply(Fuser(RIG).fuse(depth).points_m))[near]
    u, v = np.arange(THERMAL.width), np.arange(THERMAL.height)
    (u0, v0), (u1, v1) = corners.min(axis=0), corners.max(axis=0)
    covered_u = np.clip(np.minimum(u + 0.5, u1 + 0.3) - np.maximum(u - 0.5, u0 - 0.3), 0, 1)
    covered_v = np.clip(np.minimum(v + 0.5, v1 + 0.3) - np.maximum(v - 0.5, v0 - 0.3), 0, 1)
    thermal = (20 + 14 * covered_v[:, None] * covered_u).astype(np.float32)
    cloud = Fuser(RIG).fuse(depth, None, thermal)
    assert np.nanmax(cloud.temperature_c[~near]) < 20.01
    assert np.isfinite(cloud.temperature_c[near]).all()
    assert np.nanmedian(cloud.temperature_c[near]) == pytest.approx(34, abs=0.01)


@pytest.mark.parametrize(("share", "visible"), [(0.009, True), (0.0115, False)])
def test_colour_tolerance_is_libfreenect2s(share, visible):
    camera = replace(DEPTH, fx=70 * 0.99, fy=70 * 0.99)
    rig = RigCalibration(camera, replace(COLOR, fx=207, fy=207), Pose.identity())
    depth = wall(5000)
    depth[:, ::2] = round(5000 * (1 + share))
    cloud = Fuser(rig).fuse(depth, np.full((*COLOR.shape, 3), 7, np.uint8))
    inner = np.s_[10:-10, 10:-10]
    assert cloud.color_valid[inner][:, 1::2].all()
    assert cloud.color_valid[inner][:, ::2].all() == visible


def test_a_slanted_floor_keeps_its_temperature():
    v = np.arange(DEPTH.height)
    below = np.clip((v - 30) / DEPTH.fy, 0.15, None)
    depth = np.repeat((1200 / below)[:, None], DEPTH.width, axis=1).astype(np.uint16)
    cloud = Fuser(RIG).fuse(depth, None, np.full(THERMAL.shape, 21, np.float32))
    assert np.isfinite(cloud.temperature_c[45:70, 5:-5]).mean() > 0.95


def test_rolling_a_camera_with_its_image_changes_nothing():
    depth, color, thermal = random_scene(5, RIG)
    half_turn = np.diag([-1.0, -1.0, 1.0])

    def rolled(camera, pose):
        camera = replace(camera, cx=camera.width - 1 - camera.cx, cy=camera.height - 1 - camera.cy)
        return camera, Pose(half_turn @ pose.rotation, half_turn @ pose.translation_m)

    turned = RigCalibration(
        DEPTH, *rolled(COLOR, RIG.color_from_depth), *rolled(THERMAL, RIG.thermal_from_depth)
    )
    a = Fuser(RIG).fuse(depth, color, thermal)
    b = Fuser(turned).fuse(depth, color[::-1, ::-1], thermal[::-1, ::-1])
    assert (a.color_rgb == b.color_rgb).all(axis=-1).mean() > 0.999
    both = np.isfinite(a.temperature_c) & np.isfinite(b.temperature_c)
    assert (np.isfinite(a.temperature_c) == both).mean() > 0.999
    assert np.mean(np.abs(a.temperature_c - b.temperature_c)[both] < 1e-2) > 0.999


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10**6), x=st.floats(-0.3, 0.3), angle=st.floats(-3.1, 3.1))
def test_any_pose_gives_values_of_the_image_or_nothing(seed, x, angle):
    pose = Pose(Rotation.from_rotvec([0.1, angle, 0.2]).as_matrix(), np.array([x, -x, 0.1]))
    depth, _, thermal = random_scene(seed, RIG)
    cloud = Fuser(RigCalibration(DEPTH, COLOR, pose, THERMAL, pose)).fuse(
        depth, np.full((*COLOR.shape, 3), 9, np.uint8), thermal
    )
    assert (cloud.color_rgb[cloud.color_valid] == 9).all() and not cloud.color_rgb[~cloud.color_valid].any()
    known = cloud.temperature_c[np.isfinite(cloud.temperature_c)]
    assert ((known >= np.nanmin(thermal) - 1e-3) & (known <= np.nanmax(thermal) + 1e-3)).all()
    assert not cloud.color_valid[~cloud.valid].any() and np.isnan(cloud.temperature_c[~cloud.valid]).all()


def test_pixels_without_a_reading_do_not_spread():
    thermal = np.full(THERMAL.shape, 30, np.float32)
    thermal[::2, ::2] = np.nan
    cloud = Fuser(RIG).fuse(wall(), None, thermal)
    known = cloud.temperature_c[np.isfinite(cloud.temperature_c)]
    np.testing.assert_allclose(known, 30, atol=1e-4)
    assert np.isnan(Fuser(RIG).fuse(wall(), None, thermal * np.nan).temperature_c).all()


def test_without_colour_and_thermal_the_cloud_says_so():
    cloud = Fuser(RigCalibration(DEPTH)).fuse(wall())
    assert not cloud.color_valid.any() and np.isnan(cloud.temperature_c).all() and cloud.valid.all()
    frame = RigFrame(0, 0, wall(), None, np.full(THERMAL.shape, 22, np.float32))
    assert np.nanmax(Fuser(RIG).fuse_frame(frame).temperature_c) == pytest.approx(22, abs=1e-4)
    with pytest.raises(FormatError, match="cannot be decoded"):
        Fuser(RIG).fuse_frame(RigFrame(0, 0, wall(), b"no image"))


@pytest.mark.parametrize(
    ("rig", "arguments", "match"),
    [
        (RIG, (np.zeros((5, 6), np.uint16),), "depth image is 6x5 .* 96x80"),
        (RIG, (wall(), np.zeros((4, 4, 3), np.uint8)), "colour image is 4x4"),
        (RIG, (wall(), None, np.zeros((3, 9), np.float32)), "thermal image is 9x3"),
        (RigCalibration(DEPTH), (wall(), np.zeros((4, 4, 3), np.uint8)), "no colour camera"),
    ],
)
def test_a_wrong_size_or_camera_is_one_clear_line(rig, arguments, match):
    with pytest.raises(CalibrationError, match=match) as caught:
        Fuser(rig).fuse(*arguments)
    assert "\n" not in str(caught.value)


# --- libfreenect2's undistortion, and the factory's colour parameters --------------------------------


@settings(max_examples=8, deadline=None)
@given(seed=st.integers(0, 10**6), unit=st.sampled_from([KINECT2_DEPTH, OTHER_UNIT]))
def test_undistortion_equals_libfreenect2s_bit_for_bit(seed, unit):
    rng = np.random.default_rng(seed)
    depth = replace(unit, width=36, height=28, cx=17.3, cy=14.2, fx=unit.fx / 13, fy=unit.fy / 13)
    depth_mm = rng.choice([0, 700, 701, 1500, 1510, 1530, 4000], depth.shape).astype(np.uint16)
    fused = Fuser(RigCalibration(depth)).fuse(depth_mm)
    np.testing.assert_array_equal(fused.depth_mm, undistort_scalar(depth, depth_mm))
    assert fused.valid.any()


@pytest.mark.parametrize("fuser", [Fuser, CoarseFuser])
def test_a_saturated_reading_is_none(fuser):
    """65535, as other programs and older versions write it, is not a wall 65.5 m away."""
    depth = wall(2000)
    saturated = depth.copy()
    depth[10:20, 10:30], saturated[10:20, 10:30] = 0, 65535
    clouds = [fuser(RigCalibration(DEPTH)).fuse(image) for image in (depth, saturated)]
    np.testing.assert_array_equal(*(cloud.depth_mm for cloud in clouds))


def test_the_factorys_color_parameters_have_the_published_disparity():
    """56 pixels between 1 m and infinity, a third of that at 3 m (shift_m f / z)."""
    near, far = (KINECT2_COLOR.shift_m * KINECT2_COLOR.f / z for z in (1000.0, 3000.0))
    assert near == pytest.approx(56.2, abs=0.1) and far == pytest.approx(near / 3)
