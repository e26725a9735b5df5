"""Fusion beside the plain NumPy way; the NumPy way is also the tests' oracle."""

import time
from collections.abc import Callable

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from annotate.cloud.fuse import Fuser, undistortion_index
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.cloud.visibility import THERMAL_TOLERANCE
from sensors.calibration_files.kinect2_factory import KINECT2_COLOR, KINECT2_DEPTH
from sensors.rig.camera import Intrinsics, rays
from sensors.rig.rig_calibration import Pose, RigCalibration

F = np.float32

CALIBRATION = RigCalibration(
    KINECT2_DEPTH,
    Intrinsics(1920, 1080, 1081.37207, 1081.37207, 959.5, 539.5, 0.056, -0.074, 0.0014, -0.0017, 0.024),
    Pose(Rotation.from_rotvec([0.002, -0.011, 0.017]).as_matrix(), np.array([-0.052, 0.0, 0.001])),
    Intrinsics(160, 120, 110.1, 110.1, 80.3, 59.2, -0.19, 0.04),
    Pose(Rotation.from_euler("x", -2, degrees=True).as_matrix(), np.array([0.012, 0.06, -0.01])),
)


def random_scene(seed, calibration=CALIBRATION):
    """Return images of hills with boxes in front: depth with holes, random colours, smooth temperatures."""
    rng = np.random.default_rng(seed)
    height, width = calibration.depth.shape
    hills = cv2.GaussianBlur(rng.random((height, width), F), (0, 0), width / 30)
    depth = 2500 + 1500 * (hills - hills.min()) / np.ptp(hills)
    for _ in range(4):
        top, left = rng.integers(0, height * 3 // 4), rng.integers(0, width * 3 // 4)
        depth[top : top + height // 3, left : left + width // 5] = rng.uniform(900, 2400)
    depth[rng.random(depth.shape) < 0.03] = 0
    color = rng.integers(0, 256, (*calibration.color.shape, 3), np.uint8)
    thermal = cv2.GaussianBlur(rng.normal(26, 30, calibration.thermal.shape), (0, 0), 4).astype(F)
    thermal[rng.random(thermal.shape) < 0.01] = np.nan
    return depth.astype(np.uint16), color, thermal


def fuse_naive(calibration, depth_mm, color_rgb, thermal_c):
    """Fuse with whole-array NumPy, as the naive twin of ``Fuser.fuse``."""
    camera = calibration.depth.undistorted()
    source = undistortion_index(calibration.depth)
    undistorted = np.where(source >= 0, depth_mm.ravel()[source], 0).astype(np.uint16)
    z = np.where(undistorted > 0, undistorted.astype(F) / F(1000), F(np.nan))
    points = np.concatenate([rays(camera)[..., :2].astype(F) * z[..., None], z[..., None]], axis=-1)

    scale = (calibration.color.fx / camera.fx) / (KINECT2_COLOR.f / KINECT2_DEPTH.fx)
    window = round(scale), round(2 * scale)
    view = _view(calibration.color, calibration.color_from_depth, (camera, z), window, (0.01, 0))
    u, v, seen = view["u"], view["v"], view["seen"]
    color = np.zeros((*camera.shape, 3), np.uint8)
    color[seen] = color_rgb[_pixel(v[seen]), _pixel(u[seen])]

    reach = 1.5 * camera.fx / calibration.thermal.fx
    thermal, pose = calibration.thermal, calibration.thermal_from_depth
    view = _view(thermal, pose, (camera, z), (1, 1), (THERMAL_TOLERANCE, reach))
    return ThermalCloud(camera, undistorted, points, color, seen, _bilinear(thermal_c, **view))


def _view(other, pose, points, window, slacks):
    """Project points (camera, metres); return pixels, distance along z, tolerance, visibility, z-buffers."""
    (camera, z), (tolerance, reach) = points, slacks
    turned = np.einsum("ij,hwj->ihw", pose.rotation, rays(camera)).astype(F)
    t = pose.translation_m.astype(F)
    k1, k2, p1, p2, k3 = (F(k) for k in other.distortion)
    with np.errstate(invalid="ignore"):
        ahead = turned[2] * z + t[2]
        x, y = (turned[0] * z + t[0]) / ahead, (turned[1] * z + t[1]) / ahead
        r2 = x * x + y * y
        radial = 1 + ((k3 * r2 + k2) * r2 + k1) * r2
        u = F(other.fx) * (x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)) + F(other.cx)
        v = F(other.fy) * (y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y) + F(other.cy)
        inside = (u >= -0.5) & (u < other.width - 0.5) & (v >= -0.5) & (v < other.height - 0.5) & (ahead > 0)
    ahead = np.where(inside, ahead, F(np.nan))
    nearest = np.full(other.shape, np.inf, F)
    row, column = _pixel(v[inside]), _pixel(u[inside])
    np.minimum.at(nearest, (row, column), ahead[inside])
    front = cv2.erode(nearest, np.ones((2 * window[0] + 1, 2 * window[1] + 1), np.uint8))
    slack = F(tolerance) * ahead + F(reach) * _slope(ahead)
    seen = np.zeros(z.shape, bool)
    seen[inside] = ahead[inside] - front[row, column] <= slack[inside]
    return {"u": u, "v": v, "seen": seen, "depth": (ahead, slack, nearest, front)}


def _pixel(coordinate):
    return (coordinate + F(0.5)).astype(np.intp)


def _slope(z):
    """Return the smaller difference to a neighbour, by row plus by column; 0 beside gaps and borders."""
    slope = np.zeros_like(z)
    inner = z[1:-1, 1:-1]
    left, right = abs(z[1:-1, :-2] - inner), abs(z[1:-1, 2:] - inner)
    up, down = abs(z[:-2, 1:-1] - inner), abs(z[2:, 1:-1] - inner)
    slope[1:-1, 1:-1] = np.nan_to_num(np.minimum(left, right) + np.minimum(up, down))
    return slope


def _bilinear(image, u, v, seen, depth):
    """Return the bilinear mean over pixels that have a reading and show only the point's surface."""
    nearest, front, image = (np.pad(plane, 1, constant_values=np.nan) for plane in (*depth[2:], image))
    ahead, slack = depth[:2]
    x, y, z = u[seen] + F(1), v[seen] + F(1), ahead[seen]
    left, top = x.astype(np.intp), y.astype(np.intp)
    a, b = x - left.astype(F), y - top.astype(F)
    total, weight = np.zeros_like(z), np.zeros_like(z)
    for down, right in ((0, 0), (0, 1), (1, 0), (1, 1)):
        reading = image[top + down, left + right]
        own = abs(nearest[top + down, left + right] - z) <= slack[seen]
        own &= (z - front[top + down, left + right] <= slack[seen]) & ~np.isnan(reading)
        share = (b if down else F(1) - b) * (a if right else F(1) - a)
        total += np.where(own, share * reading, F(0))
        weight += np.where(own, share, F(0))
    temperature = np.full(seen.shape, np.nan, F)
    temperature[seen] = np.where(weight > 0, total / np.maximum(weight, F(1e-30)), F(np.nan))
    return temperature


def median_seconds(call: Callable[[], object], repeats: int) -> float:
    """Return the median wall time of ``repeats`` calls, after one call that compiles."""
    call()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        call()
        times.append(time.perf_counter() - start)
    return float(np.median(times))


def bench() -> list[tuple[str, float, float]]:
    """Return rows (name, seconds a frame, seconds of the naive way) at the sizes of Kinect v2 and Optris."""
    depth, color, thermal = random_scene(0)
    fuser = Fuser(CALIBRATION)
    return [
        (
            "fuse 512x424 + 1920x1080 + 160x120",
            median_seconds(lambda: fuser.fuse(depth, color, thermal), 60),
            median_seconds(lambda: fuse_naive(CALIBRATION, depth, color, thermal), 5),
        ),
    ]
