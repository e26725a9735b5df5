"""Azure Kinect recordings, arrays, LAS clouds and others' folders become frames, or one line of refusal."""

import json
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

from sensors.calibration_files.intrinsics_file import read_intrinsics
from sensors.errors import CalibrationError, FormatError
from sensors.files.images import decode_grey
from sensors.importers import arrays, tum_lists
from sensors.importers.azure_mkv import AzureRecording
from sensors.importers.open_source import open_source
from sensors.importers.tum_lists import read_associations, read_list
from sensors.rig.camera import Intrinsics, project, unproject
from sensors.rig.frame import RigFrame
from tests.helpers.depth_files import CAMERA, NUMBERS, assert_refused, depth_image, png, write
from tests.helpers.samples import (
    COLOR_SIZE,
    DEPTH_SIZE,
    azure_calibration,
    azure_depth,
    azure_jpeg,
    azure_mkv,
    element,
    las,
)

# Azure Kinect


def test_an_azure_recording_is_a_source(tmp_path):
    source = open_source(write(tmp_path / "a.mkv", azure_mkv(3)))
    assert isinstance(source, AzureRecording)
    depth, color = source.calibration.depth, source.calibration.color
    assert ((depth.width, depth.height), (color.width, color.height)) == (DEPTH_SIZE, COLOR_SIZE)
    # Binned to 512, cropped by (96, 90); centres at whole numbers.
    expected = [0.49 * 512, 0.5 * 512 - 96 - 0.5, 0.5 * 512 - 90 - 0.5]
    np.testing.assert_allclose([depth.fx, depth.cx, depth.cy], expected)
    # 720 rows from the middle of 960.
    np.testing.assert_allclose([color.fx, color.fy, color.cy], [0.48 * 1280, 0.64 * 960, 480 - 120 - 0.5])
    np.testing.assert_allclose(source.calibration.color_from_depth.translation_m, [-0.03, 0, 0])
    assert len(source) == 3
    for i, frame in enumerate(source):
        assert frame.stamp_ns == 33_333_000 * i
        np.testing.assert_array_equal(frame.depth_mm, azure_depth(i))
        np.testing.assert_array_equal(frame.infrared, azure_depth(i))
        assert frame.color_encoded == azure_jpeg(i)


def test_a_recording_that_was_cut_off_is_read_so_far(tmp_path):
    whole = azure_mkv(3)
    source = open_source(write(tmp_path / "a.mkv", whole[: -len(azure_jpeg(2)) - 400_000]))
    assert len(list(source)) == 2


def test_what_an_azure_recording_lacks_is_said(tmp_path):
    raw = open_source(write(tmp_path / "yuy2.mkv", azure_mkv(1, b"YUY2")))
    assert {"no colour images", "COLOR images are 'YUY2': left out"} <= set(raw.notes)
    assert next(iter(raw)).color_encoded is None
    film = element(0x1A45DFA3, b"") + element(0x18538067, b"")
    assert_refused(write(tmp_path / "film.mkv", film), "no DEPTH")
    other = azure_calibration().replace(b"BrownConrady", b"Theta")
    assert_refused(write(tmp_path / "theta.mkv", azure_mkv(1, calibration=other)), "Theta")
    for broken in (b"{", b"[]", b'{"CalibrationInformation": {"Cameras": [{}]}}', b"null"):
        assert_refused(write(tmp_path / "b.mkv", azure_mkv(1, calibration=broken)), "malformed")


def test_the_real_azure_recording(shared_data):
    source = open_source(shared_data / "azure_kinect" / "recording.mkv")
    frame = next(iter(source))
    assert (len(source), frame.depth_mm.shape, frame.infrared.shape) == (1, (576, 640), (576, 640))
    assert frame.decode_color().shape == (720, 1280, 3)
    camera = source.calibration.depth
    np.testing.assert_allclose([camera.fx, camera.cx, camera.cy], [504.608, 332.781, 348.830], atol=1e-2)
    assert 300 < np.median(frame.depth_mm[frame.depth_mm > 0]) < 3000
    # The mug on the table stands a hand's width wide, at arm's length.
    near = (frame.depth_mm > 300) & (frame.depth_mm < 700)
    points = unproject(camera, np.where(near, frame.depth_mm / 1000, np.nan))
    assert 0.1 < np.ptp(points[near][:, 0]) < 1


# Arrays


@pytest.mark.parametrize("kind", [np.uint16, np.int64, np.float32, np.float64, ">u2"])
@pytest.mark.parametrize("packed", [False, True])
def test_arrays_are_a_source(tmp_path, kind, packed):
    stack = np.stack([depth_image(0), depth_image(1)])
    values = np.where(stack > 0, stack / 1000, np.nan) if np.dtype(kind).kind == "f" else stack
    path = tmp_path / ("a.npz" if packed else "a.npy")
    if packed:
        np.savez_compressed(
            path, depth=np.asfortranarray(values.astype(kind)), K=CAMERA.matrix, rest=np.ones(3)
        )
    else:
        np.save(path, values.astype(kind))
        (tmp_path / "a.json").write_text(json.dumps(NUMBERS))
    source = open_source(path)
    assert (len(source), source.calibration.depth) == (2, CAMERA)
    for frame, expected in zip(source, stack, strict=True):
        np.testing.assert_array_equal(frame.depth_mm, expected)
    assert ("array 'rest' is not read" in source.notes) == packed


def test_one_image_and_one_array_need_no_names(tmp_path):
    np.savez(tmp_path / "a.npz", anything=depth_image())
    (tmp_path / "intrinsics.json").write_text(json.dumps(NUMBERS))
    np.testing.assert_array_equal(next(iter(open_source(tmp_path / "a.npz"))).depth_mm, depth_image())


def test_arrays_without_intrinsics_say_what_to_add(tmp_path):
    np.save(tmp_path / "a.npy", depth_image())
    assert_refused(tmp_path / "a.npy", r'a\.json.*"width": 32, "height": 24')


class Evil:
    def __reduce__(self):
        return (Path.touch, (Path("/tmp/annotate-cloud-was-here"),))


def test_no_array_is_executed_or_believed(tmp_path):
    (tmp_path / "intrinsics.json").write_text(json.dumps(NUMBERS))
    np.save(tmp_path / "evil.npy", np.array([Evil()], dtype=object), allow_pickle=True)
    np.savez(tmp_path / "evil.npz", depth=np.array([Evil()], dtype=object))
    for name in ("evil.npy", "evil.npz"):
        assert_refused(tmp_path / name, "Object arrays|Python objects")
    assert not Path("/tmp/annotate-cloud-was-here").exists()
    head = b"\x93NUMPY\x01\x00\x46\x00{'descr': '<u2', 'fortran_order': False, 'shape': (%s, 24, 32), }"
    for count in (b"99999999999", b"-1", b"0", b"9" * 30, b"1,2,2"):
        content = (head % count).ljust(79) + b"\n" + depth_image().tobytes()
        assert_refused(write(tmp_path / "x.npy", content))
        with zipfile.ZipFile(tmp_path / "x.npz", "w") as archive:
            archive.writestr("depth.npy", content)
        assert_refused(tmp_path / "x.npz")
    with zipfile.ZipFile(tmp_path / "bomb.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("depth.npy", bytes(1 << 22))
    content = bytearray((tmp_path / "bomb.npz").read_bytes())
    at = content.find(b"PK\x01\x02") + 24
    content[at : at + 4] = (0xFFFFFFF0).to_bytes(4, "little")
    assert_refused(write(tmp_path / "bomb.npz", bytes(content)), "unpacks to")
    for shape in ((3,), (2, 2, 2, 2), (0, 4, 4)):
        np.save(tmp_path / "s.npy", np.zeros(shape, np.uint16))
        assert_refused(tmp_path / "s.npy", "give")
    np.savez(tmp_path / "two.npz", a=depth_image(), b=depth_image())
    assert_refused(tmp_path / "two.npz", r"no array 'depth' \(it has a, b\)")


def test_of_an_archive_only_what_is_needed_is_unpacked(tmp_path, monkeypatch):
    monkeypatch.setattr(arrays, "MAX_UNPACKED_BYTES", 3 * depth_image().nbytes)
    path = tmp_path / "a.npz"
    np.savez_compressed(path, depth=depth_image(), K=CAMERA.matrix, rest=np.zeros(1 << 20, np.uint8))
    with zipfile.ZipFile(path, "a", zipfile.ZIP_LZMA) as archive:
        archive.writestr("other.npy", b"no array")
    source = open_source(path)
    assert {"array 'rest' is not read", "array 'other' is not read"} <= set(source.notes)
    np.testing.assert_array_equal(next(iter(source)).depth_mm, depth_image())
    np.savez_compressed(path, depth=np.stack([depth_image()] * 3), K=CAMERA.matrix)
    assert_refused(path, "unpacks to .*save depth as a .npy")


# LAS


@pytest.mark.parametrize("offset", [0.0, 500_000.0])
@pytest.mark.parametrize("suffix", ["las", "laz"])
def test_las_clouds_stand_upright(tmp_path, suffix, offset):
    """A wall 2 m before the viewer: z up, y forward."""
    u, v = np.meshgrid(np.arange(40), np.arange(60))
    wall = np.stack([(u - 20) * 0.02, np.full(u.shape, 2.0), (v - 30) * 0.02], axis=-1).reshape(-1, 3)
    source = open_source(write(tmp_path / f"wall.{suffix}", las(wall, offset, suffix == "laz")))
    depth = next(iter(source)).depth_mm
    rows, columns = np.nonzero(depth)
    assert np.ptp(rows) > np.ptp(columns)
    assert np.ptp(depth[depth > 0]) <= 2
    if offset == 0:
        top, bottom = project(source.calibration.depth, np.array([[0, -0.58, 2.0], [0, 0.6, 2.0]]))[:, 1]
        np.testing.assert_allclose([rows.min(), rows.max()], [top, bottom], atol=3)


@pytest.mark.parametrize("suffix", ["las", "laz"])
def test_las_files_that_lie_are_refused(tmp_path, suffix):
    good = las(np.random.default_rng(0).uniform(0, 1, (50, 3)), 0, suffix == "laz")
    many = good[:107] + (4_000_000_000).to_bytes(4, "little") + good[111:]
    for content in (good[:100], good[: len(good) // 2 + 100], many, b""):
        assert_refused(write(tmp_path / f"x.{suffix}", content))


# Folders of others


def test_a_realsense_folder_of_open3d(tmp_path):
    """``realsense_recorder.py`` of Open3D: depth aligned to colour, one matrix by columns."""
    for i in range(2):
        write(tmp_path / "depth" / f"{i:06}.png", png(depth_image(i)))
        write(tmp_path / "color" / f"{i:06}.jpg", azure_jpeg(i))
    matrix = CAMERA.matrix.T.ravel().tolist()
    fields = {"width": 32, "height": 24, "intrinsic_matrix": matrix}
    write(tmp_path / "camera_intrinsic.json", json.dumps(fields).encode())
    source = open_source(tmp_path)
    assert (source.calibration.depth, source.calibration.color, len(source)) == (CAMERA, CAMERA, 2)
    assert any("aligned" in note for note in source.notes)
    assert next(iter(source)).color_encoded == azure_jpeg(0)


def test_intrinsics_of_librealsense(tmp_path):
    fields = {
        "fx": 30,
        "fy": 31,
        "ppx": 15.5,
        "ppy": 11.5,
        "width": 32,
        "height": 24,
        "model": "Brown_Conrady",
    }
    content = {**fields, "coeffs": [0.1, 0.2, 0, 0, 0], "depth_scale": 0.0001}
    file = write(tmp_path / "i.json", json.dumps(content).encode())
    found = read_intrinsics(file)
    assert found.depth == Intrinsics(32, 24, 30, 31, 15.5, 11.5, 0.1, 0.2)
    assert found.unit_mm == pytest.approx(0.1)
    for wrong in ({"model": "ftheta"}, {"coeffs": [1]}, {"coeffs": "x"}, {"depth_scale": -1}, {"fx": None}):
        content = {**fields, "coeffs": [0.1, 0, 0, 0, 0], **wrong}
        with pytest.raises(CalibrationError):
            read_intrinsics(write(file, json.dumps(content).encode()))


@pytest.fixture
def tum(tmp_path) -> Path:
    """The layout of the TUM RGB-D datasets: images called by their time, colour at other times than depth."""
    for i in range(3):
        write(tmp_path / "depth" / f"10.{i}00000.png", png(depth_image(i) * np.uint16(5)))
        write(tmp_path / "rgb" / f"10.{i}05000.png", png(np.full((4, 4, 3), i, np.uint8)))
    lines = "\n".join(f"10.{i}00000 depth/10.{i}00000.png" for i in range(3))
    write(tmp_path / "depth.txt", b"# depth maps\n# timestamp filename\n" + lines.encode())
    lines = "\n".join(f"10.{i}05000 rgb/10.{i}05000.png" for i in range(3))
    write(tmp_path / "rgb.txt", b"# color images\n" + lines.encode())
    write(tmp_path / "intrinsics.json", json.dumps(NUMBERS).encode())
    return tmp_path


def test_a_tum_folder_is_paired_by_time(tum):
    source = open_source(tum)
    assert any("1/5000 m" in note for note in source.notes)
    for i, frame in enumerate(source):
        assert frame.stamp_ns == 10_000_000_000 + i * 100_000_000
        np.testing.assert_array_equal(frame.depth_mm, depth_image(i))
        assert frame.decode_color()[0, 0, 0] == i


def test_associations_win_and_may_leave_out(tum):
    write(tum / "associations.txt", b"10.2 rgb/10.005000.png 10.1 depth/10.100000.png\n# x\n\n")
    source = open_source(tum)
    frames = list(source)
    assert [frame.stamp_ns for frame in frames] == [10_100_000_000]
    assert frames[0].decode_color()[0, 0, 0] == 0
    assert any("2 depth images that it does not name are left out" in note for note in source.notes)


def test_lists_name_images_and_never_paths(tum):
    list_file = tum / "depth.txt"
    assert read_list(write(list_file, b"1.5 ../../etc/passwd\n2 C:\\a\\b.png")) == [
        (1_500_000_000, "passwd"),
        (2_000_000_000, "b.png"),
    ]
    assert read_associations(write(list_file, b"1.000000001 depth/a.png 2 rgb/b.png")) == [
        ((1_000_000_001, "a.png"), (2_000_000_000, "b.png"))
    ]
    for line in b"x depth/a.png|1|nan a.png|1e5 a.png|-1 a.png|99999999999 a.png|1 ..|1 \0".split(b"|"):
        with pytest.raises(FormatError):
            read_list(write(list_file, line))
    assert_refused(tum)


def test_a_list_is_read_up_to_its_bound(tum, monkeypatch):
    content = b"1 a.png " + b"x " * 99 + b"\r\n#\n\n" + b"2 b.png\n" * 8
    list_file = write(tum / "depth.txt", content)
    monkeypatch.setattr(tum_lists, "MAX_BYTES", len(content))
    assert len(read_list(list_file)) == 9
    monkeypatch.setattr(tum_lists, "MAX_BYTES", len(content) - 1)
    with pytest.raises(FormatError, match="larger than"):
        read_list(list_file)


def test_a_package_that_is_missing_is_named(tmp_path, monkeypatch):
    bag = write(tmp_path / "x.db3", b"SQLite format 3\0")
    cloud = write(tmp_path / "x.las", las(np.ones((3, 3)), 0, False))
    for package in ("laspy", "rosbags"):
        monkeypatch.setitem(sys.modules, package, None)
    for path in (cloud, bag):
        assert_refused(path, r"annotate-cloud\[exchange\]")


def test_an_image_that_is_cut_off_or_corrupt_is_refused():
    image = png(depth_image())
    np.testing.assert_array_equal(decode_grey(image, np.uint16, "depth"), depth_image())
    for at in range(45, len(image) - 12, 100):
        for broken in (image[:at], image[:at] + bytes([image[at] ^ 1]) + image[at + 1 :]):
            with pytest.raises(FormatError, match="PNG cannot be decoded"):
                decode_grey(broken, np.uint16, "depth")
    with pytest.raises(FormatError, match=r"depth PNG holds uint8 \(24, 32\); give one channel of uint16"):
        decode_grey(png(depth_image().astype(np.uint8)), np.uint16, "depth")
    for broken in (image[: len(image) // 2], azure_jpeg(0)[:100], b"GIF89a", b""):
        with pytest.raises(FormatError, match="cannot be decoded"):
            RigFrame(0, 0, depth_image(), color_encoded=broken).decode_color()
