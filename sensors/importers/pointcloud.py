"""A point cloud file (PCD, PLY, LAS, LAZ) as a source of one depth image.

An organised cloud already is a depth image: its intrinsics are fitted to its points. Any other cloud is seen
through the intrinsics of a Kinect v2, from where the whole of it is in view.
"""

from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from sensors.errors import FormatError
from sensors.importers.cloud_header import CloudHeader, read_header
from sensors.importers.las import read_las
from sensors.rig.camera import Intrinsics
from sensors.rig.frame import FrameSource, RigFrame, mm_from_metres, regular_times_ns
from sensors.rig.nearest import Nearest
from sensors.rig.rig_calibration import RigCalibration

KINECT_V2 = Intrinsics(512, 424, 365.15, 365.15, 253.98, 211.09)
"""Pinhole of a typical Kinect v2 depth camera; a projected cloud has no lens distortion."""

NEAREST_M = 0.5
"""Nearest depth of a Kinect v2."""
MARGIN = 0.05
"""Share of the image kept free at each side of a cloud moved into view; chosen by eye."""

SPLAT = 0.65
"""Half-width of a projected point in point spacings: a half closes an ideal lattice; on Kinect fusion scans
0.6 is the least that hides their far side."""

FARTHEST_M = 10_000.0
"""Metres from the origin beyond which a coordinate counts as no reading; chosen by eye."""

Axes = Literal["camera", "y-up", "z-up"]
"""Axes of a cloud: the camera's own (x right, y down, z forward); y up, z backward; or z up, y forward."""

_CAMERA_FROM = {
    "camera": np.eye(3),
    "y-up": np.diag([1.0, -1.0, -1.0]),
    "z-up": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
}


class CloudFile(FrameSource):
    """A point cloud file in metres as a ``FrameSource`` of one frame.

    ``axes`` None: z up for LAS and LAZ, which are maps; y up where most points have a negative z, which no
    camera sees; else the camera's own.
    notes: what is absent, how intrinsics and viewpoint were found. Raises FormatError.
    """

    def __init__(self, path: Path, axes: Axes | None = None) -> None:
        self.path, self.name = path, path.stem
        mapped = path.suffix.lower() in (".las", ".laz")
        header = CloudHeader(0, None) if mapped else read_header(path)
        points = read_las(path) if mapped else _read_points(path, header)
        points[(np.abs(points) > FARTHEST_M).any(axis=-1)] = np.nan
        finite = points[np.isfinite(points).all(axis=-1)]
        if len(finite) < 2:
            raise FormatError(f"{path} holds {len(finite)} finite points; give a surface in metres")
        seen: Axes = "y-up" if np.median(finite[:, 2]) < 0 else "camera"
        known_axes = axes or ("z-up" if mapped else seen)
        if header.shape is not None and known_axes == "camera":
            camera, depth_m, how = _organised(path, points.reshape(*header.shape, 3))
        else:
            camera, depth_m, how = _unorganised(finite @ _CAMERA_FROM[known_axes].T, known_axes)
        self.calibration, self.times_ns = RigCalibration(camera), regular_times_ns(1)
        self.notes = (how, "no colour images", "no thermal images", "one frame, without time stamp")
        self._depth_mm = mm_from_metres(depth_m)

    def _frame(self, index: int) -> RigFrame:
        return RigFrame(index, int(self.times_ns[index]), self._depth_mm)


def fit_intrinsics(points_m: NDArray[np.float64]) -> tuple[Intrinsics, float]:
    """Intrinsics of the pinhole that saw an organised cloud (h, w, 3), and the residual RMS in pixels.

    Least squares of u = fx x/z + cx and v = fy y/z + cy over all finite points with z > 0.
    Raises FormatError where the points do not determine them.
    """
    height, width = points_m.shape[:2]
    v, u = np.nonzero(np.isfinite(points_m).all(axis=-1) & (points_m[..., 2] > 0))
    x, y, z = points_m[v, u].T
    (fx, cx, error_u), (fy, cy, error_v) = _line(x / z, u), _line(y / z, v)
    if not (fx > 0 and fy > 0):
        raise FormatError(
            f"the {width}x{height} grid of the cloud fits no camera (fx={fx:.4g}, fy={fy:.4g}); "
            "give x right, y down, z forward, in metres"
        )
    return Intrinsics(width, height, fx, fy, cx, cy), float(np.hypot(error_u, error_v))


def project_cloud(points_m: NDArray[np.float64], camera: Intrinsics, spacing_m: float) -> NDArray[np.float64]:
    """Depth image (h, w) in metres, NaN = nothing, of camera-frame points (n, 3); the nearest point wins.

    A point covers the pixels within SPLAT * ``spacing_m`` of it, at least its own, so that a surface sampled
    at that spacing shows no holes through which its far side would be seen.
    """
    points = points_m[points_m[:, 2] > 0]
    x, y, z = points.T
    u, v = camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy
    radius = np.clip(camera.fx * SPLAT * spacing_m / z, 0.5, 8.0)
    depth = np.full(camera.shape, np.inf)
    reach = int(np.ceil(radius.max(initial=0.5)))
    for dv in range(-reach, reach + 1):
        for du in range(-reach, reach + 1):
            column, row = np.rint(u) + du, np.rint(v) + dv
            hit = (np.abs(column - u) <= radius) & (np.abs(row - v) <= radius)
            hit &= (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
            np.minimum.at(depth, (row[hit].astype(int), column[hit].astype(int)), z[hit])
    return np.where(np.isfinite(depth), depth, np.nan)


def shift_into_view(points_m: NDArray[np.float64], camera: Intrinsics) -> NDArray[np.float64]:
    """The translation (3,) in metres after which the camera sees all of the points (n, 3).

    Zero where it does already; else the cloud is centred and moved back until it fills the image but
    for a margin.
    """
    x, y, z = points_m.T
    if z.min() >= NEAREST_M:
        u, v = camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy
        if u.min() >= 0 and u.max() <= camera.width - 1 and v.min() >= 0 and v.max() <= camera.height - 1:
            return np.zeros(3)
    shift = np.asarray(-(points_m.min(axis=0) + points_m.max(axis=0)) / 2, np.float64)
    # The camera's field is not symmetric about its axis: its narrower half counts.
    center, size = np.array([camera.cx, camera.cy]), np.array([camera.width, camera.height])
    half = np.minimum(center, size - 1 - center) * (1 - 2 * MARGIN)
    needed = np.abs(points_m[:, :2] + shift[:2]) * (camera.fx, camera.fy) / half - z[:, None]
    shift[2] = max(needed.max(), NEAREST_M - z.min())
    return shift


def _organised(path: Path, points_m: NDArray[np.float64]) -> tuple[Intrinsics, NDArray[np.float64], str]:
    camera, residual = fit_intrinsics(points_m)
    if residual > 2.0:
        raise FormatError(
            f"{path}: the grid of the cloud is not a pinhole image (residual {residual:.1f} px); "
            "give it as an unorganised cloud (HEIGHT 1)"
        )
    how = (
        f"intrinsics fitted to the organised cloud: fx {camera.fx:.2f}, fy {camera.fy:.2f}, "
        f"cx {camera.cx:.2f}, cy {camera.cy:.2f}, residual {residual:.2g} px"
    )
    return camera, points_m[..., 2], how


def _unorganised(points_m: NDArray[np.float64], axes: Axes) -> tuple[Intrinsics, NDArray[np.float64], str]:
    shift = shift_into_view(points_m, KINECT_V2)
    depth = project_cloud(points_m + shift, KINECT_V2, _spacing(points_m))
    moved = "not moved" if not shift.any() else "moved by ({:.2f}, {:.2f}, {:.2f}) m".format(*shift)
    return KINECT_V2, depth, f"cloud with {axes} axes seen through Kinect v2 intrinsics, {moved}"


def _line(ratio: NDArray[np.float64], pixel: NDArray[np.intp]) -> tuple[float, float, float]:
    """Least-squares slope, offset and RMS of pixel = slope * ratio + offset."""
    if len(ratio) < 3 or np.ptp(ratio) <= 0 or np.ptp(pixel) == 0:
        return 0.0, 0.0, 0.0
    centred, mean = ratio - ratio.mean(), pixel.mean()
    slope = float(centred @ (pixel - mean) / (centred @ centred))
    rms = float(np.sqrt(np.mean((slope * centred - (pixel - mean)) ** 2)))
    return slope, float(mean - slope * ratio.mean()), rms


def _spacing(points_m: NDArray[np.float64]) -> float:
    """Distance that separates neighbouring points of a surface: nearest neighbours' 95th percentile."""
    points = _distinct(points_m)
    if len(points) < 2:
        return 0.0
    sample = points[:: max(1, len(points) // 5000)]
    distances, _ = Nearest(points).query(sample, k=2)
    return float(np.percentile(distances, 95))


def _distinct(points_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """The points without those that an earlier one equals in float32, in their order."""
    # The search compares in float32, and looks at all of many equal points each time.
    rows = points_m.astype(np.float32)
    order = np.lexsort(rows.T)
    first = np.ones(len(rows), bool)
    first[order[1:]] = (rows[order[1:]] != rows[order[:-1]]).any(axis=1)
    return points_m[first]


def _read_points(path: Path, header: CloudHeader) -> NDArray[np.float64]:
    """All points (n, 3) in the file's order, NaN where not finite or farther than FARTHEST_M."""
    try:
        import open3d as o3d
    except ImportError as error:
        raise FormatError(f"{path} needs open3d; pip install 'annotate-cloud[clouds]'") from error

    try:
        with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
            cloud = o3d.t.io.read_point_cloud(path, remove_nan_points=False, remove_infinite_points=False)
        with np.errstate(invalid="ignore"):  # signalling NaNs
            points = np.array(cloud.point.positions.numpy(), np.float64)
    except (RuntimeError, KeyError, ValueError) as error:
        raise FormatError(f"{path} cannot be read; restore it from a copy") from error
    if points.shape != (header.points, 3):
        raise FormatError(f"{path} holds {len(points)} of its {header.points} points; restore it from a copy")
    return points
