"""The calibration of a bag's depth and colour cameras, from camera descriptions and transforms."""

from collections import deque
from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import NamedTuple

from sensors.calibration_files.camera_messages import (
    Decoded,
    describes,
    intrinsics_from,
    links_from,
    window_of,
)
from sensors.calibration_files.intrinsics_file import read_intrinsics
from sensors.checks.camera_check import check_camera
from sensors.errors import CalibrationError, Setting
from sensors.importers.bags.choose import is_aligned
from sensors.importers.bags.ros_images import picture_size
from sensors.importers.bags.ros_messages import Picture, stamp_and_frame
from sensors.importers.options import ImportOptions
from sensors.rig.camera import Intrinsics
from sensors.rig.rig_calibration import Pose, RigCalibration


class Stream(NamedTuple):
    """Image topic with its first image."""

    name: str
    first: Picture

    @property
    def frame(self) -> str:
        """Return the camera's frame in the tree of transforms, without the leading slash of some ROS
        names.
        """
        return self.first.frame_id.lstrip("/")


class Found(NamedTuple):
    """A calibration, notes on its origin, and millimetres of a depth step where a file states them."""

    calibration: RigCalibration
    notes: tuple[str, ...]
    unit_mm: float | None = None


class BagCameras:
    """The camera descriptions of a bag by topic, and its transforms, static ones first."""

    def __init__(self, path: Path, infos: dict[str, Decoded], transforms: Iterator[Decoded]) -> None:
        self._path, self._infos, self._transforms = path, infos, transforms

    def calibrate(self, depth: Stream, color: Stream | None, options: ImportOptions) -> Found:
        """Return the calibration of two image topics. Raises CalibrationError if nothing describes depth."""
        unit_mm = None
        if options.intrinsics is not None:
            width, height = picture_size(depth.first) or (0, 0)
            found = read_intrinsics(options.intrinsics, (height, width))
            lens, origin, unit_mm = found.depth, options.intrinsics.name, found.unit_mm
        else:
            lens, origin = self._lens(depth, Setting.INTRINSICS)
        notes = [f"depth intrinsics from {origin}"]
        if color is not None:
            try:
                color_lens, color_origin = self._color_lens(depth, color, lens, origin)
                one = origin == color_origin and lens.shape == color_lens.shape
                pose, how = self._pose(depth, color, one)
                origins = " and ".join(dict.fromkeys((origin, color_origin)))
                calibration = RigCalibration(lens, color_lens, pose)
                return Found(calibration, (f"intrinsics from {origins}", how), unit_mm)
            except CalibrationError as error:
                notes.append(f"colour images cannot be fused: {error}")
        return Found(RigCalibration(lens), tuple(notes), unit_mm)

    def _lens(self, stream: Stream, *otherwise: Setting) -> tuple[Intrinsics, str]:
        """Return the lens of an image topic, and the camera topic that states the lens.

        otherwise: alternative remedy in the error. Raises CalibrationError where no topic states it at the
        images' size.
        """
        size, near = picture_size(stream.first), described_by(stream.name, set(self._infos))
        candidates = [*near, *self._of_frame(stream)]
        if not candidates:
            raise CalibrationError(
                f"{self._path} has no camera_info for {stream.name}; record that topic as well",
                *otherwise,
            )
        fitting = (name for name in candidates if size is None or describes(self._infos[name], size))
        name = next(fitting, candidates[0])
        info, described = self._infos[name], window_of(self._infos[name]).size
        if size is not None and not describes(info, size):
            raise CalibrationError(
                f"{name} describes images of {described[0]}x{described[1]}, {stream.name} has images of "
                f"{size[0]}x{size[1]}; record both in one mode"
            )
        rectified = "rect" in stream.name.lower().removesuffix("/compressed").rpartition("/")[2]
        return check_camera(intrinsics_from(info, rectified, name, size or described), name), name

    def _color_lens(
        self, depth: Stream, color: Stream, lens: Intrinsics, origin: str
    ) -> tuple[Intrinsics, str]:
        """Return the lens of colour, or the lens of depth if both are one camera and no message describes
        colour.
        """
        one = bool(depth.frame) and depth.frame == color.frame
        try:
            return self._lens(color)
        except CalibrationError:
            if one and picture_size(color.first) == (lens.width, lens.height):
                return lens, origin
            raise

    def _of_frame(self, stream: Stream) -> list[str]:
        """Return the camera_info topics with a stream's coordinate frame.

        If there are none, a bag's only camera_info is returned where either frame has no name, or where the
        stream's name says "aligned".
        """
        frames = {name: stamp_and_frame(info)[1].lstrip("/") for name, info in self._infos.items()}
        same = [name for name in sorted(frames) if stream.frame and frames[name] == stream.frame]
        if same or len(frames) != 1:
            return same
        name = next(iter(frames))
        return [name] if not stream.frame or not frames[name] or is_aligned(stream.name) else []

    def _pose(self, depth: Stream, color: Stream, same_info: bool) -> tuple[Pose, str]:
        """Return the pose color_from_depth, and a note on its origin.

        The pose is the identity for a shared frame, else follows the first transforms between the frames.
        same_info: True if one message describes both topics at one size; without transforms they are then one
        camera. Raises CalibrationError where nothing joins the two.
        """
        if depth.frame == color.frame and depth.frame:
            return Pose.identity(), f"depth and colour share the frame {depth.frame[:60]!r}"
        links: dict[tuple[str, str], Pose] = {}
        wanted = {depth.frame, color.frame}
        for parent, child, pose in chain.from_iterable(map(links_from, self._transforms)):
            wanted -= {parent, child}
            if links.setdefault((parent, child), pose) is not pose or wanted:
                continue
            if (found := path_between(links, depth.frame, color.frame)) is not None:
                return found, "pose of the colour camera from tf"
        if same_info:
            return Pose.identity(), "depth and colour share their camera_info: taken as aligned"
        raise CalibrationError(
            f"{self._path} has no transform from depth ({depth.frame[:60]!r}) to colour "
            f"({color.frame[:60]!r}); record /tf_static"
        )


def described_by(picture: str, cameras: set[str]) -> list[str]:
    """Return the topics that may describe an image topic's camera: beside it, or beside its source."""
    found, parent = [], picture
    while "/" in parent:
        parent = parent.rpartition("/")[0]
        names = (f"{parent}/{name}" for name in ("camera_info", "calibration", "info"))
        found += [name for name in names if name in cameras]
    return found


def path_between(links: dict[tuple[str, str], Pose], depth: str, color: str) -> Pose | None:
    """Return the pose color_from_depth along the tree of frames, or None where nothing joins the two.

    links: parent_from_child by (parent, child).
    """
    neighbours: dict[str, list[str]] = {}
    for parent, child in links:
        neighbours.setdefault(parent, []).append(child)
        neighbours.setdefault(child, []).append(parent)
    before, waiting = {depth: depth}, deque([depth])
    while waiting and color not in before:
        frame = waiting.popleft()
        new = [neighbour for neighbour in neighbours.get(frame, []) if neighbour not in before]
        before.update(dict.fromkeys(new, frame))
        waiting.extend(new)
    if color not in before:
        return None
    pose, frame = Pose.identity(), color
    while frame != depth:
        last, frame = frame, before[frame]
        pose = pose @ (links[last, frame] if (last, frame) in links else links[frame, last].inverse())
    return pose
