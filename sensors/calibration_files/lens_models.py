"""Conversion of lens models of OpenCV and RealSense's SDK to Brown's, by least squares over the image."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sensors.errors import CalibrationError
from sensors.rig.camera import Intrinsics, distort

Floats = NDArray[np.float64]

GRID = 25  # points a side at which two models are compared; untuned
WORST_PX = 1.0  # pixels between two models at which a fit is refused; untuned
PLAIN = ("none", "brown_conrady")
SCALED = ("modified_brown_conrady", "inverse_brown_conrady")  # projected by one formula


def intrinsics_from_rational(size: tuple[int, int], matrix: Floats, coefficients: Floats) -> Intrinsics:
    """Fit OpenCV's rational lens (k1 k2 p1 p2 k3 k4 k5 k6). size: (width, height). matrix: (3, 3).

    The radial factor is fitted in radius^2 out to the corners, weighted by area; for an Azure Kinect it stays
    within 0.2 % of the rational one.
    """
    k1, k2, p1, p2, k3, k4, k5, k6 = map(float, np.ravel(coefficients)[:8])
    fx, fy, cx, cy = (float(matrix[at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2)))
    width, height = size
    corner = max(np.hypot((u - cx) / fx, (v - cy) / fy) for u in (0, width - 1) for v in (0, height - 1))
    r2 = np.linspace(0, corner**2, 400)
    radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    powers = np.stack([r2, r2**2, r2**3], axis=-1)
    k1, k2, k3 = map(float, np.linalg.lstsq(powers, radial - 1, rcond=None)[0])
    return Intrinsics(width, height, fx, fy, cx, cy, k1, k2, p1, p2, k3)


def intrinsics_from_opencv(pinhole: Intrinsics, coefficients: Floats, where: str) -> Intrinsics:
    """Fit any of OpenCV's lenses. pinhole: without distortion.

    coefficients: 4, 5, 8, 12 or 14, as ``cv2.projectPoints`` takes them. OAK cameras have 14: their sensors
    are tilted by less than a milliradian (introlab/rtabmap pull request 1560). Raises CalibrationError,
    beginning with ``where``, where the fit misses by a pixel.
    """
    import cv2

    x, y = _grid(pinhole)
    rays = np.stack([x, y, np.ones_like(x)], axis=-1)
    goal = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), np.eye(3), coefficients)[0].reshape(-1, 2)
    moved = np.asarray(goal - np.stack([x, y], axis=-1), np.float64)
    camera = _fitted(pinhole, x, y, moved.T.ravel())
    missed = np.abs(distort(camera, rays[:, :2]) - goal) * (pinhole.fx, pinhole.fy)
    if not missed.max() < WORST_PX:
        raise CalibrationError(
            f"{where} has {len(coefficients)} lens coefficients; the nearest lens of five misses them by "
            f"{missed.max():.2g} pixels, over {WORST_PX:g}: record the rectified image"
        )
    return camera


def realsense_intrinsics(pinhole: Intrinsics, model: str, coefficients: Sequence[float]) -> Intrinsics:
    """Fit a lens of RealSense's SDK. pinhole: without distortion. coefficients: k1, k2, p1, p2, k3.

    model: the SDK's name; its plain model is Brown's. In the others tangential distortion applies to points
    that the radial one has moved (``rs2_project_point_to_pixel``, librealsense src/rs.cpp). The fit leaves
    less than 0.02 pixels for a D455's colour camera. Raises CalibrationError for a fisheye's models.
    """
    name = model.strip().lower().replace(" ", "_")
    k1, k2, p1, p2, k3 = map(float, coefficients[:5])
    if name in PLAIN or not any(coefficients):
        return replace(pinhole, k1=k1, k2=k2, p1=p1, p2=p2, k3=k3)
    if name not in SCALED:
        raise CalibrationError(
            f"the depth camera has lens model {model[:40]!r}, which is not supported; use a RealSense D400"
        )
    x, y = _grid(pinhole)
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    near, far = x * radial, y * radial
    x_moved = near + 2 * p1 * near * far + p2 * (r2 + 2 * near * near) - x
    y_moved = far + p1 * (r2 + 2 * far * far) + 2 * p2 * near * far - y
    return _fitted(pinhole, x, y, np.concatenate([x_moved, y_moved]))


def _grid(pinhole: Intrinsics) -> tuple[Floats, Floats]:
    """Return normalised coordinates x (n,), y (n,) of a grid over the image."""
    u, v = np.meshgrid(np.linspace(0, pinhole.width - 1, GRID), np.linspace(0, pinhole.height - 1, GRID))
    return ((u - pinhole.cx) / pinhole.fx).ravel(), ((v - pinhole.cy) / pinhole.fy).ravel()


def _fitted(pinhole: Intrinsics, x: Floats, y: Floats, moved: Floats) -> Intrinsics:
    """Return the camera whose Brown lens moves points (n,) to ``moved`` (2n,), by linear least squares."""
    r2 = x * x + y * y
    powers = [np.concatenate([x * r2**n, y * r2**n]) for n in (1, 2, 3)]
    tangential = [np.concatenate([2 * x * y, r2 + 2 * y * y]), np.concatenate([r2 + 2 * x * x, 2 * x * y])]
    terms = np.stack([powers[0], powers[1], *tangential, powers[2]], axis=-1)
    k1, k2, p1, p2, k3 = map(float, np.linalg.lstsq(terms, moved, rcond=None)[0])
    return replace(pinhole, k1=k1, k2=k2, p1=p1, p2=p2, k3=k3)
