"""A ROS 1 or 2 bag, or an MCAP file with ROS 2 or Foxglove images, as a source of frames."""

from pathlib import Path

import numpy as np

from sensors.checks.depth_check import judge_depth, spread
from sensors.errors import FormatError
from sensors.importers.bags.bag_camera import BagCameras, Stream
from sensors.importers.bags.bag_files import open_files
from sensors.importers.bags.choose import Meaning, choose, holds_depth, meaning_of
from sensors.importers.bags.ros_images import FINE_MM, Depth, color_encoded_from, depth_from
from sensors.importers.bags.ros_messages import PICTURES, Picture, picture_from
from sensors.importers.bags.timeline import paired
from sensors.importers.bags.topics import index_topics
from sensors.importers.options import AS_STATED, ImportOptions
from sensors.rig.frame import FrameSource, RigFrame


class Bag(FrameSource):
    """A bag as a ``FrameSource``: its depth images, with the colour nearest in time.

    notes: topics that are read, origin of the calibration, missing and assumed data. Raises FormatError
    without depth, or CalibrationError where nothing describes the depth camera.
    """

    path: Path

    def __init__(self, path: Path, options: ImportOptions = AS_STATED) -> None:
        self.path, self.name = path, path.stem
        files = open_files(path)
        topics = index_topics(files)
        pictures = {n: picture_from(t.read(0)) for n, t in topics.items() if t.kind in PICTURES and len(t)}
        chosen = choose(pictures, options.topics)
        lost = [file.lost for file in files if file.lost]
        if chosen is None:
            held = "; ".join([_listed(pictures, sorted(pictures)) or "no images", *lost])
            raise FormatError(
                f"{path} has no depth images: it has {held}; "
                "record depth (16UC1, 32FC1, compressedDepth or PNG of 16 bits), or choose one by --topic"
            )
        read = [topics[name] for name in (chosen.depth, chosen.color) if name]
        self._depth, self._color = read[0], read[1] if chosen.color else None
        streams = [Stream(topic.name, pictures[topic.name]) for topic in read]
        found = BagCameras(path, topics).calibrate(streams[0], streams[1] if chosen.color else None, options)
        self.calibration, self.times_ns = found.calibration, self._depth.timeline.times_ns
        samples = [self._depth_at(index) for index in spread(len(self._depth))]
        self._reading = judge_depth(samples, options.depth_unit_mm or found.unit_mm, chosen.depth, FINE_MM)
        self._pairs, apart = np.full(len(self._depth), -1, np.int64), tuple[str, ...]()
        if self._color is not None:
            self._pairs, apart = paired(self._depth.timeline, self._color.timeline)
        ignored = sorted(set(pictures) - {chosen.depth, chosen.color})
        self.notes = (
            *chosen.notes,
            *found.notes,
            *self._reading.notes,
            *(note for topic in read for note in topic.notes),
            *apart,
            "no thermal images",
            *([f"not read: {_listed(pictures, ignored)}"] if ignored else []),
            *lost,
        )

    def _depth_at(self, index: int) -> Depth:
        return depth_from(picture_from(self._depth.read(index)))

    def _frame(self, index: int) -> RigFrame:
        depth_mm = self._reading.to_mm(self._depth_at(index))
        encoded, pair = None, int(self._pairs[index])
        if self._color is not None and pair >= 0:
            encoded = color_encoded_from(picture_from(self._color.read(pair)))
        return RigFrame(index, int(self.times_ns[index]), depth_mm, encoded)


def _listed(pictures: dict[str, Picture], names: list[str]) -> str:
    """Return the first topics with their encodings, in words; marked where the name alone excludes depth."""

    def shown(name: str) -> str:
        image = pictures[name]
        why = ", no depth by its name" if holds_depth(image) and meaning_of(name) is not Meaning.DEPTH else ""
        return f"{name} ({image.encoding[:40].strip()}{why})"

    return ", ".join(map(shown, names[:8])) + (f" and {len(names) - 8} more" if len(names) > 8 else "")
