"""A ROS 1 or ROS 2 bag, or somebody else's MCAP file with ROS 2 or Foxglove images, as a source of frames."""

import re
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from sensors.errors import CalibrationError, FormatError
from sensors.importers.bags.bag_files import McapFile, index_topics, open_files
from sensors.importers.bags.ros_images import COLORS, DEPTHS, color_encoded_from, depth_mm_from
from sensors.importers.bags.ros_messages import CAMERAS, PICTURES, TRANSFORMS, Picture, picture_from
from sensors.rig.camera import Intrinsics
from sensors.rig.camera_messages import intrinsics_from, links_from
from sensors.rig.frame import FrameSource, RigFrame
from sensors.rig.pairing import COLOR_WINDOW_NS, pair_stamps
from sensors.rig.rig_calibration import Pose, RigCalibration
from sensors.session.mcap_records import is_complete

_OTHERS = re.compile(
    r"infra|thermal|confidence|mask|segment|label|fisheye|amplitude|(?<![a-z])ir\d?(?![a-z])"
)
"""Names of 16-bit or 8-bit images that are neither depth nor colour."""


class Bag(FrameSource):
    """A bag as a ``FrameSource``: its depth images, with the colour nearest in time.

    notes: which topics are read, where the calibration is from, what is absent. Raises FormatError, or
    CalibrationError where nothing describes the depth camera.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.name = path, path.stem
        files = open_files(path)
        self._topics = index_topics(files)
        pictures = {name: picture_from(t.read(0)) for name, t in self._topics.items() if t.kind in PICTURES}
        depth = choose_depth(pictures)
        if depth is None:
            raise FormatError(
                f"{path} has no depth images (16UC1, mono16, 32FC1 or compressedDepth; it has "
                f"{', '.join(sorted(pictures)[:8]) or 'no images'}); record a depth topic"
            )
        color = choose_color(pictures)
        self._depth, self._color = self._topics[depth], self._topics[color] if color else None
        self.times_ns = self._depth.stamps_ns
        self.calibration, how = self._calibrate(depth, color, pictures)
        color_ns = self._color.stamps_ns if self._color else np.empty(0, np.int64)
        self._pairs = pair_stamps(self.times_ns, color_ns, COLOR_WINDOW_NS)
        cut = [file.path.name for file in files if isinstance(file, McapFile) and _is_cut(file.path)]
        ignored = sorted(set(pictures) - {depth, color})
        self.notes = (
            f"depth from {depth}",
            f"colour from {color}" if color else "no colour images",
            *how,
            "no thermal images",
            *([f"not read: {', '.join(ignored[:8])}"] if ignored else []),
            *(f"{name} is truncated: its end is lost" for name in cut),
        )

    def _frame(self, index: int) -> RigFrame:
        depth_mm = depth_mm_from(picture_from(self._depth.read(index)))
        encoded, pair = None, int(self._pairs[index])
        if self._color is not None and pair >= 0:
            encoded = color_encoded_from(picture_from(self._color.read(pair)))
        return RigFrame(index, int(self.times_ns[index]), depth_mm, encoded)

    def _calibrate(
        self, depth: str, color: str | None, pictures: dict[str, Picture]
    ) -> tuple[RigCalibration, tuple[str, ...]]:
        """The calibration, and how it was found."""
        lens, origin = self._lens(depth)
        if lens is None:
            raise CalibrationError(f"{self.path} has no camera_info for {depth}; record that topic as well")
        if color is None:
            return RigCalibration(lens), (f"depth intrinsics from {origin}",)
        color_lens, color_origin = self._lens(color, origin)
        frames = [pictures[name].frame_id.lstrip("/") for name in (depth, color)]
        pose, how = self._pose(*frames)
        if color_lens is None or pose is None:
            lacking = "camera_info" if color_lens is None else "transform from depth"
            note = f"no {lacking} of the colour camera: its images cannot be fused"
            return RigCalibration(lens), (f"depth intrinsics from {origin}", note)
        notes = (f"intrinsics from {origin} and {color_origin}", how)
        return RigCalibration(lens, color_lens, pose), notes

    def _lens(self, picture: str, taken: str = "") -> tuple[Intrinsics | None, str]:
        """The lens of a picture topic and the topic that describes it, which is not the one ``taken``."""
        cameras = {name: t for name, t in self._topics.items() if t.kind in CAMERAS and name != taken}
        name = described_by(picture, set(cameras))
        if name is None:
            return None, ""
        camera, first = cameras[name].read(0), picture_from(self._topics[picture].read(0))
        size = (camera.width, camera.height) if first.compressed else (first.width, first.height)
        if (camera.width, camera.height) != size:
            raise CalibrationError(
                f"{name} describes {camera.width}x{camera.height}, {picture} is {size[0]}x{size[1]}; "
                "record both in one mode"
            )
        return intrinsics_from(camera, "rect" in picture.rpartition("/")[2], name), name

    def _pose(self, depth_frame: str, color_frame: str) -> tuple[Pose | None, str]:
        """color_from_depth by the first transforms that join the two, static ones before others."""
        if depth_frame == color_frame and depth_frame:
            return Pose.identity(), f"depth and colour share the frame {depth_frame[:60]!r}"
        links: dict[tuple[str, str], Pose] = {}
        wanted = {depth_frame, color_frame}
        for parent, child, pose in self._links():
            wanted -= {parent, child}
            if links.setdefault((parent, child), pose) is not pose or wanted:
                continue
            if (found := path_between(links, depth_frame, color_frame)) is not None:
                return found, "pose of the colour camera from tf"
        return None, ""

    def _links(self) -> Iterator[tuple[str, str, Pose]]:
        topics = [topic for topic in self._topics.values() if topic.kind in TRANSFORMS]
        for topic in sorted(topics, key=lambda topic: ("static" not in topic.name, topic.name)):
            for index in range(len(topic.messages)):
                yield from links_from(topic.read(index))


def choose_depth(first: dict[str, Picture]) -> str | None:
    """The depth topic: one called so rather than not, the sensor's own pixels before resampled ones, raw
    before compressed. first: the first message of every image topic."""
    return _best(first, _is_depth, ("depth", "!aligned|registered|to_color|to_rgb", "!compressed", "rect"))


def choose_color(first: dict[str, Picture]) -> str | None:
    """The colour topic: one called so rather than not, and the camera's own JPEG before decoded pixels."""
    return _best(first, _is_color, ("color|colour|rgb", "!depth", "compressed", "!rect"))


def described_by(picture: str, cameras: set[str]) -> str | None:
    """The topic that describes an image topic's camera: beside it, or beside what it was made from."""
    parent = picture
    while "/" in parent:
        parent = parent.rpartition("/")[0]
        for name in ("camera_info", "calibration", "info"):
            if f"{parent}/{name}" in cameras:
                return f"{parent}/{name}"
    return next(iter(cameras)) if len(cameras) == 1 else None


def path_between(links: dict[tuple[str, str], Pose], depth: str, color: str) -> Pose | None:
    """color_from_depth along the tree of frames, or None where nothing joins the two.

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


def _is_cut(path: Path) -> bool:
    with path.open("rb") as file:
        return not is_complete(file)


def _best(
    first: dict[str, Picture], fits: Callable[[str, Picture], bool], wishes: tuple[str, ...]
) -> str | None:
    """Of the topics that fit, the one with the earliest wishes fulfilled; then the shortest, then by name."""

    def rank(name: str) -> tuple[object, ...]:
        met = [bool(re.search(wish.lstrip("!"), name.lower())) != wish.startswith("!") for wish in wishes]
        return (*(not wish for wish in met), len(name), name)

    return min((name for name, image in first.items() if fits(name, image)), key=rank, default=None)


def _is_depth(name: str, image: Picture) -> bool:
    if image.compressed:
        return "compressedDepth" in image.encoding
    return image.encoding in DEPTHS and not _OTHERS.search(name.lower())


def _is_color(name: str, image: Picture) -> bool:
    if _OTHERS.search(name.lower()):
        return False
    if image.compressed:
        return image.data.startswith((b"\xff\xd8\xff", b"\x89PNG")) and "depth" not in name.lower()
    return image.encoding in COLORS
