"""The messages of one storage file of a ROS 2 bag (MCAP or SQLite), or of anybody's MCAP file.

Message definitions in the files are never parsed: only well-known types are decoded, by known definitions.
"""

import sqlite3
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from mcap.records import Channel, Message, Schema

from sensors.errors import FormatError
from sensors.mcap_records import MAX_RECORD_BYTES, MessageReader, record_offsets, records_at

MAX_TEXT = 200
MAX_SQLITE_STEPS = 1_000_000
"""Thousands of virtual instructions a query may take: a view can be written that never ends."""


@dataclass(frozen=True)
class Entry:
    """One message before it is read. kind: its type without package or folder; encoding: cdr or protobuf.

    place: two numbers that find it again within its file.
    """

    topic: str
    kind: str
    encoding: str
    logged_ns: int
    place: tuple[int, int]


class McapFile:
    """An MCAP file's messages. Raises FormatError when it is damaged; one cut off simply ends early."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._messages = MessageReader(path)

    def entries(self) -> Iterator[Entry]:
        """Every message of the file, in the file's order."""
        schemas: dict[int, str] = {}
        channels: dict[int, Channel] = {}
        with self.path.open("rb") as file:
            for offset in record_offsets(file):
                for slot, record in enumerate(records_at(file, offset)):
                    if isinstance(record, Schema):
                        schemas.setdefault(record.id, record.name)
                    elif isinstance(record, Channel):
                        channels.setdefault(record.id, record)
                    elif isinstance(record, Message) and record.channel_id in channels:
                        channel = channels[record.channel_id]
                        kind = schemas.get(channel.schema_id, "")
                        topic, encoding = _plain(channel.topic), channel.message_encoding
                        yield Entry(topic, _bare(kind), encoding, record.log_time, (offset, slot))

    def read(self, place: tuple[int, int]) -> bytes:
        """A message's bytes."""
        return self._messages.read(*place)


class SqliteFile:
    """The messages of a rosbag2 SQLite file. Raises FormatError when it is none."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def entries(self) -> Iterator[Entry]:
        """Every message of the file, in the order of their log times."""
        with closing(self._connect()) as database:
            try:
                real = {
                    name for (name,) in database.execute("SELECT name FROM sqlite_master WHERE type='table'")
                }
                if not {"topics", "messages"} <= real:
                    raise FormatError(f"{self.path} is no ROS 2 bag (it has no tables topics and messages)")
                query = "SELECT id, name, type, serialization_format FROM topics LIMIT 10000"
                topics = {
                    i: (_plain(str(name)), _bare(str(kind)), str(code))
                    for i, name, kind, code in database.execute(query)
                }
                query = "SELECT topic_id, timestamp, rowid FROM messages ORDER BY timestamp"
                for topic, logged_ns, row in database.execute(query):
                    if topic in topics and isinstance(logged_ns, int) and isinstance(row, int):
                        yield Entry(*topics[topic], logged_ns, (row, 0))
            except sqlite3.Error as error:
                raise self._broken(error) from error

    def read(self, place: tuple[int, int]) -> bytes:
        """A message's bytes."""
        with closing(self._connect()) as database:
            try:
                query = "SELECT data FROM messages WHERE rowid = ?"
                row = database.execute(query, place[:1]).fetchone()
            except sqlite3.Error as error:
                raise self._broken(error) from error
        if row is None or not isinstance(row[0], bytes):
            raise FormatError(f"{self.path}: message {place[0]} holds no bytes; restore it from a copy")
        return row[0]

    def _connect(self) -> sqlite3.Connection:
        try:
            database = sqlite3.connect(f"{self.path.resolve().as_uri()}?mode=ro&immutable=1", uri=True)
            database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MAX_RECORD_BYTES)
            database.text_factory = lambda text: text.decode("utf-8", "replace")
            database.execute("PRAGMA trusted_schema = OFF")
        except (sqlite3.Error, ValueError) as error:
            raise self._broken(error) from error
        steps = iter(range(MAX_SQLITE_STEPS))
        database.set_progress_handler(lambda: int(next(steps, None) is None), 1000)
        return database

    def _broken(self, error: Exception) -> FormatError:
        return FormatError(f"{self.path} cannot be read ({_plain(str(error))}); restore it from a copy")


def _plain(text: str) -> str:
    """Printable text of bounded length: what a file says is shown to people."""
    return "".join(c if c.isprintable() else " " for c in text[:MAX_TEXT])


def _bare(kind: str) -> str:
    """``sensor_msgs/msg/Image`` or ``foxglove.RawImage`` without what stands before the type's own name."""
    return kind.replace(".", "/").rpartition("/")[2]
