"""A ROS 1 or 2 bag, or an MCAP file with ROS 2 or Foxglove images, as a source of frames."""

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np

from sensors.calibration_files.camera_messages import Decoded
from sensors.checks.depth_check import judge_depth, spread
from sensors.errors import FormatError, Setting
from sensors.importers.bags.bag_camera import BagCameras, Stream
from sensors.importers.bags.bag_files import BagFile, open_files
from sensors.importers.bags.choose import Meaning, choose, holds_depth, meaning_of
from sensors.importers.bags.ros_images import FINE_MM, Depth, color_encoded_from, depth_from
from sensors.importers.bags.ros_messages import (
    CAMERAS,
    PICTURES,
    TRANSFORMS,
    Entry,
    Picture,
    Place,
    decode,
    is_empty,
    picture_from,
    stamp_and_frame,
)
from sensors.importers.bags.timeline import LATE_NS, Stamps, Timeline, paired, timeline_of
from sensors.importers.options import AS_STATED, ImportOptions
from sensors.rig.frame import FrameSource, RigFrame

STEADY = 1000  # messages in which a computer's clock is set back at most once more; untuned


class Message(NamedTuple):
    """Position of a message in the file, with its sender's time and the recorder's, in nanoseconds."""

    stamp_ns: int
    received_ns: int
    file: BagFile
    place: Place


@dataclass
class Topic:
    """Messages of one topic, all of one kind and encoding, in the order in which they were received.

    empty: number of images without pixels, which are left out. ``len`` and ``read`` count images in the order
    of ``timeline``, which leaves out repeated ones.
    """

    name: str
    kind: str
    encoding: str
    messages: list[Message] = field(default_factory=list)
    empty: int = 0

    def __len__(self) -> int:
        return len(self.timeline.times_ns) if self.kind in PICTURES else len(self.messages)

    def read(self, index: int) -> Decoded:
        """Decode a message. Raises FormatError where it is damaged."""
        at = int(self.timeline.recorded[index]) if self.kind in PICTURES else index
        return decode(self.kind, self.encoding, self._bytes(at))

    @cached_property
    def timeline(self) -> Timeline:
        """Return the order and times of the messages. Raises FormatError where messages with equal stamps
        cannot be read.
        """
        stamps_ns = np.array([message.stamp_ns for message in self.messages], np.int64)
        received_ns = np.array([message.received_ns for message in self.messages], np.int64)
        return timeline_of(Stamps(self.name, stamps_ns, received_ns, self._same))

    @property
    def notes(self) -> tuple[str, ...]:
        """Return notes on order, times and empty images."""
        empty = f"{self.name}: {self.empty} empty images are left out"
        return (*self.timeline.notes, *([empty] if self.empty else []))

    def add(self, file: BagFile, entry: Entry) -> None:
        """Add a message; an image without pixels is only counted. Raises FormatError."""
        stamp_ns = 0
        if entry.kind in PICTURES:
            message = decode(entry.kind, entry.encoding, entry.data)
            if is_empty(message):
                self.empty += 1
                return
            stamp_ns = stamp_and_frame(message)[0]
        if not (0 <= stamp_ns < 1 << 63 and 0 <= entry.logged_ns < 1 << 63):
            raise FormatError(
                f"{file.path}: {entry.topic[:60]!r} has a message at {stamp_ns / 1e9:.0f} s, logged at "
                f"{entry.logged_ns / 1e9:.0f} s; set the clock to 1970 to 2262 and record again"
            )
        self.messages.append(Message(stamp_ns, entry.logged_ns, file, entry.place))

    def _same(self, a: int, b: int) -> bool:
        return self._bytes(a) == self._bytes(b)

    def _bytes(self, at: int) -> bytes:
        message = self.messages[at]
        return message.file.read(self.name, message.place)


def index_topics(files: list[BagFile]) -> dict[str, Topic]:
    """Return every topic of a kind that is read. Raises FormatError for a damaged name, or a topic of two
    kinds.
    """
    topics: dict[str, Topic] = {}
    for file in files:
        for entry in file.entries():
            if not entry.topic.isprintable():
                raise FormatError(f"{file.path}: the name of a topic is damaged; restore it from a copy")
            topic = topics.setdefault(entry.topic, Topic(entry.topic, entry.kind, entry.encoding))
            if (topic.kind, topic.encoding) != (entry.kind, entry.encoding):
                raise FormatError(
                    f"{file.path}: topic {entry.topic[:60]!r} holds two kinds ({topic.kind} "
                    f"{topic.encoding}, {entry.kind} {entry.encoding}); record each in its own topic"
                )
            topic.add(file, entry)
    for topic in topics.values():
        if not _clock_was_set_back(topic.messages):
            topic.messages.sort(key=lambda message: message.received_ns)
    return topics


def _clock_was_set_back(messages: list[Message]) -> bool:
    """Return whether the recorder's clock stepped back, so that the file's order is the order of reception.

    Receive times that fall more often, or by less, mean that the file was written in another order.
    """
    steps_ns = np.diff(np.array([message.received_ns for message in messages], np.int64))
    falls_ns = -steps_ns[steps_ns < 0]
    return 0 < len(falls_ns) <= 1 + len(messages) // STEADY and bool((falls_ns > LATE_NS).all())


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
                "record depth (16UC1, 32FC1, compressedDepth or PNG of 16 bits), or choose a topic",
                Setting.TOPIC,
            )
        read = [topics[name] for name in (chosen.depth, chosen.color) if name]
        self._depth, self._color = read[0], read[1] if chosen.color else None
        streams = [Stream(topic.name, pictures[topic.name]) for topic in read]
        infos = {name: t.read(0) for name, t in topics.items() if t.kind in CAMERAS and len(t)}
        moving = sorted((t for t in topics.values() if t.kind in TRANSFORMS), key=_static_first)
        transforms = (topic.read(at) for topic in moving for at in range(len(topic)))
        cameras = BagCameras(path, infos, transforms)
        found = cameras.calibrate(streams[0], streams[1] if chosen.color else None, options)
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
    """Return the first topics with their encodings, as text; names that exclude depth are marked."""

    def shown(name: str) -> str:
        image = pictures[name]
        why = ", no depth by its name" if holds_depth(image) and meaning_of(name) is not Meaning.DEPTH else ""
        return f"{name} ({image.encoding[:40].strip()}{why})"

    return ", ".join(map(shown, names[:8])) + (f" and {len(names) - 8} more" if len(names) > 8 else "")


def _static_first(topic: Topic) -> tuple[bool, str]:
    return "static" not in topic.name, topic.name
