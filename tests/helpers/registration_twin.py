"""An independent twin of libfreenect2's registration: pixel by pixel in float32, after the six steps."""

import numpy as np
from numba import njit

f = np.float32


def register_scalar(depth, color, rgb, depth_mm):
    """(undistorted, registered) of one frame; arguments as ``Registration`` and its ``apply`` take them."""
    lens = np.array(
        [depth.fx, depth.fy, depth.cx, depth.cy, *depth.distortion[:2], depth.k3, depth.p1, depth.p2], f
    )
    factory = np.array([color.f, color.cx, color.cy, color.shift_d, color.shift_m], f)
    cubics = np.array([color.mx, color.my], f)
    return _register(lens, factory, cubics, rgb, np.ascontiguousarray(depth_mm, f))


@njit(cache=True)
def _register(lens, factory, cubics, rgb, depth_mm):
    fx, fy, cx, cy, k1, k2, k3, p1, p2 = lens
    focal, center_x, center_y, shift_d, shift_m = factory
    height, width = depth_mm.shape
    rows, columns = rgb.shape[:2]
    undistorted = np.zeros((height, width), np.float32)
    target = np.full((height, width), -1, np.int64)
    front = np.full((rows + 4) * columns, f(65536))
    for v in range(height):
        for u in range(width):
            dx, dy = (f(u) - cx) / fx, (f(v) - cy) / fy
            dx2, dy2, dxdy2 = dx * dx, dy * dy, f(2) * dx * dy
            r2 = dx2 + dy2
            kr = f(1) + ((k3 * r2 + k2) * r2 + k1) * r2
            x = fx * (dx * kr + p2 * (r2 + f(2) * dx2) + p1 * dxdy2) + cx
            y = fy * (dy * kr + p1 * (r2 + f(2) * dy2) + p2 * dxdy2) + cy
            column, row = int(x + f(0.5)), int(y + f(0.5))
            if not (0 <= column < width and 0 <= row < height):
                continue
            z = depth_mm[row, column]
            undistorted[v, u] = z
            if z <= 0:
                continue
            mx, my = (f(u) - cx) * f(0.01), (f(v) - cy) * f(0.01)
            powers = (
                *(mx * mx * mx, my * my * my, mx * mx * my, my * my * mx),
                *(mx * mx, my * my, mx * my, mx, my, f(1)),
            )
            wx, wy = f(0), f(0)
            for i in range(10):
                wx, wy = wx + powers[i] * cubics[0, i], wy + powers[i] * cubics[1, i]
            rx = wx / (focal * f(0.002199)) - shift_m / shift_d
            ry = wy / f(0.002199) + center_y
            across = int((rx + shift_m / z) * focal + (center_x + f(0.5)))
            offset = across + columns * int(ry + f(0.5))
            if not 0 <= offset < columns * rows:
                continue
            target[v, u] = offset
            for down in range(1, 4):
                for side in range(-2, 3):
                    cell = offset + down * columns + side
                    front[cell] = min(front[cell], z)
    registered = np.zeros((height, width, 3), np.uint8)
    for v in range(height):
        for u in range(width):
            offset, z = target[v, u], undistorted[v, u]
            if offset >= 0 and not (z - front[offset + 2 * columns]) / z > f(0.01):
                registered[v, u] = rgb[offset // columns, offset % columns]
    return undistorted, registered
