"""Which MCAP files are sessions: by their topics and schemas, wherever other programs put their records."""

from pathlib import Path
from typing import BinaryIO, NamedTuple

from mcap.opcode import Opcode
from mcap.records import Channel, Metadata, Schema

from sensors.errors import FormatError
from sensors.files.natural_order import paths_in_order
from sensors.session.mcap_records import record_offsets, records_at
from sensors.session.messages import CAMERAS, DEPTH, METADATA, SCHEMAS
from sensors.session.paths import SUFFIX
from sensors.session.summary import Summary, read_summary

OWN = {DEPTH, f"/{CAMERAS[0]}/calibration"}
"""Topics that make a session."""
KINDS = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.METADATA)


class McapFiles(NamedTuple):
    """The MCAP files of a folder, in natural order. unknown: those that are empty or none in truth."""

    sessions: list[Path]
    foreign: list[Path]
    unknown: list[Path]


def is_session(path: Path) -> bool | None:
    """Whether an MCAP file is a session; None for one without topics. Raises FormatError for no MCAP file.

    A session has the depth images and their camera, or the metadata that a session's writer adds.
    """
    with path.open("rb") as file:
        summary = read_summary(file)
        topics, named = _stated(summary) if summary and summary.channels else _searched(file)
    return (named or topics >= OWN) if topics or named else None


def mcap_files(folder: Path) -> McapFiles:
    """Sort the MCAP files of a folder by what they are."""
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
    """Raise FormatError for a folder with sessions, which is no recording itself."""
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
    """Topics of session messages, "" for others, and whether there is a session's metadata; by a summary."""
    schemas = {schema.id: schema.name for schema in summary.schemas}
    topics = {_topic(channel, schemas) for channel in summary.channels}
    return topics, any(each.name == METADATA for each in summary.metadata)


def _searched(file: BinaryIO) -> tuple[set[str], bool]:
    """The same, by the records: up to where it is clear that the file is a session."""
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
    """A channel's topic, if its messages are a session's; else ""."""
    expected = SCHEMAS.get(channel.topic)
    name = schemas.get(channel.schema_id, "")
    own = expected is not None and channel.message_encoding == "protobuf"
    return channel.topic if own and expected and name == expected.DESCRIPTOR.full_name else ""
