"""The depth around a pixel: edges, slopes, the angle of incidence, and what a second eye cannot see."""

import numba
import numpy as np

from annotate.array_types import Float32
from synth.surface.rasterize import EXACT

Number = np.float32
FAR_M = 8.0
"""Where nothing is hit, there is a background this far away: out of range, but edges and slopes need it."""


def filled(depth_m: Float32) -> Float32:
    """Depth (h, w) with a background at ``FAR_M`` in place of NaN."""
    return np.where(np.isnan(depth_m), np.float32(FAR_M), depth_m)


@numba.njit(cache=True, fastmath=EXACT)
def around(depth: Float32, y: int, x: int) -> tuple[Number, Number, Number, Number]:
    """Nearest and farthest of the 3x3 neighbours; Sobel slopes along u and v, metres a pixel."""
    above, below = max(y - 1, 0), min(y + 1, depth.shape[0] - 1)
    left, right = max(x - 1, 0), min(x + 1, depth.shape[1] - 1)
    a, b, c = depth[above, left], depth[above, x], depth[above, right]
    d, e, f = depth[y, left], depth[y, x], depth[y, right]
    g, h, i = depth[below, left], depth[below, x], depth[below, right]
    z_u = (c - a + i - g + f - d + f - d) * np.float32(0.125)
    z_v = (g - a + i - c + h - b + h - b) * np.float32(0.125)
    near = min(min(min(a, b, c), min(d, e, f)), min(g, h, i))
    far = max(max(max(a, b, c), max(d, e, f)), max(g, h, i))
    return near, far, z_u, z_v


@numba.njit(cache=True, fastmath=EXACT)
def incidence(pinhole: Float32, v: int, u: int, z: Number, z_u: Number, z_v: Number) -> Number:
    """Angle between the viewing ray and the surface normal, radians, from depth and its slopes at a pixel."""
    fx, fy, cx, cy = pinhole
    x, y = (np.float32(u) - cx) / fx, (np.float32(v) - cy) / fy
    # Normal of the surface (x z, y z, z) over the pixel grid, up to a common positive factor.
    n_x, n_y = -z_u * fx, -z_v * fy
    n_z = z - x * n_x - y * n_y
    square = (n_x * n_x + n_y * n_y + n_z * n_z) * (np.float32(1) + x * x + y * y)
    cosine = abs(n_x * x + n_y * y + n_z) / np.sqrt(square + np.float32(1e-18))
    return np.float32(np.arccos(min(cosine, np.float32(1))))


@numba.njit(cache=True, fastmath=EXACT)
def slant_of(depth: Float32, pinhole: Float32, y: int, x: int) -> Number:
    """Eighth power of a pixel's incidence over 90 degrees: how much of the light grazes past, in [0, 1]."""
    _, _, z_u, z_v = around(depth, y, x)
    slant = incidence(pinhole, y, x, depth[y, x], z_u, z_v) / np.float32(np.pi / 2)
    slant = slant * slant
    slant = slant * slant
    return np.float32(slant * slant)


EDGE_M = 0.05
"""Neighbours further apart than this belong to different surfaces (libfreenect2's close edge delta)."""
SHADOW_PX = 24
"""The widest shadow that is looked for. Chosen by eye: two things 1 m and 1.5 m away from a Kinect v1."""


@numba.njit(cache=True, fastmath=EXACT)
def shadowed(depth: Float32, y: int, x: int, parallax: Number, reach_px: int) -> bool:
    """Whether something nearer hides a pixel's surface from a second eye or projector in the same row.

    parallax: focal length in pixels times the baseline, m, negative for one to the left; seen from the right,
    the hidden strip lies to the left of what hides it. reach_px: how far to look.
    """
    width = depth.shape[1]
    here, side = np.float32(1) / depth[y, x], 1 if parallax > 0 else -1
    for k in range(1, reach_px + 1):
        u = x + side * k
        if u < 0 or u >= width:
            return False
        if abs(parallax) * (np.float32(1) / depth[y, u] - here) >= k:
            return True
    return False


def shadow_reach(depth: Float32, parallax: float) -> int:
    """Pixels of the widest shadow in an image (h, w) without NaN, ``SHADOW_PX`` at most."""
    widest = abs(parallax) * (1 / max(float(depth.min()), 0.1) - 1 / FAR_M)
    return min(SHADOW_PX, int(widest))
