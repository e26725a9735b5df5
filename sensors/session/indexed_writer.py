"""Writer of MCAP files with an index of their messages by device stamp (``stored_index``)."""

from array import array
from typing import BinaryIO

import numpy as np
from mcap.records import Attachment
from mcap.writer import Writer

from sensors.session.messages import EVENTS, METADATA, OF_CALIBRATION, event_from
from sensors.session.stored_index import COLUMNS, MEDIA_TYPE, NAME, StoredIndex

CHUNK_BYTES = 1 << 20  # of messages after which a chunk ends, if no depth image ends it before; untuned


class IndexedWriter:
    """``mcap.Writer`` that stores an index of all messages at the end."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        # With the CRC of all data, a check finds any flipped bit.
        self._writer = Writer(file, chunk_size=CHUNK_BYTES, enable_data_crcs=True)
        self._writer.start(profile="", library=METADATA)
        self._index = StoredIndex()
        self._rows = [array("q") for _ in range(COLUMNS)]
        self._topics: dict[int, int] = {}  # number in the index, by channel
        self._slot = 0  # records in the chunk that is being filled
        self._begin = file.tell()

    def register_schema(self, name: str, encoding: str, data: bytes) -> int:
        """Add a schema and return its number."""
        number: int = self._writer.register_schema(name, encoding, data)
        self._added()
        return number

    def register_channel(self, topic: str, encoding: str, schema: int, metadata: dict[str, str]) -> int:
        """Add a channel and return its number."""
        number = self._writer.register_channel(topic, encoding, schema, metadata)
        if topic not in self._index.topics:
            self._index.topics.append(topic)
        self._topics[number] = self._index.topics.index(topic)
        self._added()
        return number

    def add_metadata(self, name: str, metadata: dict[str, str]) -> None:
        """Add a metadata record."""
        self.flush()
        self._writer.add_metadata(name, metadata)
        self._begin = self._file.tell()
        if name == METADATA:
            self._index.metadata |= metadata

    def add_attachment(self, attachment: Attachment) -> None:
        """Add an attachment."""
        self.flush()
        times = attachment.create_time, attachment.log_time
        self._writer.add_attachment(*times, attachment.name, attachment.media_type, attachment.data)
        self._begin = self._file.tell()

    def add_message(
        self, channel: int, log_time: int, data: bytes, publish_time: int, number: int = 0
    ) -> None:
        """Add a message; number: its sequence."""
        self._writer.add_message(channel, log_time, data, publish_time, number)
        index, topic = self._index, self._index.topics[self._topics[channel]]
        row = (self._topics[channel], publish_time, log_time, len(index.ends), self._slot)
        for column, value in zip(self._rows, row, strict=True):
            column.append(value)
        if topic in OF_CALIBRATION:
            index.calibrations.setdefault(topic, data)
        elif topic == EVENTS:
            index.events.append((publish_time, event_from(data)))
        self._added()

    def flush(self) -> None:
        """End the chunk and write it to the system's file cache."""
        self._writer.flush()
        self._follow()

    def finish(self) -> None:
        """Write the index and the summary."""
        self.flush()
        self._index.columns = np.array([np.frombuffer(row, np.int64) for row in self._rows])
        if (data := self._index.encode()) is not None:
            self._writer.add_attachment(0, 0, NAME, MEDIA_TYPE, data)
        self._writer.finish()

    def _added(self) -> None:
        self._slot += 1
        self._follow()

    def _follow(self) -> None:
        """Record the position of a chunk that ``mcap`` has written."""
        if (end := self._file.tell()) != self._begin:
            self._index.ends.append((self._begin, end))
            self._begin, self._slot = end, 0
