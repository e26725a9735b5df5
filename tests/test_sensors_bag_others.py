"""Bags as other programs write them: cameras, clocks, names and encodings that ours never have.

Truth is a smooth depth image, written anew by rosbags or mcap, compared bit for bit. Each kind was met in a
project named in ``docs/bags.md``, or in a driver's source.
"""

import json
from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from mcap.writer import Writer
from mcap_protobuf.schema import register_schema

from sensors.calibration_files.camera_messages import describes, intrinsics_from, window_of
from sensors.errors import CalibrationError, CloudError, FormatError
from sensors.importers.bags.choose import Meaning, choose, meaning_of
from sensors.importers.bags.ros_images import color_encoded_from
from sensors.importers.bags.ros_messages import Picture
from sensors.importers.bags.timeline import Stamps, paired, timeline_of
from sensors.importers.open_source import open_source
from sensors.importers.options import AS_STATED, ImportOptions
from sensors.rig.camera import Intrinsics, project
from sensors.rig.frame import FRAME_PERIOD_NS
from sensors.rig.rig_calibration import RigCalibration
from sensors.session.messages import calibration_messages
from tests.helpers.bags import SECOND, STORAGES, camera_info, header, image, ros, transform, write_bag

H, W = 48, 64
LENS = Intrinsics(W, H, 60.0, 60.0, 31.5, 23.5)
K = LENS.matrix.ravel()
PERIOD = 100_000_000
START = 1_700_000_000 * SECOND


def scene(index: int = 0) -> np.ndarray:
    """A wall and somebody in front of it, in millimetres; a rim has no reading."""
    v, u = np.mgrid[:H, :W]
    mm = 2600 + 3 * u + 2 * v + 7 * index - 900 * (np.hypot(u - 30, v - 25) < 12)
    return np.where(u > 2, mm, 0).astype(np.uint16)


def colour(index: int = 0) -> np.ndarray:
    """RGB, one flat colour a frame, so that a pair is recognised after JPEG."""
    return np.full((H, W, 3), (20 * index, 250 - 20 * index, 90), np.uint8)


def packed(stamp_ns: int, frame: str, kind: str, data: bytes) -> object:
    return ros(
        "sensor_msgs/msg/CompressedImage", header=header(stamp_ns, frame), format=kind,
        data=np.frombuffer(data, np.uint8),
    )  # fmt: skip


def png(pixels: np.ndarray) -> bytes:
    return bytes(cv2.imencode(".png", pixels)[1])


def camera(frame: str = "d", **changed: object) -> object:
    """A camera_info whose fields are changed."""
    info = camera_info(LENS, frame)
    for name, value in changed.items():
        setattr(info, name, np.asarray(value, float) if name in "dkrp" else value)
    return info


def described(topic: str, info: object) -> tuple[str, object, int]:
    return (topic, info, START)


def depths(
    topic: str = "/camera/depth/image_raw", frame: str = "d", stamps: object = range(4), encoding="16UC1"
) -> list[tuple[str, object, int]]:
    """Depth images, received in time; stamps: in periods."""
    messages = []
    for i, stamp in enumerate(stamps):
        pixels = scene(i) if encoding != "32FC1" else (scene(i) / 1000).astype(np.float32)
        message = image(pixels, encoding, START + int(stamp * PERIOD), frame)
        messages.append((topic, message, START + i * PERIOD))
    return messages


def colours(
    topic: str = "/camera/color/image_raw", frame: str = "c", stamps: object = range(4)
) -> list[tuple[str, object, int]]:
    return [
        (topic, image(colour(i), "rgb8", START + int(s * PERIOD), frame), START + i * PERIOD)
        for i, s in enumerate(stamps)
    ]


def rig() -> list[tuple[str, object, int]]:
    """Descriptions of a depth and a colour camera, and how they stand to each other."""
    return [
        described("/camera/depth/camera_info", camera()),
        described("/camera/color/camera_info", camera("c")),
        ("/tf_static", transform("d", "c", (0.05, 0.0, 0.0)), START),
    ]


@pytest.fixture
def opened(tmp_path):
    """Frames from messages of a bag."""
    made = []

    def opened(messages, options=None, storage=STORAGES[1]):
        made.append(write_bag(tmp_path / f"bag{len(made)}", storage, messages))
        return open_source(made[-1], options or AS_STATED)

    return opened


def assert_depth(source, count: int = 4) -> None:
    assert len(source) == count
    for index, frame in enumerate(source):
        np.testing.assert_array_equal(frame.depth_mm, scene(index))


def colour_of(frame) -> int:
    """The number of the colour image that a frame has."""
    return round(float(frame.decode_color()[..., 0].mean()) / 20)


def noted(source, *words: str) -> bool:
    return any(all(word in note for word in words) for note in source.notes)


# Encodings


@pytest.mark.parametrize("kind", ["16UC1; png compressed ", "mono16; png compressed ", "png"])
def test_png_through_the_plain_compressed_transport_loses_nothing(opened, kind):
    topic = "/camera/depth/image_rect_raw/compressed"
    images = [(topic, packed(START + i * PERIOD, "d", kind, png(scene(i))), START) for i in range(3)]
    assert_depth(opened([described("/camera/depth/camera_info", camera()), *images]), 3)


def test_foxgloves_png_of_16_bits_is_depth(tmp_path):
    info = dict(calibration_messages(RigCalibration(LENS), 0))["/depth/calibration"]
    with (tmp_path / "x.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        for topic, message in [
            ("/r/depth/calibration", info),
            *[("/r/depth/image", CompressedImage(format="png", data=png(scene(i)))) for i in range(2)],
        ]:
            channel = writer.register_channel(topic, "protobuf", register_schema(writer, type(message)))
            writer.add_message(channel, START, message.SerializeToString(), START)
        writer.finish()
    assert_depth(open_source(tmp_path / "x.mcap"), 2)


def test_jpeg_is_no_depth(opened):
    jpeg = bytes(cv2.imencode(".jpg", (scene() // 20).astype(np.uint8))[1])
    topic = "/camera/depth/image_raw/compressed"
    with pytest.raises(FormatError, match=f"no depth images.*{topic} \\(16UC1; jpeg compressed"):
        opened([(topic, packed(START, "d", "16UC1; jpeg compressed", jpeg), START)])


@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
def test_bayer_patterns_become_colour(pattern):
    """A flat colour stays itself, whatever the pattern, and its first rows name it."""
    rgb = {"r": 200, "g": 120, "b": 40}
    mosaic = np.tile(np.array([rgb[c] for c in pattern], np.uint8).reshape(2, 2), (H // 2, W // 2))
    picture = Picture("", f"bayer_{pattern}8", mosaic.tobytes(), False, H, W, W)
    decoded = cv2.imdecode(np.frombuffer(color_encoded_from(picture), np.uint8), cv2.IMREAD_COLOR_RGB)
    assert (decoded == list(rgb.values())).all()


def test_an_encoding_that_is_not_read_is_named(opened):
    odd = image(np.zeros((H, W), np.uint16), "bayer_rggb16", START, "c")
    source = opened([*rig(), *depths(), ("/camera/color/image_raw", odd, START)])
    assert noted(source, "not read", "/camera/color/image_raw (bayer_rggb16)")


@pytest.mark.parametrize(("encoding", "step"), [("16UC1", 10), ("32FC1", 1)])
def test_units_that_only_one_camera_or_driver_has_are_found(opened, encoding, step):
    """Tenths of a millimetre, as a D405 counts; floats in millimetres: neither is declared in a bag."""
    kind = np.float32 if encoding == "32FC1" else np.uint16
    pixels = [(scene(i) * step).astype(kind) for i in range(3)]
    images = [
        ("/camera/depth/image_raw", image(p, encoding, START + i, "d"), START) for i, p in enumerate(pixels)
    ]
    source = opened([*rig(), *images])
    assert noted(source, f"{1 / step:g} mm a step taken")
    assert_depth(source, 3)
    assert_depth(opened([*rig(), *images], ImportOptions(depth_unit_mm=1 / step)), 3)


def test_floats_that_are_no_reading_become_none(opened):
    metres = (scene() / 1000).astype(">f4")
    bad = [np.nan, np.inf, -np.inf, -1.0, 1e30, 70.0, 0.0]
    metres[40, 10 : 10 + len(bad)] = bad
    message = image(metres, "32FC1", START, "d")
    message.is_bigendian = 1
    truth = scene()
    truth[40, 10 : 10 + len(bad)] = 0
    frame = opened([*rig(), ("/camera/depth/image_raw", message, START)]).frame(0)
    np.testing.assert_array_equal(frame.depth_mm, truth)


# Names


@pytest.mark.parametrize(
    ("topic", "encoding"),
    [
        ("/boson/image_raw", "mono16"),
        ("/flir_boson/image_raw", "16UC1"),
        ("/lepton/image_raw", "16UC1"),
        ("/optris/thermal_image", "16UC1"),
        ("/camera/nir/image_raw", "mono16"),
        ("/kinect2/sd/image_ir_rect", "16UC1"),
        ("/cam0/image_raw", "mono16"),
        ("/zed/zed_node/disparity/disparity_image", "32FC1"),
        ("/stereo/depth/uncertainty", "32FC1"),
        ("/stereo/depth/confidence_map", "32FC1"),
    ],
)
def test_what_is_no_depth_by_its_name_is_refused_by_that_name(opened, topic, encoding):
    messages = [described("/camera_info", camera()), *depths(topic, encoding=encoding)]
    with pytest.raises(FormatError, match=f"no depth images.*{topic} \\({encoding}, no depth by its name"):
        opened(messages)
    assert_depth(opened(messages, ImportOptions(topics=(topic,))))


def test_a_transport_that_is_called_depth_does_not_make_temperatures_depth(opened):
    """image_transport offers compressedDepth of every image with one channel."""
    topic = "/boson/image_raw/compressedDepth"
    message = packed(START, "d", "16UC1; compressedDepth png", png(scene()))
    with pytest.raises(FormatError, match=f"no depth images.*{topic}"):
        opened([described("/camera_info", camera()), (topic, message, START)])


def test_a_name_that_says_nothing_is_read_with_a_note(opened):
    source = opened([described("/oak/stereo/camera_info", camera()), *depths("/oak/stereo/image_raw")])
    assert_depth(source)
    assert noted(source, "/oak/stereo/image_raw is not named depth")
    with pytest.raises(FormatError):
        opened([described("/x/camera_info", camera()), *depths("/x/image_raw", "flir_optical")])


@pytest.mark.parametrize(
    ("name", "meaning"),
    [
        ("/thermal_rig/depth/image_raw", Meaning.DEPTH),
        ("/camera/aligned_depth_to_infra1/image_raw", Meaning.DEPTH),
        ("/depth_to_rgb/image_raw", Meaning.DEPTH),
        ("/rgbd_camera/image", Meaning.UNKNOWN),
        ("/depth_camera/infra1/image", Meaning.OTHER),
        ("/kinect2/qhd/image_color_rect/compressed", Meaning.COLOR),
        ("/boson/image_raw/compressedDepth", Meaning.OTHER),
        ("/first/fir/mirror", Meaning.UNKNOWN),
    ],
)
def test_the_last_part_of_a_name_that_says_something_counts(name, meaning):
    assert meaning_of(name) is meaning


# Cameras


@pytest.mark.parametrize(
    ("info", "depth", "color"),
    [
        ("/camera/color/camera_info", "/camera/aligned_depth_to_color/image_raw", "/camera/color/image_raw"),
        ("/kinect2/qhd/camera_info", "/kinect2/qhd/image_depth_rect", "/kinect2/qhd/image_color_rect"),
        ("/depth_camera/camera_info", "/depth_camera/depth/image_raw", "/depth_camera/image_raw"),
        ("/rgbd_camera/camera_info", "/rgbd_camera/depth_image", "/rgbd_camera/image"),
        ("/camera_info", "/depth", "/rgb"),
    ],
)
@pytest.mark.parametrize("frames", [("o", "o"), ("d", "c"), ("", "")])
def test_one_camera_info_describes_both_streams(opened, info, depth, color, frames):
    messages = [described(info, camera(frames[1])), *depths(depth, frames[0]), *colours(color, frames[1])]
    source = opened(messages)
    assert source.calibration.depth == source.calibration.color == LENS
    np.testing.assert_array_equal(source.calibration.color_from_depth.apply(np.ones(3)), np.ones(3))
    assert_depth(source)
    assert [colour_of(frame) for frame in source] == [0, 1, 2, 3]


def test_the_camera_info_of_colour_is_not_that_of_another_camera(opened, tmp_path):
    """Only colour is described: raw depth, of another frame, has no camera until it is given one."""
    messages = [described("/camera/color/camera_info", camera("c")), *depths(), *colours()]
    with pytest.raises(CalibrationError, match=r"no camera_info for /camera/depth/image_raw.*--intrinsics"):
        opened(messages)
    file = tmp_path / "i.json"
    file.write_text(json.dumps({"fx": 50, "fy": 51, "cx": 30, "cy": 20, "width": W, "height": H}))
    source = opened(messages, ImportOptions(intrinsics=file))
    assert source.calibration.depth == Intrinsics(W, H, 50, 51, 30, 20)
    assert_depth(source)


@pytest.mark.parametrize(
    ("changed", "word"),
    [
        ({"k": np.zeros(9)}, "K is zero"),
        ({"distortion_model": "equidistant", "d": [0.1, 0.01, 0, 0]}, "equidistant"),
        ({"distortion_model": "equidistant", "d": np.zeros(4)}, "equidistant"),
        ({"distortion_model": "rational_polynomial", "d": [0.1] * 14}, "14 numbers"),
        ({"distortion_model": "rational_polynomial", "d": [0.1] * 20}, "20 numbers"),
        ({"d": [np.nan] * 5}, "no numbers"),
        ({"d": [1200, -310, 0, 0, 90]}, "no inverse"),
    ],
)
def test_a_camera_that_is_none_costs_its_own_images_alone(opened, changed, word):
    """A refused colour camera costs a note with its topic; a refused depth camera is named."""
    messages = [*rig(), *depths(), *colours()]
    bad = described("/camera/color/camera_info", camera("c", **changed))
    source = opened([m if m[0] != bad[0] else bad for m in messages])
    assert_depth(source)
    assert source.calibration.color is None
    assert noted(source, "/camera/color/camera_info", word)
    bad = described("/camera/depth/camera_info", camera(**changed))
    with pytest.raises(CalibrationError, match=f"/camera/depth/camera_info.*{word}"):
        opened([m if m[0] != bad[0] else bad for m in messages])


RATIONAL = [0.5, 0.2, 1e-3, 5e-4, 0.1, 0.8, 0.32, 0.05]


@pytest.mark.parametrize(
    ("model", "numbers", "same"),
    [
        ("rational_polynomial", [*RATIONAL, *[0] * 6], ("rational_polynomial", RATIONAL)),
        ("rational_polynomial", [*RATIONAL, *[0] * 4], ("rational_polynomial", RATIONAL)),
        ("plumb_bob", RATIONAL, ("rational_polynomial", RATIONAL)),
        ("plumb_bob", [0.1, -0.2, 1e-3, 2e-3, 0.3, 0, 0, 0], ("plumb_bob", [0.1, -0.2, 1e-3, 2e-3, 0.3])),
        ("rational_polynomial", [0.1, -0.2, 1e-3, 2e-3, 0.3], ("plumb_bob", [0.1, -0.2, 1e-3, 2e-3, 0.3])),
        ("plumb_bob", [0.1, -0.2], ("plumb_bob", [0.1, -0.2, 0, 0, 0])),
        ("Plumb Bob", [0.0] * 5, ("plumb_bob", [])),
    ],
)
def test_zeros_behind_a_lens_are_nothing(model, numbers, same):
    found, expected = (
        intrinsics_from(camera(distortion_model=m, d=d), False, "x") for m, d in ((model, numbers), same)
    )
    assert found == expected


OAK = [
    0.33380,
    -0.03908,
    -7.1e-05,
    -1.8e-05,
    -0.001498,
    0.66514,
    -0.00981,
    -0.00932,
    0,
    0,
    0,
    0,
    1.97e-4,
    -5.32e-4,
]


def test_a_tilted_sensor_is_projected_as_opencv_does():
    """The lens of an OAK's colour camera (introlab/rtabmap pull request 1560)."""
    info = camera_info(replace(LENS, width=1280, height=720, fx=800, fy=800, cx=640, cy=360), "c")
    info.d, info.distortion_model = np.array(OAK), "rational_polynomial"
    found = intrinsics_from(info, False, "x")
    points = np.random.default_rng(0).uniform((-0.7, -0.4, 1), (0.7, 0.4, 1), (500, 3))
    truth = cv2.projectPoints(points, np.zeros(3), np.zeros(3), found.matrix, np.array(OAK))[0].reshape(-1, 2)
    np.testing.assert_allclose(project(found, points), truth, atol=0.1)
    info.d = np.array([*OAK[:8], 0.1, 0.1, 0.1, 0.1, 0.1, 0.1])
    with pytest.raises(CalibrationError, match="lens of 14 numbers"):
        intrinsics_from(info, False, "x")


@pytest.mark.parametrize(
    ("binning", "roi"), [((2, 2), (0, 0, 0, 0)), ((1, 1), (20, 10, 64, 48)), ((2, 4), (8, 16, 64, 48))]
)
def test_binning_and_a_region_shift_and_scale_what_a_camera_projects(binning, roi):
    """By the definition: pixel p of the image is pixel region + binning * p of the sensor."""
    full = Intrinsics(128, 96, 100.0, 90.0, 60.0, 50.0, 0.1, -0.05, 1e-3)
    x, y, width, height = roi
    region = SimpleNamespace(x_offset=x, y_offset=y, width=width, height=height, do_rectify=False)
    info = camera_info(full, "d")
    info.binning_x, info.binning_y, info.roi = *binning, region
    size = ((width or 128) // binning[0], (height or 96) // binning[1])
    assert window_of(info).size == size and describes(info, size) and describes(info, (128, 96))
    points = np.random.default_rng(0).uniform((-0.3, -0.3, 1), (0.3, 0.3, 3), (50, 3))
    part = project(intrinsics_from(info, False, "x", size), points)
    np.testing.assert_allclose(part * binning + (x, y), project(full, points), atol=1e-9)
    assert intrinsics_from(info, False, "x", (128, 96)) == full


def test_binned_depth_is_read(opened):
    info = camera_info(Intrinsics(2 * W, 2 * H, 120.0, 120.0, 63.0, 47.0), "d")
    info.binning_x = info.binning_y = 2
    source = opened([described("/camera/depth/camera_info", info), *depths()])
    assert source.calibration.depth == Intrinsics(W, H, 60.0, 60.0, 31.5, 23.5)
    assert_depth(source)


def test_an_image_without_pixels_is_left_out(opened):
    empty = image(np.zeros((1, 1), np.uint16), "16UC1", START - PERIOD, "d")
    empty.height = empty.width = empty.step = 0
    empty.data = empty.data[:0]
    source = opened([*rig(), ("/camera/depth/image_raw", empty, START - PERIOD), *depths()])
    assert_depth(source)
    assert noted(source, "/camera/depth/image_raw: 1 empty images")


def test_depth_and_colour_are_of_one_camera_and_a_topic_chooses_it(opened):
    def robot(name: str, by: float) -> list[tuple[str, object, int]]:
        return [
            described(f"/{name}/depth/camera_info", camera(f"{name}_d")),
            described(f"/{name}/color/camera_info", camera(f"{name}_c")),
            ("/tf_static", transform(f"{name}_d", f"{name}_c", (by, 0.0, 0.0)), START),
            *depths(f"/{name}/depth/image_raw", f"{name}_d"),
            *colours(f"/{name}/color/image_raw", f"{name}_c"),
        ]

    both = [*robot("camera", 0.1), *robot("cam2", 0.2)]
    source = opened(both)
    assert noted(source, "other depth images: /camera/depth/image_raw", "--topic")
    for name, by in (("cam2", 0.2), ("camera", 0.1)):
        for topics in ((f"/{name}/depth/image_raw",), (f"/{name}",), (f"/{name}/depth",)):
            source = opened(both, ImportOptions(topics=topics))
            assert {f"depth from /{name}/depth/image_raw", f"colour from /{name}/color/image_raw"} <= set(
                source.notes
            )
            assert source.calibration.color_from_depth.translation_m[0] == pytest.approx(-by)
    mixed = opened(both, ImportOptions(topics=("/camera/depth/image_raw", "/cam2/color/image_raw")))
    assert "colour from /cam2/color/image_raw" in mixed.notes
    with pytest.raises(FormatError, match="no image topic '/cam3'"):
        opened(both, ImportOptions(topics=("/cam3",)))


def test_the_sensors_own_pixels_come_before_those_of_the_colour_camera():
    def some(encoding: str, frame: str) -> Picture:
        return Picture(frame, encoding, bytes(8), False, 1, 1, 8)

    first = {
        "/kinect2/hd/image_depth_rect": some("16UC1", "kinect2_rgb_optical_frame"),
        "/kinect2/hd/image_color_rect": some("bgr8", "kinect2_rgb_optical_frame"),
        "/kinect2/sd/image_depth_rect": some("16UC1", "kinect2_ir_optical_frame"),
        "/kinect2/sd/image_color_rect": some("bgr8", "kinect2_ir_optical_frame"),
        "/kinect2/sd/image_ir_rect": some("16UC1", "kinect2_ir_optical_frame"),
    }
    assert choose(first)[:2] == ("/kinect2/sd/image_depth_rect", "/kinect2/sd/image_color_rect")


# Clocks


@pytest.mark.parametrize("back", [1.7e10, 36_000.0, 50.0, 2.0])
def test_a_clock_that_steps_back_leaves_the_recorded_order(opened, back):
    """back: periods by which both clocks step after the third of eight images."""
    stamps = [i - back * (i > 3) if back < 1e10 else (i if i < 4 else i - 1.69e10) for i in range(8)]
    source = opened([*rig(), *depths(stamps=stamps), *colours(stamps=stamps)])
    assert_depth(source, 8)
    assert [colour_of(frame) for frame in source] == list(range(8))
    np.testing.assert_array_equal(np.diff(source.times_ns), PERIOD)
    assert noted(source, "/camera/depth/image_raw", "steps back 1 times", "recorded order is kept")


@pytest.mark.parametrize("back", [36_000.0, 50.0])
def test_a_computer_whose_clock_is_set_back_leaves_the_recorded_order(opened, back):
    """Stamps and receive times step alike; the order in the file stays."""
    stamps = [i - back * (i > 3) for i in range(8)]
    messages = [
        (topic, message, START + int(stamp * PERIOD))
        for made in (depths(stamps=stamps), colours(stamps=stamps))
        for (topic, message, _), stamp in zip(made, stamps, strict=True)
    ]
    source = opened([*rig(), *messages])
    assert_depth(source, 8)
    assert [colour_of(frame) for frame in source] == list(range(8))
    np.testing.assert_array_equal(np.diff(source.times_ns), PERIOD)
    shuffled = np.random.default_rng(1).permutation(len(depths(stamps=range(40))))
    source = opened([*rig(), *(depths(stamps=range(40))[i] for i in shuffled)])
    assert_depth(source, 40)


def test_messages_that_arrive_late_are_put_in_their_order(opened):
    messages = depths(stamps=[0, 1, 3, 2, 4, 5, 6, 7])
    source = opened([*rig(), *messages])
    assert [int(f.depth_mm[20, 50] - scene()[20, 50]) // 7 for f in source] == [0, 1, 3, 2, 4, 5, 6, 7]
    assert (np.diff(source.times_ns) == PERIOD).all() and noted(
        source, "2 messages were received out of order"
    )


@pytest.mark.parametrize("off", [0.25, -0.25, 36_000.0, -1.69e10])
def test_colour_on_another_clock_is_paired_by_receive_times(opened, off):
    source = opened([*rig(), *depths(), *colours(stamps=[i + off for i in range(4)])])
    assert [colour_of(frame) for frame in source] == [0, 1, 2, 3]
    assert noted(
        source,
        "paired by receive times",
        "later" if off > 0 else "earlier",
        f"{abs(off) / 10:.3f} s",
    )


def test_colour_that_nothing_pairs_is_counted(opened):
    late = [(topic, m, at + 30 * SECOND) for topic, m, at in colours(stamps=[i + 300 for i in range(4)])]
    source = opened([*rig(), *depths(), *late])
    assert noted(source, "0 of 4 depth images have a colour image within 17 ms", "s later than depth")
    some = opened([*rig(), *depths(), *colours()[:3]])
    assert noted(some, "3 of 4 depth images have a colour image within 17 ms")


@pytest.mark.parametrize("stamp", [0, 5])
def test_stamps_that_are_all_alike_are_none(opened, stamp):
    source = opened([*rig(), *depths(stamps=[stamp - START / PERIOD * (stamp == 0)] * 4)])
    np.testing.assert_array_equal(source.times_ns, START + np.arange(4) * PERIOD)
    assert noted(source, "/camera/depth/image_raw has no usable time stamps")


@pytest.mark.parametrize("storage", STORAGES)
def test_without_any_times_a_rate_counts(opened, storage):
    messages = [(t, m, 7) for t, m, _ in [*rig(), *depths(stamps=[-START / PERIOD] * 4)]]
    source = opened(messages, None, storage)
    np.testing.assert_array_equal(np.diff(source.times_ns), FRAME_PERIOD_NS)
    assert noted(source, "no usable times", "--rate")
    source = opened(messages, ImportOptions(rate_hz=10), storage)
    np.testing.assert_array_equal(np.diff(source.times_ns), PERIOD)
    assert_depth(source)


def test_a_message_that_is_there_twice_is_read_once(opened):
    once = [*depths(), *colours()]
    source = opened([*rig(), *once, *once])
    assert_depth(source)
    assert noted(source, "/camera/depth/image_raw: 4 messages are in the recording twice")
    equal = opened([*rig(), *depths(stamps=[*range(10), 9, *range(11, 30)])])
    assert len(equal) == 30 and noted(equal, "1 messages have the stamp of the message before")


def test_times_never_decrease_and_every_message_is_there():
    """Whatever stamps and receive times are: a law of the timeline, over random ones."""
    rng = np.random.default_rng(0)
    for _ in range(300):
        count = int(rng.integers(1, 30))
        stamps = np.cumsum(rng.integers(-3, 5, count)) * int(rng.choice([10**6, 10**8, 10**11])) + 10**13
        received = np.sort(rng.integers(0, 10**12, count)) if rng.random() < 0.7 else np.full(count, 5)
        line = timeline_of(Stamps("x", stamps, received, lambda a, b: False))
        assert sorted(line.recorded) == list(range(count))
        assert (np.diff(line.times_ns) >= 0).all()
        pairs, _ = paired(line, line)
        used = pairs[pairs >= 0]
        assert len(set(used)) == len(used)


# Files


def test_the_description_of_a_bag_means_its_folder(tmp_path):
    bag = write_bag(tmp_path / "bag", STORAGES[0], [*rig(), *depths()])
    source = open_source(bag / "metadata.yaml")
    assert_depth(source)
    assert source.name == "bag"


@pytest.mark.parametrize("storage", STORAGES)
def test_a_frame_is_read_alone(opened, storage):
    source = opened([*rig(), *depths(), *colours()], None, storage)
    for index in (3, 0, 2, 1):
        frame = source.frame(index)
        np.testing.assert_array_equal(frame.depth_mm, scene(index))
        assert (frame.stamp_ns, colour_of(frame)) == (source.times_ns[index], index)


def test_only_clouds_are_refused(opened):
    cloud = described("/tf_static", transform("d", "c", (0.0, 0.0, 0.0)))
    with pytest.raises(CloudError, match="no depth images: it has no images"):
        opened([cloud])
