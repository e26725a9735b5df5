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
from sensors.session.mcap_records import (
    MAX_CHANNELS,
    MAX_RECORD_BYTES,
    MessageReader,
    record_offsets,
    records_at,
)

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
        channels: dict[int, tuple[str, int, str]] = {}  # topic, schema, encoding
        with self.path.open("rb") as file:
            for offset in record_offsets(file):
                for slot, record in enumerate(records_at(file, offset)):
                    if isinstance(record, Schema):
                        schemas.setdefault(record.id, record.name[:MAX_TEXT])
                    elif isinstance(record, Channel):
                        encoding = record.message_encoding[:MAX_TEXT]
                        channels.setdefault(record.id, (_plain(record.topic), record.schema_id, encoding))
                    elif isinstance(record, Message) and record.channel_id in channels:
                        topic, schema, encoding = channels[record.channel_id]
                        kind = _bare(schemas.get(schema, ""))
                        yield Entry(topic, kind, encoding, record.log_time, (offset, slot))
                    if max(len(schemas), len(channels)) > MAX_CHANNELS:
                        raise FormatError(
                            f"{self.path} names more than {MAX_CHANNELS} channels or schemas; split it"
                        )

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
                self._check_tables(database)
                query = "SELECT id, name, type, serialization_format FROM topics LIMIT 10000"
                topics = {
                    i: (_plain(str(name)), _bare(str(kind)[:MAX_TEXT]), str(code)[:MAX_TEXT])
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

    def _check_tables(self, database: sqlite3.Connection) -> None:
        """Whether both tables hold what was written: no view, and no column that is computed when read."""
        kinds = {name: kind for _, name, kind, *_ in database.execute("PRAGMA main.table_list")}
        for table in ("topics", "messages"):
            if kinds.get(table) != "table":
                raise FormatError(f"{self.path} is not a ROS 2 bag (it has no tables topics and messages)")
            for _, column, *_, hidden in database.execute(f"PRAGMA main.table_xinfo({table})"):
                if hidden:
                    raise FormatError(
                        f"{self.path} is not a ROS 2 bag ({_plain(column)} of {table} is computed)"
                    )

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
