"""ROS 2 bags and other people's MCAP, written by rosbags and mcap's own writer, become frames."""

import sqlite3
import struct
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from mcap.writer import CompressionType, Writer
from mcap_protobuf.schema import register_schema

from cli.sessions import sessions_in
from sensors.calibration_files.camera_messages import intrinsics_from, links_from
from sensors.errors import CalibrationError, CloudError, FormatError
from sensors.importers.bags.bag import Bag
from sensors.importers.bags.bag_camera import described_by, path_between
from sensors.importers.bags.choose import choose, choose_depth
from sensors.importers.bags.ros_images import color_encoded_from, depth_from
from sensors.importers.bags.ros_messages import Picture, decode, picture_from, stamp_and_frame
from sensors.importers.open_source import open_source
from sensors.rig.camera import Intrinsics
from sensors.rig.rig_calibration import Pose, RigCalibration
from sensors.session.messages import calibration_messages, color_message, image_message
from sensors.session.reader import Session
from tests.helpers.bags import (
    CAMERA,
    COLOR,
    COLOR_CAMERA,
    DEPTH,
    SECOND,
    STORAGES,
    H,
    W,
    camera_info,
    color_image,
    depth_image,
    image,
    realsense,
    transform,
    write_bag,
    write_old_bag,
)
from tests.helpers.depth_files import assert_refused, write

rosbag2 = pytest.importorskip("rosbags.rosbag2")


def assert_realsense(source: Bag) -> None:
    """Calibration and frames are those of ``realsense``."""
    assert (source.calibration.depth, source.calibration.color) == (CAMERA, COLOR_CAMERA)
    np.testing.assert_allclose(source.calibration.color_from_depth.translation_m, [-0.15, 0, 0])
    assert len(source) == 3
    for i, frame in enumerate(source):
        assert (frame.index, frame.stamp_ns) == (i, SECOND + i * 33_000_000)
        np.testing.assert_array_equal(frame.depth_mm, depth_image(i))
        np.testing.assert_array_equal(frame.decode_color(), color_image(i))


@pytest.mark.parametrize("storage", STORAGES)
@pytest.mark.parametrize("alone", [False, True])
def test_a_bag_is_a_source(tmp_path, storage, alone):
    path = write_bag(tmp_path / "bag", storage, realsense())
    if alone:
        path = next(f for f in path.iterdir() if f.suffix in (".db3", ".mcap"))
    source = open_source(path)
    assert isinstance(source, Bag)
    assert_realsense(source)
    assert {
        f"depth from {DEPTH}",
        f"colour from {COLOR}",
        "not read: /camera/infra1/image_rect_raw (mono8)",
    } <= set(source.notes)


def test_a_bag_becomes_a_session(annotate_cloud, tmp_path):
    bag = write_bag(tmp_path / "bag", STORAGES[0], realsense())
    done = annotate_cloud("import", bag, tmp_path / "x.mcap", "--json")
    assert (done.code, done.result["frames"], done.result["streams"]) == (0, 3, {"depth": 3, "color": 3})
    for a, b in zip(open_source(bag), Session(tmp_path / "x.mcap"), strict=True):
        np.testing.assert_array_equal(a.depth_mm, b.depth_mm)
        assert (a.color_encoded, a.stamp_ns) == (b.color_encoded, b.stamp_ns)


def test_what_is_absent_is_said(tmp_path):
    def notes(name: str, *without: str) -> tuple[str, ...]:
        rest = [m for m in realsense() if not m[0].startswith(without)]
        return open_source(write_bag(tmp_path / name, STORAGES[1], rest)).notes

    assert "no transform" in "".join(notes("a", "/tf"))
    assert "has no camera_info for /camera/color/image_raw" in "".join(
        notes("b", "/camera/color/camera_info", "/tf")
    )
    assert "no colour images" in notes("c", "/camera/color")
    with pytest.raises(CalibrationError, match="camera_info"):
        notes("d", "/camera/depth/camera_info", "/camera/color/camera_info")
    with pytest.raises(FormatError, match="no depth images"):
        notes("e", "/camera/depth")


@pytest.mark.parametrize("compression", list(CompressionType))
def test_foxglove_mcap_of_others_is_read(tmp_path, compression):
    path = tmp_path / "robot.mcap"
    rig = RigCalibration(CAMERA, COLOR_CAMERA, Pose.identity())
    calibrations = dict(calibration_messages(rig, 0))
    jpeg = bytes(cv2.imencode(".jpg", color_image(0))[1])
    with path.open("wb") as file:
        writer = Writer(file, compression=compression)
        writer.start()
        channels = {}
        for topic, message in [
            ("/robot/head/depth/calibration", calibrations["/depth/calibration"]),
            ("/robot/head/rgb/calibration", calibrations["/color/calibration"]),
            ("/tf", calibrations["/tf"]),
            *[
                ("/robot/head/depth/image", image_message(depth_image(i), "depth", i * SECOND))
                for i in range(2)
            ],
            *[("/robot/head/rgb/compressed", color_message(jpeg, i * SECOND)) for i in range(2)],
        ]:
            if topic not in channels:
                schema = register_schema(writer, type(message))
                channels[topic] = writer.register_channel(topic, "protobuf", schema)
            writer.add_message(channels[topic], 5, message.SerializeToString(), 5)
        writer.finish()
    source = open_source(path)
    assert isinstance(source, Bag)
    assert source.calibration.color_from_depth is not None
    assert [frame.stamp_ns for frame in source] == [0, SECOND]
    for i, frame in enumerate(source):
        np.testing.assert_array_equal(frame.depth_mm, depth_image(i))
        assert frame.color_encoded == jpeg
    path.write_bytes(path.read_bytes()[:-100])
    assert any("truncated" in note for note in open_source(path).notes)


def test_our_own_sessions_stay_sessions(rig_session):
    assert isinstance(open_source(rig_session), Session)


# Pictures


def raw(height: int, width: int, encoding: str, step: int, big_endian: bool, data: bytes) -> Picture:
    return Picture("", encoding, data, False, height, width, step, big_endian)


def packed(kind: str, data: bytes) -> Picture:
    return Picture("", kind, data, True)


def test_depth_in_every_encoding():
    mm = depth_image(0)
    metres = np.where(mm > 0, mm / 1000, np.nan).astype("<f4")
    padded = np.pad(mm, ((0, 0), (0, 3)))
    for encoding, pixels, big in (
        ("16UC1", mm, False),
        ("mono16", mm.astype(">u2"), True),
        ("32FC1", metres, False),
        ("32FC1", metres.astype(">f4"), True),
        ("16UC1", padded, False),
    ):
        picture = raw(H, W, encoding, pixels.strides[0], big, pixels.tobytes())
        values = depth_from(picture)
        assert values.dtype == (np.float32 if encoding == "32FC1" else np.uint16)
        np.testing.assert_array_equal(values, metres if encoding == "32FC1" else mm)


def test_compressed_depth():
    png = bytes(cv2.imencode(".png", depth_image(0))[1])
    head = struct.pack("<iff", 0, 0.0, 0.0)
    for data in (png, head + png):
        got = depth_from(packed("16UC1; compressedDepth png", data))
        np.testing.assert_array_equal(got, depth_image(0))
    # compressed_depth_image_transport's inverse depth: q = a / z + b
    a, b = 100.0 * 101, -99.0
    z = np.random.default_rng(0).uniform(0.5, 4, (H, W))
    quantised = np.rint(a / z + b).astype(np.uint16)
    data = struct.pack("<iff", 1, a, b) + bytes(cv2.imencode(".png", quantised)[1])
    got = depth_from(packed("32FC1; compressedDepth png", data))
    np.testing.assert_allclose(got, z, atol=2e-3)
    with pytest.raises(FormatError, match="RVL"):
        depth_from(packed("16UC1; compressedDepth rvl", b"\0" * 99))


ORDERS = {"rgb8": (0, 1, 2), "bgr8": (2, 1, 0), "rgba8": (0, 1, 2, 0), "bgra8": (2, 1, 0, 0)}


@pytest.mark.parametrize("encoding", ORDERS)
def test_colour_in_every_encoding(encoding):
    rgb = color_image(0)
    pixels = np.ascontiguousarray(rgb[..., list(ORDERS[encoding])])
    encoded = color_encoded_from(raw(2 * H, 2 * W, encoding, pixels.strides[0], False, pixels.tobytes()))
    decoded = cv2.imdecode(np.frombuffer(encoded, np.uint8), cv2.IMREAD_COLOR)[..., ::-1]
    np.testing.assert_array_equal(decoded, rgb)


@pytest.mark.parametrize(
    "picture",
    [
        raw(0, 4, "16UC1", 8, False, b""),
        raw(4, 4, "16UC1", 7, False, bytes(32)),
        raw(4, 4, "16UC1", 8, False, bytes(31)),
        raw(4, 4, "16UC1", 1 << 31, False, bytes(32)),
        raw(1 << 31, 1 << 31, "16UC1", 1 << 32, False, bytes(32)),
        raw(1, 4, "16UC1", 1 << 31, False, bytes(32)),
        raw(4, 4, "bayer_rggb16", 8, False, bytes(32)),
        packed("16UC1; compressedDepth", b""),
        packed("32FC1; compressedDepth", struct.pack("<iff", 1, float("nan"), 0)
                      + bytes(cv2.imencode(".png", np.ones((2, 2), np.uint16))[1])),
    ],
)  # fmt: skip
def test_impossible_pictures_are_refused(picture):
    with pytest.raises(FormatError):
        depth_from(picture)


def test_topics_are_chosen_by_content_and_name():
    def some(encoding: str) -> Picture:
        return raw(1, 1, encoding, 8, False, bytes(8))

    jpeg, depth_png = packed("jpeg", b"\xff\xd8\xff"), packed("16UC1; compressedDepth", b"")
    first = {
        "/a/infra1/image": some("mono16"),
        "/a/aligned_depth_to_color/image_raw": some("16UC1"),
        "/a/depth/image_raw": some("16UC1"),
        "/a/depth/image_raw/compressedDepth": depth_png,
        "/a/color/image_raw": some("rgb8"),
        "/a/color/image_raw/compressed": jpeg,
    }
    assert choose(first)[:2] == ("/a/depth/image_raw", "/a/color/image_raw/compressed")
    cameras = {"/a/depth/camera_info", "/a/color/camera_info"}
    assert described_by("/a/depth/image_raw/compressedDepth", cameras) == ["/a/depth/camera_info"]
    assert described_by("/b/image", cameras) == []
    assert choose_depth({"/a/infra1/image": some("mono16")}) is None


def test_a_lens_that_is_unknown_is_refused_unless_the_image_is_rectified():
    k = [20.0, 0, 7.5, 0, 21.0, 5.5, 0, 0, 1]
    p = [30.0, 0, 7.5, 0, 0, 31.0, 5.5, 0, 0, 0, 1, 0]
    fisheye = SimpleNamespace(width=W, height=H, distortion_model="equidistant", d=[0.1] * 4, k=k, p=p)
    with pytest.raises(CalibrationError, match="equidistant"):
        intrinsics_from(fisheye, False, "x")
    assert intrinsics_from(fisheye, True, "x") == Intrinsics(W, H, 30, 31, 7.5, 5.5)
    with pytest.raises(CalibrationError):
        intrinsics_from(CameraCalibration(width=W, height=H), False, "x")


def test_poses_go_up_and_down_the_tree():
    def shift(x: float) -> Pose:
        return Pose(np.eye(3), np.array([x, 0, 0]))

    links = {("base", "a"): shift(1), ("a", "depth"): shift(0.5), ("base", "color"): shift(3)}
    links["x", "y"] = shift(9)
    pose = path_between(links, "depth", "color")
    np.testing.assert_allclose(pose.apply(np.zeros(3)), [-1.5, 0, 0])
    assert path_between(links, "depth", "y") is None
    loop = {("a", "b"): shift(1), ("b", "a"): shift(1)}
    assert path_between(loop, "a", "c") is None


# Damaged, large, and of other recorders


def test_what_is_no_bag_is_refused(tmp_path):
    path = tmp_path / "x.db3"
    with sqlite3.connect(path) as database:
        database.execute("CREATE VIEW topics AS SELECT 1 AS id")
        database.execute("CREATE TABLE messages (id, topic_id, timestamp, data)")
    database.close()
    for content in (path.read_bytes(), b"SQLite format 3\0" + bytes(5000), b"#ROSBAG V2.0\n", b"#ROSBAG V9"):
        for name in ("x.db3", "x.bag", "bag/metadata.yaml"):
            file = write(tmp_path / name, content)
            assert_refused(file.parent if file.suffix == ".yaml" else file, kind=FormatError)


@pytest.mark.parametrize("storage", STORAGES)
def test_a_large_bag_is_read(tmp_path, storage):
    """Transforms for minutes before those of the cameras, long names, and thousands of messages."""
    name = "/" + "robot/" * 50
    others = [("/tf", transform(f"a{i % 50}", f"b{i}", (0.0, 0.0, 1.0)), 2 + i) for i in range(1500)]
    moving = [(topic.replace("/tf_static", "/tf"), m, 2000 + t) for topic, m, t in realsense(1)]
    prefixed = [(topic if topic == "/tf" else name + topic.lstrip("/"), m, t) for topic, m, t in moving]
    source = open_source(write_bag(tmp_path / "bag", storage, others + prefixed))
    np.testing.assert_allclose(source.calibration.color_from_depth.translation_m, [-0.15, 0, 0])
    assert f"depth from {name}{DEPTH.lstrip('/')}" in source.notes
    np.testing.assert_array_equal(next(iter(source)).depth_mm, depth_image(0))


@pytest.mark.parametrize("mode", list(rosbag2.CompressionMode)[1:3])
def test_a_compressed_bag_is_read(tmp_path, mode):
    assert_realsense(open_source(write_bag(tmp_path / "bag", STORAGES[0], realsense(), mode)))


@pytest.mark.parametrize("storage", STORAGES)
def test_a_bag_whose_recorder_was_killed_is_read_as_one_recording(tmp_path, storage):
    path = write_bag(tmp_path / "bag", storage, realsense())
    (path / "metadata.yaml").unlink()
    assert len(open_source(path)) == 3 and not sessions_in(path, None)


def test_a_ros_1_bag_is_a_source(tmp_path):
    assert_realsense(open_source(write_old_bag(tmp_path / "x.bag", realsense())))


@pytest.mark.parametrize("storage", STORAGES)
def test_a_flipped_bag_is_an_error_or_frames(tmp_path, storage):
    path = write_bag(tmp_path / "bag", storage, realsense(1))
    file = next(f for f in path.iterdir() if f.suffix in (".db3", ".mcap"))
    good, rng = file.read_bytes(), np.random.default_rng(0)
    for _ in range(60):
        content = bytearray(good)
        for at in rng.integers(0, len(good), 4):
            content[at] ^= 1 << rng.integers(8)
        file.write_bytes(content)
        try:
            for frame in open_source(file):
                assert frame.depth_mm.shape == (H, W)
                frame.decode_color()
        except CloudError as error:
            assert "\n" not in str(error)


def test_messages_of_the_wrong_kind_are_refused():
    for kind, encoding, data in (
        ("RawImage", "protobuf", b"\xff" * 9),
        ("Image", "cdr", b"\0\1\0\0" + b"\xff" * 40),
        ("Image", "ros1", b"\xff" * 40),
        ("TFMessage", "cdr", b"\0\1\0\0" + b"\xff" * 4),
    ):
        with pytest.raises(FormatError, match=f"a {kind} message is damaged"):
            decode(kind, encoding, data)
    message = decode("RawImage", "protobuf", RawImage(width=3).SerializeToString())
    assert picture_from(message).width == 3
    message = decode("CompressedImage", "protobuf", CompressedImage(format="x").SerializeToString())
    assert stamp_and_frame(message) == (0, "")
    with pytest.raises(CalibrationError, match="no rotation"):
        list(links_from(FrameTransforms(transforms=[{"child_frame_id": "x"}])))


def test_one_camera_info_of_depth_and_colour_is_named_once(tmp_path):
    messages = [
        ("/camera/depth/camera_info", camera_info(CAMERA, "d"), 1),
        (DEPTH, image(depth_image(0), "16UC1", SECOND, "d"), 2),
        ("/camera/aligned/image_raw", image(np.zeros((H, W, 3), np.uint8), "rgb8", SECOND, "d"), 3),
    ]
    notes = open_source(write_bag(tmp_path / "bag", STORAGES[0], messages)).notes
    assert "intrinsics from /camera/depth/camera_info" in notes, notes
