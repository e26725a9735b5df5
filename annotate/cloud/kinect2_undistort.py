"""Undistortion of depth images exactly as libfreenect2's ``Registration::apply`` does it, bit for bit."""

import numpy as np

from annotate.array_types import Int32
from sensors.rig.camera import Intrinsics


def undistortion_index(camera: Intrinsics) -> Int32:
    """Flat index int32 (h, w) into the distorted image of each undistorted pixel's source, -1 outside.

    Nearest neighbour in float32, in the order of libfreenect2's src/registration.cpp: x + 0.5 is truncated,
    so that positions up to 1.5 pixels left of or above the image still count as its first column or row.
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
