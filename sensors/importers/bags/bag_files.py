"""The messages of a bag's files, topic by topic: MCAP files by their records, all others by rosbags."""

from collections.abc import Iterator
from contextlib import contextmanager
from itertools import islice
from operator import itemgetter
from pathlib import Path
from typing import Any, NamedTuple
from weakref import finalize

import numpy as np
from mcap.records import Channel, Message, Metadata, Schema
from numpy.typing import NDArray

from sensors.errors import CloudError, FormatError
from sensors.importers.bags.ros_messages import ENCODINGS, PICTURES, READ, decode, stamp_and_frame
from sensors.rig.camera_messages import Decoded
from sensors.session.mcap_records import MessageReader, record_offsets, records_at
from sensors.session.messages import DEPTH
from sensors.session.messages import METADATA as SESSION_METADATA

METADATA = "metadata.yaml"
"""In a ROS 2 bag's folder; a recorder that was killed has not written it."""

Place = tuple[int, int]
"""Where a file has a message: offset and slot in MCAP; elsewhere the time it was logged, and how many
messages of its topic logged at that time come before it."""


def is_bag(path: Path) -> bool:
    """Whether a folder holds a ROS 2 bag, or an MCAP file is somebody else's rather than a session.

    A file without topics is left to ``Session``, whose error names the cause. Raises FormatError.
    """
    if path.is_dir():
        return bool(storage_files(path) or (path / METADATA).is_file()) and not (path / "depth").is_dir()
    seen = False
    with path.open("rb") as file:
        for offset in record_offsets(file):
            for record in records_at(file, offset):
                if isinstance(record, Metadata) and record.name == SESSION_METADATA:
                    return False
                if isinstance(record, Channel):
                    if record.topic == DEPTH and record.message_encoding == "protobuf":
                        return False
                    seen = True
                elif isinstance(record, Message):
                    return seen
    return seen


class Entry(NamedTuple):
    """One message. kind: its type without package or folder; encoding: ros1, cdr or protobuf."""

    topic: str
    kind: str
    encoding: str
    logged_ns: int
    place: Place
    data: bytes


class McapFile:
    """An MCAP file's messages; one that was cut off simply ends early. Raises FormatError."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._messages = MessageReader(path)

    def entries(self) -> Iterator[Entry]:
        """Every message of a type that is read, in the file's order."""
        schemas: dict[int, str] = {}
        channels: dict[int, tuple[str, str, str]] = {}  # topic, kind, encoding
        with self.path.open("rb") as file:
            for offset in record_offsets(file):
                for slot, record in enumerate(records_at(file, offset)):
                    if isinstance(record, Schema):
                        schemas[record.id] = _bare(record.name)
                    elif isinstance(record, Channel):
                        kind, encoding = schemas.get(record.schema_id, ""), record.message_encoding
                        if kind in READ and encoding in ENCODINGS:
                            channels[record.id] = record.topic, kind, encoding
                    elif isinstance(record, Message) and record.channel_id in channels:
                        topic = channels[record.channel_id]
                        yield Entry(*topic, record.log_time, (offset, slot), record.data)

    def read(self, topic: str, place: Place) -> bytes:
        """A message's bytes."""
        return self._messages.read(*place)


class RosbagFile:
    """The messages of a ROS 1 bag, a SQLite file, or a ROS 2 bag's folder, by rosbags (extra ``exchange``).

    Its ``AnyReader`` would make Python code of the definitions in a file: not used. encoding: ros1 or cdr.
    Raises FormatError.
    """

    def __init__(self, path: Path) -> None:
        try:
            from rosbags import rosbag1, rosbag2
        except ImportError as error:
            raise FormatError(f"{path} needs rosbags; pip install 'annotate-cloud[exchange]'") from error
        self.path = path
        self.encoding = "ros1" if path.suffix.lower() == ".bag" else "cdr"
        with damaged(path):
            self._reader: Any = rosbag1.Reader(path) if self.encoding == "ros1" else rosbag2.Reader(path)
            self._reader.open()
        finalize(self, self._reader.close)

    @property
    def topics(self) -> set[str]:
        """Every topic, whatever its type."""
        return {str(connection.topic) for connection in self._reader.connections}

    def entries(self, kinds: frozenset[str] = READ) -> Iterator[Entry]:
        """Every message of a type that is read, in the order of their log times."""
        last: dict[str, Place] = {}
        with damaged(self.path):
            wanted = [c for c in self._reader.connections if _bare(c.msgtype) in kinds]
            for connection, logged_ns, data in self._reader.messages(wanted) if wanted else ():
                topic = str(connection.topic)
                before_ns, count = last.get(topic, (-1, 0))
                last[topic] = place = (logged_ns, count + 1 if before_ns == logged_ns else 0)
                yield Entry(topic, _bare(connection.msgtype), self.encoding, logged_ns, place, bytes(data))

    def read(self, topic: str, place: Place) -> bytes:
        """A message's bytes."""
        logged_ns, number = place
        with damaged(self.path):
            connections = [c for c in self._reader.connections if str(c.topic) == topic]
            messages = self._reader.messages(connections, logged_ns, logged_ns + 1)
            return bytes(next(islice(messages, number, None))[2])


BagFile = McapFile | RosbagFile


class Topic(NamedTuple):
    """One topic's messages, all of one kind and encoding: each one's time stamp in ns, file and place."""

    name: str
    kind: str
    encoding: str
    messages: list[tuple[int, BagFile, Place]]

    @property
    def stamps_ns(self) -> NDArray[np.int64]:
        """Time stamps (n,) of the messages, sorted."""
        return np.array([stamp_ns for stamp_ns, _, _ in self.messages], np.int64)

    def read(self, index: int) -> Decoded:
        """A message. Raises FormatError."""
        _, file, place = self.messages[index]
        return decode(self.kind, self.encoding, file.read(self.name, place))


def storage_files(folder: Path) -> list[Path]:
    """The MCAP and SQLite files of a folder, sorted."""
    return sorted(f for f in folder.iterdir() if f.suffix.lower() in (".mcap", ".db3") and f.is_file())


def open_files(path: Path) -> list[BagFile]:
    """The files at ``path``: a bag's folder, or one file. Raises FormatError."""
    paths = storage_files(path) if path.is_dir() else [path]
    mcap = any(file.suffix.lower() == ".mcap" for file in paths)
    if path.is_dir() and (path / METADATA).is_file() and not mcap:
        paths = [path]  # its metadata name the compression
    return [McapFile(file) if mcap else RosbagFile(file) for file in paths]


def index_topics(files: list[BagFile]) -> dict[str, Topic]:
    """Every topic of a kind that is read, its messages by stamp, or as logged. Raises FormatError."""
    topics: dict[str, Topic] = {}
    for file in files:
        for entry in file.entries():
            topic = topics.setdefault(entry.topic, Topic(entry.topic, entry.kind, entry.encoding, []))
            if (topic.kind, topic.encoding) != (entry.kind, entry.encoding):
                raise FormatError(f"{file.path}: topic {entry.topic[:60]!r} holds messages of two kinds")
            stamp_ns = entry.logged_ns
            if entry.kind in PICTURES:
                stamp_ns = stamp_and_frame(decode(entry.kind, entry.encoding, entry.data))[0] or stamp_ns
            if not 0 <= stamp_ns < 1 << 63:
                raise FormatError(f"{file.path}: a message of {entry.topic[:60]!r} has an impossible time")
            topic.messages.append((stamp_ns, file, entry.place))
    for topic in topics.values():
        topic.messages.sort(key=itemgetter(0))
    return topics


def _bare(kind: str) -> str:
    """``sensor_msgs/msg/Image`` or ``foxglove.RawImage`` without what stands before the type's own name."""
    return kind.replace(".", "/").rpartition("/")[2]


@contextmanager
def damaged(path: Path) -> Iterator[None]:
    """Whatever rosbags, SQLite and unpackers raise at a damaged file as FormatError."""
    try:
        yield
    except CloudError:
        raise
    except Exception as error:
        raise FormatError(f"{path} cannot be read ({error}); restore it from a copy") from error
