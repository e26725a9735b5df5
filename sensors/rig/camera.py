"""Pinhole intrinsics with Brown distortion; pixels to rays and back.

Camera frame: x right, y down, z forward, metres. Pixel centres sit on integer coordinates.
"""

import math
from dataclasses import dataclass, replace
from numbers import Integral, Real
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from sensors.errors import CalibrationError
from sensors.files.bounded import MAX_IMAGE_SIDE

FloatArray = NDArray[np.floating[Any]]
Number = TypeVar("Number", float, NDArray[np.float64])
Distortion = tuple[float, float, float, float, float]
"""(k1, k2, p1, p2, k3) in OpenCV's order."""


@dataclass(frozen=True)
class Intrinsics:
    """Pinhole camera with Brown-Conrady distortion (OpenCV's k1, k2, p1, p2, k3).

    Focal lengths and principal point are in pixels; distortion is without unit.
    Raises CalibrationError for sizes or focal lengths that no camera has.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    k3: float = 0.0

    def __post_init__(self) -> None:
        # From a file they may be of any type.
        if not all(
            isinstance(n, (int, Integral)) and 0 < n <= MAX_IMAGE_SIDE for n in (self.width, self.height)
        ):
            raise CalibrationError(
                f"image size {self.width}x{self.height} is impossible; "
                f"give 1 to {MAX_IMAGE_SIDE} pixels a side"
            )
        if not all(map(_is_finite, self.distortion)):
            raise CalibrationError(
                f"lens coefficients k1, k2, p1, p2, k3 are {self.distortion}; give finite ones, or 0"
            )
        numbers = (self.fx, self.fy, self.cx, self.cy)
        if not all(map(_is_finite, numbers)) or self.fx <= 0 or self.fy <= 0:
            raise CalibrationError(
                f"intrinsics fx={self.fx}, fy={self.fy}, cx={self.cx}, cy={self.cy} are not a camera's; "
                "give positive finite focal lengths in pixels"
            )

    @property
    def shape(self) -> tuple[int, int]:
        """Image shape (height, width)."""
        return self.height, self.width

    @property
    def distortion(self) -> Distortion:
        """Of Brown's lens model, without unit."""
        return self.k1, self.k2, self.p1, self.p2, self.k3

    @property
    def matrix(self) -> NDArray[np.float64]:
        """The 3x3 camera matrix."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1]], dtype=np.float64)

    def check_size(self, name: str, shape: tuple[int, ...]) -> None:
        """Raise CalibrationError where the shape (height, width, ...) of the image ``name`` is another."""
        if shape[:2] != self.shape:
            raise CalibrationError(
                f"{name} is {shape[1]}x{shape[0]} but its calibration is of {self.width}x{self.height}; "
                "give the calibration of this camera in this mode"
            )

    def undistorted(self) -> "Intrinsics":
        """The same pinhole without distortion."""
        return replace(self, k1=0.0, k2=0.0, p1=0.0, p2=0.0, k3=0.0)


def _is_finite(number: object) -> bool:
    try:
        return isinstance(number, (float, Real)) and math.isfinite(number)
    except OverflowError:
        return False


def distort(camera: Intrinsics, xy: FloatArray) -> NDArray[np.float64]:
    """Apply Brown's lens model to ideal normalised coordinates (..., 2) -> distorted (..., 2).

    Source: Brown 1971 as in OpenCV's ``projectPoints``, and libfreenect2's ``Registration``.
    """
    x, y = np.asarray(xy[..., 0], np.float64), np.asarray(xy[..., 1], np.float64)
    return np.stack(brown(x, y, camera.distortion), axis=-1)


def brown(x: Number, y: Number, lens: Distortion) -> tuple[Number, Number]:
    """``distort`` of numbers or arrays; lens: ``Intrinsics.distortion``."""
    k1, k2, p1, p2, k3 = lens
    r2 = x * x + y * y
    radial = 1 + ((k3 * r2 + k2) * r2 + k1) * r2
    x_distorted = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    y_distorted = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    return x_distorted, y_distorted


def undistort(camera: Intrinsics, xy: FloatArray, iterations: int = 40) -> NDArray[np.float64]:
    """Invert ``distort`` by fixed-point iteration; (..., 2) -> (..., 2) normalised coordinates.

    Meaningless, perhaps not finite, where a lens model has no inverse: in corners beyond a round view.
    """
    goal = np.asarray(xy, np.float64)
    ideal = goal.copy()
    at, still = ideal.reshape(-1, 2).copy(), np.arange(ideal.size // 2)
    goal = goal.reshape(-1, 2)
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(iterations):
            before, at = at, at + (goal - distort(camera, at))
            moves = (at[:, 0] != before[:, 0]) | (at[:, 1] != before[:, 1])
            # Points that have come to rest stay there; the work goes on with the others.
            if 2 * np.count_nonzero(moves) < len(moves):
                ideal.reshape(-1, 2)[still] = at
                at, goal, still = at[moves], goal[moves], still[moves]
    ideal.reshape(-1, 2)[still] = at
    return ideal


def project(camera: Intrinsics, points_m: FloatArray) -> NDArray[np.float64]:
    """Project camera-frame points (..., 3) in metres to pixels (..., 2) as (u, v).

    Points at or behind the camera (z <= 0) give NaN.
    """
    points = np.asarray(points_m, np.float64)
    z = np.where(points[..., 2] > 0, points[..., 2], np.nan)
    xy = distort(camera, points[..., :2] / z[..., None])
    return np.stack([camera.fx * xy[..., 0] + camera.cx, camera.fy * xy[..., 1] + camera.cy], axis=-1)


def unproject(camera: Intrinsics, depth_m: FloatArray) -> NDArray[np.float32]:
    """Back-project a depth image (h, w) in metres to an organised cloud (h, w, 3), camera frame.

    Depth is along z. NaN stays NaN in all three coordinates. Lens distortion is undone.
    """
    camera.check_size("depth image", depth_m.shape)
    return (rays(camera) * depth_m[..., None]).astype(np.float32)


def rays(camera: Intrinsics) -> NDArray[np.float64]:
    """Direction (h, w, 3) of every pixel with z = 1, lens distortion undone."""
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    xy = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy], axis=-1)
    if any(camera.distortion):
        xy = undistort(camera, xy)
    return np.concatenate([xy, np.ones((*camera.shape, 1))], axis=-1)


def intrinsics_from_rational(
    size: tuple[int, int], matrix: NDArray[np.float64], coefficients: NDArray[np.float64]
) -> Intrinsics:
    """OpenCV's rational lens (k1 k2 p1 p2 k3 k4 k5 k6) as the polynomial one that fits best in the image.

    size: (width, height). matrix: (3, 3). The radial factor is fitted by least squares in radius^2 out to the
    corners, weighted by area; for an Azure Kinect it stays within 0.2 % of the rational one.
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
