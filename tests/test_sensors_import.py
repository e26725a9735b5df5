"""Folders and point clouds become frames, say what they lack, and are refused in one line when broken."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, settings

from sensors.errors import CalibrationError, FormatError
from sensors.files.flir_jpeg import read_flir
from sensors.importers.open_source import open_source
from sensors.rig.camera import Intrinsics
from sensors.rig.rig_calibration import Pose, RigCalibration, save_calibration
from sensors.session.messages import thermal_from_uint16
from sensors.session.reader import Session
from sensors.session.writer import SessionWriter
from tests.helpers.depth_files import CAMERA, NUMBERS, assert_refused, depth_image, png, write
from tests.helpers.flir_files import flir_jpeg

law = settings(deadline=None, max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])


@pytest.fixture
def folder(tmp_path) -> Path:
    path = tmp_path / "person"
    for i in range(3):
        write(path / "depth" / f"{i:03}.png", png(depth_image(i)))
    (path / "intrinsics.json").write_text(json.dumps(NUMBERS))
    return path


# Folders


def test_a_folder_of_depth_is_a_source(folder):
    source = open_source(folder)
    assert (source.name, len(source), source.calibration) == ("person", 3, RigCalibration(CAMERA))
    for i, frame in enumerate(source):
        assert frame.index == i
        np.testing.assert_array_equal(frame.depth_mm, depth_image(i))
        assert frame.color_encoded is None
        assert frame.thermal_c is None
    assert {"no colour images", "no thermal images"} <= set(source.notes)


def test_a_flir_jpeg_gives_temperatures(folder):
    write(folder / "thermal" / "001.jpg", flir_jpeg(np.full((6, 8), 31.5)))
    thermal = open_source(folder).frame(1).thermal_c
    assert thermal.dtype == np.float32
    np.testing.assert_allclose(thermal, 31.5, atol=0.05)
    with pytest.raises(FormatError, match="holds no temperatures"):
        read_flir(b"holiday", "001.jpg")


def test_colour_and_thermal_belong_by_name(folder):
    values = np.arange(48, dtype=np.uint16).reshape(6, 8) * 700
    write(folder / "thermal" / "001.png", png(values))
    write(folder / "color" / "002.png", png(np.zeros((4, 4, 3), np.uint8)))
    (folder / "color" / "notes.txt").write_text("not an image")
    (folder / "intrinsics.json").unlink()
    small, pose = Intrinsics(8, 6, 9, 9, 3.5, 2.5), Pose.identity()
    rig = RigCalibration(CAMERA, thermal=small, thermal_from_depth=pose)
    save_calibration(folder / "calibration.json", rig)
    source = open_source(folder)
    first, second, third = source
    assert (first.thermal_c, first.color_encoded, second.color_encoded) == (None, None, None)
    np.testing.assert_array_equal(second.thermal_c, thermal_from_uint16(values))
    assert third.color_encoded == (folder / "color" / "002.png").read_bytes()
    assert "2 of 3 frames have no colour image" in source.notes
    assert any("no calibration of the colour camera" in note for note in source.notes)


def test_depth_steps_become_millimetres(folder):
    (folder / "intrinsics.json").write_text(json.dumps({**NUMBERS, "depth_unit_mm": 20}))
    frame = next(iter(open_source(folder)))
    expected = depth_image(0).astype(int) * 20
    np.testing.assert_array_equal(frame.depth_mm, np.where(expected > 65535, 0, expected))


def test_missing_intrinsics_say_what_to_add(folder):
    (folder / "intrinsics.json").unlink()
    needed = '"fx": FX, "fy": FY, "cx": CX, "cy": CY, "width": 32, "height": 24'
    assert_refused(folder, f"{folder / 'intrinsics.json'} holding {{{needed}", CalibrationError)


WRONG = [
    *({"fx": "30"}, {"fx": True}, {"fx": -1}, {"cx": float("nan")}, {"width": 10**9}, {"depth_units": 0.1}),
    *({"depth_unit_mm": 0}, {"width": 33}),
]


@pytest.mark.parametrize(
    "content",
    ["{", "[" * 100_000, "[]", "{}", " " * 1_000_001, *(json.dumps({**NUMBERS, **w}) for w in WRONG)],
)
def test_bad_intrinsics_are_refused(folder, content):
    (folder / "intrinsics.json").write_text(content)
    assert_refused(folder)


def test_bad_images_are_refused(folder):
    good = (folder / "depth" / "000.png").read_bytes()
    for image, match in (
        (b"", "cut off after 0 bytes"),
        (b"no PNG", "is not a PNG;"),
        (good[:60], "cannot be decoded|cut off"),
        (png(depth_image().astype(np.uint8)), "uint8"),
        (png(np.zeros((24, 32, 3), np.uint16)), r"\(24, 32, 3\)"),
        (good[:16] + (10**6).to_bytes(4, "big") + good[20:], "1000000x24"),
    ):
        write(folder / "depth" / "000.png", image)
        assert_refused(folder, match, FormatError)
    write(folder / "color" / "frame7.png", png(np.zeros((4, 4, 3), np.uint8)))
    assert_refused(folder, "named like a depth image", FormatError)


def test_what_is_no_source_is_refused(tmp_path):
    write(tmp_path / "a.txt", b"hello")
    (tmp_path / "empty").mkdir()
    for name, match in (
        ("a.txt", "of an unsupported kind"),
        ("b.mcap", "does not exist"),
        ("empty", "no depth images"),
    ):
        assert_refused(tmp_path / name, match, FormatError)


def test_whatever_is_imported_can_be_recorded(folder, tmp_path):
    source = open_source(folder)
    with SessionWriter(tmp_path / "x.mcap", source.calibration, source.name) as writer:
        for frame in source:
            writer.write(frame)
    session = open_source(tmp_path / "x.mcap")
    assert isinstance(session, Session)
    for a, b in zip(source, session, strict=True):
        assert (a.index, a.stamp_ns) == (b.index, b.stamp_ns)
        np.testing.assert_array_equal(a.depth_mm, b.depth_mm)


def test_a_cut_or_garbled_colour_image_is_left_out_and_counted(annotate_cloud, tmp_path):
    folder = tmp_path / "theirs"
    for name in ("depth", "color"):
        (folder / name).mkdir(parents=True)
    image = np.full((48, 64, 3), 90, np.uint8)
    for i, suffix in enumerate((".jpg", ".jpg", ".png", ".jpg")):
        cv2.imwrite(str(folder / "depth" / f"{i}.png"), np.full((48, 64), 2000, np.uint16))
        cv2.imwrite(str(folder / "color" / f"{i}{suffix}"), image)
    camera = {"fx": 60, "fy": 60, "cx": 31.5, "cy": 23.5, "width": 64, "height": 48}
    (folder / "intrinsics.json").write_text(json.dumps(camera))
    for cut in ("1.jpg", "2.png"):
        file = folder / "color" / cut
        file.write_bytes(file.read_bytes()[:-40])
    (folder / "color" / "3.jpg").write_bytes(b"no image")
    done = annotate_cloud("import", folder, tmp_path / "x.mcap")
    assert done.code == 0, done.err
    assert "colour of 2 frames is cut off: left out" in done.err
    assert "colour of 1 frames" in done.err
    session = Session(tmp_path / "x.mcap")
    assert [session.frame(i).color_encoded is not None for i in range(4)] == [True, False, False, False]
