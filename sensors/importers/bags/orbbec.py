"""A recording of Orbbec's SDK 2 (.bag, a ROS 1 bag) as a source of frames.

Its images are ROS's with more behind the pixels than their definition says. Topics and contents:
OrbbecSDK_v2, src/media/ros (MIT). The SDK need not be installed.
"""

import re
import struct
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from sensors.calibration_files.lens_models import intrinsics_from_rational
from sensors.errors import CalibrationError, FormatError
from sensors.importers.bags.bag_files import RosbagFile, damaged, open_rosbag
from sensors.importers.bags.camera_frames import (
    COLOR_FOUND,
    CameraFrames,
    Images,
    Recorded,
    Stream,
    depth_lens,
)
from sensors.importers.bags.ros1_file import Ros1File
from sensors.importers.bags.ros_messages import Picture
from sensors.importers.options import AS_STATED, ImportOptions
from sensors.rig.camera import Intrinsics
from sensors.rig.frame import FrameSource, RigFrame
from sensors.rig.rig_calibration import Pose, RigCalibration

DEPTH, COLOR, INFRARED = "depth", "colour", "infrared"
SENSORS = {"3": DEPTH, "2": COLOR, "1": INFRARED, "6": INFRARED}
"""Numbers of sensors and of streams (OBSensorType, OBStreamType); of two infrared cameras the left one."""
KINDS = frozenset({"Image", "OBStreamProfileInfo"})
UNITS_MM = (0.01, 10.0)
"""Millimetres of a step of depth: what lies beyond is none."""
_IMAGE = re.compile(r"/cam/sensor_(\d+)/frameType_\d+")
_PROFILE = re.compile(r"/cam/streamProfileType_(\d+)")
_HEADER, _SIZE, _LENGTH, _STEP = (struct.Struct(code) for code in ("<III", "<II", "<I", "<BI"))
_TAIL = struct.Struct("<fQQ")
"""Behind the pixels: unit of depth in mm, number of the frame, its time in us."""
_STREAM = struct.Struct("<BB9f3f3H4f8f")
"""Stream, format, rotation and translation (mm) from depth to colour, size and rate, lens, distortion."""
_JPEG, _YUYV = ("mjpg", "mjpeg", "jpeg"), ("yuyv", "yuy2")


class _Image(NamedTuple):
    """An image message. unit_mm, number: 0 and -1 where the SDK's version puts other things there."""

    stamp_ns: int
    picture: Picture
    unit_mm: float
    number: int


@dataclass
class _Stream(Stream):
    """One stream. unit_mm: of depth, 0 = not stated; profile: the numbers of ``_STREAM``."""

    unit_mm: float = 0.0
    profile: tuple[float, ...] = ()

    def lens(self) -> Intrinsics | None:
        """The factory's intrinsics."""
        if not self.profile:
            return None
        width, height, (fx, fy, cx, cy) = int(self.profile[14]), int(self.profile[15]), self.profile[17:21]
        k1, k2, k3, k4, k5, k6, p1, p2 = self.profile[21:29]
        matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
        return intrinsics_from_rational((width, height), matrix, np.array([k1, k2, p1, p2, k3, k4, k5, k6]))

    def pose(self) -> Pose:
        """From this stream to colour. Raises CalibrationError if it is missing (the file then has zeros)."""
        return Pose(np.array(self.profile[2:11]).reshape(3, 3), np.array(self.profile[11:14]) / 1000)


class OrbbecRecording(FrameSource):
    """A recording of Orbbec's SDK as a ``FrameSource``: depth, its infrared, the colour nearest in time.

    notes: what is absent or assumed. Raises FormatError, and CalibrationError where nothing describes the
    depth camera.
    """

    path: Path

    def __init__(self, path: Path, options: ImportOptions = AS_STATED) -> None:
        self.path, self.name = path, path.stem
        self._file = open_rosbag(path)
        self._streams = {name: _Stream() for name in (DEPTH, COLOR, INFRARED)}
        with damaged(path):
            self._index()
            depth = self._streams[DEPTH]
            if not depth.images:
                raise FormatError(f"{path} has no depth images; record the depth sensor")
            depths, colors, infrareds = (self._images(name) for name in (DEPTH, COLOR, INFRARED))
            self.calibration, notes = self._calibrate(depths, options)
            unit_mm = options.depth_unit_mm or depth.unit_mm or None
            self._frames = CameraFrames(depths, colors, infrareds, unit_mm, path.name)
        timeline = depths.timeline
        self.times_ns = timeline.times_ns
        self.notes = (
            *notes,
            *([] if unit_mm else ["no depth unit in the recording"]),
            *self._frames.notes,
            *depth.lost(timeline),
            "no thermal images",
            *([self._file.lost] if self._file.lost else []),
        )

    def _frame(self, index: int) -> RigFrame:
        return self._frames.frame(index)

    def _images(self, name: str) -> Images:
        stream = self._streams[name]
        return stream.opened(name, stream.stamps_ns, self._file, self._picture)

    def _picture(self, data: bytes) -> Picture:
        with damaged(self.path):
            return _image(data).picture

    def _index(self) -> None:
        """Find the images and what describes their cameras."""
        for entry in self._file.entries(KINDS):
            image, profile = _IMAGE.fullmatch(entry.topic), _PROFILE.fullmatch(entry.topic)
            found = image or profile
            if found is None or found[1] not in SENSORS:
                continue
            stream = self._streams[SENSORS[found[1]]]
            if profile is not None:
                stream.profile = stream.profile or _profile(entry.data)
                continue
            read = _image(entry.data)
            stream.topic = entry.topic
            stream.images.append(Recorded(read.number, read.stamp_ns, entry.logged_ns, entry.place))
            stream.unit_mm = stream.unit_mm or read.unit_mm

    def _calibrate(self, images: Images, options: ImportOptions) -> tuple[RigCalibration, list[str]]:
        """Return the calibration, and notes on it. images: of depth."""
        depth, color = self._streams[DEPTH], self._streams[COLOR]
        lens, notes = depth_lens(depth.lens(), images, options.intrinsics, self.path)
        if not color.images:
            return RigCalibration(lens), [*notes, "no colour images"]
        with suppress(CalibrationError):
            if (color_lens := color.lens()) is not None:
                return RigCalibration(lens, color_lens, depth.pose()), [*notes, COLOR_FOUND]
        return RigCalibration(lens), [
            *notes,
            "no calibration of the colour camera: its images cannot be fused",
        ]


def is_orbbec(file: RosbagFile | Ros1File) -> bool:
    """Whether Orbbec's SDK made this ROS 1 bag. Raises FormatError."""
    return any(_PROFILE.fullmatch(topic) or _IMAGE.fullmatch(topic) for topic in file.topics)


def _image(data: bytes) -> _Image:
    """Raises struct.error and UnicodeDecodeError for a message that is cut."""
    _, seconds, nanoseconds = _HEADER.unpack_from(data)
    frame, at = _sized(data, _HEADER.size)
    height, width = _SIZE.unpack_from(data, at)
    encoding, at = _sized(data, at + _SIZE.size)
    big_endian, step = _STEP.unpack_from(data, at)
    pixels, at = _sized(data, at + _STEP.size)
    # The SDK goes through seconds in floating point.
    stamp_us = 1_000_000 * seconds + round(nanoseconds / 1000)
    name = encoding.decode("ascii").lower()
    if name in _JPEG:
        picture = Picture(frame.decode(), name, pixels, compressed=True)
    else:
        step = step or len(pixels) // max(1, height)
        name = "YUYV" if name in _YUYV else "mono16" if name == "z16" else name
        picture = Picture(frame.decode(), name, pixels, False, height, width, step, bool(big_endian))
    unit_mm, number, again_us = _TAIL.unpack_from(data, at) if len(data) >= at + _TAIL.size else (0, 0, -1)
    if abs(again_us - stamp_us) > 1 or not UNITS_MM[0] <= unit_mm <= UNITS_MM[1]:
        unit_mm, number = 0.0, -1
    return _Image(1000 * stamp_us, picture, float(unit_mm), number)


def _profile(data: bytes) -> tuple[float, ...]:
    """The numbers of ``_STREAM``; none of a message that holds something else."""
    with suppress(struct.error):
        _, at = _sized(data, _HEADER.size)
        numbers = _STREAM.unpack_from(data, at)
        if numbers[14] > 0 and numbers[15] > 0 and np.isfinite(numbers).all():
            return tuple(numbers)
    return ()


def _sized(data: bytes, at: int) -> tuple[bytes, int]:
    """Bytes behind their number, and where they end. Raises struct.error where they are cut."""
    (length,) = _LENGTH.unpack_from(data, at)
    end = at + _LENGTH.size + length
    if end > len(data):
        raise struct.error(f"{length} bytes are announced, {len(data) - at} there")
    return data[at + _LENGTH.size : end], end
