"""Frames of a depth camera, as its maker recorded them: depth, infrared, the colour nearest in time."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sensors.calibration_files.intrinsics_file import read_intrinsics
from sensors.checks.depth_check import judge_depth, spread
from sensors.errors import CalibrationError
from sensors.importers.bags.bag_files import BagFile
from sensors.importers.bags.entries import Place
from sensors.importers.bags.ros_images import FINE_MM, color_encoded_from, depth_from, grey_from, picture_size
from sensors.importers.bags.ros_messages import Picture
from sensors.importers.bags.timeline import Stamps, Timeline, paired, paired_by_stamps, timeline_of
from sensors.rig.camera import Intrinsics
from sensors.rig.frame import RigFrame

PAUSE_NS = 10_000_000_000
"""Nanoseconds without a depth image above which a recording was paused rather than images lost. Untuned."""

COLOR_FOUND = "colour camera from the recording"
"""Note where a recording has intrinsics and pose of its colour camera."""


class Images(NamedTuple):
    """A stream's images: their order and times, and the picture at an index in that order."""

    timeline: Timeline
    picture: Callable[[int], Picture]


class Recorded(NamedTuple):
    """One image message: its number (-1 = not known), the camera's time, the recorder's time, its place."""

    number: int
    stamp_ns: int
    received_ns: int
    place: Place


@dataclass
class Stream:
    """The images of one stream in the order in which they were written, all of one topic.

    The recorder's times are no order: a pause before the first image spoils them (librealsense pull request
    9887), and so does the end of a recording (issue 8032).
    """

    topic: str = ""
    images: list[Recorded] = field(default_factory=list)

    @property
    def stamps_ns(self) -> NDArray[np.int64]:
        """The camera's times (n,)."""
        return np.array([image.stamp_ns for image in self.images], np.int64)

    def opened(
        self, name: str, stamps_ns: NDArray[np.int64], file: BagFile, picture: Callable[[bytes], Picture]
    ) -> Images:
        """Return the stream's images.

        stamps_ns: the camera's times (n,), unwrapped. picture: decodes a message.
        """
        received_ns = np.array([image.received_ns for image in self.images], np.int64)

        def bytes_at(index: int) -> bytes:
            return file.read(self.topic, self.images[index].place)

        def same(a: int, b: int) -> bool:
            return bytes_at(a) == bytes_at(b)

        timeline = timeline_of(Stamps(name, stamps_ns, received_ns, same))
        return Images(timeline, lambda index: picture(bytes_at(int(timeline.recorded[index]))))

    def lost(self, timeline: Timeline) -> list[str]:
        """Return ``lost_notes`` of the images whose number is known."""
        numbers = np.array([self.images[at].number for at in timeline.recorded], np.int64)
        known = numbers >= 0
        return lost_notes(numbers[known], timeline.times_ns[known])


class CameraFrames:
    """The frames of three streams, read one at a time.

    unit_mm: one step of depth, None where the recording does not state it. where: names the source in
    messages. notes: on the depth, the times and the colour. Raises FormatError where depth is none.
    """

    def __init__(
        self, depth: Images, color: Images, infrared: Images, unit_mm: float | None, where: str
    ) -> None:
        self._depth, self._color, self._infrared = depth, color, infrared
        samples = [depth_from(depth.picture(at)) for at in spread(len(depth.timeline.times_ns))]
        self._reading = judge_depth(samples, unit_mm, where, FINE_MM)
        self._color_at, apart = paired(depth.timeline, color.timeline)
        self._infrared_at = paired_by_stamps(depth.timeline, infrared.timeline, 0)
        self.notes = (
            *self._reading.notes,
            *depth.timeline.notes,
            *color.timeline.notes,
            *(apart if len(color.timeline.times_ns) else ()),
        )

    def frame(self, index: int) -> RigFrame:
        """Read the frame of depth image ``index``. Raises FormatError."""
        depth_mm = self._reading.to_mm(depth_from(self._depth.picture(index)))
        color, infrared = int(self._color_at[index]), int(self._infrared_at[index])
        encoded = color_encoded_from(self._color.picture(color)) if color >= 0 else None
        amplitude = grey_from(self._infrared.picture(infrared)) if infrared >= 0 else None
        if amplitude is not None and amplitude.shape != depth_mm.shape:
            amplitude = None
        stamp_ns = int(self._depth.timeline.times_ns[index])
        return RigFrame(index, stamp_ns, depth_mm, encoded, None, amplitude)


def depth_lens(
    factory: Intrinsics | None, depth: Images, declared: Path | None, path: Path
) -> tuple[Intrinsics, list[str]]:
    """Return the lens of depth and a note on its origin.

    factory: the recording's own, None = none. declared: a file that replaces it. path: the recording, for
    messages. Raises CalibrationError where there is neither.
    """
    if declared is not None:
        width, height = picture_size(depth.picture(0)) or (0, 0)
        lens = read_intrinsics(declared, (height, width)).depth
        return lens, [f"depth intrinsics from {declared.name}, as declared"]
    if factory is None:
        raise CalibrationError(f"{path} has no intrinsics of the depth camera; give --intrinsics FILE")
    return factory, ["intrinsics from the recording"]


def lost_notes(numbers: NDArray[np.int64], times_ns: NDArray[np.int64]) -> list[str]:
    """Return the notes on images that are missing by their numbers (n,), and on pauses.

    Losses at the moment at which the counter starts again are unknown.
    """
    steps, gaps_ns = np.diff(numbers), np.diff(times_ns)
    paused = gaps_ns > PAUSE_NS
    lost = int((steps[(steps > 1) & ~paused] - 1).sum())
    notes = [f"{lost} depth images were lost while it was recorded"] * (lost > 0)
    if (again := int(np.count_nonzero(steps < 0))) > 0:
        notes.append(f"the camera's counter of images starts again {again} times")
    if paused.any():
        seconds = float(gaps_ns[paused].sum()) / 1e9
        notes.append(f"{np.count_nonzero(paused)} pauses of {seconds:.0f} s in all without depth images")
    return notes
