"""Copy of a session without colour, temperatures or a person's name. One record at a time is in memory."""

import re
from collections import Counter
from collections.abc import Callable, Collection
from dataclasses import dataclass, field, replace
from pathlib import Path

from mcap.opcode import Opcode
from mcap.records import Channel, McapRecord, Message, Metadata, Schema

from sensors.errors import FormatError
from sensors.files.atomic import check_free, replacing
from sensors.session.index import read_contents
from sensors.session.indexed_writer import IndexedWriter
from sensors.session.mcap_records import record_offsets, records_at
from sensors.session.messages import (
    COLOR,
    COUNTS,
    EVENTS,
    INFRARED,
    METADATA,
    PYROMETER,
    SCHEMAS,
    SUBJECT,
    THERMAL,
    color_from,
    color_message,
    event_from,
    event_message,
)
from sensors.session.reader import Session
from sensors.session.recording_file import SUFFIX
from sensors.session.repair import Copier

COLOURS, TEMPERATURES = frozenset({COLOR, INFRARED}), frozenset({THERMAL, COUNTS, PYROMETER})
"""Topics of the images that show a face as a photograph does, and of temperatures."""
PERSON = "a person"  # in place of a name inside other text
_KINDS = {Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.METADATA}

Blur = Callable[[int, bytes], bytes | None]
"""Returns a colour image (JPEG or PNG) without faces by its device stamp; None = leave the image out."""


@dataclass(frozen=True)
class Removal:
    """Data that a copy lacks.

    topics: of the images left out. name: of a person, "" = none. blur: removes the faces of colour images.
    """

    topics: Collection[str] = frozenset()
    name: str = ""
    blur: Blur | None = None

    def text(self, text: str) -> str:
        """Return a text without the name, in any case of its letters."""
        return re.sub(re.escape(self.name), PERSON, text, flags=re.IGNORECASE) if self.name else text

    def metadata(self, values: dict[str, str]) -> dict[str, str]:
        """Return metadata without the name."""
        is_named = self.name and self.text(values.get(SUBJECT, "")) == PERSON
        return {self.text(k): self.text(v) for k, v in values.items() if k != SUBJECT or not is_named}


@dataclass
class Stripped:
    """Result of ``strip``. frames: of the copy. left_out: number of messages by topic."""

    frames: int = 0
    left_out: Counter[str] = field(default_factory=Counter)


def strip(
    path: Path, out: Path, removal: Removal, progress: Callable[[int], None], *, overwrite: bool = False
) -> Stripped:
    """Write a session without what ``removal`` names; the copy appears whole or not at all.

    Topics that are not a session's, other programs' metadata and attachments are left out. progress: called
    with 1 for each depth image. Raises FormatError for an unfinished session, a name that is not in it or is
    in the name of the copy; ExistsError where ``out`` exists and ``overwrite`` is False.
    """
    session = Session(path)
    _check(session, out, removal)
    check_free(out, overwrite, suffix=SUFFIX)
    done = Stripped()
    out.parent.mkdir(parents=True, exist_ok=True)
    with replacing(out, overwrite) as temporary:
        with temporary.open("wb") as sink, session.path.open("rb") as file:
            copier = Copier(IndexedWriter(sink))
            copier.add_beside(
                Metadata(METADATA, removal.metadata({**session.metadata, "name": session.name})), None
            )
            for offset in record_offsets(file):
                for record in records_at(file, offset, _KINDS):
                    _copy(record, copier, removal, done)
                    if copier.frames > done.frames:
                        done.frames = copier.frames
                        progress(1)
            copier.finish(None)
        read_contents(temporary)
    return done


def _check(session: Session, out: Path, removal: Removal) -> None:
    if session.truncated:
        raise FormatError(
            f"{session.path} is unfinished; make it whole first: annotate-cloud repair {session.path}"
        )
    if out.exists() and out.samefile(session.path):
        raise FormatError(f"{out} is the session itself; give another name for the copy")
    if not removal.name:
        return
    texts = [session.name, session.subject, *session.metadata.values(), *(text for _, text in session.events)]
    if all(removal.text(text) == text for text in texts):
        raise FormatError(
            f"{session.path} does not hold the name {removal.name!r}; info shows the name of the subject"
        )
    if removal.text(out.name) != out.name:
        raise FormatError(f"{out} holds the name {removal.name!r}; give another name for the copy")


def _copy(record: McapRecord, copier: Copier, removal: Removal, done: Stripped) -> None:
    """Copy a record of a session's own kinds, as far as it may stay."""
    match record:
        case Schema():
            copier.add(record)
        case Channel() if record.topic in SCHEMAS:
            copier.add(replace(record, metadata={}))
        case Message() if (topic := copier.topic_of(record)) is not None:
            data = _stripped(topic, record, removal)
            if data is None:
                done.left_out[topic] += 1
            else:
                copier.add(replace(record, data=data))


def _stripped(topic: str, message: Message, removal: Removal) -> bytes | None:
    """Return a message's data as the copy holds it; None where it is left out."""
    if topic in removal.topics:
        return None
    if topic == EVENTS and removal.name:
        stamp_ns = message.publish_time
        return bytes(event_message(stamp_ns, removal.text(event_from(message.data))).SerializeToString())
    if topic == COLOR and removal.blur:
        image = removal.blur(message.publish_time, color_from(message.data))
        if image is None:
            return None
        return bytes(color_message(image, message.publish_time).SerializeToString())
    return bytes(message.data)
