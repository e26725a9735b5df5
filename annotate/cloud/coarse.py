"""Coarse cloud of a frame: one point for each square of about 2 x 2 pixels, where no fine outline is needed.

The first pixel with a reading represents its square. Labels of the coarse cloud are transferred back to the
whole image by depth: a pixel takes the label of the nearest point around it on its surface.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numba import njit

from annotate.array_types import Float32, Index, Int32, UInt8, UInt16
from annotate.cloud.fuse import Fuser, shifted, undistortion_index
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.frame_labels import FrameLabels
from sensors.rig.camera import Intrinsics
from sensors.rig.frame import FARTHEST_MM, RigFrame
from sensors.rig.rig_calibration import RigCalibration

FOCAL_PX = 170.0  # least of a coarse image; at 122 an outline has an IoU 0.03 lower (8 virtual frames)
SAME_SURFACE = 0.01  # share of the depth that counts as a pixel's distance; twice as much: IoU within 0.001


@dataclass(frozen=True)
class CoarseCloud:
    """Coarse cloud of a frame, with the image that it was thinned from.

    camera: undistorted, of the whole image. depth_mm: the whole image, uint16 (h, w). cloud: of
    (h // stride, w // stride) points. pixel: flat index of each point's pixel in the whole image, -1 = none.
    stride: pixels per point along a side.
    """

    camera: Intrinsics
    depth_mm: UInt16
    cloud: ThermalCloud
    pixel: Index
    stride: int

    @classmethod
    def of(cls, whole: ThermalCloud) -> "CoarseCloud":
        """Return a full cloud thinned by the stride that its focal length allows."""
        stride = stride_of(whole.camera)
        pixel = _chosen(whole.depth_mm, stride)
        rows, columns = (stride * np.arange(side) for side in pixel.shape)
        # A square without a reading takes its first pixel, which has no values.
        at = np.where(pixel < 0, rows[:, None] * whole.camera.width + columns, pixel)
        cloud = ThermalCloud(
            reduced(whole.camera, stride),
            whole.depth_mm.take(at),
            whole.points_m.reshape(-1, 3).take(at, axis=0),
            whole.color_rgb.reshape(-1, 3).take(at, axis=0),
            whole.color_valid.take(at),
            whole.temperature_c.take(at),
            whole.stamp_ns,
        )
        return cls(whole.camera, whole.depth_mm, cloud, pixel, stride)

    def enlarged(self, whose: UInt8) -> UInt8:
        """Return labels (h, w) of the whole image's pixels from labels of the points; 0 without a reading."""
        return nearest_labels(self.depth_mm, self.pixel, whose, self.stride)

    def coarse(self, labels: FrameLabels) -> FrameLabels:
        """Return labels of a whole image of this camera, thinned to the coarse cloud's points."""
        pixel = _chosen(labels.depth_mm, self.stride)

        depth_mm = np.where(pixel >= 0, labels.depth_mm.ravel()[pixel], np.uint16(0))
        parts = np.where(pixel >= 0, labels.parts.ravel()[pixel], np.uint8(0))
        persons = labels.persons
        if persons is not None:
            persons = np.where(pixel >= 0, persons.ravel()[pixel], np.uint8(0))
        return replace(labels, depth_mm=depth_mm, parts=parts, persons=persons, confidence=None)


class CoarseFuser:
    """Fusion of coarse clouds of depth and temperature, without colour; thread-safe.

    camera: the undistorted depth camera of the whole images.
    """

    def __init__(self, calibration: RigCalibration) -> None:
        self.calibration = calibration
        self.camera = calibration.depth.undistorted()
        self._source = undistortion_index(calibration.depth)
        self._stride = stride_of(self.camera)
        coarse = replace(calibration, depth=reduced(self.camera, self._stride))
        # The coarse image is undistorted and shifted already.
        self._fuser = Fuser(replace(coarse, color=None, color_from_depth=None, depth_shift_mm=0.0))

    def fuse_frame(self, frame: RigFrame) -> CoarseCloud:
        """Fuse a frame without decoding its colour image. Raises CalibrationError as ``Fuser.fuse``."""
        fused = self.fuse(frame.depth_mm, frame.thermal_c)
        return replace(fused, cloud=replace(fused.cloud, stamp_ns=frame.stamp_ns))

    def fuse(self, depth_mm: UInt16, thermal_c: Float32 | None = None) -> CoarseCloud:
        """Fuse simultaneous images to a coarse cloud; arguments as in ``Fuser.fuse``."""
        self.camera.check_size("depth image", depth_mm.shape)
        measured = shifted(depth_mm, self.calibration.depth_shift_mm)
        whole = _undistorted(np.ascontiguousarray(measured).ravel(), self._source)
        pixel = _chosen(whole, self._stride)
        coarse = np.where(pixel >= 0, whole.ravel()[pixel], np.uint16(0))
        cloud = self._fuser.fuse(coarse, None, thermal_c)
        return CoarseCloud(self.camera, whole, cloud, pixel, self._stride)


def nearest_labels(depth_mm: UInt16, pixel: Index, whose: UInt8, stride: int) -> UInt8:
    """Enlarge labels of points (rows, columns) to an image (h, w), 0 without a reading.

    pixel: flat index of each point's pixel, -1 = none; one in every square of ``stride`` pixels.
    """
    ends = np.stack([of(whose, np.ones((3, 3), np.uint8)) for of in (cv2.erode, cv2.dilate)])
    return _enlarged(depth_mm, pixel, whose, ends.astype(np.uint8), stride)


def stride_of(camera: Intrinsics) -> int:
    """Return the side in pixels of the square that each point of the coarse cloud represents."""
    return max(1, int(min(camera.fx, camera.fy) / FOCAL_PX))


def reduced(camera: Intrinsics, share: int) -> Intrinsics:
    """Return the camera of an image with ``share`` times fewer columns and rows."""
    return replace(
        camera,
        width=max(1, camera.width // share),
        height=max(1, camera.height // share),
        fx=camera.fx / share,
        fy=camera.fy / share,
        cx=(camera.cx + 0.5) / share - 0.5,
        cy=(camera.cy + 0.5) / share - 0.5,
    )


@njit(cache=True, nogil=True)
def _undistorted(depth_mm: UInt16, source: Int32) -> UInt16:
    """Return undistorted depth (h, w) from flat depth. source: (h, w), index into it, -1 = none."""
    whole = np.zeros(source.shape, np.uint16)
    for v in range(source.shape[0]):
        for u in range(source.shape[1]):
            if source[v, u] >= 0 and depth_mm[source[v, u]] <= FARTHEST_MM:
                whole[v, u] = depth_mm[source[v, u]]
    return whole


@njit(cache=True, nogil=True)
def _chosen(depth_mm: UInt16, stride: int) -> Index:
    """Return the flat index (h // stride, w // stride) of each square's first reading, -1 = none."""
    width = depth_mm.shape[1]
    pixel = np.full((max(depth_mm.shape[0] // stride, 1), max(width // stride, 1)), -1, np.intp)
    for v in range(pixel.shape[0]):
        for u in range(pixel.shape[1]):
            for k in range(stride * stride):
                y, x = v * stride + k // stride, u * stride + k % stride
                if y < depth_mm.shape[0] and x < width and depth_mm[y, x] > 0:
                    pixel[v, u] = y * width + x
                    break
    return pixel


@njit(cache=True, nogil=True)
def _enlarged(depth_mm: UInt16, pixel: Index, whose: UInt8, ends: UInt8, stride: int) -> UInt8:
    """Enlarge labels as ``nearest_labels`` does. ends: (2, rows, columns), least and highest label around
    each point.
    """
    height, width = depth_mm.shape
    rows, columns = pixel.shape
    numbers = np.zeros(depth_mm.shape, np.uint8)
    for v in range(rows):
        for u in range(columns):
            least, most = ends[0, v, u], ends[1, v, u]
            if most == 0:
                continue
            # The last row and column take the rest of the image.
            bottom, right = (v + 1) * stride, (u + 1) * stride
            bottom, right = height if v == rows - 1 else bottom, width if u == columns - 1 else right
            for y in range(v * stride, bottom):
                for x in range(u * stride, right):
                    if depth_mm[y, x] > 0:
                        alike = least == most
                        near = most if alike else _nearest(depth_mm, pixel, whose, (v, u), (y, x))
                        numbers[y, x] = near
    return numbers


@njit(cache=True, nogil=True)
def _nearest(
    depth_mm: UInt16, pixel: Index, whose: UInt8, square: tuple[int, int], at: tuple[int, int]
) -> np.uint8:
    """Return the label of the point nearest to a pixel in place and depth, in its square and the eight around
    it.
    """
    (v, u), (y, x), width = square, at, depth_mm.shape[1]
    z, least, number = np.float32(depth_mm[y, x]), np.float32(np.inf), np.uint8(0)
    for r in range(max(v - 1, 0), min(v + 2, pixel.shape[0])):
        for c in range(max(u - 1, 0), min(u + 2, pixel.shape[1])):
            i = pixel[r, c]
            if i >= 0:
                down, right = i // width - y, i % width - x
                step = (np.float32(depth_mm[i // width, i % width]) - z) / (z * np.float32(SAME_SURFACE))
                cost = np.float32(down * down + right * right) + step * step
                if cost < least:
                    least, number = cost, whose[r, c]
    return number
