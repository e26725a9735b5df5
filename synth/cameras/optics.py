"""The virtual rig's three cameras: a real Kinect v2's two lenses, a thermal one, and how they render."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
from scipy.spatial.transform import Rotation

from annotate.array_types import Float64, Int32
from sensors.rig.camera import Intrinsics, distort
from sensors.rig.kinect2_factory import KINECT2_DEPTH
from sensors.rig.rig_calibration import Pose, RigCalibration
from synth.surface.rasterize import ZBuffer, rasterize

# A real Kinect v2 (serial 196605135147 of iai_kinect2, Apache-2.0): lens of the colour camera and its pose.
KINECT_COLOR = Intrinsics(
    1920, 1080, 1081.37207, 1081.37207, 959.5, 539.5,
    0.0562684, -0.0741991, 0.00142508, -0.00169517, 0.0241077,
)  # fmt: skip
_COLOR_TURN = [
    [0.99979884, -0.01687134, -0.01084615],
    [0.0168911, 0.99985583, 0.00173301],
    [0.01081535, -0.00191586, 0.99993968],
]
_COLOR_SHIFT_M = np.array([-0.05205248, -0.00046314, 0.00088807])
COLOR_FROM_DEPTH = Pose(Rotation.from_matrix(_COLOR_TURN).as_matrix(), _COLOR_SHIFT_M)
# Optris PI200 with its 72 degree lens, mounted 6 cm above the Kinect and tilted 2 degrees down.
OPTRIS = Intrinsics(160, 120, 110.1, 110.1, 80.3, 59.2, -0.19, 0.04)
THERMAL_FROM_DEPTH = Pose(
    Rotation.from_euler("x", -2, degrees=True).as_matrix(), np.array([0.012, 0.06, -0.01])
)

RIG_CALIBRATION = RigCalibration(KINECT2_DEPTH, KINECT_COLOR, COLOR_FROM_DEPTH, OPTRIS, THERMAL_FROM_DEPTH)


class Lens:
    """Renders through a distorting lens: a wider pinhole image, and where each real pixel looks in it.

    supersample: rendered pixels per real pixel side. maps: x and y of ``cv2.remap``, float32, the size of
    the supersampled real image.
    """

    def __init__(self, camera: Intrinsics, supersample: int) -> None:
        scaled = replace(
            camera,
            width=camera.width * supersample,
            height=camera.height * supersample,
            fx=camera.fx * supersample,
            fy=camera.fy * supersample,
            cx=(camera.cx + 0.5) * supersample - 0.5,
            cy=(camera.cy + 0.5) * supersample - 0.5,
        )
        u, v = np.meshgrid(np.arange(scaled.width), np.arange(scaled.height))
        distorted = np.stack([(u - scaled.cx) / scaled.fx, (v - scaled.cy) / scaled.fy], axis=-1)
        ideal = _undistort_fast(scaled, distorted)
        x, y = ideal[..., 0] * scaled.fx + scaled.cx, ideal[..., 1] * scaled.fy + scaled.cy
        left, top = max(0, int(np.ceil(-x.min()))), max(0, int(np.ceil(-y.min())))
        wide = replace(
            scaled.undistorted(),
            width=int(np.ceil(x.max())) + left + 1,
            height=int(np.ceil(y.max())) + top + 1,
            cx=scaled.cx + left,
            cy=scaled.cy + top,
        )
        self.pinhole = wide
        self.maps = ((x + left).astype(np.float32), (y + top).astype(np.float32))

    def render_pinhole(self, points: Float64, faces: Int32) -> ZBuffer:
        """The wide pinhole image; points (V, 3) in the camera frame, metres."""
        return rasterize(self.pinhole, points.astype(np.float32), faces)

    def render(self, points: Float64, faces: Int32) -> ZBuffer:
        """The image through the lens, every pixel taking the nearest pinhole pixel."""
        wide = self.render_pinhole(points, faces)
        u, v = (np.rint(m).astype(np.intp) for m in self.maps)
        return ZBuffer(wide.depth_m[v, u], wide.face[v, u])


lens_of = lru_cache(maxsize=4)(Lens)
"""Every rig has the same cameras, and the colour camera's map takes a second."""


def _undistort_fast(camera: Intrinsics, distorted: Float64) -> Float64:
    """Fixed-point inverse of the lens model in few steps: enough for mild lenses (error under 0.01 px)."""
    ideal = distorted.copy()
    for _ in range(12):
        ideal += distorted - distort(camera, ideal)
    return ideal
