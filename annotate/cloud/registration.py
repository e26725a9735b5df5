"""Colour on depth exactly as libfreenect2's ``Registration::apply`` does it, bit for bit.

Kinect v2 only: its factory calibration maps depth to colour by two cubics and a disparity, not by
a pose. All arithmetic is float32 in the order of libfreenect2's src/registration.cpp. For any other
rig, and for temperature, use ``annotate.cloud.fuse``.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from annotate.array_types import Float32, Int32, Int64, UInt8
from sensors.errors import CalibrationError
from sensors.rig.camera import Intrinsics
from sensors.rig.kinect2_factory import KINECT2_COLOR as KINECT2_COLOR
from sensors.rig.kinect2_factory import KINECT2_DEPTH as KINECT2_DEPTH
from sensors.rig.kinect2_factory import KinectColorParams as KinectColorParams

DEPTH_Q = np.float32(0.01)
COLOR_Q = np.float32(0.002199)
"""Scales of the factory polynomials, fixed in Microsoft's SDK (libfreenect2, registration.cpp)."""

FILTER_TOLERANCE = 0.01
"""A point farther than the nearest one by more than this share of its depth is occluded."""
FILTER_HALF_WIDTH, FILTER_HALF_HEIGHT = 2, 1
"""Half sizes of the z-buffer's window in colour pixels: 5x3."""
_EMPTY_MM = 65536.0


def undistortion_index(camera: Intrinsics) -> Int32:
    """Where each undistorted pixel comes from: flat index (h, w) into the distorted image, -1 outside.

    Nearest neighbour as in libfreenect2: float32, then truncation of x + 0.5 (so that positions up
    to 1.5 pixels left of or above the image still count as its first column or row).
    """
    u, v = _pixel_grid(camera)
    fx, fy, cx, cy = (np.float32(value) for value in (camera.fx, camera.fy, camera.cx, camera.cy))
    k1, k2, p1, p2, k3 = (np.float32(value) for value in camera.distortion)
    x, y = (u - cx) / fx, (v - cy) / fy
    x2, y2 = x * x, y * y
    r2, xy2 = x2 + y2, 2 * x * y
    radial = 1 + ((k3 * r2 + k2) * r2 + k1) * r2
    x_distorted = fx * (x * radial + p2 * (r2 + 2 * x2) + p1 * xy2) + cx
    y_distorted = fy * (y * radial + p1 * (r2 + 2 * y2) + p2 * xy2) + cy
    column, row = np.trunc(x_distorted + np.float32(0.5)), np.trunc(y_distorted + np.float32(0.5))
    inside = (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
    index = np.where(inside, row, 0).astype(np.int32) * camera.width + np.where(inside, column, 0)
    return np.where(inside, index, -1).astype(np.int32)


@dataclass(frozen=True)
class Registration:
    """libfreenect2's registration of one Kinect v2: maps computed once, applied to every frame.

    depth: the infrared camera, distortion included. color: the factory's colour parameters.
    """

    depth: Intrinsics
    color: KinectColorParams
    _index: Int32 = field(init=False, repr=False)
    _x: Float32 = field(init=False, repr=False)
    _row: Int32 = field(init=False, repr=False)

    def __post_init__(self) -> None:
        x, y = _color_from_depth(self.depth, self.color)
        object.__setattr__(self, "_index", undistortion_index(self.depth).ravel())
        object.__setattr__(self, "_x", x.ravel())
        object.__setattr__(self, "_row", np.trunc(y + np.float32(0.5)).astype(np.int32).ravel())

    def apply(self, color_rgb: UInt8, depth_mm: NDArray[Any]) -> tuple[Float32, UInt8]:
        """One frame -> (undistorted depth float32 (h, w) mm, registered colour uint8 (h, w, 3)).

        color_rgb: uint8 (1080, 1920, 3). depth_mm: (424, 512) millimetres, 0 = no reading.
        The colour filter is on: occluded points are black. Raises CalibrationError for other sizes.
        """
        if color_rgb.shape != (self.color.height, self.color.width, 3) or depth_mm.shape != self.depth.shape:
            raise CalibrationError(
                f"colour is {color_rgb.shape} and depth {depth_mm.shape}; this registration is for "
                f"{(self.color.height, self.color.width, 3)} and {self.depth.shape}"
            )
        depth = np.ascontiguousarray(depth_mm, np.float32).ravel()
        undistorted, offset = _color_offsets(
            depth,
            self._index,
            self._x,
            self._row,
            np.float32(self.color.shift_m),
            np.float32(self.color.f),
            np.float32(self.color.cx) + np.float32(0.5),
            (self.color.height, self.color.width),
        )
        pixels = np.ascontiguousarray(color_rgb).reshape(-1, 3)
        registered = _filtered_colors(undistorted, offset, pixels, self.color.width)
        return undistorted.reshape(self.depth.shape), registered.reshape(*self.depth.shape, 3)


def kinect_points(depth_mm: Float32, camera: Intrinsics) -> Float32:
    """Organised cloud (h, w, 3) in metres as libfreenect2's ``getPointXYZ`` gives it.

    Its pixel centres lie at +0.5, half a pixel off ``undistortion_index``; kept for parity only.
    depth_mm: undistorted (h, w). Readings of 1 mm or less are NaN.
    """
    u, v = (axis.astype(np.float64) for axis in _pixel_grid(camera))
    z = depth_mm.astype(np.float32) / np.float32(1000)
    z = np.where(z <= np.float32(0.001), np.float32(np.nan), z)
    fx, fy = np.float32(1) / np.float32(camera.fx), np.float32(1) / np.float32(camera.fy)
    x = (u + 0.5 - np.float32(camera.cx)) * np.float64(fx) * z
    y = (v + 0.5 - np.float32(camera.cy)) * np.float64(fy) * z
    return np.stack([x, y, z], axis=-1).astype(np.float32)


def _pixel_grid(camera: Intrinsics) -> tuple[Float32, Float32]:
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    return u.astype(np.float32), v.astype(np.float32)


def _color_from_depth(depth: Intrinsics, color: KinectColorParams) -> tuple[Float32, Float32]:
    """Colour position of each undistorted pixel at infinity: x in focal lengths, y in pixels."""
    u, v = _pixel_grid(depth)
    x, y = (u - np.float32(depth.cx)) * DEPTH_Q, (v - np.float32(depth.cy)) * DEPTH_Q
    focal, shift = np.float32(color.f), np.float32(color.shift_m) / np.float32(color.shift_d)
    return (
        _cubic(color.mx, x, y) / (focal * COLOR_Q) - shift,
        _cubic(color.my, x, y) / COLOR_Q + np.float32(color.cy),
    )


def _cubic(coefficients: tuple[float, ...], x: Float32, y: Float32) -> Float32:
    """The factory's cubic, summed left to right as libfreenect2 does."""
    one = np.ones_like(x)
    terms = (x * x * x, y * y * y, x * x * y, y * y * x, x * x, y * y, x * y, x, y, one)
    total = np.zeros_like(x)
    for term, coefficient in zip(terms, coefficients, strict=True):
        total = total + term * np.float32(coefficient)
    return total


@njit(cache=True, nogil=True)
def _color_offsets(
    depth: Float32,
    index: Int32,
    x_at_infinity: Float32,
    row: Int32,
    shift_m: np.float32,
    focal: np.float32,
    center: np.float32,
    size: tuple[int, int],
) -> tuple[Float32, Int64]:
    """Undistorted depth, and per pixel the flat colour index or -1."""
    height, width = size
    undistorted = np.zeros(index.size, np.float32)
    offset = np.full(index.size, -1, np.int64)
    for i in range(index.size):
        if index[i] < 0:
            continue
        z = depth[index[i]]
        undistorted[i] = z
        if not z > 0:
            continue
        column = np.int64((x_at_infinity[i] + shift_m / z) * focal + center)
        # As in libfreenect2 the column itself is not checked: it may run into the next row.
        target = column + width * row[i]
        if 0 <= target < width * height:
            offset[i] = target
    return undistorted, offset


@njit(cache=True, nogil=True)
def _filtered_colors(depth: Float32, offset: Int64, pixels: UInt8, width: int) -> UInt8:
    """Colour of each pixel, black where a nearer point covers its colour pixel."""
    # One row above and below as in libfreenect2, and two cells against its overrun at the corners.
    border = width * FILTER_HALF_HEIGHT + FILTER_HALF_WIDTH
    nearest = np.full(pixels.shape[0] + 2 * border, np.float32(_EMPTY_MM))
    for i in range(offset.size):
        if offset[i] < 0:
            continue
        for down in range(-FILTER_HALF_HEIGHT, FILTER_HALF_HEIGHT + 1):
            start = offset[i] + border + down * width
            for cell in range(start - FILTER_HALF_WIDTH, start + FILTER_HALF_WIDTH + 1):
                nearest[cell] = min(nearest[cell], depth[i])
    registered = np.zeros((offset.size, 3), np.uint8)
    tolerance = np.float32(FILTER_TOLERANCE)
    for i in range(offset.size):
        if offset[i] >= 0 and not (depth[i] - nearest[offset[i] + border]) / depth[i] > tolerance:
            for channel in range(3):
                registered[i, channel] = pixels[offset[i], channel]
    return registered
