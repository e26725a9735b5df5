"""Folders as other programs lay them out: depth, its order, its times, and which colour belongs to it."""

import io
import json

import cv2
import numpy as np
import pytest
from PIL import Image

from sensors.errors import CloudError, FormatError
from sensors.importers.folder_files import stamps_of
from sensors.importers.open_source import open_source

COUNT, SHAPE = 12, (48, 64)
DEPTH = [
    np.linspace(1000 + 50 * n, 3000 + 50 * n, 48 * 64).reshape(SHAPE).astype(np.uint16) for n in range(COUNT)
]
COLOR = [np.full((*SHAPE, 3), 40 + 15 * n, np.uint8) for n in range(COUNT)]


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
    ("depth/{n:07d}-{n:02}0000000000.png", "rgb/{n:07d}-{n:02}0000004000.png"),  # Redwood
    ("depth/17000000{n:02}.160407.png", "rgb/17000000{n:02}.164000.png"),  # TUM without its lists
    ("depth/17000000{n:02}160407000.png", "rgb/17000000{n:02}164000000.png"),
    ("depth/{n}.npy", "color/{n}.png"),
    ("depth_{n:04}.png", "color_{n:04}.png"),
    ("{n}_depth.png", "{n}_rgb.jpg"),
    ("{n:03}.depth.png", "{n:03}.color.png"),
    ("frame-{n:06}.depth.png", "frame-{n:06}.color.png"),  # 7-Scenes
    ("Depth/{n}.PNG", "RGB/{n}.JPG"),
    ("depth/depth_{n}.png", "color/color_{n}.png"),
    ("depth/{n}.tiff", "color/{n}.png"),
    ("{n}.png", "color/{n}.png"),
    ("rs_Depth_{n}546.25000000000000.png", "rs_Color_{n}546.31000000000000.png"),  # librealsense
    ("MDepth-{n:08d}.png", ""),  # NTU RGB+D
]


@pytest.mark.parametrize(("depth", "color"), LAYOUTS)
def test_depth_and_colour_of_every_layout_belong_together(depth, color, tmp_path):
    """Hidden files and other programs' own are passed over; numbers are an order as people count."""
    path = folder(tmp_path, depth, color)
    for place in {(path / name).parent for name in (depth, color or depth)}:
        (place / "._0.png").write_bytes(b"\0\5\26\7macOS")
        (place / "Thumbs.db").write_bytes(b"\xd0\xcf\x11\xe0")
    source = open_source(path)
    assert len(source) == COUNT
    assert (source.calibration.color is not None) == bool(color)
    for n in range(COUNT):
        frame = source.frame(n)
        np.testing.assert_array_equal(frame.depth_mm, DEPTH[n])
        if color:
            np.testing.assert_allclose(frame.decode_color(), COLOR[n], atol=3)


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (["1305031102.160407", "1305031102.194330"], [0, 33_923_000]),
        (["1700000000000", "1700000000033"], [0, 33_000_000]),
        (["cam_1700000000000000", "cam_1700000000033333"], [0, 33_333_000]),
        (["1700000000000000000", "1700000000033333333"], [0, 33_333_333]),
        (["0000001-000000000000", "0000002-000000033333"], [0, 33_333_000]),
        (["rs_1546.25", "rs_1579.5"], [0, 33_250_000]),
        (["0", "1"], []),
        (["0000000001", "0000000002"], []),
        (["20231104120000", "20231104120001"], []),
        (["frame_1", "1700000000.5"], []),
    ],
)
def test_names_that_are_times_give_them(names, expected):
    stamps = stamps_of(names)
    assert [stamps[name] - stamps[names[0]] for name in stamps] == expected


def test_images_that_are_left_out_are_named(tmp_path):
    folder(tmp_path / "views", "{n}_depth.png", "{n}_color.png")
    for n in range(COUNT):
        write(tmp_path / "views" / f"{n}_depth_vis.png", (DEPTH[n] // 20).astype(np.uint8))
    opened = open_source(tmp_path / "views")
    assert len(opened) == COUNT
    assert any(note.startswith(f"{COUNT} images named like pictures of depth") for note in opened.notes)
    opened = open_source(folder(tmp_path / "colour", "depth_{n}.pgm", "color_{n}.ppm"))
    assert any(f"{COUNT} .ppm colour images are not read" in note for note in opened.notes)


def test_two_folders_of_depth_are_refused(tmp_path):
    folder(tmp_path, "depth_left/{n}.png")
    folder(tmp_path, "depth_right/{n}.png")
    with pytest.raises(FormatError, match="depth_left, depth_right; rename the right one depth"):
        open_source(tmp_path)
    folder(tmp_path, "depth/{n}.png")
    assert len(open_source(tmp_path)) == COUNT


def saved(array: np.ndarray, cut: int | None = None) -> bytes:
    file = io.BytesIO()
    np.save(file, array, allow_pickle=True)
    return file.getvalue()[:cut]


def pages() -> bytes:
    file, images = io.BytesIO(), [Image.fromarray(image) for image in DEPTH]
    images[0].save(file, "TIFF", save_all=True, append_images=images[1:])
    return file.getvalue()


TIFF = bytes(cv2.imencode(".tiff", DEPTH[0])[1])
HUGE = io.BytesIO()
Image.new("I;16", (9000, 1)).save(HUGE, "TIFF")
UNREADABLE = {
    "a stack of images": (".tif", pages(), f"holds {COUNT} images"),
    "colour": (".tif", bytes(cv2.imencode(".tiff", COLOR[0])[1]), ""),
    "an empty TIFF": (".tif", b"", ""),
    "a TIFF cut in its header": (".tif", TIFF[:40], ""),
    "a TIFF cut in its pixels": (".tif", TIFF[: len(TIFF) // 2], ""),
    "a huge TIFF": (".tif", HUGE.getvalue(), "at most 8192"),
    "two images": (".npy", saved(np.zeros((2, 48, 64))), ""),
    "a row": (".npy", saved(np.zeros(48)), ""),
    "complex numbers": (".npy", saved(np.zeros((48, 64), complex)), ""),
    "objects": (".npy", saved(np.array([{"a": 1}], object)), ""),
    **{f"the first {cut} bytes": (".npy", saved(DEPTH[0], cut), "") for cut in (10, 100, 3000)},
}


@pytest.mark.parametrize("name", UNREADABLE)
def test_files_that_hold_no_image_are_refused(name, tmp_path):
    suffix, content, match = UNREADABLE[name]
    folder(tmp_path, f"depth/{{n}}{suffix}")
    (tmp_path / f"depth/0{suffix}").write_bytes(content)
    with pytest.raises(FormatError, match=rf"0\{suffix}.*{match}") as error:
        open_source(tmp_path).frame(0)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("scale", [1.0, 0.001])
@pytest.mark.parametrize("kind", [np.float64, np.float32, ">f4", "tiff"])
def test_floats_are_metres_or_millimetres(scale, kind, tmp_path):
    folder(tmp_path, "depth/{n}.tiff" if kind == "tiff" else "depth/{n}.npy")
    for n in range(COUNT):
        values = (DEPTH[n] * scale).astype(np.float32 if kind == "tiff" else kind)
        if kind == "tiff":
            write(tmp_path / f"depth/{n}.tiff", values)
        else:
            np.save(tmp_path / f"depth/{n}.npy", np.asfortranarray(values))
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
    with pytest.raises(CloudError, match="K is not a camera matrix"):
        open_source(tmp_path / "x.npz")
