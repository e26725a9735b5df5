"""A recording of RealSense's SDK as a source of frames: .db3 (SQLite, today's), .bag (ROS 1, older ones).

Both are bags by their container, with contents of RealSense's own. Topics, and the encodings of their
messages: librealsense, src/media/ros/ros_file_format.h, ros_writer.cpp, src/media/ros2. The stamp of an image
in a .bag is the frame's time in whole seconds and nanoseconds (``write_video_frame``), so that only the
camera's own clock of 32 bits ever wraps around.
"""

import re
import struct
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import zstandard
from numpy.typing import NDArray

from sensors.calibration_files.lens_models import realsense_intrinsics
from sensors.errors import CalibrationError, FormatError
from sensors.files.bounded import MAX_IMAGE_BYTES, MAX_IMAGE_SIDE
from sensors.importers.bags.bag_files import RosbagFile, damaged, open_rosbag
from sensors.importers.bags.camera_frames import (
    COLOR_FOUND,
    CameraFrames,
    Images,
    Recorded,
    Stream,
    depth_lens,
)
from sensors.importers.bags.entries import Entry, Place
from sensors.importers.bags.ros1_file import Ros1File
from sensors.importers.bags.ros_messages import Picture, decode, picture_from
from sensors.importers.options import AS_STATED, ImportOptions
from sensors.rig.camera import Intrinsics
from sensors.rig.frame import FrameSource, RigFrame
from sensors.rig.rig_calibration import Pose, RigCalibration, rotation_of

KINDS = frozenset({"Image", "CompressedImage", "CameraInfo", "Transform", "String", "Float32"})
DEPTH, COLOR, INFRARED = STREAMS = "Depth_0", "Color_0", "Infrared_1"
"""Streams that are read; of the two infrared cameras the left one, which has the pixels of depth."""
WRAPS_NS = 1000 * 2**32
"""Nanoseconds after which the camera's clock, of 32 bits in microseconds, starts again."""
_STREAM = re.compile(rf"/device_0/sensor_\d+/({'|'.join(STREAMS)})/(.+)")
_UNIT = re.compile(r"/device_0/sensor_\d+/option/Depth[ _]Units/value")
_LENS, _METADATA, _PIXELS, _POSE = ("camera_info", "info/camera_info"), "image/metadata", "image/data", "tf/"
_PACKED = re.compile(r"(\w+); zstd; (\d+)x(\d+) step=(\d+)")
"""How a .db3 names pixels that it has packed itself: encoding, width, height, bytes a row."""
_HEAD = struct.Struct("<III")
"""Begin of an image in a .bag: its number, seconds, nanoseconds."""
_VERSION = b"\1\0\0\0" + b"1"
"""What follows (the frame's name elsewhere) where the depth unit stands behind the pixels."""


@dataclass
class _Stream(Stream):
    """One stream. kind: the type of the images' messages; about: messages by the end of their topics."""

    kind: str = ""
    about: dict[str, Entry] = field(default_factory=dict)

    def lens(self) -> Intrinsics | None:
        """The factory's intrinsics."""
        entry = next((self.about[what] for what in _LENS if what in self.about), None)
        return None if entry is None else _lens(entry)

    def pose(self) -> tuple[str, Pose] | None:
        """Where the stream is: another stream's number, and the pose from there; None for none."""
        for what, entry in self.about.items():
            # Where the SDK knows no pose it writes zeros.
            with suppress(CalibrationError, ValueError):
                if what.startswith(_POSE):
                    return what.rpartition("/")[2].removeprefix("ref_"), _pose(entry)
        return None


class _Beside(NamedTuple):
    """Images of a .db3, by stream, time of the recorder and place; times of the camera lie beside them."""

    places: list[tuple[str, int, Place]]
    metadata: dict[tuple[str, int], Entry]

    def images(self) -> Iterator[tuple[str, Recorded]]:
        """Yield the name of the stream and each image."""
        for name, logged_ns, place in self.places:
            fields = _fields(self.metadata[name, logged_ns])
            stamp_ns = 1000 * round(1000 * float(fields["timestamp"]))
            yield name, Recorded(int(fields["Frame number"]), stamp_ns, logged_ns, place)


class RealSenseRecording(FrameSource):
    """A recording of RealSense's SDK as a ``FrameSource``: depth, its infrared, the colour nearest in time.

    notes: what is absent or assumed. Raises FormatError, and CalibrationError where nothing describes the
    depth camera.
    """

    path: Path

    def __init__(self, path: Path, options: ImportOptions = AS_STATED) -> None:
        self.path, self.name = path, path.stem
        self._file, self._unit_mm = open_rosbag(path), options.depth_unit_mm
        self._streams = {name: _Stream() for name in STREAMS}
        with damaged(path):
            self._index()
            depth = self._streams[DEPTH]
            if not depth.images:
                raise FormatError(f"{path} has no depth images; record the stream Depth")
            images = {name: self._images(name) for name in STREAMS}
            self.calibration, notes = self._calibrate(images[DEPTH], options)
            self._frames = CameraFrames(
                images[DEPTH], images[COLOR], images[INFRARED], self._unit_mm, path.name
            )
        timeline = images[DEPTH].timeline
        self.times_ns = timeline.times_ns
        self.notes = (
            *notes,
            *([] if self._unit_mm else ["no depth unit in the recording"]),
            *self._frames.notes,
            *depth.lost(timeline),
            "no thermal images",
            *([self._file.lost] if self._file.lost else []),
        )

    def _frame(self, index: int) -> RigFrame:
        return self._frames.frame(index)

    def _images(self, name: str) -> Images:
        stream, first_ns = self._streams[name], self._streams[DEPTH].images[0].stamp_ns
        return stream.opened(
            name, unwrapped(stream.stamps_ns, first_ns), self._file, partial(self._picture, stream.kind)
        )

    def _picture(self, kind: str, data: bytes) -> Picture:
        with damaged(self.path):
            if self._file.encoding == "ros1" and data.startswith(_VERSION, _HEAD.size):
                data = data[:-4]
            return _unpacked(picture_from(decode(kind, self._file.encoding, data)))

    def _index(self) -> None:
        """Find the images, and the messages about them."""
        beside = _Beside([], {})
        for entry in self._file.entries(KINDS):
            found = _STREAM.fullmatch(entry.topic)
            if _UNIT.fullmatch(entry.topic):
                value = decode(entry.kind, entry.encoding, entry.data).data
                # A float32 has no more than seven digits.
                self._unit_mm = self._unit_mm or float(f"{1000 * float(value):.6g}")
            elif found is None:
                continue
            elif found[2].startswith(_PIXELS):
                stream = self._streams[found[1]]
                stream.topic, stream.kind = entry.topic, entry.kind
                if entry.encoding == "ros1":
                    stream.images.append(_recorded(entry))
                else:
                    beside.places.append((found[1], entry.logged_ns, entry.place))
            elif found[2] == _METADATA:
                beside.metadata[found[1], entry.logged_ns] = entry
            else:
                self._streams[found[1]].about.setdefault(found[2], entry)
        for name, image in beside.images():
            self._streams[name].images.append(image)

    def _calibrate(self, images: Images, options: ImportOptions) -> tuple[RigCalibration, list[str]]:
        """Return the calibration, and notes on it. images: of depth."""
        depth, color = self._streams[DEPTH], self._streams[COLOR]
        lens, notes = depth_lens(depth.lens(), images, options.intrinsics, self.path)
        if not color.images:
            return RigCalibration(lens), [*notes, "no colour images"]
        color_lens, at_depth, at_color = color.lens(), depth.pose(), color.pose()
        if color_lens is None or not at_depth or not at_color or at_depth[0] != at_color[0]:
            lacking = "intrinsics" if color_lens is None else "pose"
            note = f"no {lacking} of the colour camera: its images cannot be fused"
            return RigCalibration(lens), [*notes, note]
        color_from_depth = at_color[1] @ at_depth[1].inverse()
        return RigCalibration(lens, color_lens, color_from_depth), [*notes, COLOR_FOUND]


def unwrapped(stamps_ns: NDArray[np.int64], first_ns: int) -> NDArray[np.int64]:
    """Return times (n,) of one stream that go on where the camera's clock starts again after 71.6 minutes.

    first_ns: of depth: the first image of another stream may lie on the other side of the clock's begin. A
    clock of the host (the SDK's usual domain) is far beyond the 32 bits, so that nothing is unwrapped.
    """
    if not len(stamps_ns) or max(stamps_ns.max(), first_ns) >= WRAPS_NS:
        return stamps_ns
    wraps = np.cumsum(np.diff(stamps_ns) < -WRAPS_NS // 2) * WRAPS_NS
    shift_ns = round((first_ns - int(stamps_ns[0])) / WRAPS_NS) * WRAPS_NS
    return np.asarray(stamps_ns + np.concatenate([[0], wraps]) + shift_ns, np.int64)


def is_realsense(file: RosbagFile | Ros1File) -> bool:
    """Whether RealSense's SDK made this SQLite file or ROS 1 bag. Raises FormatError."""
    return any(topic.startswith("/device_0/sensor_") for topic in file.topics)


def _recorded(entry: Entry) -> Recorded:
    """Return an image of a .bag, whose own stamp is the camera's time."""
    number, seconds, nanoseconds = _HEAD.unpack_from(entry.data)
    # The SDK goes through seconds in floating point.
    stamp_ns = 1000 * (1_000_000 * seconds + round(nanoseconds / 1000))
    return Recorded(number, stamp_ns, entry.logged_ns, entry.place)


def _fields(entry: Entry) -> dict[str, str]:
    """A text ``key=value;key=value`` of a .db3."""
    text = str(decode("String", "cdr", entry.data).data)
    return dict(part.split("=", 1) for part in text.split(";") if "=" in part)


def _lens(entry: Entry) -> Intrinsics:
    if entry.kind == "String":
        # The .db3's CameraInfo messages call every lens plumb_bob.
        named = _fields(entry)
        pinhole = [float(named[name]) for name in ("fx", "fy", "ppx", "ppy")]
        size, model = (int(named["width"]), int(named["height"])), named["model"]
        coefficients = [float(number) for number in named["coeffs"].split(",")]
    else:
        info = decode(entry.kind, entry.encoding, entry.data)
        pinhole = [float(info.K[at]) for at in (0, 4, 2, 5)]
        size, model = (int(info.width), int(info.height)), info.distortion_model
        coefficients = info.D.tolist()
    return realsense_intrinsics(Intrinsics(*size, *pinhole), str(model), coefficients)


def _pose(entry: Entry) -> Pose:
    """This stream's camera from the reference's."""
    if entry.kind == "String":
        numbers = {key: np.array(text.split(","), np.float64) for key, text in _fields(entry).items()}
        # Column by column, as in rs2_extrinsics.
        return Pose(numbers["rotation"].reshape(3, 3).T, numbers["translation"])
    move = decode(entry.kind, entry.encoding, entry.data)
    t, q = move.translation, move.rotation
    return Pose(rotation_of(np.array([q.x, q.y, q.z, q.w])), np.array([t.x, t.y, t.z]))


def _unpacked(picture: Picture) -> Picture:
    """The picture, raw where the SDK has packed raw pixels."""
    if (found := _PACKED.fullmatch(picture.encoding)) is None:
        return picture
    width, height, step = (int(text) for text in found.groups()[1:])
    if max(width, height) > MAX_IMAGE_SIDE or step * height > MAX_IMAGE_BYTES:
        raise FormatError(f"image claims {width}x{height}, {step} bytes a row; restore the file from a copy")
    data = zstandard.ZstdDecompressor().decompress(picture.data, max_output_size=step * height)
    return Picture(picture.frame_id, found[1], data, False, height, width, step)
