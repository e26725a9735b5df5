"""Walls, floors, seats and table tops: the planes of a cloud, found from points with their normals."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit

from annotate.array_types import Bool, Float32, Float64, Index
from annotate.cloud.thermal_cloud import ThermalCloud

MAX_PLANES = 16
MIN_PLANE_M2 = 0.12
"""Surface, seen head-on: a flat patch of a body (a back, a thigh) is smaller."""
MIN_COLD_PLANE_M2 = 0.04
"""The same where no point is warm, so that no body can be meant: an arm rest, a table's edge."""
MIN_PANEL_M2 = 0.025
"""The same where all is warm, for a panel that stands free: half of a laptop's lid."""
PANEL_RADIUS_M = 0.07
"""Of the largest disc on it: half of a shin's or an arm's breadth is less."""
BEND_M, FREE_SHARE = 0.03, 0.78
"""Beside a flat patch of a body the surface bends away by less than that within four pixels; more than
this share of a panel's rim is farther behind."""
TOLERANCE = 0.006
"""Distance to a plane as a share of the depth: 12 mm at 2 m, three times a Kinect v2's noise
(Fankhauser et al. 2015)."""
LEAST_COSINE = 0.94
"""A point lies on a plane only when their normals are within 20 degrees: a limb on a seat is not the seat."""
NORMAL_JUMP = 0.02
"""Neighbours farther apart in depth than this share of it lie on another surface."""
STRIDE = 3
"""Planes are sought on every third pixel of every third row."""
SAMPLE, TRIALS = 3000, 40
"""Points that vote in a round, and how many of them are tried as the plane."""
LEAST_POINTS = 30


@dataclass(frozen=True)
class Plane:
    """normal . p = offset_m for points p of the depth camera's frame. normal: float32 (3,), of length 1,
    towards the camera. area_m2: visible surface, taken as seen head-on."""

    normal: Float32
    offset_m: float
    area_m2: float

    def close(self, points_m: Float32) -> Bool:
        """Which points (..., 3) are near enough to lie on it; NaN is not."""
        distance = np.abs(points_m @ self.normal - np.float32(self.offset_m))
        return np.asarray(distance <= np.float32(TOLERANCE) * points_m[..., 2], np.bool_)

    def parallel(self, normals: Float32) -> Bool:
        """Which unit normals (..., 3) are turned as it is; NaN is not."""
        x, y, z = self.normal
        cosine = normals[..., 0] * x + normals[..., 1] * y + normals[..., 2] * z
        return np.asarray(cosine >= LEAST_COSINE, np.bool_)


def find_planes(
    cloud: ThermalCloud, among: Bool, least_m2: float = MIN_PLANE_M2, seed: int = 0
) -> tuple[Plane, ...]:
    """The planes of at least ``least_m2`` among valid pixels (h, w), the best supported first.

    One-point RANSAC, since a point with its normal is a plane, then least squares on its inliers; the
    same for the same seed.
    """
    rows, columns = np.nonzero((among & cloud.valid)[1::STRIDE, 1::STRIDE])
    rows, columns = rows * STRIDE + 1, columns * STRIDE + 1
    points = cloud.points_m[rows, columns]
    normals = normals_at(cloud, rows, columns)
    flat = np.isfinite(normals[:, 0])
    points, normals = points[flat], normals[flat]
    pixel_m2 = points[:, 2] ** 2 * np.float32(STRIDE**2 / (cloud.camera.fx * cloud.camera.fy))
    rng = np.random.default_rng(seed)
    planes: list[Plane] = []
    while len(points) >= LEAST_POINTS and len(planes) < MAX_PLANES:
        sample = rng.permutation(len(points))[:SAMPLE]
        best = sample[_best(points[sample], normals[sample], pixel_m2[sample], min(TRIALS, len(sample)))]
        plane, on = _fitted(points, normals, pixel_m2, int(best))
        if plane.area_m2 < least_m2:
            break
        planes.append(plane)
        points, normals, pixel_m2 = points[~on], normals[~on], pixel_m2[~on]
    return tuple(planes)


def panel_of(plane: Plane, cloud: ThermalCloud, among: Bool) -> Bool:
    """Pixels (h, w) of a plane's largest patch with its rim, if it is broad and ends in steps, as a screen.

    Nothing where it is narrow, as a shin, or its border bends, as a chest's does. among: bool (h, w), pixels
    that may be of the patch.
    """
    nothing = np.zeros_like(among)
    flat = (among & plane.close(cloud.points_m)).astype(np.uint8)
    _, patches, stats, _ = cv2.connectedComponentsWithStats(flat)
    if len(stats) < 2:
        return nothing
    patch = (patches == 1 + int(stats[1:, cv2.CC_STAT_AREA].argmax())).astype(np.uint8)
    behind_m = np.float32(plane.offset_m) - cloud.points_m @ plane.normal
    grown = cv2.dilate(patch, np.ones((9, 9), np.uint8)) > 0
    rim_m = behind_m[grown & ~(cv2.dilate(patch, np.ones((3, 3), np.uint8)) > 0)]
    behind, beside = np.count_nonzero(rim_m > BEND_M), np.count_nonzero(np.abs(rim_m) <= BEND_M)
    closed = cv2.morphologyEx(patch, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
    radius_m = cv2.distanceTransform(np.pad(closed, 1), cv2.DIST_L2, 3)[1:-1, 1:-1] * cloud.points_m[..., 2]
    if np.nanmax(radius_m) < PANEL_RADIUS_M * cloud.camera.fx or behind <= FREE_SHARE * (behind + beside):
        return nothing
    return np.asarray(grown & (np.abs(behind_m) <= BEND_M), np.bool_)


def close_to(planes: Sequence[Plane], points_m: Float32) -> Bool:
    """Which points (..., 3) are close to any of the planes, however their surface is turned."""
    if not planes:
        return np.zeros(points_m.shape[:-1], np.bool_)
    normals = np.stack([plane.normal for plane in planes])
    offsets = np.array([plane.offset_m for plane in planes], np.float32)
    flat = np.ascontiguousarray(points_m, np.float32).reshape(-1, 3)
    return _close(flat, normals, offsets).reshape(points_m.shape[:-1])


def lies_on(planes: Sequence[Plane], points_m: Float32, normals: Float32) -> Bool:
    """Which points (..., 3) with unit normals (..., 3) lie on any of the planes."""
    on = np.zeros(points_m.shape[:-1], np.bool_)
    for plane in planes:
        on |= _on(plane, points_m, normals)
    return on


def _on(plane: Plane, points_m: Float32, normals: Float32) -> Bool:
    """Which points (..., 3) are close to a plane and parallel to it, with unit normals (..., 3)."""
    points, turned = (np.ascontiguousarray(one, np.float32).reshape(-1, 3) for one in (points_m, normals))
    return _lie_on(points, turned, plane.normal, np.float32(plane.offset_m)).reshape(points_m.shape[:-1])


def normals_at(cloud: ThermalCloud, rows: Index, columns: Index) -> Float32:
    """Unit normals (n, 3) of the surface at pixels, towards the camera; NaN where too little is seen.

    Least squares over 5 x 5 pixels two apart. 1/z is fitted, which is linear over the image of a plane.
    """
    lens = np.array([cloud.camera.fx, cloud.camera.fy, cloud.camera.cx, cloud.camera.cy])
    return _normals(np.ascontiguousarray(cloud.points_m[..., 2]), lens, rows, columns)


def _fitted(points: Float32, normals: Float32, pixel_m2: Float32, start: int) -> tuple[Plane, Bool]:
    """The plane around one point by least squares, and which points (n,) it was fitted to."""
    plane = Plane(normals[start], float(normals[start] @ points[start]), 0.0)
    on = _on(plane, points, normals)
    for _ in range(3):
        if on.sum() < LEAST_POINTS:
            break
        centre, scatter = _moments(points, on)
        normal = np.linalg.eigh(scatter)[1][:, 0]
        normal *= np.sign(normal @ plane.normal)
        plane = Plane(normal.astype(np.float32), float(normal @ centre), float(pixel_m2[on].sum()))
        fitted, on = on, _on(plane, points, normals)
        on |= fitted  # else a bad fit would be found again and again
    return plane, on


@njit(cache=True, nogil=True)
def _close(points: Float32, normals: Float32, offsets: Float32) -> Bool:
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
def _lie_on(points: Float32, normals: Float32, normal: Float32, offset: np.float32) -> Bool:
    on = np.empty(len(points), np.bool_)
    a, b, c = normal
    for i in range(len(points)):
        distance = abs(points[i, 0] * a + points[i, 1] * b + points[i, 2] * c - offset)
        cosine = normals[i, 0] * a + normals[i, 1] * b + normals[i, 2] * c
        on[i] = (distance <= np.float32(TOLERANCE) * points[i, 2]) & (cosine >= np.float32(LEAST_COSINE))
    return on


@njit(cache=True, nogil=True)
def _moments(points: Float32, on: Bool) -> tuple[Float64, Float64]:
    """Mean (3,) of the chosen points, and the sum (3, 3) of the outer products of what they are off it."""
    centre, scatter, count = np.zeros(3), np.zeros((3, 3)), 0
    for i in range(len(points)):
        if on[i]:
            count += 1
            for k in range(3):
                centre[k] += points[i, k]
    centre /= count
    for i in range(len(points)):
        if on[i]:
            x, y, z = points[i, 0] - centre[0], points[i, 1] - centre[1], points[i, 2] - centre[2]
            scatter[0, 0] += x * x
            scatter[1, 0] += x * y
            scatter[1, 1] += y * y
            scatter[2, 0] += x * z
            scatter[2, 1] += y * z
            scatter[2, 2] += z * z
    return centre, scatter  # the lower triangle, which is what eigh reads


@njit(cache=True, nogil=True)
def _best(points: Float32, normals: Float32, pixel_m2: Float32, trials: int) -> int:
    """Which of the first points makes the plane with the most surface on it."""
    best, most = 0, np.float32(-1)
    for i in range(trials):
        a, b, c = normals[i, 0], normals[i, 1], normals[i, 2]
        offset = a * points[i, 0] + b * points[i, 1] + c * points[i, 2]
        area = np.float32(0)
        for j in range(points.shape[0]):
            x, y, z = points[j, 0], points[j, 1], points[j, 2]
            # Twice the tolerance: one point's own noise is in the plane.
            close = abs(a * x + b * y + c * z - offset) < np.float32(2 * TOLERANCE) * z
            cosine = a * normals[j, 0] + b * normals[j, 1] + c * normals[j, 2]
            if close and cosine > np.float32(LEAST_COSINE):
                area += pixel_m2[j]
        if area > most:
            best, most = i, area
    return best


@njit(cache=True, nogil=True)
def _normals(depth_m: Float32, lens: Float64, rows: Index, columns: Index) -> Float32:
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
