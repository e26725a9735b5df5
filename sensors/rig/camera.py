"""Pinhole cameras with Brown distortion; pixels to rays and back.

Camera frame: x right, y down, z forward, metres. Pixel centres are at whole coordinates.
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
Distortion = tuple[float, float, float, float, float]  # k1, k2, p1, p2, k3: OpenCV's order


@dataclass(frozen=True)
class Intrinsics:
    """Pinhole camera in pixels with Brown-Conrady distortion (OpenCV's k1, k2, p1, p2, k3, without unit).

    Raises CalibrationError for impossible sizes or focal lengths.
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
        # Values of a file may have any type.
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
        """Return (height, width)."""
        return self.height, self.width

    @property
    def distortion(self) -> Distortion:
        """Return (k1, k2, p1, p2, k3)."""
        return self.k1, self.k2, self.p1, self.p2, self.k3

    @property
    def matrix(self) -> NDArray[np.float64]:
        """Return the camera matrix (3, 3)."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1]], dtype=np.float64)

    def check_size(self, name: str, shape: tuple[int, ...]) -> None:
        """Raise CalibrationError where the shape (height, width, ...) of the image ``name`` differs."""
        if shape[:2] != self.shape:
            raise CalibrationError(
                f"{name} is {shape[1]}x{shape[0]} but its calibration is of {self.width}x{self.height}; "
                "give the calibration of this camera in this mode"
            )

    def undistorted(self) -> "Intrinsics":
        """Return the same pinhole without distortion."""
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
    """Apply Brown's lens model to numbers or arrays."""
    k1, k2, p1, p2, k3 = lens
    r2 = x * x + y * y
    radial = 1 + ((k3 * r2 + k2) * r2 + k1) * r2
    x_distorted = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    y_distorted = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    return x_distorted, y_distorted


def undistort(camera: Intrinsics, xy: FloatArray, iterations: int = 40) -> NDArray[np.float64]:
    """Invert ``distort`` by fixed-point iteration; (..., 2) -> (..., 2) normalised coordinates.

    The result is wrong, perhaps not finite, in image corners where the lens model has no inverse.
    """
    goal = np.asarray(xy, np.float64)
    ideal = goal.copy()
    at, still = ideal.reshape(-1, 2).copy(), np.arange(ideal.size // 2)
    goal = goal.reshape(-1, 2)
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(iterations):
            before, at = at, at + (goal - distort(camera, at))
            moves = (at[:, 0] != before[:, 0]) | (at[:, 1] != before[:, 1])
            if 2 * np.count_nonzero(moves) < len(moves):  # go on without the points that rest
                ideal.reshape(-1, 2)[still] = at
                at, goal, still = at[moves], goal[moves], still[moves]
    ideal.reshape(-1, 2)[still] = at
    return ideal


def project(camera: Intrinsics, points_m: FloatArray) -> NDArray[np.float64]:
    """Project camera-frame points (..., 3) to pixels (..., 2) as (u, v); NaN for z <= 0."""
    points = np.asarray(points_m, np.float64)
    z = np.where(points[..., 2] > 0, points[..., 2], np.nan)
    xy = distort(camera, points[..., :2] / z[..., None])
    return np.stack([camera.fx * xy[..., 0] + camera.cx, camera.fy * xy[..., 1] + camera.cy], axis=-1)


def unproject(camera: Intrinsics, depth_m: FloatArray) -> NDArray[np.float32]:
    """Back-project depth along z (h, w) to an organised cloud (h, w, 3), camera frame; NaN stays NaN."""
    camera.check_size("depth image", depth_m.shape)
    return (rays(camera) * depth_m[..., None]).astype(np.float32)


def rays(camera: Intrinsics) -> NDArray[np.float64]:
    """Return the direction (h, w, 3) of every pixel with z = 1, lens distortion undone."""
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    xy = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy], axis=-1)
    if any(camera.distortion):
        xy = undistort(camera, xy)
    return np.concatenate([xy, np.ones((*camera.shape, 1))], axis=-1)
