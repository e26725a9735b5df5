"""A point cloud file (PCD, PLY, LAS, LAZ) as a source of one depth image with the cloud's colours.

An organised cloud already is a depth image: its camera is fitted to its grid. Any other cloud that lies in a
camera's frame stays there, and is seen by a camera at its origin; the rest is moved into a camera's view.
"""

from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from sensors.errors import FormatError
from sensors.importers.cloud_axes import AXES, camera_from, cone_of, on_pixels, thinned, upright, world_axes
from sensors.importers.cloud_grid import GridCamera, grid_camera
from sensors.importers.cloud_records import CloudRecords
from sensors.importers.cloud_unit import unit_mm
from sensors.importers.cloud_view import (
    KINECT_V2,
    beside,
    camera_of,
    pixels_of,
    project_cloud,
    shift_into_view,
    spacing_m,
)
from sensors.importers.las import read_las
from sensors.importers.options import AS_STATED, ImportOptions
from sensors.importers.pcd_file import read_pcd
from sensors.importers.ply_file import read_ply
from sensors.rig.camera import Intrinsics
from sensors.rig.frame import FARTHEST_MM, FrameSource, RigFrame, mm_from_metres, regular_times_ns
from sensors.rig.intrinsics_file import read_intrinsics
from sensors.rig.rig_calibration import Pose, RigCalibration

Float64 = NDArray[np.float64]

READERS = {".pcd": read_pcd, ".ply": read_ply, ".las": read_las, ".laz": read_las}
"""By suffix."""
STRAY = 1e6
"""Units from the middle of a cloud: a kilometre in millimetres."""
APART = 1.0
"""Sizes of a cloud without its outermost thousandths that a point may lie outside it. Untuned."""
SAME_FOCAL = 0.003
"""Relative difference of focal lengths up to which a declared camera is the one that took the points: a pixel
at a wide image's edge."""
MAPS = (".las", ".laz")
"""Formats of maps, whose z points up where nothing contradicts."""


@dataclass(frozen=True)
class _View:
    """How a cloud is seen. points_m: camera frame (n, 3), in the file's order, NaN = none.
    shown: index (h, w) of each pixel's point, -1 = none. how: what was found or assumed.
    organised: whether point n is pixel n. spacing_m: of the points' surface, 0 = a pixel each."""

    camera: Intrinsics
    points_m: Float64
    shown: NDArray[np.intp]
    how: tuple[str, ...]
    organised: bool = False
    spacing_m: float = 0.0


class CloudFile(FrameSource):
    """A point cloud file as a ``FrameSource`` of one frame.

    cloud: its points as the file has them. notes: what is absent, how unit, axes and camera were found.
    Raises FormatError.
    """

    def __init__(self, path: Path, options: ImportOptions = AS_STATED) -> None:
        if options.axes not in ("", *AXES):
            raise FormatError(f"axes {options.axes[:20]!r} are unknown; use {', '.join(AXES)}")
        self.path, self.name = path, path.stem
        self.cloud = READERS[path.suffix.lower()](path)
        points = self.cloud.points()
        with np.errstate(invalid="ignore"):
            points[~np.isfinite(points).all(axis=1) | ~points.any(axis=1)] = np.nan
        _drop_strays(points)
        if np.isfinite(points[:, 0]).sum() < 2:
            raise FormatError(f"{path} holds {np.isfinite(points[:, 0]).sum()} finite points; give a surface")
        self._view = _seen(path, self.cloud, points, options)
        depth_m = np.where(self._view.shown >= 0, self._view.points_m[self._view.shown, 2], np.nan)
        self._depth_mm = mm_from_metres(depth_m)
        self._check_depth()
        colors = self.cloud.colors()
        camera, pose = self._view.camera, Pose.identity()
        self.calibration = (
            RigCalibration(camera)
            if colors is None
            else RigCalibration(camera, camera, color_from_depth=pose)
        )
        self._color = None if colors is None else _png(colors, self._view.shown)
        self.times_ns = regular_times_ns(1)
        faces = self.cloud.faces
        self.notes = (
            *self._view.how,
            *([f"a mesh: of its {faces} faces only the corners are read"] if faces else ()),
            "no colour images" if colors is None else "colours of the cloud's points",
            "no thermal images",
            "one frame, without time stamp",
        )

    def _frame(self, index: int) -> RigFrame:
        return RigFrame(index, int(self.times_ns[index]), self._depth_mm, self._color)

    def _check_depth(self) -> None:
        """Raise FormatError where the points lie beyond what a depth image holds."""
        if self._depth_mm.any():
            return
        nearest = float(np.nanmin(np.abs(self._view.points_m[:, 2])))
        raise FormatError(
            f"{self.path}: no point is within the {FARTHEST_MM / 1000:g} m of a depth image (the nearest is "
            f"{nearest:.4g} m away); give --depth-unit, the millimetres of a unit"
        )

    @cached_property
    def pixels(self) -> NDArray[np.intp]:
        """The flat index (n,) of the pixel that shows each point of ``cloud``; -1 where none does."""
        depth_m = np.where(self._depth_mm > 0, self._depth_mm / 1000, np.nan)
        if self._view.organised:
            return np.where(np.isfinite(depth_m.ravel()), np.arange(depth_m.size), -1)
        pixels = pixels_of(self._view.points_m, self._view.camera, depth_m)
        return beside(self._view.points_m, pixels, self._view.spacing_m) if self._view.spacing_m else pixels


def _drop_strays(points: Float64) -> None:
    """Make points NaN that lie STRAY units from the middle of the cloud: no scene has them in any unit."""
    there = np.isfinite(points[:, 0])
    if there.any():
        with np.errstate(invalid="ignore", over="ignore"):
            points[(np.abs(points - np.median(points[there], axis=0)) > STRAY).any(axis=1)] = np.nan


def _seen(path: Path, cloud: CloudRecords, points: Float64, options: ImportOptions) -> _View:
    if cloud.organised and not options.axes:
        return _organised(path, cloud, points, options)
    return _unorganised(path, cloud, points, options)


def _organised(path: Path, cloud: CloudRecords, points: Float64, options: ImportOptions) -> _View:
    shape = cloud.grid or (1, len(points))
    found = _grid(path, points.reshape(*shape, 3), cloud.viewpoint, options.mirror)
    camera, pose = found.intrinsics, found.camera_from_cloud
    if options.intrinsics is not None:
        camera = read_intrinsics(options.intrinsics, camera.shape).depth
        camera.check_size("organised cloud", shape)
    seen = points @ pose.rotation.T + pose.translation_m
    scale, unit = _unit(path, seen, options)
    shown = np.where(np.isfinite(seen[:, 2]) & (seen[:, 2] > 0), np.arange(len(seen)), -1).reshape(shape)
    how = (
        f"intrinsics fitted to the organised cloud ({found.how}): fx {camera.fx:.2f}, fy {camera.fy:.2f}, "
        f"cx {camera.cx:.2f}, cy {camera.cy:.2f}, residual {found.residual_px:.2g} px"
    )
    return _View(camera, seen * scale, shown, (how, *unit), organised=True)


def _grid(path: Path, points: Float64, viewpoint: Pose | None, mirror: bool) -> GridCamera:
    """The camera of the grid; with ``mirror`` also of a grid that is the mirror image of its coordinates."""
    if mirror:
        with suppress(FormatError):
            found = grid_camera(path, points[:, ::-1], viewpoint)
            camera = found.intrinsics
            return found._replace(intrinsics=replace(camera, cx=camera.width - 1 - camera.cx))
    return grid_camera(path, points, viewpoint)


def _unit(path: Path, seen: Float64, options: ImportOptions) -> tuple[float, tuple[str, ...]]:
    """Metres of a unit of camera-frame points (n, 3), and a note where it is no metre."""
    ahead = seen[seen[:, 2] > 0, 2]
    distance = float(np.median(ahead)) if len(ahead) else 0.0
    return _scale(path, distance, ahead, options)


def _scale(
    path: Path, distance: float, along: Float64, options: ImportOptions
) -> tuple[float, tuple[str, ...]]:
    given = options.depth_unit_mm
    millimetres = given or unit_mm(path, distance, along)
    if millimetres == 1000.0:
        return 1.0, ()
    source = "as given" if given else f"since half of the points are more than {distance:.4g} units away"
    return millimetres / 1000, (f"a unit of the cloud is {millimetres:g} mm, {source}",)


def _unorganised(path: Path, cloud: CloudRecords, points: Float64, options: ImportOptions) -> _View:
    finite = points[np.isfinite(points[:, 0])]
    # The Kinect SDK's y is found afterwards: its cone is that of "camera".
    tried = (options.axes,) if options.axes else tuple(name for name in AXES if name != "kinect")
    for pose, where in _sensors(cloud, thinned(finite)):
        cone = cone_of(thinned(finite) @ pose.rotation.T + pose.translation_m, tried)
        if cone is not None:
            return _in_place(path, points, pose, where, cone.name, options)
    return _moved(path, points, finite, options)


def _sensors(cloud: CloudRecords, few: Float64) -> list[tuple[Pose, str]]:
    """Where the sensor may be: the poses that bring the points into its frame, the likelier first.

    A PCD's VIEWPOINT is the sensor's pose in the frame of the points (PointCloudLibrary/pcl#6279). Some
    programs write it beside points that are in the sensor's own frame already (PCLVisualizer,
    PointCloudLibrary/pcl#180; CloudCompare#522): the points lie on the pixels of a camera at the origin.
    """
    own = (Pose.identity(), "at the cloud's origin")
    if cloud.viewpoint is None:
        return [own]
    back = cloud.viewpoint.rotation.T
    stated = (Pose(back, -back @ cloud.viewpoint.translation_m), "at the file's VIEWPOINT")
    return [own, stated] if _fits(few, own[0]) and not _fits(few, stated[0]) else [stated, own]


def _fits(points: Float64, pose: Pose) -> bool:
    sensor = points @ pose.rotation.T + pose.translation_m
    cone = cone_of(sensor)
    return cone is not None and on_pixels(sensor @ camera_from(cone.name).T)


def _in_place(
    path: Path, points: Float64, pose: Pose, where: str, axes: str, options: ImportOptions
) -> _View:
    """The view of a camera in whose frame the points are after ``pose``."""
    sensor = points @ pose.rotation.T + pose.translation_m
    scale, unit = _unit(path, sensor @ camera_from(axes).T, options)
    sure = True
    if not options.axes:
        some = thinned(sensor[np.isfinite(sensor[:, 0])]) * scale
        axes, sure = upright(some, axes)
    seen = (sensor @ camera_from(axes).T) * scale
    camera, spacing = _camera(seen, options)
    shown = project_cloud(seen, camera, spacing)
    lens = "its own pixels" if spacing == 0 else "Kinect v2 focal length"
    lens = "as declared" if options.intrinsics else lens
    how = [
        f"cloud with {axes} axes left in place, seen by a camera {where}: "
        f"{camera.width}x{camera.height}, {lens}, fx {camera.fx:.2f}, fy {camera.fy:.2f}, "
        f"cx {camera.cx:.2f}, cy {camera.cy:.2f}"
    ]
    if not sure:
        how.append(
            "neither floor nor head shows that y points down; if the image is upside down: --axes kinect"
        )
    return _View(camera, seen, shown, (*how, *unit), spacing_m=spacing)


def _camera(seen: Float64, options: ImportOptions) -> tuple[Intrinsics, float]:
    """The camera that the user declares, without its lens, else ``camera_of``; and the points' spacing."""
    camera, spacing = camera_of(seen)
    if options.intrinsics is None:
        return camera, spacing
    declared = read_intrinsics(options.intrinsics).depth.undistorted()
    same = spacing == 0 and abs(declared.fx - camera.fx) < SAME_FOCAL * camera.fx
    return declared, 0.0 if same else spacing_m(seen[np.isfinite(seen[:, 0])])


def _moved(path: Path, points: Float64, finite: Float64, options: ImportOptions) -> _View:
    """The view of a Kinect v2 in front of a cloud that no camera at its origin saw."""
    size = float(np.linalg.norm(np.ptp(np.percentile(thinned(finite), (2, 98), axis=0), axis=0)))
    scale, unit = _scale(path, size, np.zeros(0), options)
    middle = np.rint(np.median(finite, axis=0)) if np.abs(finite).max() * scale > 1000 else np.zeros(3)
    some = (thinned(finite) - middle) * scale
    mapped = path.suffix.lower() in MAPS
    axes = options.axes or world_axes(some, mapped)
    if axes is None:
        raise FormatError(
            f"{path}: no camera at the cloud's origin sees it all, and neither a floor nor somebody upright "
            f"shows which way is up; give --axes: {', '.join(AXES)}"
        )
    turned = ((points - middle) * scale) @ camera_from(axes).T
    turned[_apart(turned)] = np.nan
    shift = shift_into_view(turned[np.isfinite(turned[:, 0])], KINECT_V2)
    seen = turned + shift
    spacing = spacing_m(seen[np.isfinite(seen[:, 0])])
    shown = project_cloud(seen, KINECT_V2, spacing)
    how = "cloud with {} axes seen through Kinect v2 intrinsics, moved by ({:.2f}, {:.2f}, {:.2f}) m".format(
        axes, *shift
    )
    return _View(KINECT_V2, seen, shown, (how, *unit), spacing_m=spacing)


def _apart(points_m: Float64) -> NDArray[np.bool_]:
    """Which of the points (n, 3) lie so far outside that the camera would have to go far back for them."""
    low, high = np.percentile(points_m[np.isfinite(points_m[:, 0])], (0.1, 99.9), axis=0)
    room = APART * float((high - low).max())
    with np.errstate(invalid="ignore"):
        return np.asarray(((points_m < low - room) | (points_m > high + room)).any(axis=1))


def _png(colors: NDArray[np.uint8], shown: NDArray[np.intp]) -> bytes:
    """The colours (n, 3) of the pixels' points as a PNG; black where there is none."""
    image = np.where((shown >= 0)[..., None], colors[shown], 0).astype(np.uint8)
    return bytes(cv2.imencode(".png", np.ascontiguousarray(image[..., ::-1]))[1].tobytes())
