"""Bags as other programs write them: cameras, clocks, names and encodings that ours never have.

Truth is a smooth depth image, written anew by rosbags or mcap, compared bit for bit. Each kind was met in a
project named in the tests, or in a driver's source.
"""

import json
from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage

from sensors.calibration_files.camera_messages import describes, intrinsics_from, window_of
from sensors.errors import CalibrationError, CloudError, FormatError
from sensors.importers.bags.choose import Meaning, meaning_of
from sensors.importers.open_source import open_source
from sensors.importers.options import AS_STATED, ImportOptions
from sensors.rig.camera import Intrinsics, project
from sensors.rig.rig_calibration import RigCalibration
from sensors.session.messages import calibration_messages
from tests.helpers.bag_scenes import (
    LENS,
    PERIOD,
    START,
    H,
    W,
    assert_depth,
    camera,
    colour_of,
    colours,
    depths,
    noted,
    packed,
    rig,
    scene,
)
from tests.helpers.bags import STORAGES, camera_info, image, transform, write_bag, write_mcap
from tests.helpers.depth_files import png


@pytest.fixture
def opened(tmp_path):
    """Frames from messages of a bag."""
    made = []

    def opened(messages, options=None):
        made.append(write_bag(tmp_path / f"bag{len(made)}", STORAGES[1], messages))
        return open_source(made[-1], options or AS_STATED)

    return opened


def described(topic: str, info: object) -> tuple[str, object, int]:
    return (topic, info, START)


# Encodings


@pytest.mark.parametrize("kind", ["16UC1; png compressed ", "mono16; png compressed ", "png"])
def test_png_through_the_plain_compressed_transport_loses_nothing(opened, kind):
    topic = "/camera/depth/image_rect_raw/compressed"
    images = [(topic, packed(START + i * PERIOD, "d", kind, png(scene(i))), START) for i in range(3)]
    assert_depth(opened([described("/camera/depth/camera_info", camera()), *images]), 3)


def test_foxgloves_png_of_16_bits_is_depth(tmp_path):
    info = dict(calibration_messages(RigCalibration(LENS), 0))["/depth/calibration"]
    images = [("/r/depth/image", CompressedImage(format="png", data=png(scene(i)))) for i in range(2)]
    messages = [("/r/depth/calibration", info), *images]
    assert_depth(open_source(write_mcap(tmp_path / "x.mcap", messages)), 2)


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


def test_images_that_are_not_read_are_named(opened):
    odd = ("/camera/color/image_raw", image(np.zeros((H, W), np.uint16), "bayer_rggb16", START, "c"), START)
    empty = image(np.zeros((1, 1), np.uint16), "16UC1", START - PERIOD, "d")
    empty.height = empty.width = empty.step = 0
    empty.data = empty.data[:0]
    source = opened([*rig(), ("/camera/depth/image_raw", empty, START - PERIOD), *depths(), odd])
    assert_depth(source)
    assert noted(source, "not read", "/camera/color/image_raw (bayer_rggb16)")
    assert noted(source, "/camera/depth/image_raw: 1 empty images")
    with pytest.raises(CloudError, match="no depth images: it has no images"):
        opened([("/tf_static", transform("d", "c", (0.0, 0.0, 0.0)), START)])


# Names


OTHERS = {
    "mono16": "/boson/image_raw /camera/nir/image_raw /cam0/image_raw",
    "16UC1": "/flir_boson/image_raw /lepton/image_raw /optris/thermal_image /kinect2/sd/image_ir_rect",
    "32FC1": "/zed/disparity/disparity_image /stereo/depth/uncertainty /stereo/depth/confidence_map",
}


@pytest.mark.parametrize(
    ("topic", "encoding"), [(topic, encoding) for encoding in OTHERS for topic in OTHERS[encoding].split()]
)
def test_what_is_no_depth_by_its_name_is_refused_by_that_name(opened, topic, encoding):
    messages = [described("/camera_info", camera()), *depths(topic, encoding=encoding)]
    with pytest.raises(FormatError, match=f"no depth images.*{topic} \\({encoding}, no depth by its name"):
        opened(messages)
    assert_depth(opened(messages, ImportOptions(topics=(topic,))))


JPEG = bytes(cv2.imencode(".jpg", (scene() // 20).astype(np.uint8))[1])


@pytest.mark.parametrize(
    ("topic", "kind", "data"),
    [
        # image_transport offers compressedDepth of every image with one channel.
        ("/boson/image_raw/compressedDepth", "16UC1; compressedDepth png", png(scene())),
        ("/camera/depth/image_raw/compressed", "16UC1; jpeg compressed", JPEG),
    ],
)
def test_a_transport_makes_no_depth(opened, topic, kind, data):
    with pytest.raises(FormatError, match=f"no depth images.*{topic} \\(16UC1; "):
        opened([described("/camera_info", camera()), (topic, packed(START, "d", kind, data), START)])


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
    assert noted(opened(both), "other depth images: /camera/depth/image_raw", "choose one")
    for name, by in (("cam2", 0.2), ("camera", 0.1)):
        for topics in ((f"/{name}/depth/image_raw",), (f"/{name}",), (f"/{name}/depth",)):
            source = opened(both, ImportOptions(topics=topics))
            assert noted(source, f"depth from /{name}/depth/image_raw")
            assert noted(source, f"colour from /{name}/color/image_raw")
            assert source.calibration.color_from_depth.translation_m[0] == pytest.approx(-by)
    mixed = opened(both, ImportOptions(topics=("/camera/depth/image_raw", "/cam2/color/image_raw")))
    assert "colour from /cam2/color/image_raw" in mixed.notes
    with pytest.raises(FormatError, match="no image topic '/cam3'"):
        opened(both, ImportOptions(topics=("/cam3",)))


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
    assert f"intrinsics from {info}" in source.notes
    np.testing.assert_array_equal(source.calibration.color_from_depth.apply(np.ones(3)), np.ones(3))
    assert_depth(source)
    assert [colour_of(frame) for frame in source] == [0, 1, 2, 3]


def test_the_camera_info_of_colour_is_not_that_of_another_camera(opened, tmp_path):
    """Only colour is described: raw depth, of another frame, has no camera until it is given one."""
    messages = [described("/camera/color/camera_info", camera("c")), *depths(), *colours()]
    with pytest.raises(CalibrationError, match=r"no camera_info for /camera/depth/image_raw"):
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
        ({"distortion_model": "rational_polynomial", "d": [0.1] * 14}, "14 lens coefficients"),
        ({"distortion_model": "rational_polynomial", "d": [0.1] * 20}, "with 20 coefficients"),
        ({"d": [np.nan] * 5}, "not finite"),
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
POLYNOMIAL = [0.1, -0.2, 1e-3, 2e-3, 0.3]


@pytest.mark.parametrize(
    ("model", "numbers", "same"),
    [
        ("rational_polynomial", [*RATIONAL, *[0] * 6], ("rational_polynomial", RATIONAL)),
        ("rational_polynomial", [*RATIONAL, *[0] * 4], ("rational_polynomial", RATIONAL)),
        ("plumb_bob", RATIONAL, ("rational_polynomial", RATIONAL)),
        ("plumb_bob", [*POLYNOMIAL, 0, 0, 0], ("plumb_bob", POLYNOMIAL)),
        ("rational_polynomial", POLYNOMIAL, ("plumb_bob", POLYNOMIAL)),
        ("plumb_bob", [0.1, -0.2], ("plumb_bob", [0.1, -0.2, 0, 0, 0])),
        ("Plumb Bob", [0.0] * 5, ("plumb_bob", [])),
    ],
)
def test_zeros_behind_a_lens_are_nothing(model, numbers, same):
    found, expected = (
        intrinsics_from(camera(distortion_model=m, d=d), False, "x") for m, d in ((model, numbers), same)
    )
    assert found == expected


OAK = np.zeros(14)
OAK[:8] = [0.33380, -0.03908, -7.1e-05, -1.8e-05, -0.001498, 0.66514, -0.00981, -0.00932]
OAK[12:] = [1.97e-4, -5.32e-4]


def test_a_tilted_sensor_is_projected_as_opencv_does():
    """The lens of an OAK's colour camera (introlab/rtabmap pull request 1560)."""
    info = camera_info(replace(LENS, width=1280, height=720, fx=800, fy=800, cx=640, cy=360), "c")
    info.d, info.distortion_model = OAK, "rational_polynomial"
    found = intrinsics_from(info, False, "x")
    points = np.random.default_rng(0).uniform((-0.7, -0.4, 1), (0.7, 0.4, 1), (500, 3))
    truth = cv2.projectPoints(points, np.zeros(3), np.zeros(3), found.matrix, OAK)[0].reshape(-1, 2)
    np.testing.assert_allclose(project(found, points), truth, atol=0.1)
    info.d = np.array([*OAK[:8], *[0.1] * 6])
    with pytest.raises(CalibrationError, match="14 lens coefficients"):
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
