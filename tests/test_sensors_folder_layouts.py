"""Folders as other programs lay them out: depth, its order, its times, and which colour belongs to it."""

import json

import cv2
import numpy as np
import pytest
from PIL import Image

from sensors.errors import CloudError, FormatError
from sensors.importers.folder_files import stamps_of
from sensors.importers.open_source import open_source

COUNT, SHAPE = 4, (48, 64)
DEPTH = [
    np.linspace(1000 + 200 * n, 3000 + 200 * n, 48 * 64).reshape(SHAPE).astype(np.uint16)
    for n in range(COUNT)
]
COLOR = [np.full((*SHAPE, 3), 40 + 50 * n, np.uint8) for n in range(COUNT)]


def write(path, image) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix == ".npy":
        np.save(path, image)
    else:
        assert cv2.imwrite(str(path), image)


def folder(path, depth: str, color: str = ""):
    """Write images whose names are formats of their number n."""
    for n in range(COUNT):
        write(path / depth.format(n=n), DEPTH[n])
        if color:
            write(path / color.format(n=n), COLOR[n])
    numbers = {"width": 64, "height": 48, "fx": 55.0, "fy": 55.0, "cx": 31.5, "cy": 23.5}
    (path / "intrinsics.json").write_text(json.dumps(numbers))
    return path


LAYOUTS = [
    ("depth/{n}.png", "image/{n}.jpg"),  # SUN RGB-D
    ("depth/{n}.png", "images/{n}.png"),
    ("depth_raw/{n}.png", "rgb_raw/{n}.png"),
    ("DepthImages/{n}.png", "ColorImages/{n}.png"),
    ("depthmaps/{n}.png", "colors/{n}.png"),
    ("aligned_depth_to_color/{n}.png", "color/{n}.png"),
    ("camera_depth/{n}.png", "camera_rgb/{n}.png"),
    ("DepthImage_{n}.png", "ColorImage_{n}.png"),
    ("kin_depth_{n:05d}.pgm", "kin_color_{n:05d}.png"),
    ("{n:05d}.png", "{n:05d}.jpg"),
    ("depth/{n:07d}-{n}00000000000.png", "rgb/{n:07d}-{n}00000004000.png"),  # Redwood
    ("depth/170000000{n}.160407.png", "rgb/170000000{n}.164000.png"),  # TUM without its lists
    ("depth/170000000{n}160407000.png", "rgb/170000000{n}164000000.png"),
    ("depth/{n}.npy", "color/{n}.png"),
]


@pytest.mark.parametrize(("depth", "color"), LAYOUTS)
def test_depth_and_colour_of_every_layout_belong_together(depth, color, tmp_path):
    source = open_source(folder(tmp_path, depth, color))
    assert len(source) == COUNT
    assert source.calibration.color is not None
    for n in range(COUNT):
        frame = source.frame(n)
        np.testing.assert_array_equal(frame.depth_mm, DEPTH[n])
        np.testing.assert_allclose(frame.decode_color(), COLOR[n], atol=3)


def test_ntu_names_are_depth(tmp_path):
    source = open_source(folder(tmp_path, "MDepth-{n:08d}.png"))
    assert [int(source.frame(n).depth_mm[0, 0]) for n in range(COUNT)] == [1000, 1200, 1400, 1600]


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (["1305031102.160407", "1305031102.194330"], [0, 33_923_000]),
        (["1700000000000", "1700000000033"], [0, 33_000_000]),
        (["cam_1700000000000000", "cam_1700000000033333"], [0, 33_333_000]),
        (["1700000000000000000", "1700000000033333333"], [0, 33_333_333]),
        (["0000001-000000000000", "0000002-000000033333"], [0, 33_333_000]),
        (["rs_1546.25", "rs_1579.5"], [0, 33_250_000]),
    ],
)
def test_names_that_are_times_give_them(names, expected):
    stamps = stamps_of(names)
    assert [stamps[name] - stamps[names[0]] for name in names] == expected


@pytest.mark.parametrize(
    "names", [["0", "1"], ["20231104120000", "20231104120001"], ["frame_1", "1700000000.5"]]
)
def test_other_numbers_are_no_times(names):
    assert stamps_of(names) == {}


def test_pictures_made_of_depth_are_left_out_and_counted(tmp_path):
    source = folder(tmp_path, "{n}_depth.png", "{n}_color.png")
    for n in range(COUNT):
        write(tmp_path / f"{n}_depth_vis.png", (DEPTH[n] // 20).astype(np.uint8))
    opened = open_source(source)
    assert len(opened) == COUNT
    assert any(note.startswith("4 images named like pictures of depth") for note in opened.notes)


def test_two_folders_of_depth_are_refused(tmp_path):
    folder(tmp_path, "depth_left/{n}.png")
    folder(tmp_path, "depth_right/{n}.png")
    with pytest.raises(FormatError, match="depth_left, depth_right; rename the right one depth"):
        open_source(tmp_path)
    folder(tmp_path, "depth/{n}.png")
    assert len(open_source(tmp_path)) == COUNT


def test_unread_colour_beside_depth_is_named(tmp_path):
    opened = open_source(folder(tmp_path, "depth_{n}.pgm", "color_{n}.ppm"))
    assert any("4 .ppm colour images are not read" in note for note in opened.notes)


def test_a_stack_of_images_is_refused(tmp_path):
    folder(tmp_path, "depth/{n}.tif")
    pages = [Image.fromarray(image) for image in DEPTH]
    pages[0].save(tmp_path / "depth/0.tif", save_all=True, append_images=pages[1:])
    with pytest.raises(FormatError, match="holds 4 images"):
        open_source(tmp_path)


@pytest.mark.parametrize(
    "array", [np.zeros((2, 48, 64)), np.zeros(48), np.zeros((48, 64), complex), np.array([{"a": 1}], object)]
)
def test_arrays_that_are_no_image_are_refused(array, tmp_path):
    folder(tmp_path, "depth/{n}.npy")
    np.save(tmp_path / "depth/0.npy", array, allow_pickle=True)
    with pytest.raises(FormatError, match=r"0\.npy"):
        open_source(tmp_path)


@pytest.mark.parametrize("cut", [10, 100, 3000])
def test_a_cut_array_is_refused(cut, tmp_path):
    folder(tmp_path, "depth/{n}.npy")
    file = tmp_path / "depth/0.npy"
    file.write_bytes(file.read_bytes()[:cut])
    with pytest.raises(FormatError, match=r"0\.npy"):
        open_source(tmp_path)


@pytest.mark.parametrize("scale", [1.0, 0.001])
@pytest.mark.parametrize("kind", [np.float64, np.float32, ">f4"])
def test_arrays_of_floats_are_metres_or_millimetres(scale, kind, tmp_path):
    folder(tmp_path, "depth/{n}.npy")
    for n in range(COUNT):
        np.save(tmp_path / f"depth/{n}.npy", np.asfortranarray((DEPTH[n] * scale).astype(kind)))
    source = open_source(tmp_path)
    for n in range(COUNT):
        np.testing.assert_allclose(source.frame(n).depth_mm, DEPTH[n], atol=1)


K = np.array([[55.0, 0, 31.5], [0, 55.0, 23.5], [0, 0, 1]])
K_4X4 = np.vstack([np.hstack([K, np.zeros((3, 1))]), [0, 0, 0, 1]])


@pytest.mark.parametrize("depth", ["depth", "depths", "depth_map", "depth_images"])
@pytest.mark.parametrize(
    "camera",
    [
        {"K": K},
        {"camera_matrix": K},
        {"K": K_4X4},
        {"K": np.stack([K] * COUNT)},
        {"intrinsics": K[(0, 1, 0, 1), (0, 1, 2, 2)]},
    ],
)
def test_archives_of_arrays_name_depth_and_camera_in_many_ways(depth, camera, tmp_path):
    np.savez(tmp_path / "x.npz", **{depth: np.stack(DEPTH)}, **camera)
    source = open_source(tmp_path / "x.npz")
    np.testing.assert_array_equal(source.frame(2).depth_mm, DEPTH[2])
    assert (source.calibration.depth.fx, source.calibration.depth.cy) == (55.0, 23.5)


@pytest.mark.parametrize("axis", [1, 3])
def test_axes_of_length_one_do_not_count(axis, tmp_path):
    np.savez(tmp_path / "x.npz", depth=np.expand_dims(np.stack(DEPTH), axis), K=K)
    np.testing.assert_array_equal(open_source(tmp_path / "x.npz").frame(3).depth_mm, DEPTH[3])


def test_colour_and_depth_in_one_array_are_refused(tmp_path):
    image = np.dstack([np.full((*SHAPE, 3), 90, np.uint16), DEPTH[0]])
    np.savez(tmp_path / "x.npz", depth=image, K=K)
    with pytest.raises(FormatError, match="may be colour"):
        open_source(tmp_path / "x.npz")


@pytest.mark.parametrize("wrong", [np.eye(3)[:2], np.ones((3, 3)), np.stack([K, K + 1])])
def test_other_matrices_are_no_camera(wrong, tmp_path):
    np.savez(tmp_path / "x.npz", depth=np.stack(DEPTH[:2]), K=wrong)
    with pytest.raises(CloudError, match="K is not a 3x3 camera matrix"):
        open_source(tmp_path / "x.npz")
