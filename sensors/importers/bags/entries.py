"""One message of a bag's file, and where it lies."""

from typing import NamedTuple

Place = tuple[int, ...]
"""Place of a message in its file: offset and slot in MCAP; chunk, offset and length in a ROS 1 bag; in SQLite
the time of logging, and the number of earlier messages of its topic with that time."""


class Entry(NamedTuple):
    """One message. kind: its type without package or folder; encoding: ros1, cdr or protobuf."""

    topic: str
    kind: str
    encoding: str
    logged_ns: int
    place: Place
    data: bytes


def bare(kind: str) -> str:
    """Return the bare name of a type: ``Image`` for ``sensor_msgs/msg/Image`` and ``sensor_msgs.Image``."""
    return kind.replace(".", "/").rpartition("/")[2]
