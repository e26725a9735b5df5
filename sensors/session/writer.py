"""A session on disk: an MCAP file that Foxglove and ROS tools open, that a crash cannot take away.

Topics are those of ``messages``; log_time is the host's arrival, publish_time the device's stamp.
While it is written a session is called ``NAME.mcap.partial``; it can be read at any time, and takes its
final name once complete. Every depth frame ends a compressed chunk that is handed to the system at once, so
that a killed process loses at most the frame it was writing.
"""

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, Self

import numpy as np
from google.protobuf.message import Message as ProtoMessage
from mcap.records import Channel, McapRecord, Message, Metadata, Schema
from mcap.writer import Writer
from mcap_protobuf.schema import register_schema
from numpy.typing import NDArray

from sensors.errors import CalibrationError, FormatError
from sensors.files.atomic import check_free, replacing
from sensors.rig.frame import RigFrame
from sensors.rig.rig_calibration import RigCalibration
from sensors.session.mcap_records import MAX_CHANNELS, is_complete, record_offsets, records_at
from sensors.session.messages import (
    COLOR,
    COUNTS,
    DEPTH,
    EVENTS,
    INFRARED,
    METADATA,
    PYROMETER,
    SCHEMAS,
    THERMAL,
    calibration_messages,
    color_message,
    counts_message,
    depth_message,
    event_message,
    infrared_message,
    spot_message,
    thermal_message,
)

CHUNK_BYTES = 1 << 20
MAX_DESCRIBED_BYTES, ENTRY_BYTES = 1 << 26, 100
"""Of schemas, channels and metadata of a file that is repaired: the writer keeps them to its end.
Python needs about the second for every text, however short."""


class SessionWriter:
    """Writes one session; use it as a context manager.

    On success the file takes its final name. On an exception, Ctrl-C included, what was recorded stays
    under ``partial`` and opens as a truncated session; with ``keep_partial`` False it is removed instead.
    Raises ExistsError when ``path`` or an unfinished recording of it exists and ``overwrite`` is False.
    """

    def __init__(
        self,
        path: Path,
        calibration: RigCalibration,
        name: str,
        *,
        overwrite: bool = False,
        metadata: dict[str, str] | None = None,
        keep_partial: bool = True,
    ) -> None:
        self.path, self.calibration = path, calibration
        self.partial = path.with_name(path.name + ".partial")
        self._metadata = {**(metadata or {}), "name": name}
        self._overwrite, self._keep_partial = overwrite, keep_partial
        self._file: BinaryIO
        self._writer: Writer
        self._channels: dict[str, int] = {}
        self._calibrated = False

    def __enter__(self) -> Self:
        for path in (self.path, self.partial):
            check_free(path, self._overwrite)
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self._file = self.partial.open("wb" if self._overwrite else "xb")
        self._writer = Writer(self._file, chunk_size=CHUNK_BYTES)
        self._writer.start(profile="", library=METADATA)
        for topic, schema in SCHEMAS.items():
            schema_id = register_schema(self._writer, schema)
            self._channels[topic] = self._writer.register_channel(topic, "protobuf", schema_id)
        self._writer.add_metadata(METADATA, self._metadata)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        whole = False
        try:
            try:
                if kind is None:
                    self._writer.finish()
                    self._file.flush()
                    os.fsync(self._file.fileno())
            finally:
                self._file.close()
            if kind is None:
                self.partial.replace(self.path)
                whole = True
        finally:
            if not whole and not self._keep_partial:
                self.partial.unlink(missing_ok=True)

    def write(self, frame: RigFrame, arrival_ns: int | None = None) -> None:
        """Write all that a frame has, stamped with the depth camera's time. Raises FormatError."""
        if frame.color_encoded is not None:
            self.write_color(frame.color_encoded, frame.stamp_ns, arrival_ns)
        if frame.thermal_c is not None:
            self.write_thermal(frame.thermal_c, frame.stamp_ns, arrival_ns)
        if frame.infrared is not None:
            self.write_infrared(frame.infrared, frame.stamp_ns, arrival_ns)
        self.write_depth(frame.depth_mm, frame.stamp_ns, arrival_ns)

    def write_depth(self, depth_mm: NDArray[np.uint16], stamp_ns: int, arrival_ns: int | None = None) -> None:
        """Write a depth image of the calibrated size, and hand everything so far to the system."""
        if depth_mm.shape != self.calibration.depth.shape:
            raise CalibrationError(
                f"depth image is {depth_mm.shape}, its calibration {self.calibration.depth.shape}; "
                "calibrate the camera in the mode that is recorded"
            )
        self._add(DEPTH, depth_message(depth_mm, stamp_ns), stamp_ns, arrival_ns)
        self.flush()

    def write_color(self, encoded: bytes, stamp_ns: int, arrival_ns: int | None = None) -> None:
        """Write the colour camera's own JPEG or PNG bytes. Raises FormatError for others."""
        self._add(COLOR, color_message(encoded, stamp_ns), stamp_ns, arrival_ns)

    def write_thermal(
        self, thermal_c: NDArray[np.float32], stamp_ns: int, arrival_ns: int | None = None
    ) -> None:
        """Write temperatures in Celsius, NaN = no reading."""
        self._add(THERMAL, thermal_message(thermal_c, stamp_ns), stamp_ns, arrival_ns)

    def write_infrared(
        self, infrared: NDArray[np.uint16], stamp_ns: int, arrival_ns: int | None = None
    ) -> None:
        """Write the amplitude image of a depth image; its stamp is the depth image's."""
        self._add(INFRARED, infrared_message(infrared, stamp_ns), stamp_ns, arrival_ns)

    def write_counts(self, counts: NDArray[np.uint16], stamp_ns: int, arrival_ns: int | None = None) -> None:
        """Write a thermal camera's raw counts (h, w)."""
        self._add(COUNTS, counts_message(counts, stamp_ns), stamp_ns, arrival_ns)

    def write_spot(
        self,
        target_c: float,
        head_c: float,
        box_c: float,
        stamp_ns: int,
        arrival_ns: int | None = None,
    ) -> None:
        """Write a pyrometer's temperatures in Celsius, NaN = not measured."""
        self._add(PYROMETER, spot_message(target_c, head_c, box_c, stamp_ns), stamp_ns, arrival_ns)

    def event(self, stamp_ns: int, text: str, arrival_ns: int | None = None) -> None:
        """Note something that happened at ``stamp_ns``."""
        self._add(EVENTS, event_message(stamp_ns, text), stamp_ns, arrival_ns)

    def flush(self) -> None:
        """End the chunk and hand it to the system: from here on it survives the death of the process."""
        self._writer.flush()

    def _add(self, topic: str, message: ProtoMessage, stamp_ns: int, arrival_ns: int | None) -> None:
        arrival = stamp_ns if arrival_ns is None else arrival_ns
        if not (0 <= stamp_ns < 1 << 63 and 0 <= arrival < 1 << 63):
            raise FormatError(f"time {stamp_ns} ns is impossible; give 0 to 2^63 - 1")
        if not self._calibrated:
            # First of all, and with the first stamp: the session's time range is that of its images.
            self._calibrated = True
            for its_topic, calibration in calibration_messages(self.calibration, stamp_ns):
                self._add(its_topic, calibration, stamp_ns, arrival)
            self.flush()
        self._writer.add_message(self._channels[topic], arrival, message.SerializeToString(), stamp_ns)


@dataclass(frozen=True)
class Repair:
    """What ``repair`` saved: messages kept, damaged records dropped, and whether the end was missing."""

    messages: int
    dropped: int
    truncated: bool


def repair(path: Path, out: Path, *, overwrite: bool = False) -> Repair:
    """Rewrite a truncated or damaged session as a whole one with all that can still be read.

    Raises FormatError when ``path`` is no MCAP file or has too many channels, ExistsError
    when ``out`` exists.
    """
    if not path.is_file():
        raise FormatError(f"{path} does not exist; give a recorded session")
    check_free(out, overwrite)
    kept = dropped = 0
    with path.open("rb") as source, replacing(out) as temporary, temporary.open("wb") as sink:
        writer = Writer(sink, chunk_size=CHUNK_BYTES)
        writer.start(profile="", library=METADATA)
        add = copier(writer)
        for offset in record_offsets(source):
            try:
                records = records_at(source, offset)
            except FormatError:
                dropped += 1
                continue
            kept += sum(map(add, records))
        writer.finish()
        return Repair(kept, dropped, truncated=not is_complete(source))


def copier(writer: Writer) -> Callable[[McapRecord], int]:
    """A function that copies one record and returns the number of messages copied (0 or 1).

    It raises FormatError for more channels, or longer descriptions of them, than any session has.
    """
    schemas: dict[int, int] = {0: 0}
    channels: dict[int, int] = {}
    described = 0

    def describe(*parts: str | bytes) -> None:
        nonlocal described
        described += sum(ENTRY_BYTES + len(part) for part in parts)
        if max(len(schemas), len(channels)) > MAX_CHANNELS or described > MAX_DESCRIBED_BYTES:
            raise FormatError(
                f"the file names more than {MAX_CHANNELS} channels or schemas, or takes more than "
                f"{MAX_DESCRIBED_BYTES} bytes to describe them; give a recorded session"
            )

    def add(record: McapRecord) -> int:
        if isinstance(record, Schema) and record.id not in schemas:
            describe(record.name, record.encoding, record.data)
            schemas[record.id] = writer.register_schema(record.name, record.encoding, record.data)
        elif isinstance(record, Channel) and record.id not in channels and record.schema_id in schemas:
            describe(record.topic, *record.metadata.keys(), *record.metadata.values())
            schema = schemas[record.schema_id]
            channels[record.id] = writer.register_channel(
                record.topic, record.message_encoding, schema, record.metadata
            )
        elif isinstance(record, Metadata):
            describe(record.name)
            writer.add_metadata(record.name, record.metadata)
        elif isinstance(record, Message) and record.channel_id in channels:
            writer.add_message(
                channels[record.channel_id],
                record.log_time,
                record.data,
                record.publish_time,
                record.sequence,
            )
            return 1
        return 0

    return add
