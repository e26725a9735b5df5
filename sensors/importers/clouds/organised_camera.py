"""Camera of an organised cloud (a cloud that is a depth image), fitted to the pixels of its points."""

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from sensors.errors import FormatError, Setting
from sensors.importers.clouds.axes import AXES, camera_from, subsample
from sensors.rig.camera import Intrinsics
from sensors.rig.rig_calibration import Pose

Float64 = NDArray[np.float64]

RESIDUAL_PX = 2.0  # largest RMS of a pinhole: a lens left in has less; untuned
FLAT = 1e-6  # least ratio of the second smallest singular value to the largest: planes have less; untuned


class GridCamera(NamedTuple):
    """Camera of an organised cloud.

    camera_from_cloud: its translation is in the cloud's unit. residual_px: RMS. how: description of the
    camera's position.
    """

    intrinsics: Intrinsics
    camera_from_cloud: Pose
    residual_px: float
    how: str


def grid_camera(path: object, points: Float64, viewpoint: Pose | None) -> GridCamera:
    """Return the camera of an organised cloud (h, w, 3) in any frame and unit.

    Tried in turn: a camera at the origin in each of ``AXES``; the same at ``viewpoint``; any pose (direct
    linear transform, Hartley and Zisserman 2004, 7.1). Raises FormatError where none fits, or where the grid
    is the mirror image of the coordinates.
    """
    poses = {f"{axes} axes": Pose(camera_from(axes), np.zeros(3)) for axes in AXES}
    if viewpoint is not None:
        back, origin = viewpoint.rotation.T, viewpoint.translation_m
        for axes in AXES:
            turn = camera_from(axes) @ back
            poses[f"{axes} axes at the VIEWPOINT"] = Pose(turn, -turn @ origin)
    height, width = points.shape[:2]
    mirrored = False
    for how, pose in poses.items():
        fx, fy, cx, cy, residual = _pinhole(points @ pose.rotation.T + pose.translation_m)
        if residual <= RESIDUAL_PX:
            if fx > 0 and fy > 0:
                return GridCamera(Intrinsics(width, height, fx, fy, cx, cy), pose, residual, how)
            mirrored = mirrored or fx * fy < 0
    if mirrored:
        raise _mirrored(path)
    return _any_pose(path, points)


def _pinhole(points: Float64) -> tuple[float, float, float, float, float]:
    """Return fx, fy, cx, cy and the RMS residual in pixels, infinite where points determine no camera."""
    with np.errstate(invalid="ignore"):
        finite = np.isfinite(points).all(axis=-1)
        v, u = np.nonzero(finite & (points[..., 2] > 0))
    if len(v) < 0.99 * finite.sum():
        return 0.0, 0.0, 0.0, 0.0, np.inf
    x, y, z = points[v, u].T
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        (fx, cx, error_u), (fy, cy, error_v) = _line(x / z, u), _line(y / z, v)
    return fx, fy, cx, cy, float(np.hypot(error_u, error_v))


def _line(ratio: Float64, pixel: NDArray[np.intp]) -> tuple[float, float, float]:
    """Return the least-squares slope, offset and RMS of pixel = slope * ratio + offset."""
    if len(ratio) < 3 or np.ptp(pixel) == 0 or not (np.isfinite(np.ptp(ratio)) and np.ptp(ratio) > 0):
        return 0.0, 0.0, np.inf
    centred, mean = ratio - ratio.mean(), pixel.mean()
    slope = float(centred @ (pixel - mean) / (centred @ centred))
    rms = float(np.sqrt(np.mean((slope * centred - (pixel - mean)) ** 2)))
    return slope, float(mean - slope * ratio.mean()), rms


def _any_pose(path: object, points: Float64) -> GridCamera:
    """Return the camera of a grid in any frame, by the direct linear transform over some of its points."""
    height, width = points.shape[:2]

    def refused(why: str) -> FormatError:
        return FormatError(
            f"{path}: the {width}x{height} grid of the cloud fits no camera and is not a pinhole image "
            f"({why}); give it as an unorganised cloud (HEIGHT 1)"
        )

    v, u = np.nonzero(np.isfinite(points).all(axis=-1))
    some = subsample(np.column_stack([u, v, points[v, u]]).astype(np.float64))
    matrix = _projection(some[:, :2], some[:, 2:])
    if matrix is None:
        raise refused("its points lie in a plane or are too few")
    matrix = matrix * np.sign(np.linalg.det(matrix[:, :3]))
    ahead = some[:, 2:] @ matrix[2, :3] + matrix[2, 3]
    intrinsics, rotation = map(np.asarray, cv2.decomposeProjectionMatrix(matrix)[:2])
    if not abs(intrinsics[2, 2]) > 0 or not np.isfinite(intrinsics).all():
        raise refused("it has no focal length")
    translation = np.linalg.solve(intrinsics / intrinsics[2, 2], matrix[:, 3] / np.linalg.norm(matrix[2, :3]))
    turned = points @ rotation.T + translation
    fx, fy, cx, cy, residual = _pinhole(turned if (ahead > 0).mean() > 0.5 else -turned)
    if not residual <= RESIDUAL_PX or not (fx > 0 and fy > 0):
        raise refused(f"residual {residual:.1f} px")
    if (ahead > 0).mean() < 0.5:
        raise _mirrored(path)
    x, y, z = -rotation.T @ translation
    how = f"its camera at ({x:.3g}, {y:.3g}, {z:.3g}) in the cloud's frame, by its grid"
    return GridCamera(Intrinsics(width, height, fx, fy, cx, cy), Pose(rotation, translation), residual, how)


def _projection(pixels: Float64, points: Float64) -> Float64 | None:
    """Return the (3, 4) matrix that maps points to pixels, up to scale; None where they determine none."""
    if len(points) < 12:
        return None
    middle, size = points.mean(axis=0), max(float(points.std()), 1e-12)
    centre, spread = pixels.mean(axis=0), max(float(pixels.std()), 1e-12)
    rows = np.column_stack([(points - middle) / size, np.ones(len(points))])
    flat, zeros = (pixels - centre) / spread, np.zeros_like(rows)
    across, down = (
        np.hstack([rows, zeros, -flat[:, :1] * rows]),
        np.hstack([zeros, rows, -flat[:, 1:] * rows]),
    )
    _, values, vectors = np.linalg.svd(np.concatenate([across, down]), full_matrices=False)
    if not values[-2] > FLAT * values[0]:
        return None
    back = np.array([[spread, 0, centre[0]], [0, spread, centre[1]], [0, 0, 1]])
    into = np.vstack([np.column_stack([np.eye(3) / size, -middle / size]), [0, 0, 0, 1]])
    return np.asarray(back @ vectors[-1].reshape(3, 4) @ into)


def _mirrored(path: object) -> FormatError:
    return FormatError(
        f"{path}: the grid of the cloud is the mirror image of its coordinates; negate y where the "
        "coordinates are left-handed (Unity), or mirror the image where it is mirrored (Kinect SDK)",
        Setting.MIRROR,
    )
