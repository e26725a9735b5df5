"""Images, camera descriptions and transforms of ROS 2 (CDR) and Foxglove (protobuf) as plain values.

CDR is read by rosbags (extra ``exchange``) with the definitions of ROS 2 itself.
"""

import struct
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from google.protobuf.message import DecodeError
from google.protobuf.message import Message as ProtoMessage

from sensors.errors import CalibrationError, FormatError
from sensors.rig.camera import Intrinsics
from sensors.rig.lens import intrinsics_from_rational
from sensors.rig.quaternion import rotation_of
from sensors.rig.rig_calibration import MAX_CALIBRATION_BYTES, Pose

Fields = Any
"""A decoded message of classes that rosbags and protobuf make at run time."""


@dataclass(frozen=True)
class RawPicture:
    """An uncompressed image, not yet looked at. encoding: ROS's name, e.g. 16UC1; step: bytes a row."""

    height: int
    width: int
    encoding: str
    step: int
    big_endian: bool
    data: bytes


@dataclass(frozen=True)
class PackedPicture:
    """A compressed image. format: what its sender says it is, e.g. ``16UC1; compressedDepth png``."""

    format: str
    data: bytes


@dataclass(frozen=True)
class Stamped:
    """What a message says beside its picture: when (0 = nothing), and in which frame."""

    stamp_ns: int
    frame_id: str
    picture: RawPicture | PackedPicture | None = None


@dataclass(frozen=True)
class Camera:
    """A CameraInfo's content. k: 9, p: 12 or none, d: any number of coefficients of ``model``."""

    width: int
    height: int
    model: str
    d: tuple[float, ...]
    k: tuple[float, ...]
    p: tuple[float, ...]

    def intrinsics(self, rectified: bool, name: str) -> Intrinsics:
        """The pinhole with its lens, or that of the rectified image. Raises CalibrationError."""
        k = np.array(self.k, np.float64).reshape(3, 3) if len(self.k) == 9 else np.zeros((3, 3))
        if rectified and len(self.p) == 12 and self.p[0] > 0:
            k = np.array(self.p, np.float64).reshape(3, 4)[:, :3]
        numbers = float(k[0, 0]), float(k[1, 1]), float(k[0, 2]), float(k[1, 2])
        plain = Intrinsics(self.width, self.height, *numbers)
        if rectified or not any(self.d):
            return plain
        if self.model in ("plumb_bob", "") and len(self.d) in (4, 5):
            return Intrinsics(self.width, self.height, *numbers, *self.d)
        if self.model == "rational_polynomial" and len(self.d) == 8 and np.isfinite(self.d).all():
            return intrinsics_from_rational((self.width, self.height), k, np.array(self.d))
        raise CalibrationError(
            f"{name} has lens model {self.model[:40]!r} with {len(self.d)} numbers; give plumb_bob or "
            "rational_polynomial, or record the rectified image"
        )


@dataclass(frozen=True)
class Link:
    """One transform of a tree of frames: p_parent = pose(p_child)."""

    parent: str
    child: str
    pose: Pose


PICTURES = {"Image": RawImage, "RawImage": RawImage, "CompressedImage": CompressedImage}
CAMERAS = {"CameraInfo": CameraCalibration, "CameraCalibration": CameraCalibration}
TRANSFORMS = {
    "TFMessage": FrameTransforms,
    "FrameTransforms": FrameTransforms,
    "FrameTransform": FrameTransform,
}
"""Message types that are read, by their bare names, and the protobuf class of the Foxglove ones."""
ENCODINGS = ("cdr", "protobuf")

_UNDECODABLE = (
    *(struct.error, ValueError, IndexError, KeyError, TypeError, AttributeError, AssertionError),
    *(OverflowError, MemoryError),
)
_ROS = {
    "Image": "sensor_msgs/msg/Image",
    "CompressedImage": "sensor_msgs/msg/CompressedImage",
    "CameraInfo": "sensor_msgs/msg/CameraInfo",
    "TFMessage": "tf2_msgs/msg/TFMessage",
}


def stamp_of(kind: str, encoding: str, data: bytes) -> int:
    """When a picture was taken (ns), without decoding the whole of it where that can be helped."""
    if encoding == "cdr":
        # Encapsulation (4 bytes), then std_msgs/Header, which begins with builtin_interfaces/Time.
        if len(data) < 12:
            raise FormatError(f"a {kind} message has {len(data)} bytes; repair the bag")
        seconds, nanoseconds = struct.unpack("<iI" if data[1] & 1 else ">iI", data[4:12])
        return max(0, int(seconds)) * 1_000_000_000 + int(nanoseconds) % 1_000_000_000
    return _proto_stamp(_proto(PICTURES[kind], data))


def picture_from(kind: str, encoding: str, data: bytes) -> Stamped:
    """An Image, RawImage or CompressedImage. Raises FormatError."""
    if encoding == "cdr":
        message = _ros(kind, data)
        stamp, frame = stamp_of(kind, encoding, data), str(message.header.frame_id)
        pixels = message.data.tobytes()
        if kind == "CompressedImage":
            return Stamped(stamp, frame, PackedPicture(str(message.format), pixels))
        raw = RawPicture(
            int(message.height), int(message.width), str(message.encoding), int(message.step),
            bool(message.is_bigendian), pixels,
        )  # fmt: skip
        return Stamped(stamp, frame, raw)
    message = _proto(PICTURES[kind], data)
    stamp, frame = _proto_stamp(message), str(message.frame_id)
    if kind == "CompressedImage":
        return Stamped(stamp, frame, PackedPicture(message.format, message.data))
    raw = RawPicture(message.height, message.width, message.encoding, message.step, False, message.data)
    return Stamped(stamp, frame, raw)


def camera_from(kind: str, encoding: str, data: bytes) -> Camera:
    """A CameraInfo or CameraCalibration. Raises FormatError."""
    _check_size(kind, data)
    if encoding == "cdr":
        m = _ros(kind, data)
        return Camera(
            int(m.width),
            int(m.height),
            str(m.distortion_model),
            *(tuple(map(float, x)) for x in (m.d, m.k, m.p)),
        )
    m = _proto(CAMERAS[kind], data)
    return Camera(m.width, m.height, m.distortion_model, *(tuple(map(float, x)) for x in (m.D, m.K, m.P)))


def links_from(kind: str, encoding: str, data: bytes) -> list[Link]:
    """Transforms of a TFMessage, FrameTransforms or FrameTransform. Raises FormatError, CalibrationError."""
    _check_size(kind, data)
    if encoding == "cdr":
        return [
            _link(t.header.frame_id, t.child_frame_id, t.transform.translation, t.transform.rotation)
            for t in _ros(kind, data).transforms
        ]
    message = _proto(TRANSFORMS[kind], data)
    transforms = [message] if kind == "FrameTransform" else message.transforms
    return [_link(t.parent_frame_id, t.child_frame_id, t.translation, t.rotation) for t in transforms]


def _check_size(kind: str, data: bytes) -> None:
    # Lists of empty messages unpack to fifty times their size.
    if len(data) > MAX_CALIBRATION_BYTES:
        raise FormatError(f"a {kind} message is larger than {MAX_CALIBRATION_BYTES} bytes; repair the bag")


def _link(parent: str, child: str, t: Fields, q: Fields) -> Link:
    numbers = np.array([q.x, q.y, q.z, q.w], np.float64)
    length = float(np.linalg.norm(numbers))
    if not 0.5 < length < 2:
        raise CalibrationError(f"the transform to {child[:60]!r} has no rotation; record it again")
    rotation = rotation_of(numbers)
    # ROS writes some names with a slash before them.
    return Link(
        str(parent).lstrip("/"), str(child).lstrip("/"), Pose(rotation, np.array([t.x, t.y, t.z], float))
    )


def _ros(kind: str, data: bytes) -> Fields:
    deserialize, refused = _rosbags()
    try:
        return deserialize(data, _ROS[kind])
    except (refused, *_UNDECODABLE) as error:
        raise FormatError(
            f"a {kind} message cannot be decoded ({str(error)[:80]}); repair the bag"
        ) from error


@cache
def _rosbags() -> tuple[Callable[[bytes, str], Any], type[Exception]]:
    """rosbags' CDR reader for ROS 2's own message definitions, and the error it raises."""
    if find_spec("rosbags") is None:
        raise FormatError("ROS 2 messages need rosbags; pip install 'annotate-cloud[exchange]'")
    from rosbags.serde import SerdeError
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS2_HUMBLE).deserialize_cdr, SerdeError


def _proto(kind: type[ProtoMessage], data: bytes) -> Fields:
    message = kind()
    try:
        message.ParseFromString(data)
    except DecodeError as error:
        raise FormatError(f"{kind.__name__} cannot be decoded ({error}); repair the file") from error
    return message


def _proto_stamp(message: Fields) -> int:
    return (
        max(0, int(message.timestamp.seconds)) * 1_000_000_000 + int(message.timestamp.nanos) % 1_000_000_000
    )
