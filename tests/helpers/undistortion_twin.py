"""An independent twin of libfreenect2's undistortion: pixel by pixel in float32."""

import numpy as np
from numba import njit

f = np.float32


def undistort_scalar(camera, depth_mm):
    """Undistorted depth float32 (h, w) of a depth image (h, w) in millimetres, 0 outside."""
    lens = np.array(
        [camera.fx, camera.fy, camera.cx, camera.cy, *camera.distortion[:2], camera.k3, camera.p1, camera.p2],
        f,
    )
    return _undistort(lens, np.ascontiguousarray(depth_mm, f))


@njit(cache=True)
def _undistort(lens, depth_mm):
    fx, fy, cx, cy, k1, k2, k3, p1, p2 = lens
    height, width = depth_mm.shape
    undistorted = np.zeros((height, width), np.float32)
    for v in range(height):
        for u in range(width):
            dx, dy = (f(u) - cx) / fx, (f(v) - cy) / fy
            dx2, dy2, dxdy2 = dx * dx, dy * dy, f(2) * dx * dy
            r2 = dx2 + dy2
            kr = f(1) + ((k3 * r2 + k2) * r2 + k1) * r2
            x = fx * (dx * kr + p2 * (r2 + f(2) * dx2) + p1 * dxdy2) + cx
            y = fy * (dy * kr + p1 * (r2 + f(2) * dy2) + p2 * dxdy2) + cy
            column, row = int(x + f(0.5)), int(y + f(0.5))
            if 0 <= column < width and 0 <= row < height:
                undistorted[v, u] = depth_mm[row, column]
    return undistorted
