"""ROS 2 bags as a RealSense's node leaves them, by rosbags' own writer."""

from pathlib import Path

import numpy as np
import pytest
from mcap.writer import CompressionType, Writer
from mcap_protobuf.schema import register_schema

from sensors.rig.camera import Intrinsics

rosbag2 = pytest.importorskip("rosbags.rosbag2")
typesys = pytest.importorskip("rosbags.typesys")
STORE = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
H, W = 12, 16
SECOND = 1_000_000_000
STORAGES = [rosbag2.StoragePlugin.SQLITE3, rosbag2.StoragePlugin.MCAP]
DEPTH, COLOR = "/camera/depth/image_rect_raw", "/camera/color/image_raw"


def depth_image(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 5000, (H, W), np.uint16)


def color_image(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, (2 * H, 2 * W, 3), np.uint8)


def ros(kind: str, **fields: object) -> object:
    return STORE.types[kind](**fields)


def header(stamp_ns: int, frame: str) -> object:
    time = ros("builtin_interfaces/msg/Time", sec=stamp_ns // SECOND, nanosec=stamp_ns % SECOND)
    return ros("std_msgs/msg/Header", stamp=time, frame_id=frame)


def image(pixels: np.ndarray, encoding: str, stamp_ns: int, frame: str) -> object:
    return ros(
        "sensor_msgs/msg/Image", header=header(stamp_ns, frame), height=pixels.shape[0],
        width=pixels.shape[1], encoding=encoding, is_bigendian=0, step=pixels.strides[0],
        data=pixels.view(np.uint8).ravel(),
    )  # fmt: skip


def camera_info(camera: Intrinsics, frame: str) -> object:
    region = ros(
        "sensor_msgs/msg/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False
    )
    return ros(
        "sensor_msgs/msg/CameraInfo", header=header(0, frame), height=camera.height, width=camera.width,
        distortion_model="plumb_bob", d=np.array(camera.distortion), k=camera.matrix.ravel(),
        r=np.eye(3).ravel(),
        p=np.hstack([camera.matrix, np.zeros((3, 1))]).ravel(), binning_x=0, binning_y=0, roi=region,
    )  # fmt: skip


def transform(parent: str, child: str, xyz: tuple[float, float, float]) -> object:
    move = ros(
        "geometry_msgs/msg/Transform",
        translation=ros("geometry_msgs/msg/Vector3", x=xyz[0], y=xyz[1], z=xyz[2]),
        rotation=ros("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0),
    )
    stamped = ros(
        "geometry_msgs/msg/TransformStamped", header=header(0, parent), child_frame_id=child, transform=move
    )
    return ros("tf2_msgs/msg/TFMessage", transforms=[stamped])


CAMERA, COLOR_CAMERA = (
    Intrinsics(W, H, 20.0, 21.0, 7.5, 5.5),
    Intrinsics(2 * W, 2 * H, 40.0, 41.0, 15.5, 11.5, 0.1),
)


def write_bag(
    path: Path, storage: object, messages: list[tuple[str, object, int]], compression: object = None
) -> Path:
    """(topic, message, time logged) into a ROS 2 bag, by rosbags' own writer."""
    writer = rosbag2.Writer(path, version=9, storage_plugin=storage)
    if compression:
        writer.set_compression(compression, rosbag2.CompressionFormat.ZSTD)
    with writer:
        connections: dict[str, object] = {}
        for topic, message, logged_ns in messages:
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=STORE)
            writer.write(connections[topic], logged_ns, STORE.serialize_cdr(message, kind))
    return path


def write_mcap(path: Path, messages: list[tuple[str, object]], compression=CompressionType.ZSTD) -> Path:
    """(topic, Foxglove message) into an MCAP file, by mcap's own writer."""
    with path.open("wb") as file:
        writer, channels = Writer(file, compression=compression), {}
        writer.start()
        for topic, message in messages:
            if topic not in channels:
                schema = register_schema(writer, type(message))
                channels[topic] = writer.register_channel(topic, "protobuf", schema)
            writer.add_message(channels[topic], 5, message.SerializeToString(), 5)
        writer.finish()
    return path


def realsense(frames: int = 3) -> list[tuple[str, object, int]]:
    """Messages of a RealSense's node: colour 5 ms after depth, everything logged late and in disorder."""
    depth_info = camera_info(CAMERA, "depth_optical"), camera_info(COLOR_CAMERA, "color_optical")
    messages: list[tuple[str, object, int]] = [
        ("/tf_static", transform("link", "depth_optical", (0.1, 0.0, 0.0)), 1),
        ("/tf_static", transform("link", "color_optical", (0.25, 0.0, 0.0)), 1),
        ("/camera/depth/camera_info", depth_info[0], 2),
        ("/camera/color/camera_info", depth_info[1], 2),
    ]
    for i in reversed(range(frames)):
        stamp = SECOND + i * 33_000_000
        depth, color = depth_image(i), color_image(i)
        messages.append((DEPTH, image(depth, "16UC1", stamp, "depth_optical"), 9 * SECOND - i))
        messages.append((COLOR, image(color, "rgb8", stamp + 5_000_000, "color_optical"), 9 * SECOND - i))
        infra = (depth % 256).astype(np.uint8)
        messages.append(("/camera/infra1/image_rect_raw", image(infra, "mono8", stamp, "i"), 9 * SECOND))
    return messages


def write_old_bag(
    path: Path, messages: list[tuple[str, object, int]], compression: str = "", chunk_bytes: int = 1 << 20
) -> Path:
    """(topic, message, time logged) into a ROS 1 bag, by rosbags' own writer.

    compression: "", BZ2 or LZ4. chunk_bytes: above which a chunk ends.
    """
    rosbag1 = pytest.importorskip("rosbags.rosbag1")
    store = typesys.get_typestore(typesys.Stores.ROS1_NOETIC)
    transforms = "geometry_msgs/TransformStamped[] transforms"
    store.register(typesys.get_types_from_msg(transforms, "tf2_msgs/msg/TFMessage"))

    def of_ros_1(value: object) -> object:
        """ROS 1 has a header's number beside, and some names in large letters."""
        if isinstance(value, list) or not hasattr(value, "__msgtype__"):
            return [of_ros_1(v) for v in value] if isinstance(value, list) else value
        kind = store.types[value.__msgtype__]
        fields = {name.lower(): of_ros_1(v) for name, v in vars(value).items()}
        names = [name for name in kind.__dataclass_fields__ if not name.startswith("__")]
        return kind(**{name: fields.get(name.lower(), 0) for name in names})

    writer = rosbag1.Writer(path)
    writer.chunk_threshold = chunk_bytes
    if compression:
        writer.set_compression(rosbag1.Writer.CompressionFormat[compression])
    with writer:
        connections: dict[str, object] = {}
        for topic, message, logged_ns in messages:
            old = of_ros_1(message)
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, old.__msgtype__, typestore=store)
            writer.write(connections[topic], logged_ns, store.serialize_ros1(old, old.__msgtype__))
    return path
