"""Intrinsics as other programs write them: one camera from every dialect, no guesses."""

import io
import json

import cv2
import numpy as np
import pytest

from sensors.calibration_files.intrinsics_file import read_intrinsics
from sensors.errors import CalibrationError
from sensors.importers.open_source import open_source
from sensors.rig.camera import Intrinsics, distort

CAMERA = Intrinsics(64, 48, 55.25, 56.5, 31.75, 23.125)
SHAPE = (48, 64)
K = CAMERA.matrix
K_4X4 = np.pad(K, ((0, 1), (0, 1)), constant_values=0) + np.diag([0.0, 0, 0, 1])
ROWS = ", ".join(map(str, K.ravel().tolist()))
SIZE = {"width": 64, "height": 48}
FOUR = {"fx": 55.25, "fy": 56.5, "cx": 31.75, "cy": 23.125}


def saved(matrix: np.ndarray, **options) -> str:
    text = io.StringIO()
    np.savetxt(text, matrix, **options)
    return text.getvalue()


def opencv(suffix: str, names=("camera_matrix", "distortion_coefficients"), sized=True) -> str:
    storage = cv2.FileStorage(suffix, cv2.FileStorage_WRITE | cv2.FileStorage_MEMORY)
    storage.write("calibration_time", "Thu 12 Feb 2026 11:22:33")
    if sized:
        storage.write("image_width", 64)
        storage.write("image_height", 48)
    storage.write("board_width", 9)
    storage.write(names[0], K)
    storage.write(names[1], np.zeros((5, 1)))
    return storage.releaseAndGetString()


ROS_YAML = f"""image_width: 64
image_height: 48
camera_name: depth
camera_matrix:
  rows: 3
  cols: 3
  data: [{ROWS}]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [0.0, 0.0, 0.0, 0.0, 0.0]
projection_matrix:
  rows: 3
  cols: 4
  data: [99., 0., 1., 0., 0., 99., 1., 0., 0., 0., 1., 0.]
"""
ROS_ECHO = (
    "header:\n  stamp:\n    sec: 5\n  frame_id: depth\nheight: 48\nwidth: 64\ndistortion_model: plumb_bob\n"
    "d:\n- 0.0\n- 0.0\n- 0.0\n- 0.0\n- 0.0\nk:\n"
    + "".join(f"- {number}\n" for number in K.ravel())
    + "roi:\n  x_offset: 0\n  y_offset: 0\n  height: 0\n  width: 0\n  do_rectify: false\n"
)
ORB_SLAM = (
    '%YAML:1.0\n# 640x480\nCamera.type: "PinHole"\nCamera.fx: 55.25\nCamera.fy: 56.5 # px, 640\n'
    "Camera.cx: 31.75\nCamera.cy: 23.125\nCamera.k1: 0.0\n"
    "Camera.width: 64\nCamera.height: 48\nORBextractor.scaleFactor: 1.2\n"
)
KALIBR = (
    "cam0:\n  camera_model: pinhole\n  intrinsics: [55.25, 56.5, 31.75, 23.125]\n  distortion_model: radtan\n"
    "  distortion_coeffs: [0, 0, 0, 0]\n  resolution: [64, 48]\n"
)
DIALECTS = {
    "numpy_3x3": saved(K),
    "scannet_4x4": saved(K_4X4, fmt="%f"),
    "3x4": saved(K_4X4[:3]),
    "commas": saved(K, delimiter=","),
    "one_line": " ".join(map(str, K.ravel())),
    "matlab_columns": saved(K.T, fmt="%.8e"),
    "eth3d": "55.25 56.5 31.75 23.125\n",
    "pincam": "64 48 55.25 56.5 31.75 23.125",
    "colmap": "# Camera list: 1 line\n1 PINHOLE 64 48 55.25 56.5 31.75 23.125\n",
    "ros_yaml": ROS_YAML,
    "ros_echo": ROS_ECHO,
    "opencv_yaml": opencv(".yaml"),
    "opencv_xml": opencv(".xml"),
    "opencv_json": opencv(".json"),
    "opencv_without_size": opencv(".yml", ("K", "D"), sized=False),
    "orb_slam": ORB_SLAM,
    "orb_slam3": ORB_SLAM.replace("Camera.f", "Camera1.f").replace("Camera.c", "Camera1.c"),
    "kalibr": KALIBR,
    "nerfstudio": json.dumps({"fl_x": 55.25, "fl_y": 56.5, "cx": 31.75, "cy": 23.125, "w": 64, "h": 48}),
    "bop": json.dumps({"cam_K": K.ravel().tolist()}),
    "matrix_json": json.dumps({"K": K.tolist(), "dist_coeffs": [[0, 0, 0, 0, 0]], **SIZE}),
    "more_keys": json.dumps({**FOUR, **SIZE, "fps": 30, "serial": "817412070"}),
    "ini": "[depth]\nfx = 55.25\nfy = 56.5\ncx = 31.75\ncy = 23.125\n",
    "open3d_parameters": json.dumps({"intrinsic": {"intrinsic_matrix": K.T.ravel().tolist(), **SIZE}}),
}


@pytest.mark.parametrize("dialect", DIALECTS)
def test_every_dialect_gives_the_same_camera(dialect, tmp_path):
    file = tmp_path / "camera"
    file.write_text(DIALECTS[dialect])
    found = read_intrinsics(file, SHAPE)
    numbers = [getattr(found.depth, name) for name in ("width", "height", "fx", "fy", "cx", "cy")]
    np.testing.assert_allclose(numbers, [64, 48, 55.25, 56.5, 31.75, 23.125], atol=1e-6)
    assert not any(found.depth.distortion)
    assert found.unit_mm is None


@pytest.mark.parametrize("encoding", ["utf-16", "utf-8-sig", "latin-1"])
@pytest.mark.parametrize("dialect", ["more_keys", "eth3d", "ros_yaml"])
def test_editors_of_every_encoding(encoding, dialect, tmp_path):
    file = tmp_path / "camera"
    comment = "# für\n" if encoding == "latin-1" and dialect != "more_keys" else ""
    file.write_bytes((comment + DIALECTS[dialect]).encode(encoding))
    assert read_intrinsics(file, SHAPE).depth.fx == pytest.approx(55.25)


@pytest.mark.parametrize("count", [4, 5, 8, 14])
def test_a_lens_bends_as_opencv_says(count, tmp_path):
    lens = np.array([0.05, -0.03, 0.001, -0.002, 0.01, 0.02, 0.01, 0.005, *[1e-4] * 4, 0, 0])[:count]
    file = tmp_path / "camera.json"
    file.write_text(
        json.dumps({"camera_matrix": K.tolist(), "distortion_coefficients": lens.tolist(), **SIZE})
    )
    found = read_intrinsics(file).depth
    points = np.array([[-0.4, 0.3, 1], [0.5, -0.2, 1], [0.0, 0.0, 1]])
    expected = cv2.projectPoints(points, np.zeros(3), np.zeros(3), K, lens)[0][:, 0]
    np.testing.assert_allclose(
        distort(found, points[:, :2]) * K[(0, 1), (0, 1)] + K[:2, 2], expected, atol=0.05
    )


@pytest.mark.parametrize(
    ("key", "value", "unit_mm"),
    [
        ("DepthMapFactor", 5000, 0.2),
        ("DepthMapFactor", 1, None),
        ("depth_scale", 1000, 1),
        ("depth_scale", 0.0001, 0.1),
        ("depth_scale", 0.1, 0.1),
    ],
)
def test_the_unit_is_the_one_that_the_program_means(key, value, unit_mm, tmp_path):
    """Steps of a metre (ORB-SLAM, Open3D), metres (librealsense), millimetres (BOP): no two overlap."""
    file = tmp_path / "camera.json"
    file.write_text(json.dumps({**FOUR, **SIZE, key: value}))
    assert read_intrinsics(file).unit_mm == pytest.approx(unit_mm)


@pytest.mark.parametrize(
    ("text", "match"),
    [
        (saved(np.diag([2.0, 2, 1]) @ K), "not the middle of images of 64x48"),
        (saved(np.diag([1 / 64, 1 / 48, 1]) @ K), "not the middle"),
        (ROS_YAML.replace("plumb_bob", "equidistant"), "equidistant"),
        (KALIBR + KALIBR.replace("cam0", "cam1").replace("55.25", "99"), "twice"),
        (json.dumps({"depth": FOUR, "color": {**FOUR, "fx": 900}}), "twice"),
        (json.dumps({**FOUR, **SIZE, "distortion_coefs": [0.1, 0]}), "distortion_coefs"),
        (json.dumps({**FOUR, **SIZE, "depth_units": 0.1}), "depth_units"),
        (json.dumps({**FOUR, **SIZE, "k4": 0.1}), "k4"),
        ("1 SIMPLE_RADIAL 64 48 55 31 23 0.1", "no camera"),
        ("camera_matrix: [.nan, 0, 31, 0, 55, 23, 0, 0, 1]", "not finite"),
        ("1 2 3 4 5 6 7 8 9", "not a camera's"),
        ("lorem ipsum", "no camera"),
        ("", "0 numbers"),
    ],
)
def test_what_is_unclear_is_refused(text, match, tmp_path):
    file = tmp_path / "camera.txt"
    file.write_text(text)
    with pytest.raises(CalibrationError, match=match):
        read_intrinsics(file, SHAPE)


@pytest.mark.parametrize(
    ("name", "dialect"),
    [
        ("K.txt", "numpy_3x3"),
        ("intrinsic/intrinsic_depth.txt", "scannet_4x4"),
        ("intrinsics.txt", "one_line"),
        ("calibration.txt", "eth3d"),
        ("camera_info.yaml", "ros_yaml"),
        ("camera.xml", "opencv_xml"),
    ],
)
def test_a_folder_finds_its_camera_by_the_names_that_programs_use(name, dialect, tmp_path):
    (tmp_path / "depth").mkdir()
    cv2.imwrite(str(tmp_path / "depth/0.png"), np.full(SHAPE, 2000, np.uint16))
    file = tmp_path / name
    file.parent.mkdir(exist_ok=True)
    file.write_text(DIALECTS[dialect])
    assert open_source(tmp_path).calibration.depth.fx == pytest.approx(55.25)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"fy": None, "cx": None}, "it lacks cx, fy"),
        ({"fx": "wide", "cy": True}, "fx is 'wide', cy is 'True', not a number"),
    ],
)
def test_a_file_of_ours_names_its_faulty_keys(tmp_path, change, words):
    fields = {"width": 640, "height": 480, "fx": 600.0, "fy": 600.0, "cx": 320.0, "cy": 240.0} | change
    path = tmp_path / "camera.json"
    path.write_text(json.dumps({key: value for key, value in fields.items() if value is not None}))
    with pytest.raises(CalibrationError, match=words) as caught:
        read_intrinsics(path)
    assert "[" not in str(caught.value)
