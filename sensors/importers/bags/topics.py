"""The messages of a bag's files, topic by topic, in the order of their times."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np

from sensors.calibration_files.camera_messages import Decoded
from sensors.errors import FormatError
from sensors.importers.bags.bag_files import BagFile
from sensors.importers.bags.ros_messages import PICTURES, Entry, Place, decode, is_empty, stamp_and_frame
from sensors.importers.bags.timeline import LATE_NS, Stamps, Timeline, timeline_of

STEADY = 1000  # messages in which a computer's clock is set back at most once more; untuned


class Message(NamedTuple):
    """Place of a message, its sender's time and the recorder's, in nanoseconds."""

    stamp_ns: int
    received_ns: int
    file: BagFile
    place: Place


@dataclass
class Topic:
    """One topic's messages, all of one kind and encoding, in the order in which they were received.

    empty: number of images without pixels, which are left out. ``len``, ``read`` and ``timeline`` count in
    the order of times.
    """

    name: str
    kind: str
    encoding: str
    messages: list[Message] = field(default_factory=list)
    empty: int = 0

    def __len__(self) -> int:
        return len(self.timeline.times_ns) if self.kind in PICTURES else len(self.messages)

    def __iter__(self) -> Iterator[Decoded]:
        """Yield every message. Raises FormatError."""
        return map(self.read, range(len(self)))

    def read(self, index: int) -> Decoded:
        """Read a message. Raises FormatError."""
        at = int(self.timeline.recorded[index]) if self.kind in PICTURES else index
        return decode(self.kind, self.encoding, self._bytes(at))

    @cached_property
    def timeline(self) -> Timeline:
        """Order and times. Raises FormatError where messages with equal stamps cannot be compared."""
        stamps_ns = np.array([message.stamp_ns for message in self.messages], np.int64)
        received_ns = np.array([message.received_ns for message in self.messages], np.int64)
        return timeline_of(Stamps(self.name, stamps_ns, received_ns, self._same))

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on order, times and empty images."""
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
                f"{file.path}: a message of {entry.topic[:60]!r} has an impossible time; record it again"
            )
        self.messages.append(Message(stamp_ns, entry.logged_ns, file, entry.place))

    def _same(self, a: int, b: int) -> bool:
        return self._bytes(a) == self._bytes(b)

    def _bytes(self, at: int) -> bytes:
        message = self.messages[at]
        return message.file.read(self.name, message.place)


def index_topics(files: list[BagFile]) -> dict[str, Topic]:
    """Return every topic of a kind that is read. Raises FormatError."""
    topics: dict[str, Topic] = {}
    for file in files:
        for entry in file.entries():
            if not entry.topic.isprintable():
                raise FormatError(f"{file.path}: the name of a topic is damaged; restore it from a copy")
            topic = topics.setdefault(entry.topic, Topic(entry.topic, entry.kind, entry.encoding))
            if (topic.kind, topic.encoding) != (entry.kind, entry.encoding):
                raise FormatError(
                    f"{file.path}: topic {entry.topic[:60]!r} holds messages of two kinds; record it again"
                )
            topic.add(file, entry)
    for topic in topics.values():
        if not _clock_was_set_back(topic.messages):
            topic.messages.sort(key=lambda message: message.received_ns)
    return topics


def _clock_was_set_back(messages: list[Message]) -> bool:
    """Return whether the recorder's clock stepped back, so that the file's order is the recording's.

    Otherwise a file whose messages are not in the order of receive times was written so.
    """
    steps_ns = np.diff(np.array([message.received_ns for message in messages], np.int64))
    falls_ns = -steps_ns[steps_ns < 0]
    return 0 < len(falls_ns) <= 1 + len(messages) // STEADY and bool((falls_ns > LATE_NS).all())
