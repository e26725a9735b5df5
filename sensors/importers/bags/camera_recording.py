"""Recordings of a depth camera by its maker's SDK: depth, infrared, the colour nearest in time."""

from abc import abstractmethod
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sensors.calibration_files.intrinsics_file import read_intrinsics
from sensors.checks.depth_check import judge_depth, spread
from sensors.errors import CalibrationError, FormatError, Setting
from sensors.importers.bags.bag_files import damaged, open_rosbag
from sensors.importers.bags.ros_images import FINE_MM, color_encoded_from, depth_from, grey_from, picture_size
from sensors.importers.bags.ros_messages import Picture, Place
from sensors.importers.bags.timeline import Stamps, Timeline, paired, paired_by_stamps, timeline_of
from sensors.importers.options import AS_STATED, ImportOptions
from sensors.rig.camera import Intrinsics
from sensors.rig.frame import FrameSource, RigFrame
from sensors.rig.rig_calibration import Pose, RigCalibration

DEPTH, COLOR, INFRARED = STREAMS = "depth", "colour", "infrared"
PAUSE_NS = 10_000_000_000  # a longer gap is a pause rather than lost images; untuned


class Recorded(NamedTuple):
    """One image message: its number (-1 = not known), the camera's time, the recorder's time, its place."""

    number: int
    stamp_ns: int
    received_ns: int
    place: Place


@dataclass
class Stream:
    """Images of one stream in file order, all of one topic and kind.

    The recorder's times give no reliable order. They are wrong after a pause in front of the first image
    (librealsense pull request 9887) and at the end of a recording (issue 8032).
    """

    topic: str = ""
    kind: str = ""
    images: list[Recorded] = field(default_factory=list)


class CameraRecording(FrameSource):
    """Recording of a maker's SDK as a ``FrameSource``. A subclass finds images and cameras in its messages.

    notes: missing and assumed data. Raises FormatError, and CalibrationError where nothing describes the
    depth camera.
    """

    path: Path

    def __init__(self, path: Path, options: ImportOptions = AS_STATED) -> None:
        self.path, self.name = path, path.stem
        self._file, self._streams = open_rosbag(path), {name: Stream() for name in STREAMS}
        with damaged(path):
            stated_mm = self._index()
            if not self._streams[DEPTH].images:
                raise FormatError(f"{path} has no depth images; record the depth stream")
            self._timelines = {name: self._timeline(name) for name in STREAMS}
            depth, color, infrared = self._timelines.values()
            self.times_ns = depth.times_ns
            self.calibration, camera_notes = self._calibrate(options)
            unit_mm = options.depth_unit_mm or stated_mm
            samples = [depth_from(self._image(DEPTH, at)) for at in spread(len(self))]
            self._reading = judge_depth(samples, unit_mm, path.name, FINE_MM)
            self._color_at, apart = paired(depth, color)
            self._infrared_at = paired_by_stamps(depth, infrared, 0)
        self.notes = (
            *camera_notes,
            *([] if unit_mm else ["no depth unit in the recording"]),
            *self._reading.notes,
            *depth.notes,
            *color.notes,
            *(apart if len(color.times_ns) else ()),
            *self._lost_notes(),
            "no thermal images",
            *([self._file.lost] if self._file.lost else []),
        )

    @abstractmethod
    def _index(self) -> float | None:
        """Fill the streams; return the stated millimetres of a depth step, or None."""

    @abstractmethod
    def _picture(self, kind: str, data: bytes) -> Picture:
        """Decode an image message."""

    @abstractmethod
    def _lens(self, name: str) -> Intrinsics | None:
        """Return the factory's intrinsics of a stream."""

    @abstractmethod
    def _color_from_depth(self) -> Pose | None:
        """Return the factory's pose color_from_depth or None. Raises CalibrationError where it is damaged."""

    def _stamps_ns(self, name: str) -> NDArray[np.int64]:
        """Return the camera's times (n,) of a stream."""
        return np.array([image.stamp_ns for image in self._streams[name].images], np.int64)

    def _timeline(self, name: str) -> Timeline:
        received_ns = np.array([image.received_ns for image in self._streams[name].images], np.int64)

        def same(a: int, b: int) -> bool:
            return self._bytes(name, a) == self._bytes(name, b)

        return timeline_of(Stamps(name, self._stamps_ns(name), received_ns, same))

    def _bytes(self, name: str, at: int) -> bytes:
        stream = self._streams[name]
        return self._file.read(stream.topic, stream.images[at].place)

    def _image(self, name: str, index: int) -> Picture:
        """Return a stream's picture by its index in the order of time."""
        data = self._bytes(name, int(self._timelines[name].recorded[index]))
        with damaged(self.path):
            return self._picture(self._streams[name].kind, data)

    def _calibrate(self, options: ImportOptions) -> tuple[RigCalibration, list[str]]:
        """Return the calibration, and notes on its origin."""
        if options.intrinsics is not None:
            width, height = picture_size(self._image(DEPTH, 0)) or (0, 0)
            lens = read_intrinsics(options.intrinsics, (height, width)).depth
            notes = [f"depth intrinsics from {options.intrinsics.name}, as declared"]
        elif (factory := self._lens(DEPTH)) is not None:
            lens, notes = factory, ["intrinsics from the recording"]
        else:
            raise CalibrationError(
                f"{self.path} has no intrinsics of the depth camera; give them", Setting.INTRINSICS
            )
        if not self._streams[COLOR].images:
            return RigCalibration(lens), [*notes, "no colour images"]
        with suppress(CalibrationError):
            color_lens, pose = self._lens(COLOR), self._color_from_depth()
            if color_lens is not None and pose is not None:
                calibration = RigCalibration(lens, color_lens, pose)
                return calibration, [*notes, "colour camera from the recording"]
        notes.append("no calibration of the colour camera: its images cannot be fused")
        return RigCalibration(lens), notes

    def _lost_notes(self) -> list[str]:
        """Return notes on missing image numbers and on pauses.

        Losses at a restart of the counter are unknown.
        """
        timeline, images = self._timelines[DEPTH], self._streams[DEPTH].images
        numbers = np.array([images[at].number for at in timeline.recorded], np.int64)
        known = numbers >= 0
        steps, gaps_ns = np.diff(numbers[known]), np.diff(timeline.times_ns[known])
        paused = gaps_ns > PAUSE_NS
        lost = int((steps[(steps > 1) & ~paused] - 1).sum())
        notes = [f"{lost} depth images were lost while it was recorded"] * (lost > 0)
        if (again := int(np.count_nonzero(steps < 0))) > 0:
            notes.append(f"the camera's counter of images starts again {again} times")
        if paused.any():
            seconds = float(gaps_ns[paused].sum()) / 1e9
            notes.append(f"{np.count_nonzero(paused)} pauses of {seconds:.0f} s in all without depth images")
        return notes

    def _frame(self, index: int) -> RigFrame:
        depth_mm = self._reading.to_mm(depth_from(self._image(DEPTH, index)))
        color, infrared = int(self._color_at[index]), int(self._infrared_at[index])
        encoded = color_encoded_from(self._image(COLOR, color)) if color >= 0 else None
        amplitude = grey_from(self._image(INFRARED, infrared)) if infrared >= 0 else None
        if amplitude is not None and amplitude.shape != depth_mm.shape:
            amplitude = None
        return RigFrame(index, int(self.times_ns[index]), depth_mm, encoded, None, amplitude)
