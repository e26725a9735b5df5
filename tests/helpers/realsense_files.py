"""Recordings of RealSense's SDK: a .db3 made by the SDK itself, a .bag written as older versions did."""

from pathlib import Path

import numpy as np
import pytest

rosbag1 = pytest.importorskip("rosbags.rosbag1")
typesys = pytest.importorskip("rosbags.typesys")
STORE = typesys.get_typestore(typesys.Stores.ROS1_NOETIC)
LOGGED_NS = [1_000_000_000 + 33_250_000 * index for index in range(100)]
"""Time since the recording began, from which the SDK leaves pauses out."""
STREAM_INFO = "realsense_msgs/msg/StreamInfo"
STORE.register(typesys.get_types_from_msg("uint32 fps\nstring encoding\nbool is_recommended", STREAM_INFO))


def write_old_bag(path, frames, lenses, unit_m=0.001, rotation=(0.0, 0.0, 0.0, 1.0)) -> Path:
    """A .bag of version 3 with its depth, left infrared and YUYV colour; see ros_writer.cpp of librealsense.

    frames: (number, milliseconds, depth, infrared, YUYV) of each. lenses: of depth and colour, with model.
    """
    depth_lens, color_lens = lenses
    with rosbag1.Writer(path) as writer:
        connections = {}

        def write(topic, kind, logged_ns, behind=b"", **fields):
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=STORE)
            message = STORE.types[kind](**fields)
            writer.write(connections[topic], logged_ns, bytes(STORE.serialize_ros1(message, kind)) + behind)

        write("/file_version", "std_msgs/msg/UInt32", 1, data=3)
        vector, quaternion = (
            STORE.types["geometry_msgs/msg/Vector3"],
            STORE.types["geometry_msgs/msg/Quaternion"],
        )
        region = STORE.types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
        time, header = STORE.types["builtin_interfaces/msg/Time"], STORE.types["std_msgs/msg/Header"]
        streams = {
            "sensor_0/Depth_0": (2, "mono16", depth_lens, (0.0, 0.0, 0.0)),
            "sensor_0/Infrared_1": (3, "8UC1", depth_lens, (0.0, 0.0, 0.0)),
            "sensor_1/Color_0": (4, "YUYV", color_lens, (-0.059, 0.001, 0.0)),
        }
        pair = "diagnostic_msgs/msg/KeyValue"
        for sensor, name in enumerate(("Stereo Module", "RGB Camera")):
            write(f"/device_0/sensor_{sensor}/info", pair, 1, key="Name", value=name)
        write("/device_0/info", pair, 1, key="Name", value="D455")
        write("/device_0/sensor_0/option/Depth Units/value", "std_msgs/msg/Float32", 1, data=unit_m)
        write("/device_0/sensor_0/option/Depth Units/description", "std_msgs/msg/String", 1, data="unit")
        for name, (at, encoding, (lens, model), xyz) in streams.items():
            write(
                f"/device_0/{name}/info/camera_info", "sensor_msgs/msg/CameraInfo", 1,
                header=header(seq=0, stamp=time(0, 0), frame_id=""), height=lens.height, width=lens.width,
                distortion_model=model, D=np.array(lens.distortion), K=lens.matrix.ravel(), R=np.zeros(9),
                P=np.zeros(12), binning_x=0, binning_y=0, roi=region,
            )  # fmt: skip
            write(f"/device_0/{name}/info", STREAM_INFO, 1, fps=30, encoding=encoding, is_recommended=False)
            turn = rotation if "Color" in name else (0.0, 0.0, 0.0, 1.0)
            write(
                f"/device_0/{name}/tf/0", "geometry_msgs/msg/Transform", 1,
                translation=vector(*xyz), rotation=quaternion(*turn),
            )  # fmt: skip
            for index, frame in enumerate(frames):
                number, stamp_ms, pixels = frame[0], frame[1], frame[at]
                stamp = time(int(stamp_ms // 1000), round(stamp_ms % 1000 * 1e6))
                logged_ns = LOGGED_NS[index]
                write(
                    f"/device_0/{name}/image/data", "sensor_msgs/msg/Image", logged_ns,
                    np.float32(unit_m if at == 2 else 0).tobytes(),
                    header=header(seq=number, stamp=stamp, frame_id="1"), height=pixels.shape[0],
                    width=pixels.shape[1], encoding=encoding, is_bigendian=0, step=pixels.strides[0],
                    data=pixels.view(np.uint8).ravel(),
                )  # fmt: skip
                for key, value in (("system_time", f"{stamp_ms}"), ("timestamp_domain", "Hardware Clock")):
                    write(f"/device_0/{name}/image/metadata", pair, logged_ns, key=key, value=value)
    return path


def write_db3(path, twin, numbers) -> Path:
    """These frames of a twin, recorded by the SDK itself; the twin must stream nothing of its own."""
    sdk = pytest.importorskip("pyrealsense2")
    recorder, queue = sdk.recorder(str(path), twin.device), sdk.frame_queue(8)
    sensors = list(recorder.query_sensors())
    for sensor in sensors:
        sensor.open(sensor.get_stream_profiles())
        sensor.start(queue)
    for number in numbers:
        twin.show(number)
        # The recorder drops what it cannot write in time.
        for _ in range(3):
            assert queue.try_wait_for_frame(5000)[0]
    for sensor in sensors:
        sensor.stop()
        sensor.close()
    # The file is complete when the recorder is gone.
    del sensor, sensors, recorder
    return path
