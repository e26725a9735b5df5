"""Lens models of other makers' cameras, brought to the one of ``sensors.rig.camera``."""

import numpy as np
from numpy.typing import NDArray

from sensors.rig.camera import Intrinsics


def intrinsics_from_rational(
    size: tuple[int, int], matrix: NDArray[np.float64], coefficients: NDArray[np.float64]
) -> Intrinsics:
    """OpenCV's rational lens (k1 k2 p1 p2 k3 k4 k5 k6) as the polynomial one that fits best in the image.

    size: (width, height). matrix: (3, 3). The radial factor is fitted by least squares in radius^2 out to the
    corners, weighted by area; for an Azure Kinect it stays within 0.2 % of the rational one.
    """
    k1, k2, p1, p2, k3, k4, k5, k6 = (float(value) for value in np.ravel(coefficients)[:8])
    fx, fy, cx, cy = (float(matrix[at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2)))
    width, height = size
    corner = max(np.hypot((u - cx) / fx, (v - cy) / fy) for u in (0, width - 1) for v in (0, height - 1))
    r2 = np.linspace(0, corner**2, 400)
    radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    powers = np.stack([r2, r2**2, r2**3], axis=-1)
    fitted = np.linalg.lstsq(powers, radial - 1, rcond=None)[0]
    return Intrinsics(
        width, height, fx, fy, cx, cy, float(fitted[0]), float(fitted[1]), p1, p2, float(fitted[2])
    )
