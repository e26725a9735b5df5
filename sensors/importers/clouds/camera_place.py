"""Position and unit of a cloud's camera and its view of the points, found in the points or declared.

Constants are untuned unless a source is given.
"""

from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sensors.calibration_files.intrinsics_file import read_intrinsics
from sensors.errors import FormatError, Note, Setting
from sensors.importers.clouds.axes import (
    AXES,
    FLOOR_SHARE,
    camera_from,
    floor_share,
    is_credible,
    narrowest_cone,
    on_pixels,
    subsample,
    upright_axes,
    world_axes,
)
from sensors.importers.clouds.organised_camera import GridCamera, grid_camera
from sensors.importers.clouds.projection import (
    KINECT_V2,
    find_camera,
    project_cloud,
    shift_into_view,
    spacing_m,
)
from sensors.importers.clouds.records import CloudRecords
from sensors.importers.options import ImportOptions
from sensors.rig.camera import Intrinsics
from sensors.rig.rig_calibration import Pose

Float64 = NDArray[np.float64]

APART = 1.0  # farthest point from its cloud, in sizes of the cloud without its outermost 0.1 %
SAME_FOCAL = 0.003  # difference up to which a declared camera took the points: a pixel at the edge
MIRRORED = (
    "x is taken to point to the camera's left, as in the Kinect SDK; where it points right (Unity), "
    "mirror the image, because left and right are exchanged"
)
MAPS = (".las", ".laz")  # formats of maps, in which z points up
FARAWAY_M = 1000.0  # distance beyond which coordinates are a map's (UTM), with z up in any format
METRES = (0.1, 30.0)  # typical distances in metres: depth cameras measure 0.2 to 10 m
MILLIMETRES = (600.0, 60_000.0)  # the same in millimetres; 600 cm are farther than people are recorded
STEPS_MM = {"millimetres": 1.0, "centimetres": 10.0, "inches": 25.4}  # units between these


@dataclass(frozen=True)
class CloudView:
    """View of a cloud from its camera.

    points_m: camera frame (n, 3), in the file's order, NaN = none. shown: index (h, w) of each pixel's point,
    -1 = none. how: notes on findings and assumptions. organised: True if point n is pixel n. spacing_m:
    distance of neighbouring points on a surface, 0 = one point per pixel. scale: metres of the file's unit.
    """

    camera: Intrinsics
    points_m: Float64
    shown: NDArray[np.intp]
    how: tuple[str, ...]
    organised: bool = False
    spacing_m: float = 0.0
    scale: float = 1.0


def view_of(path: Path, cloud: CloudRecords, points: Float64, options: ImportOptions) -> CloudView:
    """Return the view of ``points`` (n, 3) of ``cloud``, in its unit, NaN = none. Raises FormatError where
    its unit or grid is unclear.
    """
    if cloud.organised and not options.axes:
        return _organised(path, cloud, points, options)
    finite = points[np.isfinite(points[:, 0])]
    # The Kinect SDK's y is found afterwards: its cone is the one of "camera".
    tried = (options.axes,) if options.axes else tuple(name for name in AXES if name != "kinect")
    for sensor in _sensors(cloud, subsample(finite)):
        few = subsample(finite) @ sensor.pose.rotation.T + sensor.pose.translation_m
        cone = narrowest_cone(few, tried)
        if cone is None:
            continue
        scale, _ = _unit(path, few @ camera_from(cone.name).T, options)
        if options.axes or is_credible(few * scale, cone):
            return _in_place(path, points, sensor, cone.name, options)
    return _moved(path, points, finite, options)


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
    """Return the camera of an organised cloud. mirror: True to accept a grid that mirrors its coordinates."""
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
    millimetres = given or _unit_mm(path, distance, along)
    if millimetres == 1000.0:
        return 1.0, ()
    source = "as given" if given else f"since half of the points are more than {distance:.4g} units away"
    return millimetres / 1000, (f"a unit of the cloud is {millimetres:g} mm, {source}",)


def _unit_mm(path: Path, distance: float, along: Float64) -> float:
    """Return the millimetres of a unit of the cloud, because files state no unit.

    distance: typical distance from the camera, in the file's unit; for a cloud without a camera, its size.
    along: depths (n,) in the file's unit. Cameras measure whole millimetres, so depths distinguish units
    where the distance does not. Raises FormatError where the unit stays unknown, with the remedy.
    """
    if METRES[0] <= distance <= METRES[1]:
        return 1000.0
    if MILLIMETRES[0] <= distance <= MILLIMETRES[1]:
        return 1.0
    if METRES[1] < distance < MILLIMETRES[0]:
        for unit in STEPS_MM.values():
            millimetres = along * unit
            away = np.abs(millimetres - np.rint(millimetres))
            odd = np.mod(np.rint(millimetres), 5) != 0
            if len(away) > 20 and np.percentile(away, 95) < 0.05 and odd.mean() > 0.2:
                return unit
        guesses = ", ".join(f"{distance * unit / 1000:.2g} m as {name}" for name, unit in STEPS_MM.items())
        raise FormatError(
            f"{path}: half of the points are over {distance:.4g} units of unknown length away ({guesses}); "
            "give the millimetres of a unit: 10 for centimetres, 25.4 for inches, 1 for millimetres",
            Setting.DEPTH_UNIT,
        )
    raise FormatError(
        f"{path}: half of the points are {'over' if distance > 1 else 'under'} {distance:.4g} units away, "
        "impossible in metres or millimetres; give the millimetres of a unit",
        Setting.DEPTH_UNIT,
    )


class _Sensor(NamedTuple):
    """Possible sensor of a cloud. pose: ``sensor_from_cloud``; where: description of its position."""

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
    cone = narrowest_cone(sensor)
    return cone is not None and on_pixels(sensor @ camera_from(cone.name).T)


def _in_place(path: Path, points: Float64, found: _Sensor, axes: str, options: ImportOptions) -> CloudView:
    """Return the view of a camera at the sensor's pose."""
    sensor = points @ found.pose.rotation.T + found.pose.translation_m
    scale, unit = _unit(path, sensor @ camera_from(axes).T, options)
    sure = True
    if not options.axes:
        axes, sure = upright_axes(subsample(sensor[np.isfinite(sensor[:, 0])]) * scale, axes)
    seen = (sensor @ camera_from(axes).T) * scale
    camera, spacing = find_camera(seen)
    lens = "its own pixels" if spacing == 0 else "Kinect v2 focal length"
    if options.intrinsics is not None:
        declared = read_intrinsics(options.intrinsics).depth.undistorted()
        same = spacing == 0 and abs(declared.fx - camera.fx) < SAME_FOCAL * camera.fx
        camera, spacing = declared, 0.0 if same else spacing_m(seen[np.isfinite(seen[:, 0])])
        lens = "as declared"
    how = [
        f"cloud with {axes} axes left in place, seen by a camera {found.where}: "
        f"{camera.width}x{camera.height}, {lens}, fx {camera.fx:.2f}, fy {camera.fy:.2f}, "
        f"cx {camera.cx:.2f}, cy {camera.cy:.2f}"
    ]
    if not sure:
        other = "kinect" if axes == "camera" else "camera"
        how.append(_where_y_points(other))
    if axes == "kinect" and not options.axes:
        how.append(Note(MIRRORED, Setting.MIRROR))
    shown = project_cloud(seen, camera, spacing)
    return CloudView(camera, seen, shown, (*how, *unit), spacing_m=spacing, scale=scale)


def _moved(path: Path, points: Float64, finite: Float64, options: ImportOptions) -> CloudView:
    """Return the view of a Kinect v2 placed in front of a cloud that has no camera at its origin."""
    size = float(np.linalg.norm(np.ptp(np.percentile(subsample(finite), (2, 98), axis=0), axis=0)))
    scale, unit = _scale(path, size, np.zeros(0), options)
    middle = np.rint(np.median(finite, axis=0)) if np.abs(finite).max() * scale > FARAWAY_M else np.zeros(3)
    some = (subsample(finite) - middle) * scale
    mapped = path.suffix.lower() in MAPS or bool(middle.any())
    axes = options.axes or world_axes(some, mapped)
    if axes is None:
        raise FormatError(
            f"{path}: no camera at the cloud's origin sees it all, and neither a floor nor a standing person "
            f"shows the direction up; give the axes: {', '.join(AXES)}",
            Setting.AXES,
        )
    turned = ((points - middle) * scale) @ camera_from(axes).T
    turned[_outliers(turned)] = np.nan
    shift = shift_into_view(turned[np.isfinite(turned[:, 0])], KINECT_V2)
    seen = turned + shift
    spacing = spacing_m(seen[np.isfinite(seen[:, 0])])
    moved = ", ".join(f"{number:.2f}" for number in shift)
    how = [f"cloud with {axes} axes seen through Kinect v2 intrinsics, moved by ({moved}) m"]
    if axes == "y-up" and not options.axes and floor_share(some, AXES[axes][1]) < FLOOR_SHARE:
        how.append(_where_y_points("camera"))
    shown = project_cloud(seen, KINECT_V2, spacing)
    return CloudView(KINECT_V2, seen, shown, (*how, *unit), spacing_m=spacing, scale=scale)


def _where_y_points(other: str) -> Note:
    """Return the note that the axes are a guess. other: axes of an image that is upside down."""
    doubt = f"no floor shows where y points; if the image is upside down, the axes are {other}"
    return Note(doubt, Setting.AXES)


def _outliers(points_m: Float64) -> NDArray[np.bool_]:
    """Return flags of points (n, 3) far outside the rest, which would move the camera far back."""
    low, high = np.percentile(points_m[np.isfinite(points_m[:, 0])], (0.1, 99.9), axis=0)
    room = APART * float((high - low).max())
    with np.errstate(invalid="ignore"):
        return np.asarray(((points_m < low - room) | (points_m > high + room)).any(axis=1))
