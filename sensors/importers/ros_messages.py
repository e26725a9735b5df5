"""Images, camera descriptions and transforms of ROS 1, ROS 2 (both by rosbags) and Foxglove, as plain values.

ROS messages are decoded by ROS's own definitions; rosbags would make Python code of those in a file.
"""

from collections.abc import Iterator
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage

from sensors.errors import CalibrationError, FormatError
from sensors.rig.camera import Intrinsics, intrinsics_from_rational
from sensors.rig.rig_calibration import Pose, rotation_of

PICTURES = frozenset({"Image", "RawImage", "CompressedImage"})
CAMERAS = frozenset({"CameraInfo", "CameraCalibration"})
TRANSFORMS = frozenset({"TFMessage", "tfMessage", "FrameTransforms", "FrameTransform"})
READ = PICTURES | CAMERAS | TRANSFORMS
"""Message types that are read, by their bare names."""
ENCODINGS = frozenset({"ros1", "cdr", "protobuf"})

_ROS = {
    "Image": "sensor_msgs/msg/Image",
    "CompressedImage": "sensor_msgs/msg/CompressedImage",
    "CameraInfo": "sensor_msgs/msg/CameraInfo",
    "TFMessage": "tf2_msgs/msg/TFMessage",
    "tfMessage": "tf2_msgs/msg/TFMessage",
}
_FOXGLOVE = {
    "RawImage": RawImage,
    "CompressedImage": CompressedImage,
    "CameraCalibration": CameraCalibration,
    "FrameTransform": FrameTransform,
    "FrameTransforms": FrameTransforms,
}
Decoded = Any
"""A message of the classes that rosbags and protobuf make at run time."""


class Picture(NamedTuple):
    """An image message. data: pixels in rows of ``step`` bytes, or a file's bytes where it is compressed.

    encoding: ROS's name of the pixels, e.g. 16UC1, or the format that the sender gives a compressed image.
    frame_id: its camera's frame in the tree of transforms.
    """

    frame_id: str
    encoding: str
    data: bytes
    compressed: bool
    height: int = 0
    width: int = 0
    step: int = 0
    big_endian: bool = False


def decode(kind: str, encoding: str, data: bytes) -> Decoded:
    """A message from its type's bare name and its bytes. Raises FormatError."""
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
    """When a picture was taken (ns, 0 = unknown), and its camera's frame in the tree of transforms."""
    if hasattr(message, "header"):
        stamp = message.header.stamp
        return _nanoseconds(stamp.sec, stamp.nanosec), str(message.header.frame_id)
    return _nanoseconds(message.timestamp.seconds, message.timestamp.nanos), str(message.frame_id)


def picture_from(message: Decoded) -> Picture:
    """An Image, RawImage or CompressedImage."""
    frame, pixels = stamp_and_frame(message)[1], bytes(message.data)
    if hasattr(message, "format"):
        return Picture(frame, str(message.format), pixels, compressed=True)
    size = int(message.height), int(message.width), int(message.step)
    big_endian = bool(getattr(message, "is_bigendian", False))
    return Picture(frame, str(message.encoding), pixels, False, *size, big_endian)


def intrinsics_from(message: Decoded, rectified: bool, name: str) -> Intrinsics:
    """The pinhole of a CameraInfo or CameraCalibration with its lens, or that of the rectified image.

    Raises CalibrationError, which names the topic ``name``.
    """
    # ROS 1 and Foxglove write large letters, ROS 2 small ones.
    d, k, p = (
        np.array(getattr(message, letter if hasattr(message, letter) else letter.upper()), np.float64)
        for letter in "dkp"
    )
    matrix = k.reshape(3, 3) if k.size == 9 else np.zeros((3, 3))
    if rectified and p.size == 12 and p[0] > 0:
        matrix = p.reshape(3, 4)[:, :3]
    size, model = (int(message.width), int(message.height)), str(message.distortion_model)
    pinhole = [float(matrix[at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2))]
    if rectified or not d.any():
        return Intrinsics(*size, *pinhole)
    if model in ("plumb_bob", "") and d.size in (4, 5):
        return Intrinsics(*size, *pinhole, *d.tolist())
    if model == "rational_polynomial" and d.size == 8 and np.isfinite(d).all():
        return intrinsics_from_rational(size, matrix, d)
    raise CalibrationError(
        f"{name} has lens model {model[:40]!r} with {d.size} numbers; give plumb_bob or "
        "rational_polynomial, or record the rectified image"
    )


def links_from(message: Decoded) -> Iterator[tuple[str, str, Pose]]:
    """(parent, child, parent_from_child) of every transform of a message. Raises CalibrationError."""
    for transform in getattr(message, "transforms", None) or [message]:
        if hasattr(transform, "header"):
            parent, child, move = transform.header.frame_id, transform.child_frame_id, transform.transform
        else:
            parent, child, move = transform.parent_frame_id, transform.child_frame_id, transform
        t, q = move.translation, move.rotation
        quaternion = np.array([q.x, q.y, q.z, q.w], np.float64)
        if not 0.5 < float(np.linalg.norm(quaternion)) < 2:
            raise CalibrationError(f"the transform to {child[:60]!r} has no rotation; record it again")
        # ROS writes some names with a slash before them.
        pose = Pose(rotation_of(quaternion), np.array([t.x, t.y, t.z], np.float64))
        yield str(parent).lstrip("/"), str(child).lstrip("/"), pose


def _nanoseconds(seconds: int, nanoseconds: int) -> int:
    return max(0, int(seconds)) * 1_000_000_000 + int(nanoseconds) % 1_000_000_000


@cache
def _typestore(encoding: str) -> Decoded:
    """ROS's own message definitions, as rosbags ships them; those of ROS 1 lack transforms."""
    try:
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore
    except ImportError as error:
        raise FormatError("ROS messages need rosbags; pip install 'annotate-cloud[exchange]'") from error
    if encoding == "cdr":
        return get_typestore(Stores.ROS2_HUMBLE)
    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", _ROS["TFMessage"]))
    return store
