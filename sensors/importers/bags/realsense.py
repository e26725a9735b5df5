"""A recording of RealSense's SDK as a source of frames: .db3 (SQLite, today's), .bag (ROS 1, older ones).

Both are bags by their container, with contents of RealSense's own. Topics, and the encodings of their
messages: librealsense, src/media/ros/ros_file_format.h, ros_writer.cpp, src/media/ros2. The stamp of an image
in a .bag is the frame's time in whole seconds and nanoseconds (``write_video_frame``). So only the camera's
own clock of 32 bits ever wraps around.
"""

import re
import struct
from contextlib import suppress
from pathlib import Path

import numpy as np
import zstandard
from numpy.typing import NDArray

from sensors.calibration_files.lens_models import realsense_intrinsics
from sensors.errors import CalibrationError, FormatError
from sensors.files.bounded import MAX_IMAGE_BYTES, MAX_IMAGE_SIDE
from sensors.importers.bags.bag_files import RosbagFile
from sensors.importers.bags.camera_recording import COLOR, DEPTH, INFRARED, STREAMS, CameraRecording, Recorded
from sensors.importers.bags.ros1_file import Ros1File
from sensors.importers.bags.ros_messages import Entry, Picture, decode, picture_from
from sensors.importers.options import AS_STATED, ImportOptions
from sensors.rig.camera import Intrinsics
from sensors.rig.rig_calibration import Pose, rotation_of

KINDS = frozenset({"Image", "CompressedImage", "CameraInfo", "Transform", "String", "Float32"})
NAMES = {"Depth_0": DEPTH, "Color_0": COLOR, "Infrared_1": INFRARED}
"""Streams that are read; of the two infrared cameras the left one, which has the pixels of depth."""
WRAPS_NS = 1000 * 2**32  # period of the camera's clock, of 32 bits in microseconds
_STREAM = re.compile(rf"/device_0/sensor_\d+/({'|'.join(NAMES)})/(.+)")
_UNIT = re.compile(r"/device_0/sensor_\d+/option/Depth[ _]Units/value")
_LENS, _METADATA, _PIXELS, _POSE = ("camera_info", "info/camera_info"), "image/metadata", "image/data", "tf/"
_PACKED = re.compile(r"(\w+); zstd; (\d+)x(\d+) step=(\d+)")
"""Encoding of pixels that the SDK packs in a .db3: their own encoding, width, height, bytes a row."""
_HEAD = struct.Struct("<III")  # begin of an image in a .bag: its number, seconds, nanoseconds
_VERSION = b"\1\0\0\0" + b"1"
"""Bytes behind the head (the frame's name elsewhere) where the depth unit stands behind the pixels."""


class RealSenseRecording(CameraRecording):
    """A recording of RealSense's SDK as a ``FrameSource``."""

    def __init__(self, path: Path, options: ImportOptions = AS_STATED) -> None:
        # Messages about a stream by the end of their topics.
        self._about: dict[str, dict[str, Entry]] = {name: {} for name in STREAMS}
        super().__init__(path, options)

    def _index(self) -> float | None:
        stated_mm: float | None = None
        pixels: list[tuple[str, int, tuple[int, ...]]] = []
        metadata: dict[tuple[str, int], Entry] = {}
        for entry in self._file.entries(KINDS):
            found = _STREAM.fullmatch(entry.topic)
            if _UNIT.fullmatch(entry.topic):
                value = decode(entry.kind, entry.encoding, entry.data).data
                # A float32 has no more than seven digits.
                stated_mm = stated_mm or float(f"{1000 * float(value):.6g}")
            if found is None:
                continue
            name, what = NAMES[found[1]], found[2]
            if what.startswith(_PIXELS):
                stream = self._streams[name]
                stream.topic, stream.kind = entry.topic, entry.kind
                if entry.encoding == "ros1":
                    stream.images.append(_recorded(entry))
                else:
                    pixels.append((name, entry.logged_ns, entry.place))
            elif what == _METADATA:
                metadata[name, entry.logged_ns] = entry
            else:
                self._about[name].setdefault(what, entry)
        for name, logged_ns, place in pixels:
            # In a .db3 the camera's times lie beside the images.
            fields = _fields(metadata[name, logged_ns])
            stamp_ns = 1000 * round(1000 * float(fields["timestamp"]))
            image = Recorded(int(fields["Frame number"]), stamp_ns, logged_ns, place)
            self._streams[name].images.append(image)
        return stated_mm

    def _stamps_ns(self, name: str) -> NDArray[np.int64]:
        return unwrapped(super()._stamps_ns(name), self._streams[DEPTH].images[0].stamp_ns)

    def _picture(self, kind: str, data: bytes) -> Picture:
        if self._file.encoding == "ros1" and data.startswith(_VERSION, _HEAD.size):
            data = data[:-4]
        picture = picture_from(decode(kind, self._file.encoding, data))
        if (found := _PACKED.fullmatch(picture.encoding)) is None:
            return picture
        width, height, step = (int(text) for text in found.groups()[1:])
        if max(width, height) > MAX_IMAGE_SIDE or step * height > MAX_IMAGE_BYTES:
            raise FormatError(
                f"an image of {self._file.path} states {width}x{height} pixels, {step} bytes a row, over "
                f"{MAX_IMAGE_SIDE} a side or {MAX_IMAGE_BYTES} bytes in all; restore it from a copy"
            )
        data = zstandard.ZstdDecompressor().decompress(picture.data, max_output_size=step * height)
        return Picture(picture.frame_id, found[1], data, False, height, width, step)

    def _lens(self, name: str) -> Intrinsics | None:
        entry = next((self._about[name][what] for what in _LENS if what in self._about[name]), None)
        if entry is None:
            return None
        if entry.kind == "String":
            # The .db3's CameraInfo messages call every lens plumb_bob.
            named = _fields(entry)
            pinhole = [float(named[key]) for key in ("fx", "fy", "ppx", "ppy")]
            size, model = (int(named["width"]), int(named["height"])), named["model"]
            coefficients = [float(number) for number in named["coeffs"].split(",")]
        else:
            info = decode(entry.kind, entry.encoding, entry.data)
            pinhole = [float(info.K[at]) for at in (0, 4, 2, 5)]
            size, model = (int(info.width), int(info.height)), info.distortion_model
            coefficients = info.D.tolist()
        return realsense_intrinsics(Intrinsics(*size, *pinhole), str(model), coefficients)

    def _color_from_depth(self) -> Pose | None:
        depth, color = self._pose(DEPTH), self._pose(COLOR)
        if depth is None or color is None or depth[0] != color[0]:
            return None
        return color[1] @ depth[1].inverse()

    def _pose(self, name: str) -> tuple[str, Pose] | None:
        """Return the number of another stream, and this camera's pose relative to it; None without a pose."""
        for what, entry in self._about[name].items():
            # Where the SDK knows no pose it writes zeros.
            with suppress(CalibrationError, ValueError):
                if what.startswith(_POSE):
                    return what.rpartition("/")[2].removeprefix("ref_"), _pose(entry)
        return None


def unwrapped(stamps_ns: NDArray[np.int64], first_ns: int) -> NDArray[np.int64]:
    """Return times (n,) of one stream that stay monotonic when the camera's 32-bit clock wraps after 71.6
    minutes.

    first_ns: first depth time, because another stream may start on the other side of the wrap. A clock of the
    host (the SDK's usual domain) is far beyond the 32 bits and is not unwrapped.
    """
    if not len(stamps_ns) or max(stamps_ns.max(), first_ns) >= WRAPS_NS:
        return stamps_ns
    wraps = np.cumsum(np.diff(stamps_ns) < -WRAPS_NS // 2) * WRAPS_NS
    shift_ns = round((first_ns - int(stamps_ns[0])) / WRAPS_NS) * WRAPS_NS
    return np.asarray(stamps_ns + np.concatenate([[0], wraps]) + shift_ns, np.int64)


def is_realsense(file: RosbagFile | Ros1File) -> bool:
    """Return whether RealSense's SDK made this SQLite file or ROS 1 bag. Raises FormatError where it is
    damaged.
    """
    return any(topic.startswith("/device_0/sensor_") for topic in file.topics)


def _recorded(entry: Entry) -> Recorded:
    """Return the image message of a .bag entry; its own stamp is the camera's time."""
    number, seconds, nanoseconds = _HEAD.unpack_from(entry.data)
    # The SDK goes through seconds in floating point.
    stamp_ns = 1000 * (1_000_000 * seconds + round(nanoseconds / 1000))
    return Recorded(number, stamp_ns, entry.logged_ns, entry.place)


def _fields(entry: Entry) -> dict[str, str]:
    """Return the fields of a text ``key=value;key=value`` in a .db3."""
    text = str(decode("String", "cdr", entry.data).data)
    return dict(part.split("=", 1) for part in text.split(";") if "=" in part)


def _pose(entry: Entry) -> Pose:
    """Return the pose of this stream's camera relative to the reference camera."""
    if entry.kind == "String":
        numbers = {key: np.array(text.split(","), np.float64) for key, text in _fields(entry).items()}
        # Column by column, as in rs2_extrinsics.
        return Pose(numbers["rotation"].reshape(3, 3).T, numbers["translation"])
    move = decode(entry.kind, entry.encoding, entry.data)
    t, q = move.translation, move.rotation
    return Pose(rotation_of(np.array([q.x, q.y, q.z, q.w])), np.array([t.x, t.y, t.z]))
