"""Open3D tensor clouds from the arrays of a thermal cloud, and back; needs the extra ``clouds``."""

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from annotate.array_types import Bool, Float32, UInt8
from sensors.errors import CloudError, FormatError

PointCloud: TypeAlias = Any
"""An ``open3d.t.geometry.PointCloud``; Open3D is imported only where one is made."""


def tensor_cloud(
    points_m: Float32, color_rgb: UInt8, color_valid: Bool, temperature_c: Float32
) -> PointCloud:
    """Open3D cloud of the n pixels with a reading, as of ``ThermalCloud.to_open3d``.

    points_m (h, w, 3), color_rgb (h, w, 3), color_valid (h, w), temperature_c (h, w): as of ``ThermalCloud``.
    Raises CloudError without Open3D.
    """
    try:
        import open3d as o3d
    except ImportError as error:
        raise CloudError("open3d is not installed; pip install 'annotate-cloud[clouds]'") from error
    pixel = np.flatnonzero(np.isfinite(points_m[..., 2]))
    cloud: PointCloud = o3d.t.geometry.PointCloud(o3d.core.Tensor.from_numpy(points_m.reshape(-1, 3)[pixel]))
    cloud.point.colors = color_rgb.reshape(-1, 3)[pixel].astype(np.float32) / np.float32(255)
    cloud.point.color_valid = color_valid.reshape(-1, 1)[pixel]
    cloud.point.temperature = temperature_c.reshape(-1, 1)[pixel]
    cloud.point.pixel = pixel.astype(np.int32)[:, None]
    return cloud


def pixel_arrays(cloud: PointCloud, shape: tuple[int, int]) -> dict[str, NDArray[Any]]:
    """Arrays (h, w, ...) of a ``ThermalCloud`` by name, without its camera: inverse of ``tensor_cloud``.

    Pixels without a point have no reading. Raises FormatError for a cloud with an attribute missing, or pixel
    indices that are not unique or outside the image.
    """
    missing = [n for n in ("colors", "color_valid", "temperature", "pixel") if n not in cloud.point]
    if missing:
        raise FormatError(f"cloud has no attribute {missing[0]!r}; give one that came from to_open3d")
    size, pixel = shape[0] * shape[1], cloud.point.pixel.numpy()[:, 0]
    if len(np.unique(pixel)) < len(pixel) or (len(pixel) and not 0 <= pixel.min() <= pixel.max() < size):
        raise FormatError(
            f"pixel indices are not unique from 0 to {size - 1}; give the depth camera of the cloud, and a "
            "selection of its points"
        )
    points_m, temperature_c = np.full((size, 3), np.nan, np.float32), np.full(size, np.nan, np.float32)
    color_rgb, color_valid = np.zeros((size, 3), np.uint8), np.zeros(size, np.bool_)
    points_m[pixel], temperature_c[pixel] = (
        cloud.point.positions.numpy(),
        cloud.point.temperature.numpy()[:, 0],
    )
    color_rgb[pixel] = np.rint(cloud.point.colors.numpy() * 255).astype(np.uint8)
    color_valid[pixel] = cloud.point.color_valid.numpy()[:, 0]
    depth_mm = np.rint(np.nan_to_num(points_m[:, 2]) * 1000).astype(np.uint16)
    return {
        "depth_mm": depth_mm.reshape(shape),
        "points_m": points_m.reshape(*shape, 3),
        "color_rgb": color_rgb.reshape(*shape, 3),
        "color_valid": color_valid.reshape(shape),
        "temperature_c": temperature_c.reshape(shape),
    }
