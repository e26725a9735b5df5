"""Rasteriser: triangle meshes in the camera frame to a z-buffer with the visible face of each pixel."""

import math
from dataclasses import dataclass
from typing import Any, TypeVar

import numba
import numpy as np
from numpy.typing import NDArray

from annotate.array_types import Float32, Float64, Int32
from sensors.rig.camera import Intrinsics
from sensors.rig.rig_calibration import Pose

T = TypeVar("T", bound=np.floating[Any])
_Pinhole = tuple[float, float, float, float]

NEAR_M = 0.05  # m; triangles that reach nearer to the camera plane are dropped
# compiler flags that change no bit: reassociation or fused steps would depend on the processor
EXACT = {"nnan", "nsz"}
WIDE_PX = 8  # a wider triangle is filled by spans, a smaller one over its bounding box


@dataclass(frozen=True)
class Mesh:
    """Triangles, each with a tag. vertices_m: float32 (V, 3), faces: int32 (F, 3), tags: int32 (F,)."""

    vertices_m: Float32
    faces: Int32
    tags: Int32

    def placed(self, rotation: Float64, translation_m: Float64) -> "Mesh":
        """Return the mesh rotated by (3, 3), then translated by (3,)."""
        vertices = self.vertices_m @ rotation.T + translation_m
        return Mesh(vertices.astype(np.float32), self.faces, self.tags)


def merge(meshes: list[Mesh]) -> Mesh:
    """Return the concatenated meshes with their tags."""
    offsets = np.cumsum([0] + [len(m.vertices_m) for m in meshes[:-1]])
    return Mesh(
        np.concatenate([m.vertices_m for m in meshes]),
        np.concatenate([m.faces + np.int32(o) for m, o in zip(meshes, offsets, strict=True)]),
        np.concatenate([m.tags for m in meshes]),
    )


@dataclass(frozen=True)
class ZBuffer:
    """Image of a pinhole camera.

    depth_m: float32 (h, w) along z, NaN without a hit. face: int32 (h, w), -1 without one.
    """

    depth_m: Float32
    face: Int32


def rasterize(camera: Intrinsics, vertices_m: Float32, faces: Int32, closed: bool = False) -> ZBuffer:
    """Render triangles given in the camera frame (x right, y down, z forward, metres).

    Lens distortion is ignored: pass the undistorted camera. A pixel belongs to a triangle that contains its
    centre. Depth is interpolated with perspective (1/z is linear on the image). Both sides of a face are
    drawn. closed: True if surfaces have no holes and faces point outwards; the image is the same in half the
    time. Source: Pineda 1988, edge functions.
    """
    size, pinhole = (camera.width, camera.height), (camera.fx, camera.fy, camera.cx, camera.cy)
    return ZBuffer(*_rasterize(vertices_m, faces, size, pinhole, closed))


@numba.njit(cache=True, nogil=True)
def _rasterize(
    vertices: Float32, faces: Int32, size: tuple[int, int], pinhole: _Pinhole, closed: bool
) -> tuple[Float32, Int32]:
    points, (width, height) = _project(vertices, pinhole), size
    depth, face = np.zeros((height, width), np.float32), np.full((height, width), np.int32(-1))
    _fill(points, faces, _candidates(points, faces, width, height, closed), depth, face)
    for v in range(height):
        for u in range(width):
            # Nearness so far.
            depth[v, u] = np.float32(1) / depth[v, u] if depth[v, u] > 0 else np.float32(np.nan)
    return depth, face


@numba.njit(cache=True, fastmath=EXACT)
def _project(vertices: Float32, pinhole: _Pinhole) -> Float32:
    """Return pixel coordinates and nearness 1/z (V, 3); nearness 0 for vertices not beyond the near plane."""
    fx, fy, cx, cy = pinhole
    points = np.empty((len(vertices), 3), np.float32)
    for i in range(len(vertices)):
        z = vertices[i, 2]
        w = np.float32(1) / z if z > NEAR_M else np.float32(0)
        points[i, 0] = fx * vertices[i, 0] * w + cx
        points[i, 1] = fy * vertices[i, 1] * w + cy
        points[i, 2] = w
    return points


@numba.njit(cache=True, fastmath=EXACT)
def _candidates(points: Float32, faces: Int32, width: int, height: int, closed: bool) -> Int32:
    """Return the faces whose bounding box holds a pixel centre; branch-free because most faces hold none."""
    kept = np.empty(len(faces), np.int32)
    right, bottom = np.float32(width - 1), np.float32(height - 1)
    n = 0
    for f in range(len(faces)):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        ua, ub, uc = points[a, 0], points[b, 0], points[c, 0]
        va, vb, vc = points[a, 1], points[b, 1], points[c, 1]
        u0, u1 = np.ceil(min(ua, ub, uc)), np.floor(max(ua, ub, uc))
        v0, v1 = np.ceil(min(va, vb, vc)), np.floor(max(va, vb, vc))
        seen = (u0 <= u1) & (v0 <= v1) & (u1 >= 0) & (v1 >= 0) & (u0 <= right) & (v0 <= bottom)
        seen &= (points[a, 2] > 0) & (points[b, 2] > 0) & (points[c, 2] > 0)
        # Faces outwards run counter-clockwise seen from outside, and v points down.
        seen &= (not closed) | ((ub - ua) * (vc - va) < (uc - ua) * (vb - va))
        kept[n] = f
        n += int(seen)
    return kept[:n]


@numba.njit(cache=True, fastmath=EXACT)
def _fill(points: Float32, faces: Int32, candidates: Int32, nearness: Float32, face: Int32) -> None:
    height, width = nearness.shape
    for f in candidates:
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        ua, ub, uc = np.float64(points[a, 0]), np.float64(points[b, 0]), np.float64(points[c, 0])
        va, vb, vc = np.float64(points[a, 1]), np.float64(points[b, 1]), np.float64(points[c, 1])
        area = (ub - ua) * (vc - va) - (uc - ua) * (vb - va)
        if abs(area) < 1e-12:
            continue
        u0 = max(0, math.ceil(min(ua, ub, uc)))
        u1 = min(width - 1, math.floor(max(ua, ub, uc)))
        v0 = max(0, math.ceil(min(va, vb, vc)))
        v1 = min(height - 1, math.floor(max(va, vb, vc)))
        # Barycentric coordinates are affine in the pixel: start values and steps.
        inverse = 1 / area
        lb_u, lb_v = (vc - va) * inverse, -(uc - ua) * inverse
        lc_u, lc_v = -(vb - va) * inverse, (ub - ua) * inverse
        wa = np.float64(points[a, 2])
        wb, wc = points[b, 2] - wa, points[c, 2] - wa
        w_u = lb_u * wb + lc_u * wc
        for y in range(v0, v1 + 1):
            start, end = u0, u1
            lb = lb_u * (u0 - ua) + lb_v * (y - va)
            lc = lc_u * (u0 - ua) + lc_v * (y - va)
            if u1 - u0 > WIDE_PX:
                start, end = _narrow(start, end, u0, lb, lb_u)
                start, end = _narrow(start, end, u0, lc, lc_u)
                start, end = _narrow(start, end, u0, 1 - lb - lc, -lb_u - lc_u)
                lb += lb_u * (start - u0)
                lc += lc_u * (start - u0)
            w = wa + lb * wb + lc * wc
            for x in range(start, end + 1):
                if (lb >= -1e-9) & (lc >= -1e-9) & (lb + lc <= 1 + 1e-9) & (w > nearness[y, x]):
                    nearness[y, x] = w
                    face[y, x] = f
                lb += lb_u
                lc += lc_u
                w += w_u


@numba.njit(cache=True, fastmath=EXACT)
def _narrow(start: int, end: int, u0: int, value: float, step: float) -> tuple[int, int]:
    """Return [start, end] clipped to ``value + step (u - u0) >= 0``, with a margin of one pixel for
    rounding.
    """
    if step > 0:
        start = max(start, u0 + int(min(max(-value / step, 0.0), 1e6)) - 1)
    elif step < 0:
        end = min(end, u0 + int(min(max(-value / step, -1.0), 1e6)) + 1)
    elif value < -1e-9:
        end = start - 1
    return max(start, u0), end


def tagged(vertices_m: Float32, faces: Int32, tag: int) -> Mesh:
    return Mesh(vertices_m, faces, np.full(len(faces), tag, np.int32))


def face_means(by_vertex: NDArray[T], faces: Int32) -> NDArray[T]:
    """Return the mean (F, ...) of values (V, ...) over each face's vertices, ten times faster than
    ``mean``.
    """
    a, b, c = (np.take(by_vertex, faces[:, k], axis=0) for k in range(3))
    return np.asarray((a + b + c) / by_vertex.dtype.type(3))


def box(low: tuple[float, float, float], high: tuple[float, float, float], tag: int) -> Mesh:
    """Return an axis-aligned box as 12 triangles."""
    x, y, z = zip(low, high, strict=True)
    corners = np.array([(a, b, c) for a in x for b in y for c in z], np.float32)
    quads = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    faces = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))], np.int32)
    return tagged(corners, faces, tag)


def sheet(origin: Float64, along: Float64, across: Float64, tag: int) -> Mesh:
    """Return a rectangle made of quarter-metre cells, so that only cells behind the camera are dropped."""
    n, m = (max(1, int(np.ceil(np.linalg.norm(side) / 0.25))) for side in (along, across))
    i, j = np.meshgrid(np.linspace(0, 1, n + 1), np.linspace(0, 1, m + 1), indexing="ij")
    vertices = (origin + i[..., None] * along + j[..., None] * across).reshape(-1, 3).astype(np.float32)
    return tagged(vertices, grid_faces(n + 1, m + 1), tag)


def grid_faces(rows: int, columns: int) -> Int32:
    """Return the triangles (2 (rows - 1) (columns - 1), 3) of a grid of nodes numbered row by row."""
    a = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    b = a + columns
    halves = [np.stack([a, a + 1, b + 1], axis=1), np.stack([a, b + 1, b], axis=1)]
    return np.concatenate(halves).astype(np.int32)


def look_at(eye_m: Float64, target_m: Float64, roll_rad: float = 0.0) -> Pose:
    """Return ``camera_from_world`` of a camera at ``eye_m`` that looks at ``target_m``. roll_rad: 0 =
    level.
    """
    forward = (target_m - eye_m) / np.linalg.norm(target_m - eye_m)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    if np.linalg.norm(right) < 1e-6:
        right = np.array([1.0, 0.0, 0.0])
    from scipy.spatial.transform import Rotation  # `predict` works without scipy

    right = right / np.linalg.norm(right)
    level = np.stack([right, np.cross(forward, right), forward])
    rotation = Rotation.from_euler("z", roll_rad).as_matrix() @ level
    return Pose(rotation, -rotation @ eye_m)


def beside(centre_m: Float64, azimuth_rad: float, distance_m: float, height_m: float) -> Float64:
    """Return the position (3,) at a distance from a centre (3,); azimuth 0 is in front of the person."""
    place = centre_m + distance_m * np.array([np.sin(azimuth_rad), -np.cos(azimuth_rad), 0.0])
    place[2] = height_m
    return place
