"""Fusion of simultaneous depth, colour and temperature images to an organised cloud.

A point takes colour and temperature only from a camera that it is visible to (``annotate.cloud.visibility``).
So a person's heat is not copied onto the wall behind the person.
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from annotate.array_types import Bool, Float32, Int32, UInt8, UInt16
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.cloud.visibility import ONE, ZERO, PointView, Projection, nearest_pixel
from sensors.errors import CalibrationError
from sensors.rig.camera import Intrinsics, rays
from sensors.rig.frame import FARTHEST_MM, RigFrame
from sensors.rig.rig_calibration import RigCalibration

BESIDE = 2  # threads that look up temperatures; untuned, for two cores


def undistortion_index(camera: Intrinsics) -> Int32:
    """Return the flat index int32 (h, w) of each undistorted pixel's pixel in the sensor's image, -1 outside.

    Bit for bit as libfreenect2 (``Registration::apply``): nearest neighbour in float32. x + 0.5 is truncated,
    so positions up to 1.5 pixels left of or above the image count as its first column or row.
    """
    u, v = (
        axis.astype(np.float32) for axis in np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    )
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


def shifted(depth_mm: UInt16, shift_mm: float) -> UInt16:
    """Return depth with a calibration's shift added, in whole millimetres; readings out of range become 0."""
    whole = round(shift_mm)
    if not whole:
        return depth_mm
    moved = depth_mm.astype(np.int32) + whole
    known = (depth_mm > 0) & (depth_mm <= FARTHEST_MM) & (moved > 0) & (moved <= FARTHEST_MM)
    return np.where(known, moved, 0).astype(np.uint16)


class Fuser:
    """Fusion of the frames of one calibration, with precomputed maps; thread-safe.

    camera: the undistorted depth camera of the clouds.
    """

    def __init__(self, calibration: RigCalibration) -> None:
        depth = calibration.depth
        self.calibration = calibration
        self.camera = depth.undistorted()
        self._source = undistortion_index(depth)
        self._rays = rays(self.camera)[..., :2].astype(np.float32)
        self._beside = ThreadPoolExecutor(BESIDE, "fuse")
        self._color: PointView | None = None
        self._thermal: PointView | None = None
        if calibration.color is not None and calibration.color_from_depth is not None:
            self._color = PointView.of_color(depth, calibration.color, calibration.color_from_depth)
        if calibration.thermal is not None and calibration.thermal_from_depth is not None:
            self._thermal = PointView.of_thermal(depth, calibration.thermal, calibration.thermal_from_depth)

    def fuse_frame(self, frame: RigFrame) -> ThermalCloud:
        """Fuse a frame, decoding its colour image. Raises FormatError for a broken image, CalibrationError as
        ``fuse``.
        """
        fused = self.fuse(frame.depth_mm, frame.decode_color(), frame.thermal_c)
        return replace(fused, stamp_ns=frame.stamp_ns)

    def fuse(
        self, depth_mm: UInt16, color_rgb: UInt8 | None = None, thermal_c: Float32 | None = None
    ) -> ThermalCloud:
        """Fuse simultaneous images to a cloud over the undistorted depth image.

        depth_mm: uint16 (h, w) of the sensor; undistorted by nearest neighbour as in libfreenect2, and
        shifted by the calibration's depth shift. color_rgb: uint8 (h', w', 3), by nearest pixel. thermal_c:
        float32 (h", w"), NaN = no reading. Temperatures are interpolated bilinearly, without pixels that show
        another surface than the point's. A missing image leaves colours invalid or temperatures NaN. Raises
        CalibrationError if an image's size is not its camera's, or if its camera is missing.
        """
        self.camera.check_size("depth image", depth_mm.shape)
        measured = shifted(depth_mm, self.calibration.depth_shift_mm)
        undistorted, points = _undistort(np.ascontiguousarray(measured).ravel(), self._source, self._rays)
        depth_m = np.ascontiguousarray(points[..., 2])
        color, seen = np.zeros(points.shape, np.uint8), np.zeros(undistorted.shape, np.bool_)
        felt = None
        if thermal_c is not None:
            view = _view_of("thermal", thermal_c, self._thermal)
            felt = self._beside.submit(_temperatures, view, depth_m, thermal_c)
        if color_rgb is not None:
            color, seen = _colors(_view_of("colour", color_rgb, self._color), depth_m, color_rgb)
        temperature = np.full(undistorted.shape, np.nan, np.float32) if felt is None else felt.result()
        return ThermalCloud(self.camera, undistorted, points, color, seen, temperature)


def _colors(view: PointView, depth_m: Float32, color_rgb: UInt8) -> tuple[UInt8, Bool]:
    """Return colours uint8 (h, w, 3) of points with depths (h, w), and flags (h, w) of visible ones."""
    projection = view.project(depth_m)
    seen = view.visible(projection)
    return _nearest(projection, seen, np.ascontiguousarray(color_rgb)), seen


def _temperatures(view: PointView, depth_m: Float32, thermal_c: Float32) -> Float32:
    """Return temperatures (h, w) of points with depths (h, w), NaN out of view or without a reading."""
    projection = view.project(depth_m)
    nearest = view.zbuffer(projection)
    front, known = view.front(nearest), np.isfinite(thermal_c)
    # A border without readings saves the kernel the checks of the image's edge.
    sight = np.zeros((*(side + 2 for side in thermal_c.shape), 3), np.float32)
    sight[..., 0] = np.inf
    sight[1:-1, 1:-1] = np.stack([np.where(known, nearest, np.inf), front, np.where(known, thermal_c, 0)], -1)
    return _bilinear(projection, view.slack_m(projection.ahead_m), sight)


def _view_of(name: str, image: NDArray[Any], view: PointView | None) -> PointView:
    """Return the view of an image's camera. Raises CalibrationError where it is missing or has another
    size.
    """
    if view is None:
        raise CalibrationError(
            f"the frame has a {name} image but the calibration has no {name} camera; "
            "calibrate it or leave the image out"
        )
    view.camera.check_size(f"{name} image", image.shape)
    return view


@njit(cache=True, nogil=True)
def _undistort(depth_mm: UInt16, source: Int32, rays_xy: Float32) -> tuple[UInt16, Float32]:
    """Return undistorted depth (h, w) in millimetres, and points (h, w, 3) in metres, NaN = no reading."""
    undistorted = np.zeros(source.shape, np.uint16)
    points = np.full((*source.shape, 3), np.float32(np.nan))
    for v in range(source.shape[0]):
        for u in range(source.shape[1]):
            if source[v, u] >= 0 and 0 < depth_mm[source[v, u]] <= FARTHEST_MM:
                undistorted[v, u] = depth_mm[source[v, u]]
                z = np.float32(undistorted[v, u]) / np.float32(1000)
                points[v, u, 0], points[v, u, 1] = rays_xy[v, u, 0] * z, rays_xy[v, u, 1] * z
                points[v, u, 2] = z
    return undistorted, points


@njit(cache=True, nogil=True)
def _nearest(projection: Projection, seen: Bool, image: UInt8) -> UInt8:
    """Return colours (h, w, 3) of the nearest pixels of an image (h', w', 3); 0 where ``seen`` (h, w) is
    False.
    """
    columns, rows, _ = projection
    colors = np.zeros((*seen.shape, 3), np.uint8)
    for v in range(seen.shape[0]):
        for u in range(seen.shape[1]):
            if seen[v, u]:
                row, column = nearest_pixel(rows[v, u]), nearest_pixel(columns[v, u])
                for channel in range(3):
                    colors[v, u, channel] = image[row, column, channel]
    return colors


@njit(cache=True, nogil=True)
def _bilinear(projection: Projection, slack_m: Float32, sight: Float32) -> Float32:
    """Return the bilinear mean (h, w) of temperatures, over pixels that show the point's own surface alone;
    NaN without any.

    sight: (h' + 2, w' + 2, 3), z-buffer (inf = no reading), its minimum in the window, temperature.
    """
    column, row, ahead = projection
    values = np.full(ahead.shape, np.float32(np.nan))
    for v in range(ahead.shape[0]):
        for u in range(ahead.shape[1]):
            z, slack = ahead[v, u], slack_m[v, u]
            if not z > 0:
                continue
            r, c = nearest_pixel(row[v, u]) + np.uint32(1), nearest_pixel(column[v, u]) + np.uint32(1)
            if z - sight[r, c, 1] > slack:
                continue
            x, y = column[v, u] + ONE, row[v, u] + ONE
            left, top = np.uint32(x), np.uint32(y)
            right_share, lower_share = x - np.float32(left), y - np.float32(top)
            total, weight = ZERO, ZERO
            for down in range(2):
                for right in range(2):
                    r, c = top + np.uint32(down), left + np.uint32(right)
                    nearest, front, reading = sight[r, c, 0], sight[r, c, 1], sight[r, c, 2]
                    share = lower_share if down else ONE - lower_share
                    share *= right_share if right else ONE - right_share
                    share = share if (nearest - z <= slack) & (z - front <= slack) else ZERO
                    total += share * reading
                    weight += share
            if weight > 0:
                values[v, u] = total / weight
    return values
