"""A ROS 2 bag, or somebody else's MCAP file with ROS 2 or Foxglove images, as a source of frames."""

from collections import deque
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from mcap.records import Channel, Message, Metadata
from numpy.typing import NDArray

from sensors.errors import CalibrationError, FormatError
from sensors.importers.bag_files import McapFile
from sensors.importers.bag_index import BagFile, index_topics, open_files, storage_files
from sensors.importers.bag_topics import choose_color, choose_depth, described_by
from sensors.importers.ros_images import color_encoded_from, depth_mm_from
from sensors.importers.ros_messages import (
    CAMERAS,
    PICTURES,
    TRANSFORMS,
    Camera,
    RawPicture,
    Stamped,
    camera_from,
    links_from,
)
from sensors.rig.camera import Intrinsics
from sensors.rig.frame import RigFrame
from sensors.rig.pairing import COLOR_WINDOW_NS, pair_stamps
from sensors.rig.rig_calibration import Pose, RigCalibration
from sensors.session.mcap_records import is_complete, record_offsets, records_at
from sensors.session.messages import DEPTH, METADATA

MAX_TRANSFORMS = 1000
"""Messages with transforms that are looked at, from the first on: cameras do not move on a rig."""
MAX_TRANSFORM_BYTES = 2_000_000
"""Of all of them together: 16,000 transforms, ten seconds."""


class Bag:
    """A bag as a ``FrameSource``: its depth images, with the colour nearest in time.

    notes: which topics are read, where the calibration is from, what is absent. Raises FormatError, or
    CalibrationError where nothing describes the depth camera.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.name = path, path.stem
        files = open_files(path)
        self._topics = index_topics(files)
        pictures = {name: t.picture(0) for name, t in self._topics.items() if t.kind in PICTURES}
        depth = choose_depth(pictures)
        if depth is None:
            raise FormatError(
                f"{path} has no depth images (16UC1, mono16, 32FC1 or compressedDepth) but "
                f"{', '.join(sorted(pictures)[:8]) or 'no image topic'}; record a depth topic"
            )
        color = choose_color(pictures)
        self._depth, self._color = self._topics[depth], self._topics[color] if color else None
        self.calibration, how = self._calibrate(depth, color, pictures)
        self._pairs = self._paired()
        cut = [file.path.name for file in files if _is_cut(file)]
        ignored = sorted(set(pictures) - {depth, color})
        self.notes = (
            f"depth from {depth}",
            f"colour from {color}" if color else "no colour images",
            *how,
            "no thermal images",
            *([f"not read: {', '.join(ignored[:8])}"] if ignored else []),
            *(f"{name} is truncated: its end is lost" for name in cut),
        )

    def __len__(self) -> int:
        return len(self._depth.stamps_ns)

    def __iter__(self) -> Iterator[RigFrame]:
        return (self.frame(index) for index in range(len(self)))

    def frame(self, index: int) -> RigFrame:
        """Frame ``index`` of 0 .. len - 1. Raises IndexError, FormatError or CalibrationError."""
        if not 0 <= index < len(self):
            raise IndexError(index)
        picture = self._depth.picture(index).picture
        depth_mm = depth_mm_from(picture) if picture else np.zeros((0, 0), np.uint16)
        if depth_mm.shape != self.calibration.depth.shape:
            raise CalibrationError(
                f"depth image {index} of {self.path} is {depth_mm.shape}, its calibration "
                f"{self.calibration.depth.shape}; record one mode"
            )
        encoded, pair = None, int(self._pairs[index])
        if self._color is not None and pair >= 0:
            color = self._color.picture(pair).picture
            encoded = color_encoded_from(color) if color else None
        return RigFrame(index, self._depth.stamps_ns[index], depth_mm, encoded)

    def _paired(self) -> NDArray[np.int64]:
        color = [] if self._color is None else self._color.stamps_ns
        stamps = [np.array(stamps, np.int64) for stamps in (self._depth.stamps_ns, color)]
        return pair_stamps(stamps[0], stamps[1], COLOR_WINDOW_NS)

    def _calibrate(
        self, depth: str, color: str | None, pictures: dict[str, Stamped]
    ) -> tuple[RigCalibration, tuple[str, ...]]:
        """The calibration, and how it was found."""
        lens, origin = self._lens(depth)
        if lens is None:
            raise CalibrationError(f"{self.path} has no camera_info for {depth}; record that topic as well")
        if color is None:
            return RigCalibration(lens), (f"depth intrinsics from {origin}",)
        color_lens, color_origin = self._lens(color, origin)
        pose, how = self._pose(pictures[depth].frame_id.lstrip("/"), pictures[color].frame_id.lstrip("/"))
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
        camera: Camera = camera_from(cameras[name].kind, cameras[name].encoding, cameras[name].read(0))
        first = self._topics[picture].picture(0).picture
        size = (first.width, first.height) if isinstance(first, RawPicture) else (camera.width, camera.height)
        if (camera.width, camera.height) != size:
            raise CalibrationError(
                f"{name} describes {camera.width}x{camera.height}, {picture} is {size[0]}x{size[1]}; "
                "record both in one mode"
            )
        return camera.intrinsics("rect" in picture.rpartition("/")[2], name), name

    def _pose(self, depth_frame: str, color_frame: str) -> tuple[Pose | None, str]:
        if depth_frame == color_frame and depth_frame:
            return Pose.identity(), f"depth and colour share the frame {depth_frame[:60]!r}"
        pose = path_between(self._links(), depth_frame, color_frame)
        return pose, "pose of the colour camera from tf"

    def _links(self) -> dict[tuple[str, str], Pose]:
        """parent_from_child by (parent, child); the first of each, static ones before others."""
        links: dict[tuple[str, str], Pose] = {}
        left = MAX_TRANSFORM_BYTES
        topics = {name: t for name, t in self._topics.items() if t.kind in TRANSFORMS}
        for name in sorted(topics, key=lambda name: ("static" not in name, name)):
            topic = topics[name]
            for index in range(min(MAX_TRANSFORMS, len(topic.places))):
                data = topic.read(index)
                left -= len(data)
                if left < 0:
                    return links
                for link in links_from(topic.kind, topic.encoding, data):
                    links.setdefault((link.parent, link.child), link.pose)
        return links


def is_bag(path: Path) -> bool:
    """Whether a folder holds a ROS 2 bag, or an MCAP file is somebody else's rather than a session.

    A file without topics is left to ``Session``, which says what is wrong with it. Raises FormatError.
    """
    if path.is_dir():
        return bool(storage_files(path)) and not (path / "depth").is_dir()
    seen = False
    with path.open("rb") as file:
        for offset in record_offsets(file):
            for record in records_at(file, offset):
                if isinstance(record, Metadata) and record.name == METADATA:
                    return False
                if isinstance(record, Channel):
                    if record.topic == DEPTH and record.message_encoding == "protobuf":
                        return False
                    seen = True
                elif isinstance(record, Message):
                    return seen
    return seen


def path_between(links: dict[tuple[str, str], Pose], depth: str, color: str) -> Pose | None:
    """color_from_depth along the tree of frames, or None where nothing joins the two."""
    steps: dict[str, list[tuple[str, Pose]]] = {}
    for (parent, child), parent_from_child in links.items():
        steps.setdefault(child, []).append((parent, parent_from_child))
        steps.setdefault(parent, []).append((child, parent_from_child.inverse()))
    found, waiting = {depth: Pose.identity()}, deque([depth])
    while waiting and color not in found:
        frame = waiting.popleft()
        for neighbour, neighbour_from_frame in steps.get(frame, []):
            if neighbour not in found:
                found[neighbour] = neighbour_from_frame @ found[frame]
                waiting.append(neighbour)
    return found.get(color) if color else None


def _is_cut(file: BagFile) -> bool:
    if not isinstance(file, McapFile):
        return False
    with file.path.open("rb") as opened:
        return not is_complete(opened)
