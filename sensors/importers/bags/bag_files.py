"""The files of a bag: MCAP files and ROS 1 bags by their records, ROS 2's SQLite files by rosbags."""

from collections.abc import Iterator
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import Any
from weakref import finalize

from mcap.records import Channel, Message, Schema
from natsort import natsorted

from sensors.errors import CloudError, FormatError
from sensors.importers.bags.ros1_file import Ros1File
from sensors.importers.bags.ros_messages import ENCODINGS, READ, Entry, Place, bare
from sensors.session.mcap_records import MAGIC, MessageReader, is_complete, record_offsets, records_at
from sensors.session.recognise import check_no_sessions, is_session

METADATA = "metadata.yaml"  # in a ROS 2 bag's folder; a killed recorder has not written it
_ROS1 = b"#ROSBAG "  # begin of a ROS 1 bag of any version


def is_bag(path: Path) -> bool:
    """Return True for the folder of a ROS 2 bag, and for an MCAP file with topics that is not a session.

    Raises FormatError for a folder of sessions.
    """
    if not path.is_dir():
        return is_session(path) is False
    if (path / "depth").is_dir():
        return False
    check_no_sessions(path)
    return bool(storage_files(path) or (path / METADATA).is_file())


class McapFile:
    """An MCAP file's messages; a file that was cut off simply ends early. Raises FormatError for a damaged
    file.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._messages = MessageReader(path)

    @property
    def lost(self) -> str:
        """Return a note on a truncated end, one sentence, or ""."""
        with self.path.open("rb") as file:
            return "" if is_complete(file) else f"{self.path.name} is truncated: its end is lost"

    def entries(self) -> Iterator[Entry]:
        """Yield every message of a type that is read, in the file's order."""
        schemas: dict[int, str] = {}
        channels: dict[int, tuple[str, str, str]] = {}  # topic, kind, encoding
        with self.path.open("rb") as file:
            for offset in record_offsets(file):
                for slot, record in enumerate(records_at(file, offset)):
                    if isinstance(record, Schema):
                        schemas[record.id] = bare(record.name)
                    elif isinstance(record, Channel):
                        kind, encoding = schemas.get(record.schema_id, ""), record.message_encoding
                        if kind in READ and encoding in ENCODINGS:
                            channels[record.id] = record.topic, kind, encoding
                    elif isinstance(record, Message) and record.channel_id in channels:
                        topic = channels[record.channel_id]
                        yield Entry(*topic, record.log_time, (offset, slot), record.data)

    def read(self, topic: str, place: Place) -> bytes:
        """Read a message's bytes."""
        return self._messages.read(*place)


class RosbagFile:
    """The messages of a ROS 2 bag's SQLite file, or of its folder, by rosbags (extra ``exchange``).

    Its ``AnyReader`` is not used, because it generates Python code from the definitions in a file. Raises
    FormatError without rosbags, and for a damaged file.
    """

    encoding, lost = "cdr", ""

    def __init__(self, path: Path) -> None:
        try:
            from rosbags import rosbag2
        except ImportError as error:
            raise FormatError(f"{path} needs rosbags; pip install 'annotate-cloud[exchange]'") from error
        self.path = path
        with damaged(path):
            self._reader: Any = rosbag2.Reader(path)
            self._reader.open()
        finalize(self, self._reader.close)

    @property
    def topics(self) -> set[str]:
        """Return the topics of all types."""
        return {str(connection.topic) for connection in self._reader.connections}

    def entries(self, kinds: frozenset[str] = READ) -> Iterator[Entry]:
        """Yield every message of a type that is read, in the order of their log times."""
        last: dict[str, Place] = {}
        with damaged(self.path):
            wanted = [c for c in self._reader.connections if bare(c.msgtype) in kinds]
            for connection, logged_ns, data in self._reader.messages(wanted) if wanted else ():
                topic = str(connection.topic)
                before_ns, count = last.get(topic, (-1, 0))
                last[topic] = place = (logged_ns, count + 1 if before_ns == logged_ns else 0)
                yield Entry(topic, bare(connection.msgtype), self.encoding, logged_ns, place, bytes(data))

    def read(self, topic: str, place: Place) -> bytes:
        """Read a message's bytes."""
        logged_ns, number = place
        with damaged(self.path):
            connections = [c for c in self._reader.connections if str(c.topic) == topic]
            messages = self._reader.messages(connections, logged_ns, logged_ns + 1)
            return bytes(next(islice(messages, number, None))[2])


BagFile = McapFile | RosbagFile | Ros1File


def storage_files(folder: Path) -> list[Path]:
    """Return the MCAP and SQLite files of a folder, in the natural order of their names."""
    return natsorted(f for f in folder.iterdir() if f.suffix.lower() in (".mcap", ".db3") and f.is_file())


def open_files(path: Path) -> list[BagFile]:
    """Open a bag's folder, or one file. Raises FormatError for damaged files."""
    paths = storage_files(path) if path.is_dir() else [path]
    mcap = any(file.suffix.lower() == ".mcap" for file in paths)
    if path.is_dir() and (path / METADATA).is_file() and not mcap:
        paths = [path]  # its metadata name the compression
    return [
        McapFile(file)
        if _head(file).startswith(MAGIC) or file.suffix.lower() == ".mcap"
        else open_rosbag(file)
        for file in paths
    ]


def open_rosbag(path: Path) -> RosbagFile | Ros1File:
    """Open a ROS 1 bag, or SQLite files. Raises FormatError for damaged files."""
    return Ros1File(path) if _head(path).startswith(_ROS1) else RosbagFile(path)


def _head(path: Path) -> bytes:
    if not path.is_file():
        return b""
    with path.open("rb") as file:
        return file.read(len(MAGIC))


@contextmanager
def damaged(path: Path) -> Iterator[None]:
    """Convert all errors that rosbags, SQLite and unpackers raise at a damaged file to FormatError."""
    try:
        yield
    except CloudError:
        raise
    except Exception as error:
        raise FormatError(f"{path} cannot be read ({error}); restore it from a copy") from error
