"""Planes of a cloud (walls, floors, seats, table tops), from its points and their normals.

Constants are untuned unless a source is given.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit

from annotate.array_types import Bool, Float32, Float64, Index
from annotate.cloud.grid import JUMP
from annotate.cloud.thermal_cloud import ThermalCloud

MIN_PLANE_M2 = 0.12  # visible surface; flat patches of a body are smaller
TOLERANCE = 0.006  # off a plane, share of the depth: three times a Kinect v2's noise (Fankhauser 2015)
LEAST_COSINE = 0.94  # between a point's and its plane's normals, because a limb on a seat is turned
PLANE_STRIDE = 3  # pixels between the rows and columns in which planes are sought
TRIALS, MOST_PLANES = 40, 16  # points tried as the next plane; bound for rough surfaces


@dataclass(frozen=True)
class Plane:
    """Plane normal . p = offset_m for points p in metres, depth camera's frame.

    normal: float32 (3,), unit, towards the camera. area_m2: visible area of the plane.
    """

    normal: Float32
    offset_m: float
    area_m2: float


def find_planes(cloud: ThermalCloud) -> tuple[Plane, ...]:
    """Return planes of at least ``MIN_PLANE_M2``, at most ``MOST_PLANES``, roughly the largest first.

    One-point RANSAC (a point with its normal is a plane), then least squares on the inliers. Deterministic.
    """
    some = slice(1, None, PLANE_STRIDE)
    rows, columns = (1 + PLANE_STRIDE * at for at in np.nonzero(cloud.valid[some, some]))
    points, camera = cloud.points_m[rows, columns], cloud.camera
    lens = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
    normals = _normals(np.ascontiguousarray(cloud.points_m[..., 2]), lens, rows, columns)
    # As rows x, y, z of both, so that loops vectorise.
    lines = np.concatenate([points, normals], axis=1).T[:, np.isfinite(normals[:, 0])]
    pixel_m2 = lines[2] ** 2 * np.float32(PLANE_STRIDE**2 / (camera.fx * camera.fy))
    rng = np.random.default_rng(0)
    planes: list[Plane] = []
    while lines.size and len(planes) < MOST_PLANES:
        lines = np.ascontiguousarray(lines)
        best = _best(lines, rng.permutation(lines.shape[1])[:TRIALS])
        plane, on = _fitted(lines, pixel_m2, best)
        if plane.area_m2 < MIN_PLANE_M2:
            break
        planes.append(plane)
        lines, pixel_m2 = lines[:, ~on], pixel_m2[~on]
    return tuple(planes)


def distance_m(planes: Sequence[Plane], points_m: Float32) -> Float32:
    """Return the metres (h, w) from points (h, w, 3) to the nearest plane; infinite without any."""
    rows = [(*plane.normal, plane.offset_m) for plane in planes]
    return _nearest_m(points_m, np.array(rows, np.float32).reshape(-1, 4))


def _fitted(lines: Float32, pixel_m2: Float32, start: int) -> tuple[Plane, Bool]:
    """Return a plane fitted by least squares around a point, and flags (n,) of its points.

    lines: (6, n), points and normals. pixel_m2: (n,), areas. start: index of the point.
    """
    normal = np.ascontiguousarray(lines[3:, start])
    plane = Plane(normal, float(normal @ lines[:3, start]), 0.0)
    on = _on(plane, lines)
    for _ in range(3):
        points = lines[:3].take(np.flatnonzero(on), axis=1).astype(np.float64)
        if points.shape[1] < 3:
            break
        points -= (centre := points.mean(axis=1))[:, None]
        normal = np.linalg.eigh(points @ points.T)[1][:, 0]
        normal *= np.sign(normal @ plane.normal)
        plane = Plane(normal.astype(np.float32), float(normal @ centre), float(pixel_m2[on].sum()))
        fitted, on = on, _on(plane, lines)
        on |= fitted  # otherwise a bad fit would be found again and again
    return plane, on


def _on(plane: Plane, lines: Float32) -> Bool:
    """Return flags (n,) of points that are close to a plane and have a parallel normal. lines: (6, n), points
    and normals.
    """
    distance_m = np.abs(plane.normal @ lines[:3] - np.float32(plane.offset_m))
    along = plane.normal @ lines[3:] >= np.float32(LEAST_COSINE)
    return np.asarray((distance_m <= np.float32(TOLERANCE) * lines[2]) & along, np.bool_)


@njit(cache=True, nogil=True)
def _nearest_m(points_m: Float32, planes: Float32) -> Float32:
    """Return the metres (h, w) from points (h, w, 3) to the nearest of planes (k, 4), normals and offsets."""
    found_m: Float32 = np.full(points_m.shape[:2], np.float32(np.inf))
    for v in range(found_m.shape[0]):
        for k in range(len(planes)):
            a, b, c, offset = planes[k]
            for u in range(found_m.shape[1]):
                x, y, z = points_m[v, u]
                away = abs(x * a + y * b + z * c - offset)
                if away < found_m[v, u]:  # False for NaN
                    found_m[v, u] = away
    return found_m


@njit(cache=True, nogil=True)
def _best(lines: Float32, tried: Index) -> int:
    """Return the index, among indices (k,), of the point whose own plane covers the largest area. lines: (6,
    n), points and normals.
    """
    x, y, z, right, down, ahead = lines
    weight = np.rint(100 * z**2).astype(np.int64)  # whole numbers add up in any order
    best, most = 0, np.int64(-1)
    for i in tried:
        a, b, c = right[i], down[i], ahead[i]
        offset, area = a * x[i] + b * y[i] + c * z[i], np.int64(0)
        for j in range(x.size):
            # Twice the tolerance: the trial plane has one point's noise.
            close = abs(a * x[j] + b * y[j] + c * z[j] - offset) < np.float32(2 * TOLERANCE) * z[j]
            along = a * right[j] + b * down[j] + c * ahead[j] > np.float32(LEAST_COSINE)
            area += weight[j] * np.int64(close & along)
        if area > most:
            best, most = i, area
    return best


@njit(cache=True, nogil=True)
def _normals(depth_m: Float32, lens: Float64, rows: Index, columns: Index) -> Float32:
    """Return unit normals (n, 3) of the surface at pixels, towards the camera; NaN with few readings. lens:
    fx, fy, cx, cy.
    """
    fx, fy, cx, cy = lens
    height, width = depth_m.shape
    normals = np.full((rows.size, 3), np.float32(np.nan))
    for i in range(rows.size):
        v, u = rows[i], columns[i]
        z0 = np.float64(depth_m[v, u])
        n, sx, sy, sd, sxx, sxy, syy, sxd, syd = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for y in range(-4, 5, 2):
            for x in range(-4, 5, 2):
                if not (0 <= v + y < height and 0 <= u + x < width):
                    continue
                z = np.float64(depth_m[v + y, u + x])
                if abs(z - z0) <= JUMP * z0:  # False for NaN
                    d = 1 / z
                    n, sx, sy, sd = n + 1, sx + x, sy + y, sd + d
                    sxx, sxy, syy, sxd, syd = sxx + x * x, sxy + x * y, syy + y * y, sxd + x * d, syd + y * d
        if n < 8:
            continue
        sxx, sxy, syy = sxx - sx * sx / n, sxy - sx * sy / n, syy - sy * sy / n
        sxd, syd = sxd - sx * sd / n, syd - sy * sd / n
        det = sxx * syy - sxy * sxy
        if det < 1:
            continue
        a, b = (syy * sxd - sxy * syd) / det, (sxx * syd - sxy * sxd) / det
        c = (sd - sx * a - sy * b) / n
        # 1/z = a (u' - u) + b (v' - v) + c: with u' = fx X/Z + cx it is fx a X + fy b Y + (...) Z = 1.
        x, y, z = fx * a, fy * b, c + a * (cx - u) + b * (cy - v)
        length = np.sqrt(x * x + y * y + z * z)
        normals[i, 0], normals[i, 1], normals[i, 2] = -x / length, -y / length, -z / length
    return normals
