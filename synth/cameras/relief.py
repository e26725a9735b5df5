"""The depth around a pixel: steep surfaces, and strips that a second eye cannot see."""

import numba
import numpy as np

from annotate.array_types import Float32
from synth.surface.rasterize import EXACT

Number = np.float32
FAR_M = 8.0
"""Where nothing is hit, there is a background this far away: out of range, but edges and slopes need it."""
FARTHEST_MM = 7900
"""Readings beyond are of that background."""
EDGE_M = 0.05
"""Neighbours further apart than this belong to different surfaces (libfreenect2's close edge delta)."""
SHADOW_PX = 24
"""The widest shadow that is looked for. Chosen by eye: of two things 1 m and 2.2 m from a Kinect v1."""


@numba.njit(cache=True, fastmath=EXACT)
def grazed(depth: Float32, pinhole: Float32, y: int, x: int) -> Number:
    """How likely a pixel's surface is too steep to be matched: 0 up to 60 degrees of incidence, 1 at 90.

    (1 - 4 cos^2)^4. Chosen by eye; structured light is measured to get noisy from 60 degrees on and to be
    lost from 70 to 80 (Nguyen et al. 2012). Of two neighbours the one on the same surface counts.
    """
    height, width = depth.shape
    fx, fy, cx, cy = pinhole
    z = depth[y, x]
    n_x = -fx * _slope(depth[y, max(x - 1, 0)], z, depth[y, min(x + 1, width - 1)])
    n_y = -fy * _slope(depth[max(y - 1, 0), x], z, depth[min(y + 1, height - 1), x])
    # Normal of the surface over the pixel grid, and its angle with the viewing ray.
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
    """The smaller of the two steps to a pixel's neighbours."""
    back, on = here - before, behind - here
    return back if abs(back) < abs(on) else on


@numba.njit(cache=True, fastmath=EXACT)
def shadowed(depth: Float32, nearness: Float32, y: int, x: int, parallax: Number) -> bool:
    """Whether something nearer hides a pixel's surface from a second eye or projector in the same row.

    nearness: ``nearness_of`` the depth. parallax: focal length in pixels times the baseline, m, negative for
    one to the left; seen from the right, the hidden strip lies to the left of what hides it.
    """
    z, right, width = depth[y, x], parallax > 0, abs(parallax)
    reach = min(int(width * (nearness[y] - np.float32(1) / z)), SHADOW_PX)
    reach = min(reach, depth.shape[1] - 1 - x if right else x)
    for k in range(1, reach + 1):
        other = depth[y, x + k if right else x - k]
        # width (1 / other - 1 / z) >= k: the ray to the eye passes behind it.
        if width * (z - other) >= k * z * other:
            return True
    return False


def nearness_of(depth: Float32) -> Float32:
    """One over the nearest depth (h,) of each row of an image (h, w) without NaN, 1/m."""
    return np.asarray(1 / depth.min(axis=1), np.float32)
