"""Organised thermal-coloured cloud: one point per pixel of the undistorted depth image."""

from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from annotate.array_types import Bool, Float32, UInt8, UInt16
from sensors.errors import CloudError, FormatError
from sensors.rig.camera import Intrinsics

PointCloud: TypeAlias = Any
"""``open3d.t.geometry.PointCloud``, imported only when needed."""


@dataclass(frozen=True)
class ThermalCloud:
    """Points, colours and temperatures of one frame; point index = pixel index [v, u].

    camera: the undistorted depth camera, of shape (h, w). depth_mm: uint16 (h, w), 0 = no reading. points_m:
    float32 (h, w, 3), depth camera's frame, NaN = no reading. color_rgb: uint8 (h, w, 3), 0 where not
    color_valid (h, w). temperature_c: float32 (h, w), NaN = no reading. stamp_ns: the depth camera's time, or
    None.

    Raises FormatError for arrays that do not match the camera's shape.
    """

    camera: Intrinsics
    depth_mm: UInt16
    points_m: Float32
    color_rgb: UInt8
    color_valid: Bool
    temperature_c: Float32
    stamp_ns: int | None = None

    def __post_init__(self) -> None:
        for name, channels in (
            ("depth_mm", ()),
            ("points_m", (3,)),
            ("color_rgb", (3,)),
            ("color_valid", ()),
            ("temperature_c", ()),
        ):
            actual, expected = getattr(self, name).shape, (*self.camera.shape, *channels)
            if actual != expected:
                raise FormatError(f"cloud's {name} is {actual}; give {expected}")

    @property
    def valid(self) -> Bool:
        """Return flags (h, w) of pixels with a depth reading."""
        return self.depth_mm > 0

    def to_open3d(self) -> PointCloud:
        """Return an Open3D cloud (``open3d.t.geometry.PointCloud``) of the n pixels with a reading.

        positions: float32 (n, 3), metres, depth camera's frame. colors: float32 (n, 3), sRGB in [0, 1], black
        where not ``color_valid`` (bool (n, 1)). temperature: float32 (n, 1), NaN = no reading. pixel: int32
        (n, 1), flat index. Raises CloudError without the extra ``clouds``.
        """
        try:
            import open3d as o3d
        except ImportError as error:
            raise CloudError("open3d is not installed; pip install 'annotate-cloud[clouds]'") from error
        pixel = np.flatnonzero(np.isfinite(self.points_m[..., 2]))
        points_m = o3d.core.Tensor.from_numpy(self.points_m.reshape(-1, 3)[pixel])
        cloud: PointCloud = o3d.t.geometry.PointCloud(points_m)
        cloud.point.colors = self.color_rgb.reshape(-1, 3)[pixel].astype(np.float32) / np.float32(255)
        cloud.point.color_valid = self.color_valid.reshape(-1, 1)[pixel]
        cloud.point.temperature = self.temperature_c.reshape(-1, 1)[pixel]
        cloud.point.pixel = pixel.astype(np.int32)[:, None]
        return cloud

    @classmethod
    def from_open3d(cls, cloud: PointCloud, camera: Intrinsics) -> "ThermalCloud":
        """Return the cloud that ``to_open3d`` converted, or a selection of its points; other pixels have no
        reading.

        camera: the undistorted depth camera, in whose frame positions must be. Raises FormatError for a
        missing attribute, or pixel indices that are not unique or not of this camera.
        """
        missing = [n for n in ("colors", "color_valid", "temperature", "pixel") if n not in cloud.point]
        if missing:
            raise FormatError(f"cloud has no attribute {missing[0]!r}; give a cloud that to_open3d made")
        size, pixel = camera.height * camera.width, cloud.point.pixel.numpy()[:, 0]
        if len(np.unique(pixel)) < len(pixel) or (len(pixel) and not 0 <= pixel.min() <= pixel.max() < size):
            raise FormatError(
                f"cloud has pixel indices that repeat or exceed {size - 1}; give a cloud of {camera.width} x "
                f"{camera.height} pixels as to_open3d made it, or some of its points"
            )
        shape = camera.shape
        points_m, celsius = np.full((*shape, 3), np.nan, np.float32), np.full(shape, np.nan, np.float32)
        color_rgb, color_valid = np.zeros((*shape, 3), np.uint8), np.zeros(shape, np.bool_)
        points_m.reshape(-1, 3)[pixel] = cloud.point.positions.numpy()
        color_rgb.reshape(-1, 3)[pixel] = np.rint(cloud.point.colors.numpy() * 255)
        color_valid.flat[pixel] = cloud.point.color_valid.numpy()[:, 0]
        celsius.flat[pixel] = cloud.point.temperature.numpy()[:, 0]
        depth_mm = np.rint(np.nan_to_num(points_m[..., 2]) * 1000).astype(np.uint16)
        return cls(camera, depth_mm, points_m, color_rgb, color_valid, celsius)
