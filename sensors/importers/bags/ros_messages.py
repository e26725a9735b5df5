"""Images, camera descriptions and transforms of ROS 1, ROS 2 (both by rosbags) and Foxglove, as plain values.

ROS messages are decoded by ROS's own definitions; definitions in a file are not used, because rosbags would
generate Python code from them.
"""

from functools import cache
from typing import NamedTuple

from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage

from sensors.calibration_files.camera_messages import Decoded
from sensors.errors import FormatError

Place = tuple[int, ...]
"""Place of a message in its file: offset and slot in MCAP; chunk, offset and length in a ROS 1 bag; in SQLite
the time of logging, and the number of earlier messages of its topic with that time."""

PICTURES = frozenset({"Image", "RawImage", "CompressedImage"})
CAMERAS = frozenset({"CameraInfo", "CameraCalibration"})
TRANSFORMS = frozenset({"TFMessage", "tfMessage", "FrameTransforms", "FrameTransform"})
READ = PICTURES | CAMERAS | TRANSFORMS  # message types that are read, by their bare names
ENCODINGS = frozenset({"ros1", "cdr", "protobuf"})

_ROS = {
    "Image": "sensor_msgs/msg/Image",
    "CompressedImage": "sensor_msgs/msg/CompressedImage",
    "CameraInfo": "sensor_msgs/msg/CameraInfo",
    "TFMessage": "tf2_msgs/msg/TFMessage",
    "tfMessage": "tf2_msgs/msg/TFMessage",
    "Transform": "geometry_msgs/msg/Transform",
    "String": "std_msgs/msg/String",
    "Float32": "std_msgs/msg/Float32",
}
_FOXGLOVE = {
    "RawImage": RawImage,
    "CompressedImage": CompressedImage,
    "CameraCalibration": CameraCalibration,
    "FrameTransform": FrameTransform,
    "FrameTransforms": FrameTransforms,
}


class Entry(NamedTuple):
    """Message in a file. kind: its type without package or folder; encoding: ros1, cdr or protobuf."""

    topic: str
    kind: str
    encoding: str
    logged_ns: int
    place: Place
    data: bytes


class Picture(NamedTuple):
    """Image message.

    data: pixels in rows of ``step`` bytes, or a file's bytes where it is compressed. encoding: ROS's name of
    the pixels, e.g. 16UC1, or the format that the sender gives a compressed image. frame_id: its camera's
    frame in the tree of transforms.
    """

    frame_id: str
    encoding: str
    data: bytes
    compressed: bool
    height: int = 0
    width: int = 0
    step: int = 0
    big_endian: bool = False


def bare(kind: str) -> str:
    """Return the bare name of a type: ``Image`` for ``sensor_msgs/msg/Image`` and ``sensor_msgs.Image``."""
    return kind.replace(".", "/").rpartition("/")[2]


def decode(kind: str, encoding: str, data: bytes) -> Decoded:
    """Decode a message by its type's bare name. Raises FormatError where it is damaged."""
    try:
        if encoding == "protobuf":
            message = _FOXGLOVE[kind]()
            message.ParseFromString(data)
            return message
        store = _typestore(encoding)
        return (store.deserialize_ros1 if encoding == "ros1" else store.deserialize_cdr)(data, _ROS[kind])
    except FormatError:
        raise
    except Exception as error:  # rosbags' generated code raises whatever struct, numpy and indexing do
        raise FormatError(f"a {kind} message is damaged ({error}); restore the bag from a copy") from error


def stamp_and_frame(message: Decoded) -> tuple[int, str]:
    """Return a picture's time (ns, 0 = unknown), and its camera's frame in the tree of transforms."""
    if hasattr(message, "header"):
        stamp = message.header.stamp
        return _nanoseconds(stamp.sec, stamp.nanosec), str(message.header.frame_id)
    return _nanoseconds(message.timestamp.seconds, message.timestamp.nanos), str(message.frame_id)


def is_empty(message: Decoded) -> bool:
    """Return whether a picture has no pixels, as some drivers send before the camera runs."""
    sized = not hasattr(message, "height") or (message.height and message.width)
    return not (sized and len(message.data))


def picture_from(message: Decoded) -> Picture:
    """Return an Image, RawImage or CompressedImage as a picture."""
    frame, pixels = stamp_and_frame(message)[1], bytes(message.data)
    if hasattr(message, "format"):
        return Picture(frame, _printable(message.format), pixels, compressed=True)
    size = int(message.height), int(message.width), int(message.step)
    big_endian = bool(getattr(message, "is_bigendian", False))
    return Picture(frame, _printable(message.encoding), pixels, False, *size, big_endian)


def _printable(text: object) -> str:
    """Return a message's text, which may be damaged, as errors and notes quote it."""
    return "".join(letter for letter in str(text) if letter.isprintable())


def _nanoseconds(seconds: int, nanoseconds: int) -> int:
    return max(0, int(seconds)) * 1_000_000_000 + int(nanoseconds) % 1_000_000_000


@cache
def _typestore(encoding: str) -> Decoded:
    """Return ROS's own message definitions, as rosbags ships them, with the transforms that ROS 1's lack."""
    try:
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore
    except ImportError as error:
        raise FormatError("ROS messages need rosbags; pip install 'annotate-cloud[exchange]'") from error
    if encoding == "cdr":
        return get_typestore(Stores.ROS2_HUMBLE)
    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", _ROS["TFMessage"]))
    return store
