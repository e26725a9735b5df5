"""OpenCV's lens of 12 or 14 numbers (thin prism, tilted sensor) as Brown's."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sensors.errors import CalibrationError
from sensors.rig.camera import Intrinsics, distort

GRID = 25
"""Points a side at which the two models are compared. Untuned."""
WORST_PX = 1.0
"""Pixels between the two models at which the fit is refused. Untuned."""


def intrinsics_from_opencv(pinhole: Intrinsics, coefficients: NDArray[np.float64], where: str) -> Intrinsics:
    """Fit Brown's coefficients by least squares over the image to any of OpenCV's lenses.

    pinhole: without distortion. coefficients: 4, 5, 8, 12 or 14, as ``cv2.projectPoints`` takes them. OAK
    cameras have 14: their sensors are tilted by less than a milliradian (introlab/rtabmap pull request 1560),
    which Brown's tangential terms describe. Raises CalibrationError, beginning with ``where``, where the fit
    misses by a pixel.
    """
    import cv2

    u, v = np.meshgrid(np.linspace(0, pinhole.width - 1, GRID), np.linspace(0, pinhole.height - 1, GRID))
    x, y = ((u - pinhole.cx) / pinhole.fx).ravel(), ((v - pinhole.cy) / pinhole.fy).ravel()
    rays = np.stack([x, y, np.ones_like(x)], axis=-1)
    goal = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), np.eye(3), coefficients)[0].reshape(-1, 2)
    r2 = x * x + y * y
    powers = [np.concatenate([x * r2**n, y * r2**n]) for n in (1, 2, 3)]
    tangential = [np.concatenate([2 * x * y, r2 + 2 * y * y]), np.concatenate([r2 + 2 * x * x, 2 * x * y])]
    # Brown's model is linear in its coefficients.
    terms = np.stack([powers[0], powers[1], *tangential, powers[2]], axis=-1)
    moved = (goal - np.stack([x, y], axis=-1)).T.ravel()
    k1, k2, p1, p2, k3 = map(float, np.linalg.lstsq(terms, moved, rcond=None)[0])
    camera = replace(pinhole, k1=k1, k2=k2, p1=p1, p2=p2, k3=k3)
    missed = np.abs(distort(camera, rays[:, :2]) - goal) * (pinhole.fx, pinhole.fy)
    if not missed.max() < WORST_PX:
        raise CalibrationError(
            f"{where} has a lens of {len(coefficients)} numbers, which is {missed.max():.2g} pixels off "
            "as one of five; record the rectified image"
        )
    return camera
