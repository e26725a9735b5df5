"""A recorded session as a source of frames, read from disk one frame at a time."""

import hashlib
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sensors.errors import CloudError, FormatError, one_line
from sensors.files.own_files import own_file
from sensors.rig.frame import FrameSource, RigFrame
from sensors.rig.pairing import (
    COLOR_WINDOW_NS,
    SPOT_WINDOW_NS,
    interpolate,
    pair_stamps,
    thermal_window_ns,
)
from sensors.rig.thermal_reference import LEAST_READINGS, READINGS, ThermalReference
from sensors.session.host_times import host_times
from sensors.session.index import Places, read_contents
from sensors.session.mcap_records import MessageReader
from sensors.session.messages import (
    CAST,
    COLOR,
    COUNTS,
    DEPTH,
    INFRARED,
    PYROMETER,
    SUBJECT,
    THERMAL,
    color_from,
    image_from,
    target_from,
    thermal_from,
)
from sensors.session.recording_file import RecordingError, is_being_recorded, recording_at

DELAY_NS = 1_000_000  # from stamp to arrival, from which the two are of different clocks; untuned


@dataclass(frozen=True)
class StreamRate:
    """Number of messages of a topic, and their mean rate by device stamp (0 for fewer than two)."""

    count: int
    rate_hz: float


class Session(FrameSource):
    """A session file, whole or truncated, as a ``FrameSource``.

    Depth is master: a frame has the colour and thermal images nearest to it in device time, within windows,
    and no message is used twice. Frames are numbered in the order of their depth stamps. Opening reads the
    index in the file, or the whole file without one; damage in a chunk is found with its frame. ``path`` may
    name a recording of which only the ``.partial`` exists. Raises FormatError for a file that is not a
    session or is damaged, CalibrationError when calibration is missing.
    """

    path: Path

    def __init__(self, path: Path) -> None:
        path = recording_at(path)
        if path.is_dir():
            own = own_file(path)
            raise FormatError(f"{path} is {own.kind if own else 'a folder'}; give a session's file")
        try:
            contents = read_contents(path)
        except CloudError as error:
            if is_being_recorded(path):
                raise RecordingError(
                    f"{path} is being recorded and has no frame yet; open it again in a second"
                ) from error
            raise
        self.path = path
        self.metadata = {**contents.metadata}
        self.name = self.metadata.pop("name", "") or path.name.split(".")[0]
        self.events = contents.events
        self.calibration, self.truncated = contents.calibration, contents.truncated
        self.subject = one_line(self.metadata.get(SUBJECT, ""))
        self.cast = one_line(self.metadata.get(CAST, self.cast))
        self._places = contents.places
        self._clocks_lost = not contents.metadata and any(map(_is_delayed, self._places.values()))
        self.times_ns = self._places[DEPTH]["stamp_ns"]
        host = host_times(self._places, self.metadata, self.events)
        self._pairs = {
            DEPTH: np.arange(len(self)),
            COLOR: host.pairs(DEPTH, COLOR, COLOR_WINDOW_NS),
            THERMAL: host.pairs(DEPTH, THERMAL, thermal_window_ns(host.ns[THERMAL])),
            # One exposure gives depth and infrared.
            INFRARED: pair_stamps(self.times_ns, self._places[INFRARED]["stamp_ns"], 0),
        }
        self._host = host.ns
        self.is_being_recorded = self.truncated and is_being_recorded(path)
        self._reader = MessageReader(path)

    def _frame(self, index: int) -> RigFrame:
        depth, color, thermal, infrared = (self._message(t, int(at[index])) for t, at in self._pairs.items())
        return RigFrame(
            index,
            int(self.times_ns[index]),
            image_from(depth, "depth"),
            color_from(color) if color else None,
            self._referenced(index, thermal_from(thermal)) if thermal else None,
            image_from(infrared, "infrared") if infrared else None,
        )

    @cached_property
    def reference_c(self) -> NDArray[np.float64]:
        """Return float64 (n,) Celsius: the pyrometer's target at the time of every frame, NaN = not measured.

        Interpolated between its two nearest readings within ``SPOT_WINDOW_NS``.
        """
        times = self._host[PYROMETER]
        values = [self._target_c(i) for i in range(len(times))]
        return interpolate(times, np.array(values), self._host[DEPTH], SPOT_WINDOW_NS)

    @cached_property
    def offsets_k(self) -> NDArray[np.float64] | None:
        """Return float64 (n,) kelvins that the pyrometer's correction adds to each frame's temperatures.

        None without a pyrometer, or where its spot in the image is unknown.
        """
        if not len(self._places[PYROMETER]):
            return None
        camera, times_s = self.calibration.thermal, self._host[DEPTH].astype(np.float64) * 1e-9
        known = np.flatnonzero(np.isfinite(self.reference_c) & (self._pairs[THERMAL] >= 0))
        if camera is None or not len(known):
            return None
        reference = ThermalReference(camera.fx)
        for at in np.unique(np.linspace(0, len(known) - 1, READINGS).round().astype(int)):
            index = int(known[at])
            with suppress(FormatError):  # a damaged image costs its own frame alone
                image = thermal_from(self._message(THERMAL, int(self._pairs[THERMAL][index])))
                reference.add(float(times_s[index]), float(self.reference_c[index]), image)
        spot = reference.spot()
        return None if spot is None else reference.offsets_k(spot, times_s)

    @property
    def frame_of_color(self) -> dict[int, int]:
        """Return the index of the frame that a colour image belongs to, by the image's device stamp."""
        stamps_ns, pairs = self._places[COLOR]["stamp_ns"], self._pairs[COLOR]
        return {int(stamps_ns[at]): frame for frame, at in enumerate(pairs) if at >= 0}

    def _target_c(self, index: int) -> float:
        """Return a reading of the pyrometer; NaN where it is damaged."""
        try:
            return target_from(self._message(PYROMETER, index))
        except FormatError:
            return np.nan

    def _referenced(self, index: int, thermal_c: NDArray[np.float32]) -> NDArray[np.float32]:
        return thermal_c if self.offsets_k is None else thermal_c + np.float32(self.offsets_k[index])

    @property
    def streams(self) -> dict[str, StreamRate]:
        """Return count and rate of every image topic that has messages."""
        return {topic: _rate(found["stamp_ns"]) for topic, found in self._places.items() if len(found)}

    @cached_property
    def notes(self) -> tuple[str, ...]:  # type: ignore[override]
        """Return missing parts of the session, and corrections of its images, one sentence each."""
        has = {topic: bool(len(found)) for topic, found in self._places.items()}
        notes = ["no colour images"] * (not has[COLOR]) + ["no thermal images"] * (not has[THERMAL])
        if shift_mm := round(self.calibration.depth_shift_mm):
            notes.append(f"depth readings are moved by {shift_mm:+d} mm, as calibrated")
        if has[COUNTS] and not has[THERMAL]:
            notes.append("thermal counts without the camera's calibration are not temperatures")
        if len(self._places[PYROMETER]) >= LEAST_READINGS and has[THERMAL]:
            notes.append(self._pyrometer_note())
        for name, camera, topic in (
            ("colour", self.calibration.color, COLOR),
            ("thermal", self.calibration.thermal, THERMAL),
        ):
            if camera is None and has[topic]:
                notes.append(f"no calibration of the {name} camera: its images cannot be fused")
        if self._clocks_lost:
            notes.append(
                "the metadata that name the cameras' clocks are missing: all stamps are taken as of one "
                "clock, so that colour and temperature may belong to other frames"
            )
        if self.truncated and self.is_being_recorded:
            notes.append(f"{self.path} is being recorded: {len(self)} frames up to now")
        elif self.truncated:
            notes.append(
                f"truncated: the recording was cut off after {len(self)} frames; "
                f"make it whole with: annotate-cloud repair {self.path}"
            )
        return tuple(notes)

    def _pyrometer_note(self) -> str:
        if self.offsets_k is None:
            return "the pyrometer corrects nothing: too little moves to find its spot in the thermal image"
        low, high = self.offsets_k.min(), self.offsets_k.max()
        return f"temperatures are corrected by the pyrometer's, by {low:+.1f} to {high:+.1f} K"

    @cached_property
    def sha256(self) -> str:
        """Return the SHA-256 of the file, in hexadecimal."""
        with self.path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()

    def _message(self, topic: str, index: int) -> bytes:
        """Return the bytes of a message; none where ``index`` is -1."""
        if index < 0:
            return b""
        place = self._places[topic][index]
        return self._reader.read(int(place["offset"]), int(place["slot"]), int(place["stamp_ns"]))


def _is_delayed(places: Places) -> bool:
    """Return whether a device's stamps differ from the host's times; simulated and imported sessions have
    equal times.
    """
    return bool(len(places)) and bool(np.abs(places["arrival_ns"] - places["stamp_ns"]).max() > DELAY_NS)


def _rate(stamps_ns: NDArray[np.int64]) -> StreamRate:
    span_s = float(stamps_ns[-1] - stamps_ns[0]) * 1e-9
    return StreamRate(len(stamps_ns), round((len(stamps_ns) - 1) / span_s, 3) if span_s > 0 else 0.0)
