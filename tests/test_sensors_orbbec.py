"""Recordings of Orbbec's SDK: a bag laid out as it writes them, played by the SDK in test_sensors_devices."""

import struct

import numpy as np
import pytest

from sensors.errors import CalibrationError, FormatError
from sensors.importers.bags import orbbec
from sensors.importers.bags.orbbec import OrbbecRecording
from sensors.importers.open_source import open_source
from sensors.importers.options import ImportOptions
from sensors.rig.camera import Intrinsics
from sensors.session.reader import Session
from tests.helpers import orbbec_files
from tests.helpers.orbbec_files import SHIFT_MM, jpeg_of, write_orbbec_bag

DEPTH_LENS = Intrinsics(64, 58, 50.4, 50.4, 32.0, 33.0, 0.1)
COLOR_LENS = Intrinsics(96, 54, 55.0, 55.0, 48.0, 27.0, 0.08)


def frames(count=5):
    rng = np.random.default_rng(0)
    return [
        (n, 1_000_000 + 33_333 * n, *rng.integers(0, 4000, (2, *DEPTH_LENS.shape), np.uint16),
         jpeg_of(COLOR_LENS, 40 + n))
        for n in range(count)
    ]  # fmt: skip


def bag(folder, recorded=None):
    return write_orbbec_bag(folder / "bolt.bag", DEPTH_LENS, COLOR_LENS, recorded or frames())


def test_a_recording_becomes_a_session_by_one_command_to_the_bit(tmp_path, annotate_cloud):
    recorded, out = frames(), tmp_path / "bolt.mcap"
    done = annotate_cloud("import", bag(tmp_path, recorded), out)
    assert done.code == 0, done.err
    session = Session(out)
    assert len(session) == len(recorded)
    for frame, (_, stamp_us, depth, infrared, jpeg) in zip(session, recorded, strict=True):
        np.testing.assert_array_equal(frame.depth_mm, depth)
        np.testing.assert_array_equal(frame.infrared, infrared)
        assert frame.color_encoded == jpeg
        assert frame.stamp_ns == 1000 * stamp_us
    found = session.calibration
    assert found.depth.fx == pytest.approx(50.4) and found.color.cx == 48.0
    assert found.depth.k1 == pytest.approx(0.1, abs=1e-3)
    np.testing.assert_allclose(found.color_from_depth.translation_m, np.array(SHIFT_MM) / 1000, rtol=1e-6)


def test_lost_images_are_counted_and_the_order_is_that_of_time(tmp_path):
    recorded = frames(6)
    source = open_source(bag(tmp_path, [recorded[n] for n in (4, 0, 1, 5)]))
    assert isinstance(source, OrbbecRecording)
    assert "2 depth images were lost while it was recorded" in source.notes
    assert [frame.stamp_ns for frame in source] == [1000 * recorded[n][1] for n in (0, 1, 4, 5)]


@pytest.mark.parametrize(("unit", "note"), [(0.5, False), (2.2e-44, True)])
def test_the_unit_of_depth_counts_where_there_is_one(tmp_path, monkeypatch, unit, note):
    """Some versions of the SDK write another thing in its place."""
    message = orbbec_files.image_message
    plain = struct.pack("<f", 1.0)

    def with_unit(number, stamp_us, pixels, encoding, shape):
        data = message(number, stamp_us, pixels, encoding, shape)
        at = len(data) - struct.calcsize("<fQQQQII")
        assert data[at : at + 4] == plain
        return data[:at] + struct.pack("<f", unit) + data[at + 4 :]

    monkeypatch.setattr(orbbec_files, "image_message", with_unit)
    (number, stamp_us, depth, *rest) = frames(1)[0]
    source = open_source(bag(tmp_path, [(number, stamp_us, depth // 2 * 2, *rest)]))
    expected = depth // 2 * 2 if note else depth // 2
    np.testing.assert_array_equal(next(iter(source)).depth_mm, expected)
    assert ("no depth unit in the recording" in source.notes) == note


def test_without_a_pose_colour_is_kept_but_not_fused(tmp_path, monkeypatch):
    """Where the SDK knows no pose, zeros stand."""
    profile = orbbec_files.profile_message

    def without_pose(stream, *rest):
        data = profile(stream, *rest)
        start = 16 + 2
        return data[:start] + bytes(48) + data[start + 48 :]

    monkeypatch.setattr(orbbec_files, "profile_message", without_pose)
    source = open_source(bag(tmp_path))
    assert source.calibration.color is None
    assert next(iter(source)).color_encoded is not None
    assert "no calibration of the colour camera: its images cannot be fused" in source.notes


def test_what_lacks_a_lens_or_depth_is_refused_in_one_line(tmp_path, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(orbbec, "_profile", lambda data: ())
        with pytest.raises(CalibrationError, match="no intrinsics of the depth camera"):
            open_source(bag(tmp_path))
        (tmp_path / "bolt.bag").unlink()
    monkeypatch.setattr(orbbec_files, "DEPTH", 7)
    with pytest.raises(FormatError, match="has no depth images"):
        open_source(bag(tmp_path))


def test_a_cut_message_is_damage(tmp_path, monkeypatch):
    message = orbbec_files.image_message
    monkeypatch.setattr(orbbec_files, "image_message", lambda *a: message(*a)[:200])
    with pytest.raises(FormatError, match="cannot be read"):
        open_source(bag(tmp_path))


def test_declared_intrinsics_of_any_dialect_replace_the_recording_s(tmp_path):
    """A matrix without a size is of the recording's images, and the notes name its file as their origin."""
    file = tmp_path / "K.txt"
    np.savetxt(file, Intrinsics(64, 58, 60, 61, 30, 29).matrix)
    path = bag(tmp_path)
    source = open_source(path, ImportOptions(intrinsics=file))
    assert source.calibration.depth == Intrinsics(64, 58, 60, 61, 30, 29)
    assert source.calibration.color == open_source(path).calibration.color
    assert [note for note in source.notes if "intrinsics" in note] == [
        "depth intrinsics from K.txt, as declared"
    ]
