"""A recording of an Orbbec camera, a ROS 1 bag laid out as OrbbecSDK 2 writes it (src/media/ros, MIT)."""

import struct
from pathlib import Path

import cv2
import numpy as np
import pytest

from sensors.rig.camera import Intrinsics

rosbag1 = pytest.importorskip("rosbags.rosbag1")
HEADER = "std_msgs/Header header\n"
LAYOUTS = {
    "sensor_msgs/msg/Image": ("060021388200f6f0f447d0fcd9c64743", "uint32 height\n"),
    "custom_msg/msg/OBStreamProfileInfo": ("0123456789abcdef0123456789abcdef", "uint8 streamType\n"),
    "custom_msg/msg/OBProperty": ("0123456789abcdef0123456789abcdef", "uint8 propertyId\n"),
    "custom_msg/msg/OBDeviceInfo": ("afef5328bb4abebd1a309e1ea8b26b3a", "string name\n"),
}
"""By type: the sum that the SDK looks for, and a definition, which it does not read."""
COLOR, DEPTH, INFRARED = 2, 3, 1
"""Sensors, streams and frames have the same numbers (OBSensorType, OBStreamType, OBFrameType)."""
Y16, MJPG = 8, 5
SHIFT_MM = (-32.0, -2.0, 4.0)
"""Of depth to colour."""


def text(value: str) -> bytes:
    return struct.pack("<I", len(value)) + value.encode()


def header(stamp_us: int) -> bytes:
    return struct.pack("<III", 0, stamp_us // 1_000_000, stamp_us % 1_000_000 * 1000) + text("")


def image_message(
    number: int, stamp_us: int, pixels: np.ndarray, encoding: str, shape: tuple[int, int]
) -> bytes:
    data = pixels.tobytes()
    step = 2 * shape[1] if encoding == "mono16" else 0
    message = header(stamp_us) + struct.pack("<II", *shape) + text(encoding) + struct.pack("<BI", 0, step)
    message += struct.pack("<I", len(data)) + data + struct.pack("<f", 1.0)
    return message + struct.pack("<QQQQ", number, stamp_us, stamp_us, stamp_us) + struct.pack("<II", 0, 0)


def profile_message(stream: int, kind: int, lens: Intrinsics, shift: tuple[float, ...]) -> bytes:
    turn, (k1, k2, p1, p2, k3) = np.eye(3, dtype="<f4").tobytes(), lens.distortion
    message = header(1_000_000) + struct.pack("<BB", stream, kind) + turn + struct.pack("<3f", *shift)
    message += struct.pack("<3H4f", lens.width, lens.height, 30, lens.fx, lens.fy, lens.cx, lens.cy)
    return message + struct.pack("<8fB", k1, k2, k3, 0, 0, 0, p1, p2, 3)


def write_orbbec_bag(path: Path, depth_lens: Intrinsics, color_lens: Intrinsics, frames: list[tuple]) -> Path:
    """Frames (number, microseconds, depth, infrared, JPEG) of a Femto Bolt."""
    with rosbag1.Writer(path) as writer:
        connections = {}

        def write(topic: str, kind: str, stamp_us: int, message: bytes) -> None:
            if topic not in connections:
                md5, definition = LAYOUTS[kind]
                connections[topic] = writer.add_connection(
                    topic, kind, msgdef=HEADER + definition, md5sum=md5
                )
            writer.write(connections[topic], 1000 * stamp_us, message)

        for number, stamp_us, depth, infrared, jpeg in frames:
            for sensor, pixels, encoding, lens in (
                (COLOR, np.frombuffer(jpeg, np.uint8), "mjpg", color_lens),
                (DEPTH, depth, "mono16", depth_lens),
                (INFRARED, infrared, "mono16", depth_lens),
            ):
                message = image_message(number, stamp_us, pixels, encoding, lens.shape)
                write(f"/cam/sensor_{sensor}/frameType_{sensor}", "sensor_msgs/msg/Image", stamp_us, message)
        first_us = frames[0][1]
        info = "custom_msg/msg/OBStreamProfileInfo"
        for stream, kind, lens, shift in (
            (COLOR, MJPG, color_lens, (0.0,) * 3),
            (DEPTH, Y16, depth_lens, SHIFT_MM),
            (INFRARED, Y16, depth_lens, (0.0,) * 3),
        ):
            write(
                f"/cam/streamProfileType_{stream}", info, first_us, profile_message(stream, kind, lens, shift)
            )
        version = struct.pack("<d", 2.0)
        prop = header(first_us) + struct.pack("<I", 0) + struct.pack("<I", 8) + version + struct.pack("<I", 8)
        write("/cam/property", "custom_msg/msg/OBProperty", first_us, prop)
        names = ("Femto Bolt", "Orbbec Femto Bolt", "")
        device = header(first_us) + b"".join(map(text, names)) + struct.pack("<HH", 0x2BC5, 0x066B)
        device += b"".join(map(text, ("uid", "CL8TEST", "1.0", "1.0", "2.0", "USB3.2")))
        device += struct.pack("<HB", 0, 0) + text("") + text("")
        write("/cam/deviceInfo", "custom_msg/msg/OBDeviceInfo", first_us, device)
    return path


def jpeg_of(lens: Intrinsics, grey: int) -> bytes:
    return cv2.imencode(".jpg", np.full((*lens.shape, 3), grey, np.uint8))[1].tobytes()
