"""Folders and arrays as other programs write them: right, or refused in one line with the remedy."""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from annotate.cloud.fuse import Fuser
from annotate.exchange.companion import frame_files
from annotate.frame_labels import FrameLabels
from annotate.labelset.label_set import LabelSet
from sensors.calibration_files.lens_models import realsense_intrinsics
from sensors.errors import CloudError
from sensors.files.natural_order import in_order
from sensors.importers import folder as folder_module
from sensors.importers.folder_files import JPEGS, files_of
from sensors.importers.open_source import open_source
from sensors.importers.options import ImportOptions
from sensors.rig.camera import Intrinsics
from sensors.rig.rig_calibration import Pose, RigCalibration, save_calibration
from sensors.rig.turn import Turn
from tests.helpers.depth_files import CAMERA, NUMBERS, assert_refused, png, write


def plain(seed: int = 0) -> np.ndarray:
    """A slope of 1.2 to 3.6 m, uint16 (24, 32), some of it without a reading."""
    depth = (1200 + 100 * np.arange(24)[:, None] + np.arange(32) + seed).astype(np.uint16)
    depth[:2, :3] = 0
    return depth


def coloured(seed: int, shape: tuple[int, int] = (24, 32)) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, (*shape, 3), np.uint8)


def words(seed: int, shape: tuple[int, int] = (24, 32)) -> np.ndarray:
    celsius = np.random.default_rng(seed).uniform(20, 35, shape)
    return np.rint((celsius + 100) * 100).astype(np.uint16)


def camera_file(path: Path, **more: object) -> Path:
    return write(path / "intrinsics.json", json.dumps({**NUMBERS, **more}).encode())


def depths_of(path: Path, options: ImportOptions | None = None) -> list[np.ndarray]:
    source = open_source(path, options) if options else open_source(path)
    return [frame.depth_mm for frame in source]


# Aligned images


def test_images_of_depth_s_size_are_aligned(tmp_path):
    for i in range(2):
        write(tmp_path / "depth" / f"{i}.png", png(plain(i)))
        write(tmp_path / "color" / f"{i}.png", png(coloured(i)))
        write(tmp_path / "thermal" / f"{i}.png", png(words(i)))
    camera_file(tmp_path, k1=0.1)
    source = open_source(tmp_path)
    camera = replace(CAMERA, k1=0.1)
    aligned = RigCalibration(camera, camera, Pose.identity(), camera, Pose.identity())
    assert repr(source.calibration) == repr(aligned)
    assert sum("assumed to be aligned with depth pixel for pixel" in note for note in source.notes) == 2
    np.testing.assert_allclose(source.frame(1).thermal_c, words(1) / 100 - 100, atol=1e-4)
    np.testing.assert_array_equal(source.frame(1).decode_color(), coloured(1)[..., ::-1])


def test_images_of_another_size_are_named_and_not_used(tmp_path):
    write(tmp_path / "depth" / "0.png", png(plain()))
    write(tmp_path / "color" / "0.jpg", bytes(cv2.imencode(".jpg", coloured(0, (48, 60)))[1]))
    write(tmp_path / "thermal" / "0.png", png(words(0, (12, 16))))
    camera_file(tmp_path)
    source = open_source(tmp_path)
    assert (source.calibration.color, source.calibration.thermal) == (None, None)
    for named in ("colour images are 60x48", "thermal images are 16x12"):
        assert any(named in note and "register them to depth" in note for note in source.notes)


@pytest.mark.parametrize("step", [(0.01, -100.0), (0.01, -273.15), (0.1, -273.15), None])
def test_thermal_images_of_any_scale_are_celsius(tmp_path, step):
    """step: of words, and their zero; None = floats in a TIFF."""
    write(tmp_path / "depth" / "0.png", png(plain()))
    camera_file(tmp_path)
    celsius = np.random.default_rng(0).uniform(20, 35, (24, 32)).astype(np.float32)
    stored, name = (celsius, "0.tiff") if step is None else (np.rint((celsius - step[1]) / step[0]), "0.png")
    stored = stored if step is None else stored.astype(np.uint16)
    write(tmp_path / "thermal" / name, bytes(cv2.imencode(name[1:], stored)[1]))
    atol = 1e-4 + (step[0] / 2 if step else 0)
    np.testing.assert_allclose(open_source(tmp_path).frame(0).thermal_c, celsius, atol=atol)
    if step is not None:
        write(tmp_path / "thermal" / "0.png", png(np.full((24, 32), 22000, np.uint16)))
        assert_refused(tmp_path, "not raw counts")


def test_unread_colours_are_named(tmp_path):
    write(tmp_path / "depth" / "0.png", png(plain()))
    write(tmp_path / "color" / "0.bmp", bytes(cv2.imencode(".bmp", coloured(0))[1]))
    camera_file(tmp_path)
    source = open_source(tmp_path)
    assert "color holds 1 .bmp files, which are not read: convert them to JPEG or PNG" in source.notes


# Names and layouts


def test_names_are_an_order_as_people_count(tmp_path):
    names = ["0", "1", "2", "9", "10", "11", "100"]
    for seed, name in enumerate(names):
        write(tmp_path / "f" / "depth" / f"{name}.png", png(plain(seed)))
        write(tmp_path / "jpegs" / f"{name}.jpg", b"")
    camera_file(tmp_path / "f")
    np.testing.assert_array_equal(depths_of(tmp_path / "f"), [plain(seed) for seed in range(len(names))])
    labels = LabelSet.create(tmp_path / "l", CAMERA, {})
    for name in reversed(names):
        labels.write(FrameLabels(name, plain(), np.zeros((24, 32), np.uint8)))
    assert labels.frame_ids == names
    assert [name for name, _ in frame_files(tmp_path / "f" / "depth", ".png")] == names
    assert [file.stem for file in files_of(tmp_path / "jpegs", JPEGS)] == names
    padded = [f"{i:06}" for i in range(300)]
    assert in_order(padded[::-1]) == padded and in_order(["10", "1", "01"]) == ["01", "1", "10"]


def test_what_a_folder_holds_instead_is_named(tmp_path):
    for i in range(12):
        write(tmp_path / "depth" / f"{i}.exr", b"v/1\1")
    camera_file(tmp_path)
    assert_refused(tmp_path, r"depth holds no depth images \(it holds 12 \.exr files\); put 16-bit PNGs into")


# Lists


def listed(folder: Path, unit: int, lists: dict[str, str]) -> Path:
    for i in range(3):
        write(folder / "depth" / f"{i}.png", png(plain(i) * np.uint16(unit)))
        write(folder / "rgb" / f"{i}.png", png(coloured(i)))
    for name, line in lists.items():
        write(folder / name, "\n".join(line.format(i=i, t=1.5e9 + i / 10) for i in range(3)).encode())
    camera_file(folder)
    return folder


@pytest.mark.parametrize("unit", [1, 5])
@pytest.mark.parametrize(
    "lists",
    [
        {"associations.txt": "{i} depth/{i}.png {i} rgb/{i}.png"},  # ICL-NUIM
        {"associated.txt": "{t:.6f} rgb/{i}.png {t:.6f} depth/{i}.png"},  # ETH3D
        {"depth.txt": "{t:.6f} depth/{i}.png", "rgb.txt": "{t:.6f} rgb/{i}.png"},  # Bonn, without header
        {"depth.txt": "{t:.6f} depth/{i}.png"},
    ],
)
def test_lists_without_a_header(tmp_path, unit, lists):
    """Fifths of a millimetre where millimetres are impossible; numbers are not seconds."""
    source = open_source(listed(tmp_path, unit, lists))
    for i, frame in enumerate(source):
        np.testing.assert_array_equal(frame.depth_mm, plain(i))
    wanted = np.arange(3) * (33_333_333 if "associations.txt" in lists else 100_000_000)
    np.testing.assert_array_equal(source.times_ns - source.times_ns[0], wanted)
    assert ("rgb.txt" in lists or "depth.txt" not in lists) == (source.frame(0).color_encoded is not None)
    assert any("numbers, not times" in note for note in source.notes) == ("associations.txt" in lists)


def test_a_calibration_beside_tum_s_lists_changes_no_unit(tmp_path):
    lists = {"depth.txt": "{t:.6f} depth/{i}.png", "rgb.txt": "{t:.6f} rgb/{i}.png"}
    folder = listed(tmp_path, 5, lists)
    write(folder / "depth.txt", b"# depth maps\n" + (folder / "depth.txt").read_bytes())
    for beside in (False, True):
        if beside:
            save_calibration(folder / "calibration.json", RigCalibration(CAMERA))
        np.testing.assert_array_equal(depths_of(folder)[0], plain())
    camera_file(folder, depth_unit_mm=0.4)
    np.testing.assert_array_equal(depths_of(folder)[0], plain() * 2)


# The camera


def test_inverse_lenses_are_read_as_in_bags(tmp_path):
    write(tmp_path / "depth" / "0.png", png(plain()))
    lens = [0.1, -0.2, 0.001, 0.001, 0.05]
    fields = {"fx": 30, "fy": 31, "ppx": 15.5, "ppy": 11.5, "width": 32, "height": 24, "coeffs": lens}
    write(
        tmp_path / "intrinsics.json",
        json.dumps({**fields, "model": "distortion.inverse_brown_conrady"}).encode(),
    )
    pinhole = Intrinsics(32, 24, 30, 31, 15.5, 11.5)
    expected = realsense_intrinsics(pinhole, "inverse_brown_conrady", lens)
    assert open_source(tmp_path).calibration.depth == expected


@pytest.mark.parametrize("wrong", [{"fx": 0.49, "fy": 0.49}, {"cx": 4000}, {"k1": 1200.0}])
def test_cameras_that_none_is_are_refused(tmp_path, wrong):
    write(tmp_path / "depth" / "0.png", png(plain()))
    camera_file(tmp_path, **wrong)
    assert_refused(tmp_path, r"intrinsics\.json: ")


# Options


def test_a_camera_and_a_unit_can_be_declared(tmp_path):
    write(tmp_path / "f" / "depth" / "0.png", png(plain() * np.uint16(10)))
    assert_refused(tmp_path / "f", "give such a file")
    file = camera_file(tmp_path / "elsewhere")
    options = ImportOptions(intrinsics=file, depth_unit_mm=0.1, rate_hz=5, subject="anna")
    source = open_source(tmp_path / "f", options)
    np.testing.assert_array_equal(source.frame(0).depth_mm, plain())
    assert (source.calibration.depth, source.subject) == (CAMERA, "anna")
    for wrong in ({"depth_unit_mm": 0}, {"turn_deg": 45}, {"rate_hz": -1}, {"topics": ("/a",)}):
        with pytest.raises(CloudError):
            open_source(tmp_path / "f", ImportOptions(intrinsics=file, **wrong))


@pytest.mark.parametrize("turn", [0, 90, 180, 270])
@pytest.mark.parametrize("mirror", [False, True])
def test_turning_changes_images_and_cameras_alike(tmp_path, turn, mirror):
    """A point keeps its pixels' colour and temperature, except a few at borders of a coarse image."""
    write(tmp_path / "depth" / "0.png", png(plain()))
    write(tmp_path / "color" / "0.png", png(coloured(0, (48, 60))))
    write(tmp_path / "thermal" / "0.png", png(words(0, (12, 16))))
    angle = np.radians(3.0)
    tilt = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    rig = RigCalibration(
        CAMERA,
        Intrinsics(60, 48, 55, 56, 29, 24, 0.05, -0.02, 0.001, 0.002),
        Pose(tilt, np.array([0.05, 0.01, 0.0])),
        Intrinsics(16, 12, 15, 15, 7.5, 5.5),
        Pose(tilt.T, np.array([-0.03, 0.02, 0.01])),
    )
    save_calibration(tmp_path / "calibration.json", rig)
    upright, turned = (
        Fuser(source.calibration).fuse_frame(source.frame(0))
        for source in (
            open_source(tmp_path),
            open_source(tmp_path, ImportOptions(turn_deg=turn, mirror=mirror)),
        )
    )
    turning = Turn(turn // 90, mirror)
    for name in ("depth_mm", "color_rgb", "temperature_c"):
        expected = turning.image(getattr(upright, name))
        same = np.isclose(getattr(turned, name), expected, atol=0.01, equal_nan=True)
        assert same.mean() > 0.9, name


def test_a_frame_is_read_without_the_others(tmp_path, monkeypatch):
    data = png(plain())
    for i in range(1000):
        write(tmp_path / "depth" / f"{i}.png", data)
    write(tmp_path / "depth" / "900.png", png(plain(900)))
    camera_file(tmp_path)
    source, decoded = open_source(tmp_path), []
    decode = folder_module.decode_depth
    monkeypatch.setattr(
        folder_module, "decode_depth", lambda d, name: (decoded.append(name), decode(d, name))[1]
    )
    np.testing.assert_array_equal(source.frame(900).depth_mm, plain(900))
    assert decoded == [str(tmp_path / "depth" / "900.png")]


# Arrays


def test_arrays_of_matlab_and_other_cameras(tmp_path):
    stack = np.stack([plain(i) for i in range(5)])
    path = tmp_path / "a.npz"
    numbers = {name: NUMBERS[name] for name in ("fx", "fy", "cx", "cy")}
    for camera in ({"K": CAMERA.matrix}, {"intrinsics": CAMERA.matrix}, numbers):
        for depth in (stack, np.moveaxis(stack, 0, 2)):
            np.savez(path, depth=depth, **camera)
            source = open_source(path)
            assert source.calibration.depth == CAMERA
            np.testing.assert_array_equal(np.stack(depths_of(path)), stack)
    np.save(tmp_path / "b.npy", np.moveaxis(stack, 0, 2))
    camera_file(tmp_path)
    np.testing.assert_array_equal(np.stack(depths_of(tmp_path / "b.npy")), stack)
    np.savez(path, depth=(stack / 16).astype(np.uint8), K=CAMERA.matrix)
    assert_refused(path, "8 bits")


def test_files_of_no_kind_are_named_in_a_line(tmp_path):
    for name, head, match in (
        ("a.mat", b"MATLAB 5.0 MAT-file, Platform", "MATLAB file; read it with scipy"),
        ("a.h5", b"\x89HDF\r\n\x1a\n", "HDF5"),
        ("a.bin", b"\1\2\3\4", "numpy.fromfile"),
        ("a.mp4", b"\0\0\0\x20ftypisom", "a video"),
        ("a.oni", b"xx", "OpenNI"),
        ("a.xef", b"xx", "Kinect Studio"),
        ("a.svo", b"xx", "ZED"),
        ("a.png", png(plain()), "into FOLDER/depth"),
        ("a.zip", b"PK\3\4", "unpack it"),
        ("a.what", b"xx", "import --help"),
    ):
        write(tmp_path / name, head)
        with pytest.raises(CloudError, match=match) as error:
            open_source(tmp_path / name)
        assert len(str(error.value)) - len(str(tmp_path)) < 150 and "\n" not in str(error.value)
