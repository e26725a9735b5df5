"""ROS bags and MCAP files of other programs, written by rosbags and mcap's own writer, become frames."""

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
from mcap.writer import CompressionType

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
    color_image,
    depth_image,
    realsense,
    rosbag2,
    transform,
    write_bag,
    write_mcap,
    write_old_bag,
)
from tests.helpers.depth_files import assert_refused, png, write

SQLITE, MCAP = STORAGES


def storage_file(folder):
    return next(f for f in folder.iterdir() if f.suffix in (".db3", ".mcap"))


def without_metadata(path):
    """As a killed recorder leaves it."""
    (path / "metadata.yaml").unlink()
    assert not sessions_in(path, None)
    return path


MODES = list(rosbag2.CompressionMode)[1:3]
CONTAINERS = {
    "SQLite": lambda path: write_bag(path, SQLITE, realsense()),
    "MCAP": lambda path: write_bag(path, MCAP, realsense()),
    "SQLite file": lambda path: storage_file(write_bag(path, SQLITE, realsense())),
    "MCAP file": lambda path: storage_file(write_bag(path, MCAP, realsense())),
    "SQLite of a killed recorder": lambda path: without_metadata(write_bag(path, SQLITE, realsense())),
    "MCAP of a killed recorder": lambda path: without_metadata(write_bag(path, MCAP, realsense())),
    "compressed files": lambda path: write_bag(path, SQLITE, realsense(), MODES[0]),
    "compressed messages": lambda path: write_bag(path, SQLITE, realsense(), MODES[1]),
    "metadata.yaml": lambda path: write_bag(path, SQLITE, realsense()) / "metadata.yaml",
    "ROS 1": lambda path: write_old_bag(path.with_suffix(".bag"), realsense()),
}


@pytest.mark.parametrize("container", CONTAINERS)
def test_a_bag_is_a_source(tmp_path, container):
    source = open_source(CONTAINERS[container](tmp_path / "bag"))
    assert isinstance(source, Bag) and len(source) == 3
    assert (source.calibration.depth, source.calibration.color) == (CAMERA, COLOR_CAMERA)
    np.testing.assert_allclose(source.calibration.color_from_depth.translation_m, [-0.15, 0, 0])
    for i in (2, 0, 1):
        frame = source.frame(i)
        assert (frame.index, frame.stamp_ns) == (i, SECOND + i * 33_000_000)
        np.testing.assert_array_equal(frame.depth_mm, depth_image(i))
        np.testing.assert_array_equal(frame.decode_color(), color_image(i))
    ignored = "not read: /camera/infra1/image_rect_raw (mono8)"
    assert {f"depth from {DEPTH}", f"colour from {COLOR}", ignored} <= set(source.notes)


def test_a_bag_becomes_a_session_that_stays_a_session(annotate_cloud, tmp_path):
    bag = write_bag(tmp_path / "bag", SQLITE, realsense())
    done = annotate_cloud("import", bag, tmp_path / "x.mcap", "--json")
    assert (done.code, done.result["frames"], done.result["streams"]) == (0, 3, {"depth": 3, "color": 3})
    session = open_source(tmp_path / "x.mcap")
    assert isinstance(session, Session)
    for a, b in zip(open_source(bag), session, strict=True):
        np.testing.assert_array_equal(a.depth_mm, b.depth_mm)
        assert (a.color_encoded, a.stamp_ns) == (b.color_encoded, b.stamp_ns)


@pytest.mark.parametrize(
    ("without", "text"),
    [
        (("/tf",), "no transform"),
        (("/camera/color/camera_info", "/tf"), "has no camera_info for /camera/color/image_raw"),
        (("/camera/color",), "no colour images"),
        (("/camera/depth/camera_info", "/camera/color/camera_info"), CalibrationError),
        (("/camera/depth",), FormatError),
    ],
)
def test_what_is_absent_is_noted_or_refused(tmp_path, without, text):
    rest = [m for m in realsense() if not m[0].startswith(without)]
    path = write_bag(tmp_path / "a", MCAP, rest)
    if isinstance(text, str):
        assert text in "".join(open_source(path).notes)
    else:
        assert_refused(path, "camera_info" if text is CalibrationError else "no depth images", text)


@pytest.mark.parametrize("compression", list(CompressionType))
def test_foxglove_mcap_of_others_is_read(tmp_path, compression):
    rig = RigCalibration(CAMERA, COLOR_CAMERA, Pose.identity())
    calibrations = dict(calibration_messages(rig, 0))
    jpeg = bytes(cv2.imencode(".jpg", color_image(0))[1])
    messages = [
        ("/robot/head/depth/calibration", calibrations["/depth/calibration"]),
        ("/robot/head/rgb/calibration", calibrations["/color/calibration"]),
        ("/tf", calibrations["/tf"]),
    ]
    for i in range(2):
        messages.append(("/robot/head/depth/image", image_message(depth_image(i), "depth", i * SECOND)))
        messages.append(("/robot/head/rgb/compressed", color_message(jpeg, i * SECOND)))
    path = write_mcap(tmp_path / "robot.mcap", messages, compression)
    source = open_source(path)
    assert isinstance(source, Bag) and source.calibration.color_from_depth is not None
    assert [frame.stamp_ns for frame in source] == [0, SECOND]
    for i, frame in enumerate(source):
        np.testing.assert_array_equal(frame.depth_mm, depth_image(i))
        assert frame.color_encoded == jpeg
    path.write_bytes(path.read_bytes()[:-100])
    assert any("truncated" in note for note in open_source(path).notes)


# Pictures


def raw(pixels: np.ndarray, encoding: str, size: tuple[int, int] = (H, W), step: int = 0) -> Picture:
    big = pixels.dtype.byteorder == ">"
    return Picture("", encoding, pixels.tobytes(), False, *size, step or pixels.strides[0], big)


def packed(kind: str, data: bytes) -> Picture:
    return Picture("", kind, data, True)


MM = depth_image(0)
METRES = np.where(MM > 0, MM / 1000, np.nan).astype("<f4")
CONFIG = struct.pack("<iff", 0, 0.0, 0.0)


@pytest.mark.parametrize(
    "picture",
    [
        raw(MM, "16UC1"),
        raw(MM.astype(">u2"), "mono16"),
        raw(np.pad(MM, ((0, 0), (0, 3))), "16UC1"),
        raw(METRES, "32FC1"),
        raw(METRES.astype(">f4"), "32FC1"),
        packed("16UC1; compressedDepth png", png(MM)),
        packed("16UC1; compressedDepth png", CONFIG + png(MM)),
    ],
)
def test_depth_in_every_encoding(picture):
    values = depth_from(picture)
    floats = picture.encoding == "32FC1"
    assert values.dtype == (np.float32 if floats else np.uint16)
    np.testing.assert_array_equal(values, METRES if floats else MM)


def test_inverse_depth():
    """As compressed_depth_image_transport quantises it: q = a / z + b."""
    a, b = 100.0 * 101, -99.0
    z = np.random.default_rng(0).uniform(0.5, 4, (H, W))
    data = struct.pack("<iff", 1, a, b) + png(np.rint(a / z + b).astype(np.uint16))
    np.testing.assert_allclose(depth_from(packed("32FC1; compressedDepth png", data)), z, atol=2e-3)


ORDERS = {"rgb8": (0, 1, 2), "bgr8": (2, 1, 0), "rgba8": (0, 1, 2, 0), "bgra8": (2, 1, 0, 0)}
RGB = {"r": 200, "g": 120, "b": 40}


@pytest.mark.parametrize("encoding", [*ORDERS, "bayer_rggb8", "bayer_bggr8", "bayer_gbrg8", "bayer_grbg8"])
def test_colour_in_every_encoding(encoding):
    """Bayer: a flat colour stays itself, whatever the pattern, and its first rows name it."""
    expected = color_image(0)
    if encoding in ORDERS:
        pixels = np.ascontiguousarray(expected[..., list(ORDERS[encoding])])
    else:
        block = np.array([RGB[letter] for letter in encoding[6:10]], np.uint8).reshape(2, 2)
        pixels = np.tile(block, (H, W))
        expected = np.broadcast_to(np.array(list(RGB.values()), np.uint8), (2 * H, 2 * W, 3))
    encoded = color_encoded_from(raw(pixels, encoding, (2 * H, 2 * W)))
    decoded = cv2.imdecode(np.frombuffer(encoded, np.uint8), cv2.IMREAD_COLOR_RGB)
    np.testing.assert_array_equal(decoded, expected)


BYTES = np.zeros(32, np.uint8)


@pytest.mark.parametrize(
    "picture",
    [
        raw(BYTES[:0], "16UC1", (0, 4), 8),
        raw(BYTES, "16UC1", (4, 4), 7),
        raw(BYTES[:31], "16UC1", (4, 4), 8),
        raw(BYTES, "16UC1", (4, 4), 1 << 31),
        raw(BYTES, "16UC1", (1 << 31, 1 << 31), 1 << 32),
        raw(BYTES, "16UC1", (1, 4), 1 << 31),
        raw(BYTES, "bayer_rggb16", (4, 4), 8),
        packed("16UC1; compressedDepth", b""),
        packed("16UC1; compressedDepth rvl", bytes(99)),
        packed(
            "32FC1; compressedDepth",
            struct.pack("<iff", 1, float("nan"), 0) + png(np.ones((2, 2), np.uint16)),
        ),
    ],
)
def test_impossible_pictures_are_refused(picture):
    with pytest.raises(FormatError):
        depth_from(picture)


# Topics, lenses, poses


def test_topics_are_chosen_by_content_and_name():
    def some(encoding: str, frame: str = "") -> Picture:
        return Picture(frame, encoding, bytes(8), False, 1, 1, 8)

    first = {
        "/a/infra1/image": some("mono16"),
        "/a/aligned_depth_to_color/image_raw": some("16UC1"),
        "/a/depth/image_raw": some("16UC1"),
        "/a/depth/image_raw/compressedDepth": packed("16UC1; compressedDepth", b""),
        "/a/color/image_raw": some("rgb8"),
        "/a/color/image_raw/compressed": packed("jpeg", b"\xff\xd8\xff"),
    }
    assert choose(first)[:2] == ("/a/depth/image_raw", "/a/color/image_raw/compressed")
    assert choose_depth({"/a/infra1/image": some("mono16")}) is None
    # The sensor's own pixels come before the colour camera's.
    kinect = {
        "/kinect2/hd/image_depth_rect": some("16UC1", "kinect2_rgb_optical_frame"),
        "/kinect2/hd/image_color_rect": some("bgr8", "kinect2_rgb_optical_frame"),
        "/kinect2/sd/image_depth_rect": some("16UC1", "kinect2_ir_optical_frame"),
        "/kinect2/sd/image_color_rect": some("bgr8", "kinect2_ir_optical_frame"),
        "/kinect2/sd/image_ir_rect": some("16UC1", "kinect2_ir_optical_frame"),
    }
    assert choose(kinect)[:2] == ("/kinect2/sd/image_depth_rect", "/kinect2/sd/image_color_rect")
    cameras = {"/a/depth/camera_info", "/a/color/camera_info"}
    assert described_by("/a/depth/image_raw/compressedDepth", cameras) == ["/a/depth/camera_info"]
    assert described_by("/b/image", cameras) == []


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
    assert path_between({("a", "b"): shift(1), ("b", "a"): shift(1)}, "a", "c") is None


# Damaged and large


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
    """Transforms for minutes before the cameras' own, long names, and thousands of messages."""
    name = "/" + "robot/" * 50
    others = [("/tf", transform(f"a{i % 50}", f"b{i}", (0.0, 0.0, 1.0)), 2 + i) for i in range(1500)]
    moving = [(topic.replace("/tf_static", "/tf"), m, 2000 + t) for topic, m, t in realsense(1)]
    prefixed = [(topic if topic == "/tf" else name + topic.lstrip("/"), m, t) for topic, m, t in moving]
    source = open_source(write_bag(tmp_path / "bag", storage, others + prefixed))
    np.testing.assert_allclose(source.calibration.color_from_depth.translation_m, [-0.15, 0, 0])
    assert f"depth from {name}{DEPTH.lstrip('/')}" in source.notes
    np.testing.assert_array_equal(next(iter(source)).depth_mm, depth_image(0))


@pytest.mark.parametrize("storage", STORAGES)
def test_a_flipped_bag_is_an_error_or_frames(tmp_path, storage):
    file = storage_file(write_bag(tmp_path / "bag", storage, realsense(1)))
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
    with pytest.raises(CalibrationError, match="rotation quaternion of length 0 instead of 1"):
        list(links_from(FrameTransforms(transforms=[{"child_frame_id": "x"}])))
