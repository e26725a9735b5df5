"""Images, calibrations and events of a session as Foxglove protobuf messages and back.

Every ``*_message`` has its inverse ``*_from``, which takes serialised messages from outside and raises
FormatError or CalibrationError.
"""

from collections.abc import Iterator
from typing import Any, TypeVar

import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.KeyValuePair_pb2 import KeyValuePair
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from google.protobuf.message import DecodeError
from google.protobuf.message import Message as ProtoMessage
from google.protobuf.timestamp_pb2 import Timestamp
from numpy.typing import NDArray

from sensors.calibration_files.camera_messages import intrinsics_from, links_from
from sensors.errors import CalibrationError, FormatError
from sensors.rig.camera import Intrinsics
from sensors.rig.rig_calibration import MAX_CALIBRATION_BYTES, Pose, RigCalibration, quaternion_of

CAMERAS = ("depth", "color", "thermal")
DEPTH, COLOR, THERMAL = (f"/{camera}/image" for camera in CAMERAS)
INFRARED, COUNTS, PYROMETER = "/infrared/image", "/thermal/counts", "/pyrometer"
IMAGES = (DEPTH, COLOR, THERMAL, INFRARED, COUNTS, PYROMETER)
CALIBRATIONS = {f"/{camera}/calibration": camera for camera in CAMERAS}
TF, EVENTS = "/tf", "/events"
SHIFT, SHIFT_KEY = "/depth/shift", "depth_shift_mm"
"""Topic and key of the depth shift, absent for 0. A message, because copying loses metadata."""
OF_CALIBRATION = (*CALIBRATIONS, TF, SHIFT)
"""Topics whose first messages are the session's calibration."""
SCHEMAS: dict[str, type[ProtoMessage]] = {
    DEPTH: RawImage,
    COLOR: CompressedImage,
    THERMAL: RawImage,
    INFRARED: RawImage,
    COUNTS: RawImage,
    PYROMETER: RawImage,
    **dict.fromkeys(CALIBRATIONS, CameraCalibration),
    TF: FrameTransforms,
    EVENTS: Log,
    SHIFT: KeyValuePair,
}
SUBJECT = "subject"  # metadata key of the recorded person's name
CAST = "cast"  # metadata key of a simulated recording's cast; absent for the training cast
METADATA = "annotate-cloud"  # metadata record with the session's name and its maker's notes
THERMAL_OFFSET_C = THERMAL_STEPS_PER_C = 100.0
"""On disk a temperature is the uint16 round((celsius + 100) * 100); 0 = no reading; -99.99..555.35 C."""
_FORMATS = {b"\xff\xd8\xff": "jpeg", b"\x89PN": "png"}

M = TypeVar("M", bound=ProtoMessage)


def image_message(image: NDArray[np.uint16], frame_id: str, stamp_ns: int) -> RawImage:
    """Return uint16 (h, w) as 16UC1: depth in millimetres, infrared amplitudes, thermal counts."""
    return raw_image(np.asarray(image, "<u2"), "16UC1", frame_id, stamp_ns)


def image_from(data: bytes, name: str) -> NDArray[np.uint16]:
    """Invert ``image_message``; ``name`` is the image's in errors. Raises FormatError."""
    message = _decode(RawImage, data)
    if message.encoding not in ("16UC1", "mono16"):
        raise FormatError(f"{name} image has encoding {message.encoding!r}; record it as 16UC1")
    height, width, step = message.height, message.width, message.step
    if width == 0 or height == 0 or step < 2 * width or step % 2 or len(message.data) != step * height:
        raise FormatError(
            f"{name} image states {width}x{height}, {step} bytes a row, but holds {len(message.data)} bytes; "
            "record it again"
        )
    rows = np.frombuffer(message.data, "<u2").reshape(height, step // 2)
    return rows[:, :width].astype(np.uint16)


def spot_message(target_c: float, head_c: float, box_c: float, stamp_ns: int) -> RawImage:
    """Return a pyrometer's reading as a row of 32FC1: target, head and box, Celsius, NaN = not measured."""
    return raw_image(np.array([[target_c, head_c, box_c]], "<f4"), "32FC1", "pyrometer", stamp_ns)


def target_from(data: bytes) -> float:
    """Return the target's temperature of a ``spot_message``, Celsius. Raises FormatError."""
    message = _decode(RawImage, data)
    if message.encoding != "32FC1" or len(message.data) < 4:
        raise FormatError(f"a pyrometer reading has encoding {message.encoding!r}; record it as 32FC1")
    return float(np.frombuffer(message.data[:4], "<f4")[0])


def thermal_message(thermal_c: NDArray[np.float32], stamp_ns: int) -> RawImage:
    """Return float32 (h, w) Celsius as 16UC1 (see THERMAL_OFFSET_C), saturated; non-finite becomes 0."""
    steps = np.rint((np.asarray(thermal_c, np.float64) + THERMAL_OFFSET_C) * THERMAL_STEPS_PER_C)
    values = np.where(np.isfinite(steps), np.clip(steps, 1, 65535), 0).astype(np.uint16)
    return image_message(values, "thermal", stamp_ns)


def thermal_from(data: bytes) -> NDArray[np.float32]:
    """Invert ``thermal_message``. Raises FormatError."""
    return thermal_from_uint16(image_from(data, "thermal"))


def thermal_from_uint16(values: NDArray[np.uint16]) -> NDArray[np.float32]:
    """Return Celsius of the documented scale; NaN for 0."""
    celsius = values.astype(np.float64) / THERMAL_STEPS_PER_C - THERMAL_OFFSET_C
    return np.where(values > 0, celsius, np.nan).astype(np.float32)


def color_message(encoded: bytes, stamp_ns: int) -> CompressedImage:
    """Return the camera's own JPEG or PNG bytes, unchanged. Raises FormatError for other bytes."""
    kind = _FORMATS.get(encoded[:3])
    if kind is None:
        raise FormatError(f"colour image starts with {encoded[:3]!r}; record it as JPEG or PNG")
    return CompressedImage(timestamp=time_message(stamp_ns), frame_id="color", format=kind, data=encoded)


def color_from(data: bytes) -> bytes:
    """Invert ``color_message``. Raises FormatError."""
    message = _decode(CompressedImage, data)
    if message.format not in _FORMATS.values():
        raise FormatError(f"colour image has format {message.format!r}; record it as jpeg or png")
    return bytes(message.data)


def event_message(stamp_ns: int, text: str) -> Log:
    """Return a note on an event: flag closed, frame dropped, camera unplugged."""
    return Log(timestamp=time_message(stamp_ns), level=Log.INFO, message=text)


def event_from(data: bytes) -> str:
    """Invert ``event_message``. Raises FormatError."""
    return _decode(Log, data).message


def calibration_messages(calibration: RigCalibration, stamp_ns: int) -> Iterator[tuple[str, ProtoMessage]]:
    """Yield (topic, message): intrinsics, poses as a tree below frame ``depth``, the depth shift."""
    for topic, name in CALIBRATIONS.items():
        camera = getattr(calibration, name)
        if camera is not None:
            yield topic, _camera_message(camera, name, stamp_ns)
    poses = {"color": calibration.color_from_depth, "thermal": calibration.thermal_from_depth}
    # One parent (depth) for all keeps the frames a tree.
    transforms = [
        transform_message("depth", name, pose.inverse(), stamp_ns) for name, pose in poses.items() if pose
    ]
    if transforms:
        yield TF, FrameTransforms(transforms=transforms)
    if calibration.depth_shift_mm:
        yield SHIFT, KeyValuePair(key=SHIFT_KEY, value=repr(float(calibration.depth_shift_mm)))


def calibration_from(messages: dict[str, bytes]) -> RigCalibration:
    """Invert ``calibration_messages``; the first message of each topic. Raises CalibrationError."""
    for topic, data in messages.items():
        # A protobuf list of empty messages unpacks to fifty times its size.
        if len(data) > MAX_CALIBRATION_BYTES:
            raise CalibrationError(f"{topic} is larger than {MAX_CALIBRATION_BYTES} bytes; record it again")
    cameras = {
        name: intrinsics_from(_decode(CameraCalibration, messages[topic]), False, f"the {name} camera")
        for topic, name in CALIBRATIONS.items()
        if topic in messages
    }
    if "depth" not in cameras:
        raise CalibrationError("the session has no /depth/calibration; record it with its calibration")
    poses: dict[str, Pose] = {}
    for parent, child, depth_from_child in links_from(_decode(FrameTransforms, messages.get(TF, b""))):
        if parent == "depth" and child in ("color", "thermal") and child in cameras:
            poses[f"{child}_from_depth"] = depth_from_child.inverse()
    for child in ("color", "thermal"):
        if f"{child}_from_depth" not in poses:  # intrinsics without a pose are ignored
            cameras.pop(child, None)
    shift_mm = _shift_from(messages[SHIFT]) if SHIFT in messages else 0.0
    return RigCalibration(**cameras, **poses, depth_shift_mm=shift_mm)  # type: ignore[arg-type]


def _shift_from(data: bytes) -> float:
    entry = _decode(KeyValuePair, data)
    try:
        return float(entry.value) if entry.key == SHIFT_KEY else 0.0
    except ValueError as error:
        raise CalibrationError(
            f"{SHIFT} holds {entry.value[:40]!r}, not millimetres; record it again"
        ) from error


def _decode(kind: type[M], data: bytes) -> M:
    message: M = kind()
    try:
        message.ParseFromString(data)
    except DecodeError as error:
        name = kind.DESCRIPTOR.full_name
        raise FormatError(f"a {name} message cannot be decoded ({error}); record it again") from error
    return message


def raw_image(image: NDArray[Any], encoding: str, frame_id: str, stamp_ns: int) -> RawImage:
    """Return an image (h, w) or (h, w, channels) with its encoding by ROS's names, such as 8UC1 or rgb8."""
    return RawImage(
        timestamp=time_message(stamp_ns),
        frame_id=frame_id,
        width=image.shape[1],
        height=image.shape[0],
        encoding=encoding,
        step=image.nbytes // image.shape[0],
        data=image.tobytes(),
    )


def time_message(stamp_ns: int) -> Timestamp:
    """Return nanoseconds as a message's time."""
    timestamp = Timestamp()
    timestamp.FromNanoseconds(stamp_ns)
    return timestamp


def _camera_message(camera: Intrinsics, frame_id: str, stamp_ns: int) -> CameraCalibration:
    return CameraCalibration(
        timestamp=time_message(stamp_ns),
        frame_id=frame_id,
        width=camera.width,
        height=camera.height,
        distortion_model="plumb_bob",
        D=camera.distortion,
        K=camera.matrix.ravel().tolist(),
        R=np.eye(3).ravel().tolist(),
        P=np.hstack([camera.matrix, np.zeros((3, 1))]).ravel().tolist(),
    )


def transform_message(parent: str, child: str, parent_from_child: Pose, stamp_ns: int) -> FrameTransform:
    """Return the place of a child's frame in its parent's: p_parent = R p_child + t."""
    message = FrameTransform(timestamp=time_message(stamp_ns), parent_frame_id=parent, child_frame_id=child)
    move, turn = message.translation, message.rotation
    move.x, move.y, move.z = parent_from_child.translation_m
    turn.x, turn.y, turn.z, turn.w = quaternion_of(parent_from_child.rotation)
    return message
