"""Where the messages of a bag lie, topic by topic, whatever files it consists of."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from sensors.errors import FormatError
from sensors.importers.bag_files import Entry, McapFile, SqliteFile
from sensors.importers.ros_messages import (
    CAMERAS,
    ENCODINGS,
    PICTURES,
    TRANSFORMS,
    Stamped,
    picture_from,
    stamp_of,
)


class BagFile(Protocol):
    """One storage file: every message it has, and a message's bytes by its place."""

    path: Path

    def entries(self) -> Iterator[Entry]: ...

    def read(self, place: tuple[int, int]) -> bytes: ...


@dataclass
class Topic:
    """Where one topic's messages lie: (file, place), with their stamps; all of one kind and encoding."""

    kind: str
    encoding: str
    stamps_ns: list[int] = field(default_factory=list)
    places: list[tuple[BagFile, tuple[int, int]]] = field(default_factory=list)

    def read(self, index: int) -> bytes:
        """A message's bytes."""
        file, place = self.places[index]
        return file.read(place)

    def picture(self, index: int) -> Stamped:
        """A message as a picture."""
        return picture_from(self.kind, self.encoding, self.read(index))

    def sort(self) -> None:
        """Order by stamp; as logged where they are the same."""
        order = sorted(range(len(self.stamps_ns)), key=self.stamps_ns.__getitem__)
        self.stamps_ns = [self.stamps_ns[i] for i in order]
        self.places = [self.places[i] for i in order]


def storage_files(folder: Path) -> list[Path]:
    """The MCAP and SQLite files of a folder, sorted."""
    return sorted(f for f in folder.iterdir() if f.suffix.lower() in (".mcap", ".db3") and f.is_file())


def open_files(path: Path) -> list[BagFile]:
    """The storage files at ``path``: a bag's folder, or one file."""
    paths = storage_files(path) if path.is_dir() else [path]
    return [McapFile(p) if p.suffix.lower() == ".mcap" else SqliteFile(p) for p in paths]


def index_topics(files: list[BagFile]) -> dict[str, Topic]:
    """Every topic of a kind that is read, its messages by stamp. Raises FormatError."""
    topics: dict[str, Topic] = {}
    for file in files:
        for entry in file.entries():
            if entry.kind not in PICTURES | CAMERAS | TRANSFORMS or entry.encoding not in ENCODINGS:
                continue
            topic = topics.setdefault(entry.topic, Topic(entry.kind, entry.encoding))
            if (topic.kind, topic.encoding) != (entry.kind, entry.encoding):
                raise FormatError(f"{file.path}: topic {entry.topic[:60]!r} holds messages of two kinds")
            stamp_ns = entry.logged_ns
            if entry.kind in PICTURES:
                stamp_ns = stamp_of(entry.kind, entry.encoding, file.read(entry.place)) or stamp_ns
            topic.stamps_ns.append(stamp_ns)
            topic.places.append((file, entry.place))
            if not 0 <= stamp_ns < 1 << 63:
                raise FormatError(f"{file.path}: a message of {entry.topic[:60]!r} has an impossible time")
    for topic in topics.values():
        topic.sort()
    return topics
