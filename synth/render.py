"""The rasteriser: triangle meshes in the camera frame to a z-buffer and the face seen at each pixel."""

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from sensors.camera import Intrinsics

NEAR_M = 0.05
"""Triangles reaching nearer than this to the camera plane are dropped: nothing useful is that close."""


@dataclass(frozen=True)
class Mesh:
    """Triangles with one integer tag a face. vertices_m: float32 (V, 3), faces: int32 (F, 3), tags: int32 (F,)."""

    vertices_m: NDArray[np.float32]
    faces: NDArray[np.int32]
    tags: NDArray[np.int32]


def merge(meshes: list[Mesh]) -> Mesh:
    """One mesh of many; tags stay."""
    offsets = np.cumsum([0] + [len(m.vertices_m) for m in meshes[:-1]])
    return Mesh(
        np.concatenate([m.vertices_m for m in meshes]),
        np.concatenate([m.faces + np.int32(o) for m, o in zip(meshes, offsets, strict=True)]),
        np.concatenate([m.tags for m in meshes]),
    )


@dataclass(frozen=True)
class ZBuffer:
    """What a pinhole camera sees.

    depth_m: float32 (h, w) along z, NaN where nothing is hit. face: int32 (h, w), -1 where nothing.
    """

    depth_m: NDArray[np.float32]
    face: NDArray[np.int32]


def rasterize(camera: Intrinsics, vertices_m: NDArray[np.float32], faces: NDArray[np.int32]) -> ZBuffer:
    """Render triangles given in the camera frame (x right, y down, z forward, metres).

    Lens distortion is ignored: pass the undistorted camera. A pixel belongs to a triangle when its
    centre lies inside; depth is interpolated with perspective (1/z is linear on the image). Both
    sides of a face are seen. Source: Pineda 1988, edge functions.
    """
    depth = np.full(camera.shape, np.inf, np.float32)
    face = np.full(camera.shape, -1, np.int32)
    _rasterize(vertices_m, faces, camera.fx, camera.fy, camera.cx, camera.cy, depth, face)
    depth[face < 0] = np.nan
    return ZBuffer(depth, face)


@numba.njit(cache=True, fastmath=True)
def _rasterize(vertices, faces, fx, fy, cx, cy, depth, face):  # type: ignore[no-untyped-def] # pragma: no cover
    height, width = depth.shape
    n = len(vertices)
    u = np.empty(n, np.float64)
    v = np.empty(n, np.float64)
    w = np.empty(n, np.float64)
    for i in range(n):
        z = vertices[i, 2]
        w[i] = 1.0 / z if z > NEAR_M else 0.0
        u[i] = fx * vertices[i, 0] * w[i] + cx
        v[i] = fy * vertices[i, 1] * w[i] + cy
    for f in range(len(faces)):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        if w[a] == 0.0 or w[b] == 0.0 or w[c] == 0.0:
            continue
        area = (u[b] - u[a]) * (v[c] - v[a]) - (u[c] - u[a]) * (v[b] - v[a])
        if abs(area) < 1e-12:
            continue
        u0 = max(0, int(np.ceil(min(u[a], u[b], u[c]))))
        u1 = min(width - 1, int(np.floor(max(u[a], u[b], u[c]))))
        v0 = max(0, int(np.ceil(min(v[a], v[b], v[c]))))
        v1 = min(height - 1, int(np.floor(max(v[a], v[b], v[c]))))
        if u0 > u1 or v0 > v1:
            continue
        inverse = 1.0 / area
        # Barycentric coordinates are affine in the pixel: start values and steps.
        lb_u = (v[c] - v[a]) * inverse
        lb_v = -(u[c] - u[a]) * inverse
        lc_u = -(v[b] - v[a]) * inverse
        lc_v = (u[b] - u[a]) * inverse
        dw_u = lb_u * (w[b] - w[a]) + lc_u * (w[c] - w[a])
        for y in range(v0, v1 + 1):
            lb = lb_u * (u0 - u[a]) + lb_v * (y - v[a])
            lc = lc_u * (u0 - u[a]) + lc_v * (y - v[a])
            iw = w[a] + lb * (w[b] - w[a]) + lc * (w[c] - w[a])
            for x in range(u0, u1 + 1):
                if lb >= -1e-9 and lc >= -1e-9 and lb + lc <= 1.0 + 1e-9:
                    z = 1.0 / iw
                    if z < depth[y, x]:
                        depth[y, x] = z
                        face[y, x] = f
                lb += lb_u
                lc += lc_u
                iw += dw_u
