"""Multipath of time-of-flight cameras: the depth error from light that bounces twice."""

import cv2
import numba
import numpy as np

from annotate.array_types import Float32
from sensors.rig.camera import Intrinsics
from synth.surface.rasterize import EXACT

STRIDE = 12  # pixels a patch's side: bounced light is diffuse
MODULATION_HZ = 80e6  # the middle frequency of a Kinect v2 (libfreenect2: 16, 80, 120 MHz)
_RAD_PER_M = 4 * np.pi * MODULATION_HZ / 299_792_458


def multipath_m(camera: Intrinsics, depth_m: Float32, reflectance: float, stride: int = STRIDE) -> Float32:
    """Return the depth error (h, w), always positive, metres along z; NaN at a NaN depth.

    Two bounces of Jimenez et al. 2014 (Image and Vision Computing 32) between Lambertian surfaces of one
    reflectance in [0, 1]; lens distortion is ignored.
    """
    height, width = depth_m.shape
    v, u = np.mgrid[stride // 2 : height : stride, stride // 2 : width : stride]
    x, y = (u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy
    directions = np.stack([x, y, np.ones(x.shape)], axis=-1).astype(np.float32)
    points = directions * depth_m[v, u, None]
    area = (stride * points[..., 2]) ** 2 / np.float32(camera.fx * camera.fy)
    normals = _normals(points)
    bias = np.zeros(x.shape, np.float32)
    known = np.isfinite(points[..., 2]) & np.isfinite(normals).all(axis=2)
    bias[known] = _bounce(points[known], normals[known], area[known], reflectance)
    bias /= np.linalg.norm(directions, axis=2)
    # Pixel u lies at (u - stride // 2) / stride among the patches.
    shift = -(stride // 2) / stride
    place = np.array([[1 / stride, 0, shift], [0, 1 / stride, shift]])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    smooth = cv2.warpAffine(bias, place, (width, height), flags=flags, borderMode=cv2.BORDER_REPLICATE)
    return np.where(np.isnan(depth_m), np.float32(np.nan), smooth).astype(np.float32)


def _normals(points: Float32) -> Float32:
    """Return unit normals (h, w, 3) towards the camera; NaN beside NaN points."""
    normal = np.cross(np.gradient(points, axis=1), np.gradient(points, axis=0))
    normal /= np.linalg.norm(normal, axis=2, keepdims=True) + np.float32(1e-12)
    normal *= -np.sign((normal * points).sum(axis=2, keepdims=True))
    return np.asarray(normal, np.float32)


@numba.njit(cache=True, nogil=True, fastmath=EXACT)
def _bounce(points: Float32, normals: Float32, area: Float32, reflectance: float) -> Float32:
    n = len(points)
    excess = np.zeros(n, np.float32)
    away = np.empty(n)
    lit = np.empty(n)
    for p in range(n):
        x, y, z = points[p]
        away[p] = np.sqrt(x * x + y * y + z * z)
        facing = -(normals[p, 0] * x + normals[p, 1] * y + normals[p, 2] * z) / away[p]
        # The patch's true area grows as it turns away while the light on it falls: the cosines cancel.
        lit[p] = max(facing, 0.05)
    for p in range(n):
        along, across = 1.0, 0.0
        direct = lit[p] / (away[p] * away[p])
        for q in range(n):
            x, y, z = points[q, 0] - points[p, 0], points[q, 1] - points[p, 1], points[q, 2] - points[p, 2]
            square = x * x + y * y + z * z
            at_p = normals[p, 0] * x + normals[p, 1] * y + normals[p, 2] * z
            at_q = -(normals[q, 0] * x + normals[q, 1] * y + normals[q, 2] * z)
            if at_p <= 0 or at_q <= 0 or square < 1e-6:
                continue
            # The area bounds the solid angle of patches that nearly touch.
            form = at_p * at_q / square / (np.pi * max(square, area[q]))
            share = reflectance * area[q] / (away[q] * away[q]) * form / direct
            phase = _RAD_PER_M * (away[q] + np.sqrt(square) - away[p]) / 2
            along += share * np.cos(phase)
            across += share * np.sin(phase)
        excess[p] = np.arctan2(across, along) / _RAD_PER_M
    return excess
