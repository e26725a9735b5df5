"""A recording of Orbbec's SDK 2 (.bag, a ROS 1 bag) as a source of frames; the SDK need not be installed.

Its image messages are ROS's, with additional fields after the pixels. Topics and contents: OrbbecSDK_v2,
src/media/ros (MIT).
"""

import re
import struct
from contextlib import suppress
from pathlib import Path

import numpy as np

from sensors.calibration_files.lens_models import intrinsics_from_rational
from sensors.importers.bags.bag_files import RosbagFile
from sensors.importers.bags.camera_recording import COLOR, DEPTH, INFRARED, CameraRecording, Recorded
from sensors.importers.bags.ros1_file import Ros1File
from sensors.importers.bags.ros_messages import Picture
from sensors.importers.options import AS_STATED, ImportOptions
from sensors.rig.camera import Intrinsics
from sensors.rig.rig_calibration import Pose

SENSORS = {"3": DEPTH, "2": COLOR, "1": INFRARED, "6": INFRARED}
"""Numbers of sensors and of streams (OBSensorType, OBStreamType); of two infrared cameras the left one."""
KINDS = frozenset({"Image", "OBStreamProfileInfo"})
UNITS_MM = (0.01, 10.0)  # possible steps of depth
_IMAGE = re.compile(r"/cam/sensor_(\d+)/frameType_\d+")
_PROFILE = re.compile(r"/cam/streamProfileType_(\d+)")
_HEADER, _SIZE, _LENGTH, _STEP = (struct.Struct(code) for code in ("<III", "<II", "<I", "<BI"))
_TAIL = struct.Struct("<fQQ")  # behind the pixels: unit of depth in mm, number of the frame, its time in us
_STREAM = struct.Struct("<BB9f3f3H4f8f")
"""Stream, format, rotation and translation (mm) from depth to colour, size and rate, lens, distortion."""
_ENCODINGS = {"yuyv": "YUYV", "yuy2": "YUYV", "z16": "mono16"}


class OrbbecRecording(CameraRecording):
    """A recording of Orbbec's SDK as a ``FrameSource``."""

    def __init__(self, path: Path, options: ImportOptions = AS_STATED) -> None:
        self._profiles: dict[str, tuple[float, ...]] = {}  # the numbers of _STREAM by stream
        super().__init__(path, options)

    def _index(self) -> float | None:
        stated_mm = 0.0
        for entry in self._file.entries(KINDS):
            image, profile = _IMAGE.fullmatch(entry.topic), _PROFILE.fullmatch(entry.topic)
            found = image or profile
            if found is None or found[1] not in SENSORS:
                continue
            name = SENSORS[found[1]]
            if profile is not None:
                self._profiles[name] = self._profiles.get(name) or _profile(entry.data)
                continue
            stamp_ns, _, unit_mm, number = _image(entry.data)
            stream = self._streams[name]
            stream.topic = entry.topic
            stream.images.append(Recorded(number, stamp_ns, entry.logged_ns, entry.place))
            if name == DEPTH:
                stated_mm = stated_mm or unit_mm
        return stated_mm or None

    def _picture(self, kind: str, data: bytes) -> Picture:
        return _image(data)[1]

    def _lens(self, name: str) -> Intrinsics | None:
        profile = self._profiles.get(name)
        if not profile:
            return None
        width, height, (fx, fy, cx, cy) = int(profile[14]), int(profile[15]), profile[17:21]
        k1, k2, k3, k4, k5, k6, p1, p2 = profile[21:29]
        matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
        return intrinsics_from_rational((width, height), matrix, np.array([k1, k2, p1, p2, k3, k4, k5, k6]))

    def _color_from_depth(self) -> Pose | None:
        """Return the pose color_from_depth.

        Raises CalibrationError for the zeros that a file without a pose holds.
        """
        profile = self._profiles.get(DEPTH)
        if not profile:
            return None
        return Pose(np.array(profile[2:11]).reshape(3, 3), np.array(profile[11:14]) / 1000)


def is_orbbec(file: RosbagFile | Ros1File) -> bool:
    """Return whether Orbbec's SDK made this ROS 1 bag. Raises FormatError where it is damaged."""
    return any(_PROFILE.fullmatch(topic) or _IMAGE.fullmatch(topic) for topic in file.topics)


def _image(data: bytes) -> tuple[int, Picture, float, int]:
    """Return time (ns), image, unit (mm) and number of an image message.

    Unit and number are 0 and -1 for SDK versions with another layout. Raises struct.error and
    UnicodeDecodeError for a truncated message.
    """
    _, seconds, nanoseconds = _HEADER.unpack_from(data)
    frame, at = _sized(data, _HEADER.size)
    height, width = _SIZE.unpack_from(data, at)
    encoding, at = _sized(data, at + _SIZE.size)
    big_endian, step = _STEP.unpack_from(data, at)
    pixels, at = _sized(data, at + _STEP.size)
    # The SDK goes through seconds in floating point.
    stamp_us = 1_000_000 * seconds + round(nanoseconds / 1000)
    name = encoding.decode("ascii").lower()
    if name in ("mjpg", "mjpeg", "jpeg"):
        picture = Picture(frame.decode(), name, pixels, compressed=True)
    else:
        step = step or len(pixels) // max(1, height)
        name = _ENCODINGS.get(name, name)
        picture = Picture(frame.decode(), name, pixels, False, height, width, step, bool(big_endian))
    unit_mm, number, again_us = _TAIL.unpack_from(data, at) if len(data) >= at + _TAIL.size else (0, 0, -1)
    if abs(again_us - stamp_us) > 1 or not UNITS_MM[0] <= unit_mm <= UNITS_MM[1]:
        unit_mm, number = 0.0, -1
    return 1000 * stamp_us, picture, float(unit_mm), number


def _profile(data: bytes) -> tuple[float, ...]:
    """Return the numbers of ``_STREAM``; empty for a message with another layout."""
    with suppress(struct.error):
        _, at = _sized(data, _HEADER.size)
        numbers = _STREAM.unpack_from(data, at)
        if numbers[14] > 0 and numbers[15] > 0 and np.isfinite(numbers).all():
            return tuple(numbers)
    return ()


def _sized(data: bytes, at: int) -> tuple[bytes, int]:
    """Return the bytes after a length field, and their end. Raises struct.error where they are truncated."""
    (length,) = _LENGTH.unpack_from(data, at)
    end = at + _LENGTH.size + length
    if end > len(data):
        raise struct.error(f"{length} bytes are announced, {len(data) - at} there")
    return data[at + _LENGTH.size : end], end
