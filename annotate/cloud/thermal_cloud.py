"""The organised thermal-coloured cloud: one point per pixel of the undistorted depth image."""

from dataclasses import dataclass

from annotate.array_types import Bool, Float32, UInt8, UInt16
from annotate.cloud.open3d_cloud import PointCloud, pixel_arrays, tensor_cloud
from sensors.errors import FormatError
from sensors.rig.camera import Intrinsics


@dataclass(frozen=True)
class ThermalCloud:
    """Points, colours and temperatures of one rig frame; point index = pixel index [v, u].

    camera: the undistorted depth camera, of shape (h, w). depth_mm: uint16 (h, w), 0 = no reading. points_m:
    float32 (h, w, 3), depth camera's frame, NaN = no reading. color_rgb: uint8 (h, w, 3), (0, 0, 0) where not
    color_valid. color_valid: bool (h, w), False where the colour camera does not see the point (occluded, out
    of view, no colour camera). temperature_c: float32 (h, w), degrees Celsius, NaN where the thermal camera
    does not see the point.
    """

    camera: Intrinsics
    depth_mm: UInt16
    points_m: Float32
    color_rgb: UInt8
    color_valid: Bool
    temperature_c: Float32

    def __post_init__(self) -> None:
        for name, expected in (
            ("depth_mm", self.camera.shape),
            ("points_m", (*self.camera.shape, 3)),
            ("color_rgb", (*self.camera.shape, 3)),
            ("color_valid", self.camera.shape),
            ("temperature_c", self.camera.shape),
        ):
            actual = getattr(self, name).shape
            if actual != expected:
                raise FormatError(f"cloud's {name} is {actual}; give {expected}")

    @property
    def valid(self) -> Bool:
        """Flags (h, w) of pixels with a depth reading."""
        return self.depth_mm > 0

    def to_open3d(self) -> PointCloud:
        """Open3D cloud (``open3d.t.geometry.PointCloud``) of the n pixels with a reading.

        positions: float32 (n, 3), metres, depth camera's frame. colors: float32 (n, 3), sRGB in [0, 1], black
        where not ``color_valid`` (bool (n, 1)). temperature: float32 (n, 1), degrees Celsius, NaN = no
        reading. pixel: int32 (n, 1), flat pixel index. Raises CloudError without the extra ``clouds``.
        """
        return tensor_cloud(self.points_m, self.color_rgb, self.color_valid, self.temperature_c)

    @classmethod
    def from_open3d(cls, cloud: PointCloud, camera: Intrinsics) -> "ThermalCloud":
        """Inverse of ``to_open3d``, also for a selection of the points: other pixels have no reading.

        camera: the undistorted depth camera. Positions must still be in its frame. Raises FormatError for a
        cloud with an attribute missing, or pixel indices that are not unique or not of this camera.
        """
        return cls(camera, **pixel_arrays(cloud, camera.shape))
