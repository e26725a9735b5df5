"""Visibility of the depth camera's points in another camera, by projection and z-buffer.

A point is occluded if the z-buffer around its pixel holds a point nearer by more than the slack. All
arithmetic is float32, accurate to a few ten-thousandths of a pixel, so that it vectorises.
"""

import threading
from dataclasses import dataclass, field
from typing import NamedTuple

import cv2
import numpy as np
from numba import njit

from annotate.array_types import Bool, Float32
from sensors.calibration_files.kinect2_factory import KINECT2_COLOR, KINECT2_DEPTH
from sensors.rig.camera import Intrinsics, rays
from sensors.rig.rig_calibration import Pose

COLOR_TOLERANCE = 0.01  # share of depth; a coloured point may lie so far behind the nearest (libfreenect2)
COLOR_HALF_HEIGHT, COLOR_HALF_WIDTH = 1, 2  # pixels of a Kinect v2's colour camera (libfreenect2: 5 x 3)
THERMAL_HALF_WINDOW = 1  # thermal pixels, because a pixel on a silhouette mixes both surfaces; untuned
THERMAL_TOLERANCE = 0.03  # as COLOR_TOLERANCE; 0.01 loses a third of a seated person's points; untuned
HALF, ONE, TWO, ZERO = np.float32(0.5), np.float32(1), np.float32(2), np.float32(0)
NOWHERE = np.float32(np.nan)


class Projection(NamedTuple):
    """Columns and rows (h, w) of points in another camera's image, and depth (h, w) in that camera, metres.

    ahead_m: the depth; NaN for points without a reading, behind the camera or outside its image.
    """

    column: Float32
    row: Float32
    ahead_m: Float32


@dataclass(frozen=True)
class PointView:
    """View of the depth camera's points from another camera, with its occlusion test.

    rays: float32 (3, h, w), the depth camera's rays (z = 1) in the other camera's axes. translation_m:
    float32 (3,), other_from_depth. half_window: (rows, columns) of the z-buffer's window to each side.
    tolerance: share of its depth by which a visible point may lie behind another. slope_reach: depth pixels
    over which a slanted surface may recede without counting as occluded (slope-scaled bias of shadow
    mapping).
    """

    camera: Intrinsics
    rays: Float32
    translation_m: Float32
    half_window: tuple[int, int]
    tolerance: float
    slope_reach: float
    _buffers: threading.local = field(default_factory=threading.local, init=False, repr=False, compare=False)

    @staticmethod
    def of_color(depth: Intrinsics, color: Intrinsics, color_from_depth: Pose) -> "PointView":
        """Return the view of a colour camera.

        The z-buffer's window is libfreenect2's, scaled to this camera's resolution. In an image aligned with
        depth pixel for pixel, no point hides another.
        """
        if color == depth and not color_from_depth.translation_m.any():
            return PointView(color, *_turned(depth, color_from_depth), (0, 0), np.inf, 0.0)
        scale = (color.fx / depth.fx) / (KINECT2_COLOR.f / KINECT2_DEPTH.fx)
        half_window = round(COLOR_HALF_HEIGHT * scale), round(COLOR_HALF_WIDTH * scale)
        return PointView(color, *_turned(depth, color_from_depth), half_window, COLOR_TOLERANCE, 0.0)

    @staticmethod
    def of_thermal(depth: Intrinsics, thermal: Intrinsics, thermal_from_depth: Pose) -> "PointView":
        """Return the view of a thermal camera. ``slope_reach`` is half a window, in depth pixels."""
        reach = (THERMAL_HALF_WINDOW + 0.5) * depth.fx / thermal.fx
        half_window = THERMAL_HALF_WINDOW, THERMAL_HALF_WINDOW
        return PointView(thermal, *_turned(depth, thermal_from_depth), half_window, THERMAL_TOLERANCE, reach)

    def project(self, depth_m: Float32) -> Projection:
        """Project the points of an undistorted depth image (h, w) in metres, NaN = no reading."""
        camera = self.camera
        lens = np.array([camera.fx, camera.fy, camera.cx, camera.cy, *camera.distortion], np.float32)
        size = np.float32(camera.height), np.float32(camera.width)
        flat = _project(depth_m.ravel(), self.rays.reshape(3, -1), self.translation_m, lens, size)
        return Projection(*(plane.reshape(depth_m.shape) for plane in flat))

    def slack_m(self, ahead_m: Float32) -> Float32:
        """Return the metres by which each point (h, w) may lie behind the z-buffer and still be visible.

        The slack is ``tolerance`` of its depth, plus the slope of its surface times ``slope_reach``. The
        slope is the lesser difference to each side, so that edges do not count; beside a gap it is 0.
        """
        return _slack(ahead_m, np.float32(self.tolerance), np.float32(self.slope_reach))

    def zbuffer(self, projection: Projection) -> Float32:
        """Return the depth (h', w') in metres of the nearest point on each pixel; inf without any.

        The calling thread's next ``zbuffer`` or ``visible`` overwrites the result.
        """
        nearest = self._buffer(0)
        _fill_zbuffer(projection, nearest, _steps(0))
        return nearest

    def front(self, nearest: Float32) -> Float32:
        """Return the minimum (h', w') of a z-buffer over each pixel's window."""
        rows, columns = self.half_window
        window = np.ones((2 * rows + 1, 2 * columns + 1), np.uint8)
        return np.asarray(cv2.erode(nearest, window), np.float32)

    def visible(self, projection: Projection) -> Bool:
        """Return flags (h, w) of points not behind ``front`` by more than ``slack_m``."""
        rows, columns = self.half_window
        tall = self._buffer(rows)
        _fill_zbuffer(projection, tall, _steps(rows))
        return _visible(projection, tall, _steps(columns), np.uint32(rows), self.slack_m(projection.ahead_m))

    def _buffer(self, rows: int) -> Float32:
        """Return a reusable image (h' + 2 * rows, w') of this view and the calling thread; its content is
        undefined.
        """
        # Reused, because fresh pages for 1920x1080 floats cost more time than the arithmetic.
        height, width = self.camera.shape
        shape = height + 2 * rows, width
        if getattr(self._buffers, "image", None) is None or self._buffers.image.shape != shape:
            self._buffers.image = np.empty(shape, np.float32)
        buffer: Float32 = self._buffers.image
        return buffer


def _turned(depth: Intrinsics, pose: Pose) -> tuple[Float32, Float32]:
    """Return rays (3, h, w) of the depth camera in the other camera's axes, and the translation (3,)."""
    turned = np.einsum("ij,hwj->ihw", pose.rotation, rays(depth.undistorted()))
    return np.ascontiguousarray(turned, np.float32), pose.translation_m.astype(np.float32)


@njit(cache=True, nogil=True, forceinline=True)
def nearest_pixel(coordinate: np.float32) -> np.uint32:
    """Return the index of the pixel at a coordinate of at least -0.5.

    The index is unsigned, so that no kernel checks for negative ones.
    """
    return np.uint32(coordinate + HALF)


@njit(cache=True, nogil=True, error_model="numpy")
def _project(
    depth_m: Float32, turned: Float32, translation_m: Float32, lens: Float32, size: tuple[np.float32, ...]
) -> tuple[Float32, Float32, Float32]:
    """Project flat depths (n,); return columns, rows and metres ahead (n,). turned: (3, n), rays."""
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = lens
    t_x, t_y, t_z = translation_m
    rays_x, rays_y, rays_z = turned[0], turned[1], turned[2]
    height, width = size
    columns, rows = np.empty(depth_m.size, np.float32), np.empty(depth_m.size, np.float32)
    ahead = np.empty(depth_m.size, np.float32)
    for i in range(depth_m.size):
        z = rays_z[i] * depth_m[i] + t_z
        x, y = (rays_x[i] * depth_m[i] + t_x) / z, (rays_y[i] * depth_m[i] + t_y) / z
        # Brown's lens, as in sensors.rig.camera.distort.
        r2 = x * x + y * y
        radial = ONE + ((k3 * r2 + k2) * r2 + k1) * r2
        column = fx * (x * radial + TWO * p1 * x * y + p2 * (r2 + TWO * x * x)) + cx
        row = fy * (y * radial + p1 * (r2 + TWO * y * y) + TWO * p2 * x * y) + cy
        inside = (column + HALF >= 0) & (column + HALF < width) & (row + HALF >= 0) & (row + HALF < height)
        columns[i], rows[i] = column, row
        ahead[i] = z if inside & (z > 0) else NOWHERE
    return columns, rows, ahead


@njit(cache=True, nogil=True)
def _slack(ahead_m: Float32, tolerance: np.float32, slope_reach: np.float32) -> Float32:
    """Return ``PointView.slack_m`` of distances (h, w)."""
    slack = tolerance * ahead_m
    for v in range(1, ahead_m.shape[0] - 1):
        above, row, below = ahead_m[v - 1], ahead_m[v], ahead_m[v + 1]
        for u in range(1, ahead_m.shape[1] - 1):
            left, right = abs(row[u - 1] - row[u]), abs(row[u + 1] - row[u])
            up, down = abs(above[u] - row[u]), abs(below[u] - row[u])
            slope = min(left, right) + min(up, down)
            slack[v, u] += slope_reach * slope if left + right + up + down >= 0 else ZERO
    return slack


def _steps(half: int) -> tuple[np.uint32, ...]:
    """Return the offsets 0 to 2 * half; a tuple, so that its length is known to the compiler."""
    return tuple(np.uint32(step) for step in range(2 * half + 1))


@njit(cache=True, nogil=True)
def _fill_zbuffer(projection: Projection, nearest: Float32, rows: tuple[np.uint32, ...]) -> None:
    """Fill ``nearest`` with the depth of the nearest point on each pixel. rows: offsets at which a point is
    entered.
    """
    column, row, ahead = projection
    nearest[:] = np.float32(np.inf)
    for v in range(ahead.shape[0]):
        for u in range(ahead.shape[1]):
            z = ahead[v, u]
            if z > 0:
                y, x = nearest_pixel(row[v, u]), nearest_pixel(column[v, u])
                for down in rows:
                    nearest[y + down, x] = min(nearest[y + down, x], z)


@njit(cache=True, nogil=True)
def _visible(
    projection: Projection, tall: Float32, columns: tuple[np.uint32, ...], rows: np.uint32, slack_m: Float32
) -> Bool:
    """Return flags (h, w) of points that no nearer point hides, as ``PointView.visible``.

    tall: z-buffer (h' + 2 * rows, w'), already the minimum over the window's rows. columns: offsets of the
    window's columns. slack_m: (h, w), depth difference that does not hide.
    """
    column, row, ahead = projection
    seen, width = np.zeros(ahead.shape, np.bool_), tall.shape[1]
    half, last = np.uint32(len(columns) // 2), np.uint32(width - 1)
    for v in range(ahead.shape[0]):
        for u in range(ahead.shape[1]):
            z = ahead[v, u]
            if z > 0:
                y, x = nearest_pixel(row[v, u]) + rows, nearest_pixel(column[v, u])
                front = z
                for right in columns:
                    front = min(front, tall[y, min(max(x + right, half) - half, last)])
                seen[v, u] = z - front <= slack_m[v, u]
    return seen
