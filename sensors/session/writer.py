"""Writer of a session: an MCAP file for Foxglove and ROS tools that survives a crash.

Topics: ``messages``; log_time is the host's arrival, publish_time the device's stamp. Until it is complete a
session is called ``NAME.mcap.partial``, and can be read at any time. Every depth frame ends a compressed
chunk that is handed to the system at once, so that a killed process loses at most one frame.
"""

import errno
import os
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO, Self

import numpy as np
from google.protobuf.message import Message as ProtoMessage
from mcap_protobuf.schema import build_file_descriptor_set
from numpy.typing import NDArray

from sensors.errors import ExistsError, FormatError
from sensors.files.atomic import check_free
from sensors.rig.frame import RigFrame
from sensors.rig.rig_calibration import RigCalibration
from sensors.session.indexed_writer import IndexedWriter
from sensors.session.messages import (
    COLOR,
    DEPTH,
    EVENTS,
    INFRARED,
    METADATA,
    SCHEMAS,
    THERMAL,
    calibration_messages,
    color_message,
    event_message,
    image_message,
    thermal_message,
)
from sensors.session.recording_file import open_locked, partial_of


class SessionWriter:
    """Writer of one session, as a context manager.

    On success the file takes its final name. On an exception, Ctrl-C included, the record stays under
    ``partial`` and opens as a truncated session. The partial is locked (``recording_file``) while it is
    written. Raises ExistsError when ``path`` or an unfinished recording of it exists and ``overwrite`` is
    False, at the end too, RecordingError while another process writes it.
    """

    keeps_partial = True

    def __init__(
        self,
        path: Path,
        calibration: RigCalibration,
        name: str,
        *,
        overwrite: bool = False,
        metadata: dict[str, str] | None = None,
    ) -> None:
        self.path, self.calibration = path, calibration
        self.partial = partial_of(path)
        self._metadata = {**(metadata or {}), "name": name}
        self._overwrite = overwrite
        self._file: BinaryIO
        self._writer: IndexedWriter
        self._channels: dict[str, int] = {}
        self._calibrated = False

    def __enter__(self) -> Self:
        for path in (self.path, self.partial):
            check_free(path, self._overwrite)
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self._file = open_locked(self.partial, self._overwrite)
        try:
            self._begin()
        except BaseException:
            with suppress(OSError):
                self._file.close()
            self.partial.unlink(missing_ok=True)
            raise
        return self

    def _begin(self) -> None:
        """Write the records that come before the first message."""
        self._writer = IndexedWriter(self._file)
        for topic, schema in SCHEMAS.items():
            described = build_file_descriptor_set(schema).SerializeToString()
            number = self._writer.register_schema(schema.DESCRIPTOR.full_name, "protobuf", described)
            self._channels[topic] = self._writer.register_channel(topic, "protobuf", number, {})
        self._writer.add_metadata(METADATA, self._metadata)

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        try:
            with self._file:
                if kind is None:
                    self._writer.finish()
                    self._file.flush()
                    os.fsync(self._file.fileno())
                    self._check_names()
                    self.partial.replace(self.path)  # while the partial is locked
        finally:
            if not self.keeps_partial:
                self.partial.unlink(missing_ok=True)

    def is_in_place(self) -> bool:
        """Return whether the partial file still exists under its name; True where that is unknown."""
        try:
            return os.path.samestat(self.partial.stat(), os.fstat(self._file.fileno()))
        except FileNotFoundError:
            return False
        except OSError:  # of a share that does not answer
            return True

    def _check_names(self) -> None:
        """Check that the partial file was not replaced, and that its final name is free."""
        if not self.is_in_place():
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(self.partial))
        if self.path.exists() and not self._overwrite:
            raise ExistsError(
                f"{self.path} was made by another program meanwhile, and stays; the session is whole as "
                f"{self.partial}: rename it"
            )

    def write(self, frame: RigFrame, arrival_ns: int | None = None) -> None:
        """Write a frame, stamped with the depth camera's time. Raises FormatError as ``add`` and
        ``color_message``.
        """
        stamp_ns = frame.stamp_ns
        if frame.color_encoded is not None:
            self.add(COLOR, color_message(frame.color_encoded, stamp_ns), stamp_ns, arrival_ns)
        if frame.thermal_c is not None:
            self.add(THERMAL, thermal_message(frame.thermal_c, stamp_ns), stamp_ns, arrival_ns)
        if frame.infrared is not None:
            self.add(INFRARED, image_message(frame.infrared, "infrared", stamp_ns), stamp_ns, arrival_ns)
        self.write_depth(frame.depth_mm, stamp_ns, arrival_ns)

    def write_depth(self, depth_mm: NDArray[np.uint16], stamp_ns: int, arrival_ns: int | None = None) -> None:
        """Write a depth image of the calibrated size, and pass all data so far to the system's file cache."""
        self.calibration.depth.check_size("depth image", depth_mm.shape)
        self.add(DEPTH, image_message(depth_mm, "depth", stamp_ns), stamp_ns, arrival_ns)
        self.flush()

    def event(self, stamp_ns: int, text: str, arrival_ns: int | None = None) -> None:
        """Write a note on an event at ``stamp_ns``."""
        self.add(EVENTS, event_message(stamp_ns, text), stamp_ns, arrival_ns)

    def flush(self) -> None:
        """End the chunk and write it to the system's file cache, which survives the death of the process."""
        self._writer.flush()

    def add(self, topic: str, message: ProtoMessage, stamp_ns: int, arrival_ns: int | None = None) -> None:
        """Write one of ``messages``, made at ``stamp_ns``. Raises FormatError for an impossible time."""
        arrival = stamp_ns if arrival_ns is None else arrival_ns
        if not (0 <= stamp_ns < 1 << 63 and 0 <= arrival < 1 << 63):
            raise FormatError(f"time {stamp_ns} ns is impossible; give 0 to 2^63 - 1")
        if not self._calibrated:
            # First, and with the first stamp: the session's time range is the images'.
            self._calibrated = True
            for its_topic, calibration in calibration_messages(self.calibration, stamp_ns):
                self.add(its_topic, calibration, stamp_ns, arrival)
            self.flush()
        self._writer.add_message(self._channels[topic], arrival, message.SerializeToString(), stamp_ns)


class RepeatableWriter(SessionWriter):
    """Writer of a session that can be generated again; after an exception no file is kept."""

    keeps_partial = False
