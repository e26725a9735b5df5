"""Cloud of a frame with its whole colour image, and the cloud's pixels in this image."""

from dataclasses import dataclass

import cv2
import numpy as np

from annotate.array_types import Bool, Float32, Float64, UInt8, UInt16
from annotate.cloud.fuse import Fuser
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.cloud.visibility import PointView, Projection
from annotate.witness.person_crop import PersonCrop, crop_of_points
from annotate.witness.skeleton import Surface
from sensors.errors import CalibrationError
from sensors.rig.camera import Intrinsics
from sensors.rig.frame import RigFrame
from sensors.rig.rig_calibration import Pose, RigCalibration


@dataclass(frozen=True)
class ColouredCloud:
    """Cloud of a frame with its colour image.

    cloud: full cloud. rgb: uint8 (h', w', 3), or None without a colour image. projection: of the cloud's
    points in the colour image. camera, depth_from_color: intrinsics and pose of the colour camera.
    """

    cloud: ThermalCloud
    rgb: UInt8 | None
    projection: Projection
    camera: Intrinsics
    depth_from_color: Pose

    @property
    def depth_mm(self) -> UInt16:
        """Return the undistorted depth image (h, w)."""
        return self.cloud.depth_mm

    def crop(self, mask: Bool) -> PersonCrop | None:
        """Return the crop of the colour image about a mask (h, w) of the depth image; None without any."""
        return crop_of_points(self._at_px(mask & np.isfinite(self.projection.ahead_m)))

    def surface(self, mask: Bool) -> Surface:
        """Return the visible points of a mask (h, w) as the colour camera shows them."""
        mask = mask & self.cloud.color_valid
        ahead_m = self.projection.ahead_m[mask]
        return Surface(self._at_px(mask), ahead_m, self.camera, self.depth_from_color)

    def seen(self, plane: Float32) -> Float32:
        """Return a plane (h', w') of the colour image at the depth image's pixels (h, w); NaN for points that
        the colour camera does not show.
        """
        columns, rows = (np.nan_to_num(one, nan=-9) for one in self.projection[:2])
        found = cv2.remap(plane, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
        return np.where(self.cloud.color_valid, found, np.float32(np.nan))

    def px_per_px(self) -> float:
        """Return the size of a colour pixel in depth pixels, by the focal lengths."""
        return self.cloud.camera.fx / self.camera.fx

    def _at_px(self, mask: Bool) -> Float64:
        return np.column_stack([one[mask] for one in self.projection[:2]]).astype(np.float64) + 0.5


class ColourFuser:
    """Fusion of frames to coloured clouds. Raises CalibrationError where colour is neither aligned with depth
    nor calibrated.
    """

    def __init__(self, calibration: RigCalibration) -> None:
        color, pose = calibration.color, calibration.color_from_depth
        if color is None or pose is None:
            raise CalibrationError(
                "the recording has no colour camera that is aligned with depth or calibrated; "
                "register colour to depth, or calibrate"
            )
        self._fuser, self._depth_from_color = Fuser(calibration), pose.inverse()
        self._view = PointView.of_color(calibration.depth, color, pose)
        self.calibration, self.camera = calibration, self._fuser.camera

    def fuse(self, depth_mm: UInt16, rgb: UInt8 | None = None) -> ColouredCloud:
        """Fuse a depth image with a colour image, if any."""
        return self._with(self._fuser.fuse(depth_mm, rgb), rgb)

    def fuse_frame(self, frame: RigFrame) -> ColouredCloud:
        """Fuse a frame, decoding its colour image. Raises the errors of ``Fuser.fuse_frame``."""
        rgb = frame.decode_color()
        return self._with(self._fuser.fuse(frame.depth_mm, rgb, frame.thermal_c), rgb)

    def _with(self, cloud: ThermalCloud, rgb: UInt8 | None) -> ColouredCloud:
        projection = self._view.project(np.ascontiguousarray(cloud.points_m[..., 2]))
        return ColouredCloud(cloud, rgb, projection, self._view.camera, self._depth_from_color)
