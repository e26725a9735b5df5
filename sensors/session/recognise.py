"""Recognition of sessions among MCAP files by topics and schemas, in any order of these records."""

from pathlib import Path
from typing import BinaryIO, NamedTuple

from mcap.opcode import Opcode
from mcap.records import Channel, Metadata, Schema

from sensors.errors import FormatError
from sensors.files.natural_order import paths_in_order
from sensors.session.mcap_records import record_offsets, records_at
from sensors.session.messages import CAMERAS, DEPTH, METADATA, SCHEMAS
from sensors.session.recording_file import SUFFIX
from sensors.session.summary import Summary, read_summary

OWN = {DEPTH, f"/{CAMERAS[0]}/calibration"}  # topics that make a session
KINDS = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.METADATA)


class McapFiles(NamedTuple):
    """MCAP files of a folder, in natural order. unknown: empty files, and files of another format."""

    sessions: list[Path]
    foreign: list[Path]
    unknown: list[Path]


def is_session(path: Path) -> bool | None:
    """Return whether an MCAP file is a session; None without topics. Raises FormatError for a file that is
    not MCAP.

    A session has the depth images and their camera, or the metadata that a session's writer adds.
    """
    with path.open("rb") as file:
        summary = read_summary(file)
        topics, named = _stated(summary) if summary and summary.channels else _searched(file)
    return (named or topics >= OWN) if topics or named else None


def mcap_files(folder: Path) -> McapFiles:
    """Sort the MCAP files of a folder by kind."""
    files = McapFiles([], [], [])
    kinds = {True: files.sessions, False: files.foreign, None: files.unknown}
    for file in paths_in_order(folder.glob(f"*{SUFFIX}")):
        if file.is_file() and not file.name.startswith("."):
            try:
                kind = is_session(file)
            except (FormatError, OSError):
                kind = None
            kinds[kind].append(file)
    return files


def check_no_sessions(folder: Path) -> None:
    """Raise FormatError for a folder of sessions, because it is not one recording."""
    sessions, foreign, _ = mcap_files(folder)
    if not sessions:
        return
    names = ", ".join(file.name for file in sessions[:3]) + (", ..." if len(sessions) > 3 else "")
    beside = f" and another program's recordings ({foreign[0].name})" if foreign else ""
    several = "session" if len(sessions) == 1 else f"{len(sessions)} sessions"
    raise FormatError(
        f"{folder} is a folder with {several} ({names}){beside}; give one file, e.g. {sessions[0]}"
    )


def _stated(summary: Summary) -> tuple[set[str], bool]:
    """Return topics of session messages, "" for others, and whether a session's metadata is stated."""
    schemas = {schema.id: schema.name for schema in summary.schemas}
    topics = {_topic(channel, schemas) for channel in summary.channels}
    return topics, any(each.name == METADATA for each in summary.metadata)


def _searched(file: BinaryIO) -> tuple[set[str], bool]:
    """Return the result of ``_stated`` from the file's records, up to the first proof of a session."""
    schemas: dict[int, str] = {}
    topics: set[str] = set()
    for offset in record_offsets(file):
        for record in records_at(file, offset, KINDS):
            if isinstance(record, Schema):
                schemas[record.id] = record.name
            elif isinstance(record, Channel):
                topics.add(_topic(record, schemas))
            elif isinstance(record, Metadata) and record.name == METADATA:
                return topics, True
        if topics >= OWN:
            break
    return topics, False


def _topic(channel: Channel, schemas: dict[int, str]) -> str:
    """Return a channel's topic where its messages are a session's; else ""."""
    expected = SCHEMAS.get(channel.topic)
    if expected is None or channel.message_encoding != "protobuf":
        return ""
    return channel.topic if schemas.get(channel.schema_id) == expected.DESCRIPTOR.full_name else ""
