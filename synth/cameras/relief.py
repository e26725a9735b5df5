"""Effects of the surface around a pixel: steep surfaces, and strips hidden from a second viewpoint."""

import numba
import numpy as np

from annotate.array_types import Float32
from synth.surface.rasterize import EXACT

Number = np.float32
FAR_M = 8.0  # depth in place of NaN, out of range, for edges and slopes
FARTHEST_MM = 7900  # readings beyond show ``FAR_M``
EDGE_M = 0.05  # step between two surfaces (libfreenect2's close edge delta)
SHADOW_PX = 24  # widest shadow: of 1 m and 2.2 m from a Kinect v1; untuned


@numba.njit(cache=True, fastmath=EXACT)
def grazed(depth: Float32, pinhole: Float32, y: int, x: int) -> Number:
    """Return the probability that a steep surface gives no match: (1 - 4 cos^2)^4, 0 up to 60 degrees of
    incidence.

    The formula is untuned; structured light gets noisy at 60 and lost at 70 to 80 degrees (Nguyen et al.
    2012).
    """
    height, width = depth.shape
    fx, fy, cx, cy = pinhole
    z = depth[y, x]
    n_x = -fx * _slope(depth[y, max(x - 1, 0)], z, depth[y, min(x + 1, width - 1)])
    n_y = -fy * _slope(depth[max(y - 1, 0), x], z, depth[min(y + 1, height - 1), x])
    if n_x * n_x + n_y * n_y < z * z:
        return np.float32(0)
    a, b = (np.float32(x) - cx) / fx, (np.float32(y) - cy) / fy
    n_z = z - a * n_x - b * n_y
    square = (n_x * n_x + n_y * n_y + n_z * n_z) * (np.float32(1) + a * a + b * b)
    steep = np.float32(1) - np.float32(4) * z * z / square
    steep = max(steep, np.float32(0))
    return np.float32(steep * steep * steep * steep)


@numba.njit(cache=True, fastmath=EXACT)
def _slope(before: Number, here: Number, behind: Number) -> Number:
    """Return the smaller of the two depth steps beside a pixel, because it stays on the pixel's surface."""
    back, on = here - before, behind - here
    return back if abs(back) < abs(on) else on


@numba.njit(cache=True, fastmath=EXACT)
def shadowed(depth: Float32, nearness: Float32, y: int, x: int, parallax: Number) -> bool:
    """Return True if a nearer surface hides a pixel from a second camera or projector in the same row.

    nearness: of ``Pixels``. parallax: focal length in pixels times baseline in m, positive to the right.
    """
    z, right, width = depth[y, x], parallax > 0, abs(parallax)
    reach = min(int(width * (nearness[y] - np.float32(1) / z)), SHADOW_PX)
    reach = min(reach, depth.shape[1] - 1 - x if right else x)
    for k in range(1, reach + 1):
        other = depth[y, x + k if right else x - k]
        # width (1 / other - 1 / z) >= k: the ray passes behind the other surface.
        if width * (z - other) >= k * z * other:
            return True
    return False
