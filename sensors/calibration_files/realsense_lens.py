"""The lens models of RealSense's SDK, as Brown's."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sensors.errors import CalibrationError
from sensors.rig.camera import Intrinsics

PLAIN = ("none", "brown_conrady")
SCALED = ("modified_brown_conrady", "inverse_brown_conrady")
"""Names of ``rs2_distortion``, in small letters. The SDK projects both of ``SCALED`` by one formula."""
GRID = 25
"""Points a side at which the two models are compared. Chosen by eye."""


def realsense_intrinsics(pinhole: Intrinsics, model: str, coefficients: Sequence[float]) -> Intrinsics:
    """A camera of RealSense's SDK. pinhole: without distortion. coefficients: k1, k2, p1, p2, k3.

    model: as the SDK names it. Its plain model is Brown's. In the others tangential distortion applies to
    points that the radial one has moved already (``rs2_project_point_to_pixel``, librealsense
    src/rs.cpp): Brown's coefficients are fitted to that by least squares over the image, which for a D455's
    colour camera leaves less than 0.02 pixels. Raises CalibrationError for a fisheye's models.
    """
    name = model.strip().lower().replace(" ", "_")
    k1, k2, p1, p2, k3 = map(float, coefficients[:5])
    if name in PLAIN or not any(coefficients):
        return replace(pinhole, k1=k1, k2=k2, p1=p1, p2=p2, k3=k3)
    if name not in SCALED:
        raise CalibrationError(f"lens model {model[:40]!r} is not supported; use a RealSense D400")
    u, v = np.meshgrid(np.linspace(0, pinhole.width - 1, GRID), np.linspace(0, pinhole.height - 1, GRID))
    x, y = ((u - pinhole.cx) / pinhole.fx).ravel(), ((v - pinhole.cy) / pinhole.fy).ravel()
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    near, far = x * radial, y * radial
    goal = np.concatenate(
        [
            near + 2 * p1 * near * far + p2 * (r2 + 2 * near * near) - x,
            far + p1 * (r2 + 2 * far * far) + 2 * p2 * near * far - y,
        ]
    )
    # Brown's model is linear in its coefficients.
    powers = [np.concatenate([x * r2**n, y * r2**n]) for n in (1, 2, 3)]
    tangential = [
        np.concatenate([2 * x * y, r2 + 2 * y * y]),
        np.concatenate([r2 + 2 * x * x, 2 * x * y]),
    ]
    terms = np.stack([powers[0], powers[1], *tangential, powers[2]], axis=-1)
    k1, k2, p1, p2, k3 = map(float, np.linalg.lstsq(terms, goal, rcond=None)[0])
    return replace(pinhole, k1=k1, k2=k2, p1=p1, p2=p2, k3=k3)
