"""Coarse clouds keep surface and outlines; components on the pixel grid equal their naive twins."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from annotate.cloud.coarse import SAME_SURFACE, CoarseCloud, CoarseFuser, reduced
from annotate.cloud.fuse import Fuser
from annotate.cloud.grid import components
from annotate.frame_labels import FrameLabels
from sensors.rig.camera import Intrinsics, rays
from sensors.rig.rig_calibration import RigCalibration
from sensors.session.reader import Session


@pytest.fixture(scope="module")
def rig(rig_session):
    session = Session(rig_session)
    return session.calibration, session.frame(0)


def coarse_of(depth_mm, focal=365.0):
    height, width = depth_mm.shape
    camera = Intrinsics(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)
    return CoarseFuser(RigCalibration(camera)).fuse(depth_mm)


def test_its_points_are_points_of_the_whole_cloud(rig):
    calibration, frame = rig
    coarse, whole = CoarseFuser(calibration).fuse_frame(frame), Fuser(calibration).fuse_frame(frame)
    np.testing.assert_array_equal(coarse.depth_mm, whole.depth_mm)
    seen = coarse.pixel >= 0
    at = coarse.pixel[seen]
    np.testing.assert_array_equal(coarse.cloud.depth_mm[seen], whole.depth_mm.ravel()[at])
    # Half a pixel off at most: the point stands for its square's middle.
    off = np.abs(coarse.cloud.points_m[seen] - whole.points_m.reshape(-1, 3)[at]).max(axis=1)
    assert (off <= 0.51 * whole.points_m.reshape(-1, 3)[at, 2] / calibration.depth.fx).all()
    celsius = coarse.cloud.temperature_c[seen] - whole.temperature_c.ravel()[at]
    assert np.mean(np.abs(celsius) < 0.5) > 0.85
    assert not coarse.cloud.color_valid.any()


def test_a_whole_cloud_gives_the_coarse_one_of_its_depth(rig):
    calibration, frame = rig
    fused, taken = (
        CoarseFuser(calibration).fuse(frame.depth_mm),
        CoarseCloud.of(Fuser(calibration).fuse(frame.depth_mm)),
    )
    np.testing.assert_array_equal(fused.pixel, taken.pixel)
    np.testing.assert_array_equal(fused.cloud.depth_mm, taken.cloud.depth_mm)
    assert fused.cloud.camera == taken.cloud.camera
    np.testing.assert_allclose(
        fused.cloud.points_m, taken.cloud.points_m, atol=0.007
    )  # Half a pixel at 4.5 m.


def enlarged_naively(depth_mm, pixel, whose, stride):
    numbers = np.zeros_like(depth_mm, np.uint8)
    for y, x in np.argwhere(depth_mm > 0):
        v, u = (min(at // stride, side - 1) for at, side in zip((y, x), pixel.shape, strict=True))
        costs = []
        for r in range(max(v - 1, 0), min(v + 2, pixel.shape[0])):
            for c in range(max(u - 1, 0), min(u + 2, pixel.shape[1])):
                if pixel[r, c] >= 0:
                    row, column = divmod(int(pixel[r, c]), depth_mm.shape[1])
                    z = float(depth_mm[y, x])
                    step = (float(depth_mm[row, column]) - z) / (z * SAME_SURFACE)
                    costs.append(((row - y) ** 2 + (column - x) ** 2 + step**2, whose[r, c]))
        numbers[y, x] = min(costs, key=lambda cost: cost[0])[1]
    return numbers


@pytest.mark.parametrize("shape", [(12, 16), (13, 17), (1, 1), (2, 7)])
def test_numbers_come_back_as_a_naive_search_gives_them(shape):
    rng = np.random.default_rng(shape[0])
    depth = np.where(rng.random(shape) < 0.2, 0, rng.integers(900, 3000, shape)).astype(np.uint16)
    coarse = coarse_of(depth)
    whose = rng.integers(0, 3, coarse.pixel.shape).astype(np.uint8)
    expected = enlarged_naively(depth, coarse.pixel, whose, coarse.stride)
    np.testing.assert_array_equal(coarse.enlarged(whose), expected)


@pytest.mark.parametrize(("focal", "stride"), [(285.0, 1), (365.0, 2), (504.0, 2), (915.0, 5)])
def test_an_outline_comes_back_whole(focal, stride):
    """A disc before a wall, with a fifth of its readings missing; coarser for finer cameras."""
    v, u = np.mgrid[:240, :320]
    disc = np.hypot(v - 110.3, u - 150.8) < 60
    depth = np.where(disc, 2000, 3000).astype(np.uint16)
    depth[np.random.default_rng(1).random(depth.shape) < 0.2] = 0
    coarse = coarse_of(depth, focal)
    assert coarse.stride == stride
    points = coarse.cloud.depth_mm == 2000
    found = coarse.enlarged(points.astype(np.uint8)) == 1
    assert np.mean(found[depth > 0] != disc[depth > 0]) < 0.002
    labels = FrameLabels("0", depth, disc.astype(np.uint8), persons=disc.astype(np.uint8))
    np.testing.assert_array_equal(coarse.coarse(labels).parts, points)
    np.testing.assert_array_equal(
        coarse.coarse(replace(labels, persons=None)).depth_mm, coarse.cloud.depth_mm
    )


def test_a_reduced_camera_has_the_same_rays():
    camera = Intrinsics(512, 424, 365.0, 366.0, 254.0, 211.1)
    blocks = rays(camera).reshape(212, 2, 256, 2, 3)
    np.testing.assert_allclose(rays(reduced(camera, 2)), blocks.mean(axis=(1, 3)), atol=1e-12)


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
