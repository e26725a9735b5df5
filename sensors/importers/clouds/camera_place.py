"""Place of a cloud's camera and its view of the points, found in them or declared."""

from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sensors.calibration_files.intrinsics_file import read_intrinsics
from sensors.errors import FormatError
from sensors.importers.clouds.axes import (
    AXES,
    FLOOR_SHARE,
    camera_from,
    cone_of,
    credible,
    floor_share,
    on_pixels,
    thinned,
    upright,
    world_axes,
)
from sensors.importers.clouds.organised_camera import GridCamera, grid_camera
from sensors.importers.clouds.projection import (
    KINECT_V2,
    camera_of,
    project_cloud,
    shift_into_view,
    spacing_m,
)
from sensors.importers.clouds.records import CloudRecords
from sensors.importers.clouds.unit import unit_mm
from sensors.importers.options import ImportOptions
from sensors.rig.camera import Intrinsics
from sensors.rig.rig_calibration import Pose

Float64 = NDArray[np.float64]

APART = 1.0
"""Largest distance of a point from its cloud, in sizes of the cloud without its outermost 0.1 %. Untuned."""
SAME_FOCAL = 0.003
"""Relative difference of focal lengths up to which a declared camera took the points: a pixel at the edge of
a wide image."""
MAPS = (".las", ".laz")
"""Suffixes of maps' formats, in which z points up."""
FARAWAY_M = 1000.0
"""Metres from the origin beyond which coordinates are a map's (UTM), with z up in any format. Untuned."""


@dataclass(frozen=True)
class CloudView:
    """View of a cloud. points_m: camera frame (n, 3), in the file's order, NaN = none.
    shown: index (h, w) of each pixel's point, -1 = none. how: notes on findings and assumptions.
    organised: whether point n is pixel n. spacing_m: of the points' surface, 0 = a pixel each.
    scale: metres of the file's unit."""

    camera: Intrinsics
    points_m: Float64
    shown: NDArray[np.intp]
    how: tuple[str, ...]
    organised: bool = False
    spacing_m: float = 0.0
    scale: float = 1.0


def view_of(path: Path, cloud: CloudRecords, points: Float64, options: ImportOptions) -> CloudView:
    """Return the view of ``points`` (n, 3), those of ``cloud`` in its unit, NaN = none.

    Raises FormatError.
    """
    if cloud.organised and not options.axes:
        return _organised(path, cloud, points, options)
    return _unorganised(path, cloud, points, options)


def _organised(path: Path, cloud: CloudRecords, points: Float64, options: ImportOptions) -> CloudView:
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
    return CloudView(camera, seen * scale, shown, (how, *unit), organised=True, scale=scale)


def _grid(path: Path, points: Float64, viewpoint: Pose | None, mirror: bool) -> GridCamera:
    """Return the camera of the grid.

    mirror: whether the grid may be the mirror image of its coordinates.
    """
    if mirror:
        with suppress(FormatError):
            found = grid_camera(path, points[:, ::-1], viewpoint)
            camera = found.intrinsics
            return found._replace(intrinsics=replace(camera, cx=camera.width - 1 - camera.cx))
    return grid_camera(path, points, viewpoint)


def _unit(path: Path, seen: Float64, options: ImportOptions) -> tuple[float, tuple[str, ...]]:
    """Return the metres of a unit of camera-frame points (n, 3), and a note on any unit but metres."""
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


def _unorganised(path: Path, cloud: CloudRecords, points: Float64, options: ImportOptions) -> CloudView:
    finite = points[np.isfinite(points[:, 0])]
    # The Kinect SDK's y is found afterwards: its cone is that of "camera".
    tried = (options.axes,) if options.axes else tuple(name for name in AXES if name != "kinect")
    for sensor in _sensors(cloud, thinned(finite)):
        few = thinned(finite) @ sensor.pose.rotation.T + sensor.pose.translation_m
        cone = cone_of(few, tried)
        if cone is None:
            continue
        scale, _ = _unit(path, few @ camera_from(cone.name).T, options)
        if options.axes or credible(few * scale, cone):
            return _in_place(path, points, sensor, cone.name, options)
    return _moved(path, points, finite, options)


class _Sensor(NamedTuple):
    """Possible sensor of a cloud. pose: ``sensor_from_cloud``; where: its place, in words."""

    pose: Pose
    where: str


def _sensors(cloud: CloudRecords, few: Float64) -> list[_Sensor]:
    """Return possible poses of the sensor, which bring the points into its frame, likelier ones first.

    A PCD's VIEWPOINT is the sensor's pose in the frame of the points (PointCloudLibrary/pcl#6279). Some
    programs write it beside points that are in the sensor's own frame already (PCLVisualizer,
    PointCloudLibrary/pcl#180; CloudCompare#522). Such points lie on the pixels of a camera at the origin.
    """
    own = _Sensor(Pose.identity(), "at the cloud's origin")
    if cloud.viewpoint is None:
        return [own]
    back = cloud.viewpoint.rotation.T
    stated = _Sensor(Pose(back, -back @ cloud.viewpoint.translation_m), "at the file's VIEWPOINT")
    return [own, stated] if _fits(few, own.pose) and not _fits(few, stated.pose) else [stated, own]


def _fits(points: Float64, pose: Pose) -> bool:
    sensor = points @ pose.rotation.T + pose.translation_m
    cone = cone_of(sensor)
    return cone is not None and on_pixels(sensor @ camera_from(cone.name).T)


def _in_place(path: Path, points: Float64, found: _Sensor, axes: str, options: ImportOptions) -> CloudView:
    """Return the view of a camera that is the sensor."""
    sensor = points @ found.pose.rotation.T + found.pose.translation_m
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
        f"cloud with {axes} axes left in place, seen by a camera {found.where}: "
        f"{camera.width}x{camera.height}, {lens}, fx {camera.fx:.2f}, fy {camera.fy:.2f}, "
        f"cx {camera.cx:.2f}, cy {camera.cy:.2f}"
    ]
    if not sure:
        other = "kinect" if axes == "camera" else "camera"
        how.append(
            f"no floor shows where y points; if the image is upside down: import it with --axes {other}"
        )
    if axes == "kinect" and not options.axes:
        how.append(
            "x is taken to point to the camera's left, as in the Kinect SDK; where it points right (Unity), "
            "left and right are mirrored: import it with --mirror"
        )
    return CloudView(camera, seen, shown, (*how, *unit), spacing_m=spacing, scale=scale)


def _camera(seen: Float64, options: ImportOptions) -> tuple[Intrinsics, float]:
    """Return the declared camera without its lens, else ``camera_of``; and the points' spacing."""
    camera, spacing = camera_of(seen)
    if options.intrinsics is None:
        return camera, spacing
    declared = read_intrinsics(options.intrinsics).depth.undistorted()
    same = spacing == 0 and abs(declared.fx - camera.fx) < SAME_FOCAL * camera.fx
    return declared, 0.0 if same else spacing_m(seen[np.isfinite(seen[:, 0])])


def _moved(path: Path, points: Float64, finite: Float64, options: ImportOptions) -> CloudView:
    """Return the view of a Kinect v2 in front of a cloud that no camera at its origin took."""
    size = float(np.linalg.norm(np.ptp(np.percentile(thinned(finite), (2, 98), axis=0), axis=0)))
    scale, unit = _scale(path, size, np.zeros(0), options)
    middle = np.rint(np.median(finite, axis=0)) if np.abs(finite).max() * scale > FARAWAY_M else np.zeros(3)
    some = (thinned(finite) - middle) * scale
    mapped = path.suffix.lower() in MAPS or bool(middle.any())
    axes = options.axes or world_axes(some, mapped)
    if axes is None:
        raise FormatError(
            f"{path}: no camera at the cloud's origin sees it all, and neither a floor nor a standing person "
            f"shows the direction up; import it with --axes: {', '.join(AXES)}"
        )
    turned = ((points - middle) * scale) @ camera_from(axes).T
    turned[_apart(turned)] = np.nan
    shift = shift_into_view(turned[np.isfinite(turned[:, 0])], KINECT_V2)
    seen = turned + shift
    spacing = spacing_m(seen[np.isfinite(seen[:, 0])])
    shown = project_cloud(seen, KINECT_V2, spacing)
    how = [
        "cloud with {} axes seen through Kinect v2 intrinsics, moved by ({:.2f}, {:.2f}, {:.2f}) m".format(
            axes, *shift
        )
    ]
    if axes == "y-up" and not options.axes and floor_share(some, AXES[axes][1]) < FLOOR_SHARE:
        how.append("no floor shows where y points; if the image is upside down: import it with --axes camera")
    return CloudView(KINECT_V2, seen, shown, (*how, *unit), spacing_m=spacing, scale=scale)


def _apart(points_m: Float64) -> NDArray[np.bool_]:
    """Return flags of the points (n, 3) far outside, which would move the camera far back."""
    low, high = np.percentile(points_m[np.isfinite(points_m[:, 0])], (0.1, 99.9), axis=0)
    room = APART * float((high - low).max())
    with np.errstate(invalid="ignore"):
        return np.asarray(((points_m < low - room) | (points_m > high + room)).any(axis=1))
