"""Turn of a camera's images: mirrored, then turned clockwise, with its intrinsics and the poses of a rig."""

from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from sensors.rig.camera import Intrinsics
from sensors.rig.rig_calibration import Pose, RigCalibration

Pixel = TypeVar("Pixel", bound=np.generic)
_MIRROR = np.diag([-1.0, 1.0, 1.0])
_QUARTER = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""From a camera's frame to that of its image turned clockwise: x' = -y, y' = x."""


@dataclass(frozen=True)
class Turn:
    """Transformation of images: mirrored left to right, then turned clockwise by ``quarters``."""

    quarters: int = 0
    mirror: bool = False

    def image(self, image: NDArray[Pixel]) -> NDArray[Pixel]:
        """Return an image (h, w), upright."""
        return np.ascontiguousarray(np.rot90(image[:, ::-1] if self.mirror else image, -self.quarters))

    def camera(self, camera: Intrinsics) -> Intrinsics:
        """Return the camera of the upright image."""
        if self.mirror:
            camera = replace(camera, cx=camera.width - 1 - camera.cx, p2=-camera.p2)
        for _ in range(self.quarters):
            camera = replace(
                camera,
                width=camera.height,
                height=camera.width,
                fx=camera.fy,
                fy=camera.fx,
                cx=camera.height - 1 - camera.cy,
                cy=camera.cx,
                p1=camera.p2,
                p2=-camera.p1,
            )
        return camera

    def calibration(self, factory: RigCalibration) -> RigCalibration:
        """Return the calibration of a depth camera, with or without colour, mounted so."""
        depth = self.camera(factory.depth)
        if factory.color is None or factory.color_from_depth is None:
            return replace(factory, depth=depth)
        color, pose = Turn(0, self.mirror).camera(factory.color), factory.color_from_depth
        if self.mirror:
            pose = Pose(_MIRROR @ pose.rotation @ _MIRROR, _MIRROR @ pose.translation_m)
        back = Pose(np.linalg.matrix_power(_QUARTER, self.quarters).T, np.zeros(3))
        return replace(factory, depth=depth, color=color, color_from_depth=pose @ back)

    def whole(self, rig: RigCalibration) -> RigCalibration:
        """Return the calibration of a rig all of whose images are turned."""
        axes = np.linalg.matrix_power(_QUARTER, self.quarters) @ (_MIRROR if self.mirror else np.eye(3))

        def pose(old: Pose | None) -> Pose | None:
            return None if old is None else Pose(axes @ old.rotation @ axes.T, axes @ old.translation_m)

        return replace(
            rig,
            depth=self.camera(rig.depth),
            color=None if rig.color is None else self.camera(rig.color),
            color_from_depth=pose(rig.color_from_depth),
            thermal=None if rig.thermal is None else self.camera(rig.thermal),
            thermal_from_depth=pose(rig.thermal_from_depth),
        )
