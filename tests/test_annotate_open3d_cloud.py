"""Thermal clouds as Open3D's and back: nothing is lost, and a selection keeps its pixels."""

import sys
from dataclasses import replace

import numpy as np
import pytest

from annotate.cloud.fuse import Fuser
from annotate.cloud.thermal_cloud import ThermalCloud
from bench.fuse import CALIBRATION, random_scene
from sensors.errors import CloudError, FormatError

FIELDS = ("depth_mm", "points_m", "color_rgb", "color_valid", "temperature_c")
CLOUD = Fuser(CALIBRATION).fuse(*random_scene(3))


@pytest.fixture(autouse=True)
def o3d():
    """Return Open3D, imported by the first test that needs it, because the import takes seconds."""
    return pytest.importorskip("open3d")


def assert_same(cloud, other):
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(cloud, name), getattr(other, name))


@pytest.mark.parametrize("share", [0, 0.3, 1])
def test_a_selection_comes_back_to_its_pixels(o3d, share):
    cloud = CLOUD.to_open3d()
    chosen = np.random.default_rng(1).permutation(len(cloud.point.pixel))[: int(share * CLOUD.valid.sum())]
    back = ThermalCloud.from_open3d(cloud.select_by_index(o3d.core.Tensor(chosen)), CLOUD.camera)
    kept = np.zeros(CLOUD.valid.shape, bool)
    kept.ravel()[cloud.point.pixel.numpy()[chosen, 0]] = True
    assert back.valid.sum() == len(chosen)
    assert_same(back, without(~kept))


def without(hidden):
    """The cloud with no reading at hidden pixels (h, w)."""
    hidden = hidden | ~CLOUD.valid
    gone = {name: np.where(hidden, 0, getattr(CLOUD, name)) for name in ("depth_mm", "color_valid")}
    gone["color_rgb"] = np.where(hidden[..., None], 0, CLOUD.color_rgb)
    gone["points_m"] = np.where(hidden[..., None], np.nan, CLOUD.points_m)
    return replace(CLOUD, **gone, temperature_c=np.where(hidden, np.nan, CLOUD.temperature_c))


def test_the_whole_cloud_comes_back_as_it_was():
    cloud = CLOUD.to_open3d()
    assert str(cloud.point.positions.dtype) == "Float32" and len(cloud.point.pixel) == CLOUD.valid.sum()
    assert cloud.point.colors.numpy().max() <= 1
    assert_same(ThermalCloud.from_open3d(cloud, CLOUD.camera), CLOUD)


def test_a_plane_of_open3d_is_a_plane_of_pixels():
    depth = np.full(CALIBRATION.depth.shape, 2000, np.uint16)
    depth[100:200, 100:200] = 1000
    cloud = Fuser(CALIBRATION).fuse(depth)
    _, on = cloud.to_open3d().segment_plane(distance_threshold=0.01)
    wall = ThermalCloud.from_open3d(cloud.to_open3d().select_by_index(on), cloud.camera)
    np.testing.assert_array_equal(wall.valid, cloud.depth_mm == 2000)


def test_foreign_clouds_are_refused(o3d):
    cloud = CLOUD.to_open3d()
    with pytest.raises(FormatError, match="exceed"):
        ThermalCloud.from_open3d(cloud, replace(CLOUD.camera, width=100))
    with pytest.raises(FormatError, match="repeat"):
        ThermalCloud.from_open3d(cloud.append(cloud), CLOUD.camera)
    with pytest.raises(FormatError, match="no attribute 'colors'"):
        ThermalCloud.from_open3d(o3d.t.geometry.PointCloud(cloud.point.positions), CLOUD.camera)


def test_without_open3d_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "open3d", None)
    with pytest.raises(CloudError, match=r"pip install 'annotate-cloud\[clouds\]'"):
        CLOUD.to_open3d()
