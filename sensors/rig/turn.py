"""Turn of a camera's images (mirroring, then clockwise rotation), applied to its intrinsics and a rig's
poses.
"""

from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from sensors.rig.camera import Intrinsics
from sensors.rig.rig_calibration import Pose, RigCalibration

Pixel = TypeVar("Pixel", bound=np.generic)
_MIRROR = np.diag([-1.0, 1.0, 1.0])
_QUARTER = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # of a clockwise turn: x' = -y


@dataclass(frozen=True)
class Turn:
    """Transformation of images: mirrored left to right, then turned clockwise by ``quarters``."""

    quarters: int = 0
    mirror: bool = False

    def image(self, image: NDArray[Pixel]) -> NDArray[Pixel]:
        """Return an image (h, w), upright."""
        return np.ascontiguousarray(np.rot90(image[:, ::-1] if self.mirror else image, -self.quarters))

    def camera(self, camera: Intrinsics) -> Intrinsics:
        """Return the intrinsics of the upright image."""
        if self.mirror:
            camera = replace(camera, cx=camera.width - 1 - camera.cx, p2=-camera.p2)
        for _ in range(self.quarters):
            old = replace(camera, width=camera.height, height=camera.width, p1=camera.p2, p2=-camera.p1)
            centre = camera.height - 1 - camera.cy
            camera = replace(old, fx=camera.fy, fy=camera.fx, cx=centre, cy=camera.cx)
        return camera

    def calibration(self, factory: RigCalibration) -> RigCalibration:
        """Return a depth camera's calibration in this mounting; colour is mirrored, but not rotated."""
        depth = self.camera(factory.depth)
        if factory.color is None or factory.color_from_depth is None:
            return replace(factory, depth=depth)
        color, pose = Turn(0, self.mirror).camera(factory.color), factory.color_from_depth
        if self.mirror:
            pose = Pose(_MIRROR @ pose.rotation @ _MIRROR, _MIRROR @ pose.translation_m)
        back = Pose(np.linalg.matrix_power(_QUARTER, self.quarters).T, np.zeros(3))
        return replace(factory, depth=depth, color=color, color_from_depth=pose @ back)

    def whole(self, rig: RigCalibration) -> RigCalibration:
        """Return the calibration of a rig whose images are all turned."""
        axes = np.linalg.matrix_power(_QUARTER, self.quarters) @ (_MIRROR if self.mirror else np.eye(3))
        turned: dict[str, Intrinsics | Pose] = {}
        for name, value in vars(rig).items():
            if isinstance(value, Intrinsics):
                turned[name] = self.camera(value)
            elif isinstance(value, Pose):
                turned[name] = Pose(axes @ value.rotation @ axes.T, axes @ value.translation_m)
        return replace(rig, **turned)  # type: ignore[arg-type]
