"""Planes of a cloud (walls, floors, seats, table tops), found from its points and their normals."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit

from annotate.array_types import Bool, Float32, Float64, Index, Int32
from annotate.cloud.thermal_cloud import ThermalCloud

MOST_PLANES, LEAST_PLANE_POINTS = 16, 30
"""Planes sought in one cloud, and points below which none is fitted. Chosen by eye."""
MIN_PLANE_M2 = 0.12
"""Least visible surface in m2 of a plane: flat patches of a body (back, thigh) are smaller. Chosen by eye."""
TOLERANCE = 0.006
"""Distance to a plane as a share of the depth: 12 mm at 2 m, three times a Kinect v2's measured noise
(Fankhauser et al. 2015)."""
LEAST_COSINE = 0.94
"""Least cosine between a point's and its plane's normals: a limb on a seat is turned. Chosen by eye."""
NORMAL_JUMP = 0.02
"""Depth difference, as a share of the depth, to a neighbour on another surface. Chosen by eye."""
PLANE_STRIDE = 3
"""Pixels between the rows and the columns in which planes are sought. Chosen by eye."""
SAMPLE, TRIALS = 3000, 40
"""Points that count for or against a candidate plane, and points of these tried as the plane. Chosen by
eye."""
WHOLE = 2.0**30
"""All points' surface in the whole numbers in which candidate planes are compared, as 32 bits hold it."""


@dataclass(frozen=True)
class Plane:
    """A plane normal . p = offset_m of points p in metres, depth camera's frame.

    normal: float32 (3,), unit, towards the camera. area_m2: visible surface, taken as seen head-on.
    """

    normal: Float32
    offset_m: float
    area_m2: float


def find_planes(cloud: ThermalCloud, among: Bool) -> tuple[Plane, ...]:
    """Planes of at least ``MIN_PLANE_M2`` visible surface, the best supported first.

    among: bool (h, w), pixels to search. One-point RANSAC, since a point with its normal is a plane, then
    least squares on the inliers; the same cloud gives the same planes.
    """
    rows, columns = np.nonzero((among & cloud.valid)[1::PLANE_STRIDE, 1::PLANE_STRIDE])
    rows, columns = rows * PLANE_STRIDE + 1, columns * PLANE_STRIDE + 1
    points = cloud.points_m[rows, columns]
    normals = _normals_at(cloud, rows, columns)
    flat = np.isfinite(normals[:, 0])
    pixel_m2 = points[flat, 2] ** 2 * np.float32(PLANE_STRIDE**2 / (cloud.camera.fx * cloud.camera.fy))
    lines, whole = _lines(points[flat], normals[flat]), WHOLE / max(float(pixel_m2.sum()), 1e-9)
    weight = np.rint(pixel_m2 * whole).astype(np.int32)
    rng = np.random.default_rng(0)
    planes: list[Plane] = []
    while len(weight) >= LEAST_PLANE_POINTS and len(planes) < MOST_PLANES:
        sample = rng.permutation(len(weight))[:SAMPLE]
        best = sample[_best(lines.take(sample, axis=1), weight[sample], TRIALS)]
        plane, on = _fitted(lines, pixel_m2, int(best))
        if plane.area_m2 < MIN_PLANE_M2:
            break
        planes.append(plane)
        left = np.flatnonzero(~on)
        lines, weight, pixel_m2 = lines.take(left, axis=1), weight[left], pixel_m2[left]
    return tuple(planes)


def close_to(planes: Sequence[Plane], points_m: Float32) -> Bool:
    """Flags (...) of points (..., 3) in metres close to any of the planes, whatever their normals."""
    if not planes:
        return np.zeros(points_m.shape[:-1], np.bool_)
    normals = np.stack([plane.normal for plane in planes])
    offsets = np.array([plane.offset_m for plane in planes], np.float32)
    flat = np.ascontiguousarray(points_m, np.float32).reshape(-1, 3)
    return _close(flat, normals, offsets).reshape(points_m.shape[:-1])


def _lines(points_m: Float32, normals: Float32) -> Float32:
    """Points (..., 3) and their normals (..., 3) as rows (6, n): x, y, z of both, so that loops vectorise."""
    rows = [rows.reshape(-1, 3).T for rows in (points_m, normals)]
    return np.ascontiguousarray(np.concatenate(rows), np.float32)


def _on(plane: Plane, lines: Float32) -> Bool:
    """Flags (n,) of the points of ``_lines`` close to a plane and parallel to it."""
    return _lie_on(lines, plane.normal, np.float32(plane.offset_m))


def _normals_at(cloud: ThermalCloud, rows: Index, columns: Index) -> Float32:
    """Unit normals float32 (n, 3) of the surface at pixels, towards the camera; NaN for lack of readings.

    Least squares over 5 x 5 pixels two apart. 1/z is fitted, which is linear over the image of a plane.
    """
    lens = np.array([cloud.camera.fx, cloud.camera.fy, cloud.camera.cx, cloud.camera.cy])
    return _normals(np.ascontiguousarray(cloud.points_m[..., 2]), lens, rows, columns)


def _fitted(lines: Float32, pixel_m2: Float32, start: int) -> tuple[Plane, Bool]:
    """Least-squares plane around point ``start`` of ``_lines``, and flags (n,) of the points of its fit."""
    normal = np.ascontiguousarray(lines[3:, start])
    plane = Plane(normal, float(normal @ lines[:3, start]), 0.0)
    on = _on(plane, lines)
    for _ in range(3):
        if on.sum() < LEAST_PLANE_POINTS:
            break
        centre, scatter = _moments(lines, on)
        normal = np.linalg.eigh(scatter)[1][:, 0]
        normal *= np.sign(normal @ plane.normal)
        plane = Plane(normal.astype(np.float32), float(normal @ centre), float(pixel_m2[on].sum()))
        fitted, on = on, _on(plane, lines)
        on |= fitted  # otherwise a bad fit would be found again and again
    return plane, on


@njit(cache=True, nogil=True)
def _close(points: Float32, normals: Float32, offsets: Float32) -> Bool:
    """Flags (n,) of points (n, 3) within TOLERANCE of any plane; normals (k, 3), offsets (k,) in metres."""
    close = np.zeros(len(points), np.bool_)
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        for k in range(len(offsets)):
            distance = abs(x * normals[k, 0] + y * normals[k, 1] + z * normals[k, 2] - offsets[k])
            if distance <= np.float32(TOLERANCE) * z:
                close[i] = True
                break
    return close


@njit(cache=True, nogil=True)
def _lie_on(lines: Float32, normal: Float32, offset: np.float32) -> Bool:
    """Flags (n,) of the points of ``_lines`` close to the plane normal . p = offset and parallel."""
    x, y, z, right, down, ahead = lines
    on = np.empty(x.size, np.bool_)
    a, b, c = normal
    for i in range(x.size):
        distance = abs(x[i] * a + y[i] * b + z[i] * c - offset)
        cosine = right[i] * a + down[i] * b + ahead[i] * c
        on[i] = (distance <= np.float32(TOLERANCE) * z[i]) & (cosine >= np.float32(LEAST_COSINE))
    return on


@njit(cache=True, nogil=True)
def _moments(lines: Float32, on: Bool) -> tuple[Float64, Float64]:
    """Mean (3,) of the chosen points of ``_lines``, and their scatter (3, 3) about it (lower triangle)."""
    centre, scatter, count = np.zeros(3), np.zeros((3, 3)), 0
    for i in range(on.size):
        if on[i]:
            count += 1
            for k in range(3):
                centre[k] += lines[k, i]
    centre /= count
    for i in range(on.size):
        if on[i]:
            x, y, z = lines[0, i] - centre[0], lines[1, i] - centre[1], lines[2, i] - centre[2]
            scatter[0, 0] += x * x
            scatter[1, 0] += x * y
            scatter[1, 1] += y * y
            scatter[2, 0] += x * z
            scatter[2, 1] += y * z
            scatter[2, 2] += z * z
    return centre, scatter


@njit(cache=True, nogil=True)
def _best(lines: Float32, weight: Int32, trials: int) -> int:
    """Index of the point, among the first ``trials``, with the most surface on its plane.

    lines: (6, n), see ``_lines``; weight: (n,), surface in whole numbers, which add up in any order.
    """
    x, y, z, right, down, ahead = lines
    best, most = 0, np.int32(-1)
    for i in range(min(trials, weight.size)):
        a, b, c = right[i], down[i], ahead[i]
        offset = a * x[i] + b * y[i] + c * z[i]
        area = np.int32(0)
        for j in range(weight.size):
            # Twice the tolerance: the trial plane has one point's noise.
            close = abs(a * x[j] + b * y[j] + c * z[j] - offset) < np.float32(2 * TOLERANCE) * z[j]
            along = a * right[j] + b * down[j] + c * ahead[j] > np.float32(LEAST_COSINE)
            area += weight[j] * np.int32(close & along)
        if area > most:
            best, most = i, area
    return best


@njit(cache=True, nogil=True)
def _normals(depth_m: Float32, lens: Float64, rows: Index, columns: Index) -> Float32:
    """Unit normals (n, 3) at pixels, NaN where unknown; lens: (fx, fy, cx, cy) in pixels."""
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
                if abs(z - z0) <= NORMAL_JUMP * z0:  # False for NaN
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
