"""A session survives to the bit, a killed one up to its last frame; damage never goes unnoticed."""

import os
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from sensors.errors import CalibrationError, CloudError, ExistsError, FormatError
from sensors.rig.camera import Intrinsics
from sensors.rig.frame import RigFrame
from sensors.rig.pairing import COLOR_WINDOW_NS
from sensors.rig.rig_calibration import Pose, RigCalibration
from sensors.session.messages import (
    COLOR,
    COUNTS,
    DEPTH,
    INFRARED,
    PYROMETER,
    SCHEMAS,
    SHIFT,
    THERMAL,
    calibration_from,
    calibration_messages,
    color_message,
    image_from,
    image_message,
    spot_message,
    thermal_from_uint16,
    thermal_message,
)
from sensors.session.reader import Session
from sensors.session.repair import repair
from sensors.session.writer import RepeatableWriter, SessionWriter
from tests.conftest import assert_refused

law = settings(deadline=None, max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])

DEPTH_CAMERA = Intrinsics(32, 24, 30.0, 31.0, 15.5, 11.5, k1=0.09, k2=-0.27, p1=1e-4, p2=-5e-4, k3=0.1)
_TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
RIG = RigCalibration(
    depth=DEPTH_CAMERA,
    color=Intrinsics(16, 12, 20.0, 20.0, 7.5, 5.5),
    color_from_depth=Pose(_TURN, np.array([0.052, 0.001, -0.002])),
    thermal=Intrinsics(8, 6, 9.0, 9.0, 3.5, 2.5),
    thermal_from_depth=Pose(np.eye(3), np.array([-0.03, 0.06, 0.0])),
)
PERIOD_NS = 33_333_333
JPEG = bytes(cv2.imencode(".jpg", np.full((12, 16, 3), 90, np.uint8))[1])


def frames(n: int, seed: int = 0) -> list[RigFrame]:
    rng = np.random.default_rng(seed)
    return [
        RigFrame(
            index=i,
            stamp_ns=10**18 + i * PERIOD_NS,
            depth_mm=rng.integers(0, 65536, (24, 32), np.uint16),
            color_encoded=JPEG + bytes(rng.integers(0, 256, 9, np.uint8)),
            thermal_c=thermal_from_uint16(rng.integers(0, 65536, (6, 8), np.uint16)),
            infrared=rng.integers(0, 65536, (24, 32), np.uint16),
        )
        for i in range(n)
    ]


def record(path: Path, recorded: list[RigFrame], calibration: RigCalibration = RIG) -> Path:
    with SessionWriter(path, calibration, "rig 7", metadata={"subject": "s01"}) as writer:
        for frame in recorded:
            writer.write(frame)
        writer.event(recorded[0].stamp_ns, "flag closed")
        for i, stamp in enumerate((recorded[0].stamp_ns, recorded[-1].stamp_ns)):
            writer.add(PYROMETER, spot_message(30.0 + i, 25.0, float("nan"), stamp), stamp)
        counts = image_message(np.arange(48, dtype=np.uint16).reshape(6, 8), "thermal", stamp)
        writer.add(COUNTS, counts, recorded[0].stamp_ns)
    return path


def assert_same(a: RigFrame, b: RigFrame) -> None:
    assert (a.index, a.stamp_ns, a.color_encoded) == (b.index, b.stamp_ns, b.color_encoded)
    np.testing.assert_array_equal(a.depth_mm, b.depth_mm)
    np.testing.assert_array_equal(a.thermal_c, b.thermal_c)
    np.testing.assert_array_equal(a.infrared, b.infrared)


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Path:
    return record(tmp_path_factory.mktemp("session") / "rig.mcap", frames(8))


def test_a_session_survives_to_the_bit(whole):
    session = Session(whole)
    for original, copy in zip(frames(8), session, strict=True):
        assert_same(original, copy)
    assert_same(session.frame(5), frames(8)[5])
    assert (session.name, session.metadata, len(session)) == ("rig 7", {"subject": "s01"}, 8)
    assert session.events == ((10**18, "flag closed"),)
    assert not session.truncated
    assert not session.notes
    assert {topic: stream.count for topic, stream in session.streams.items()} == {
        DEPTH: 8,
        COLOR: 8,
        THERMAL: 8,
        INFRARED: 8,
        COUNTS: 1,
        PYROMETER: 2,
    }
    np.testing.assert_allclose(session.reference_c, np.linspace(30, 31, 8), atol=1e-6)
    assert session.streams[DEPTH].rate_hz == pytest.approx(30, abs=0.001)
    assert not list(whole.parent.glob("*.partial"))


def test_the_public_reader_decodes_all_of_it(whole):
    with whole.open("rb") as file:
        decoded = list(
            make_reader(
                file, validate_crcs=True, decoder_factories=[DecoderFactory()]
            ).iter_decoded_messages()
        )
    names = {channel.topic: schema.name for schema, channel, _, _ in decoded}
    expected = {topic: schema.DESCRIPTOR.full_name for topic, schema in SCHEMAS.items() if topic != SHIFT}
    assert names == expected
    depth = [message for _, channel, _, message in decoded if channel.topic == DEPTH]
    values = np.frombuffer(depth[3].data, "<u2").reshape(depth[3].height, depth[3].width)
    np.testing.assert_array_equal(values, frames(8)[3].depth_mm)
    assert (depth[3].encoding, depth[3].frame_id) == ("16UC1", "depth")
    assert depth[3].timestamp.ToNanoseconds() == frames(8)[3].stamp_ns


def stored(celsius):
    """uint16 (h, w) on the documented scale, as a thermal message holds it."""
    return image_from(thermal_message(celsius, 0).SerializeToString(), "thermal")


@given(values=arrays(np.uint16, (5, 7)))
@law
def test_the_thermal_scale_is_invertible(values):
    np.testing.assert_array_equal(stored(thermal_from_uint16(values)), values)


def test_the_thermal_scale_saturates_and_marks_what_is_no_reading():
    values = np.array([[np.nan, np.inf, -1e9, -99.99, 36.6, 555.35, 1e9]], np.float32)
    np.testing.assert_array_equal(stored(values), [[0, 0, 1, 1, 13660, 65535, 65535]])


@given(seed=st.integers(0, 2**32 - 1))
@law
def test_the_calibration_messages_are_invertible(seed):
    copy = calibration_from({t: m.SerializeToString() for t, m in calibration_messages(RIG, seed)})
    assert (copy.depth, copy.color, copy.thermal) == (RIG.depth, RIG.color, RIG.thermal)
    for name in ("color_from_depth", "thermal_from_depth"):
        for part in ("rotation", "translation_m"):
            ours, theirs = (getattr(getattr(rig, name), part) for rig in (copy, RIG))
            np.testing.assert_allclose(ours, theirs, atol=1e-12)


def test_unsynchronised_streams_pair_by_device_time(tmp_path):
    path, depth = tmp_path / "live.mcap", np.ones((24, 32), np.uint16)
    late = PERIOD_NS // 3
    with SessionWriter(path, RIG, "live") as writer:
        for i in range(1, 7):
            writer.write_depth(depth * i, i * PERIOD_NS, arrival_ns=10**15 + i * PERIOD_NS)
            if i % 2:  # colour at half the rate, arriving after its depth image
                stamp = i * PERIOD_NS + late
                writer.add(COLOR, color_message(JPEG, stamp), stamp, 10**15 + i * PERIOD_NS + 9)
    with_color = [frame.color_encoded is not None for frame in Session(path)]
    assert late < COLOR_WINDOW_NS
    assert with_color == [True, False] * 3
    assert "no thermal images" in Session(path).notes


def test_depth_alone_is_a_session(tmp_path):
    alone = [RigFrame(i, i * PERIOD_NS, f.depth_mm) for i, f in enumerate(frames(3))]
    session = Session(record(tmp_path / "depth.mcap", alone, RigCalibration(DEPTH_CAMERA)))
    assert session.notes[:2] == ("no colour images", "no thermal images")
    assert "counts" in session.notes[2]
    assert all(f.color_encoded is None and f.thermal_c is None for f in session)
    assert session.calibration == RigCalibration(DEPTH_CAMERA)


def test_nothing_is_overwritten_unasked(tmp_path):
    path = record(tmp_path / "a.mcap", frames(1))
    before = path.read_bytes()
    with pytest.raises(ExistsError, match="choose another name"):
        record(path, frames(2))
    (tmp_path / "b.mcap.partial").write_bytes(b"an unfinished recording")
    with pytest.raises(ExistsError, match="partial"):
        record(tmp_path / "b.mcap", frames(2))
    assert path.read_bytes() == before
    with SessionWriter(path, RIG, "new", overwrite=True) as writer:
        writer.write(frames(1)[0])
    assert Session(path).name == "new"


@pytest.mark.parametrize("writer", [SessionWriter, RepeatableWriter])
def test_an_interrupted_session_never_gets_its_final_name(tmp_path, writer):
    path = tmp_path / "a.mcap"
    with (
        pytest.raises(KeyboardInterrupt),
        writer(path, RIG, "rig") as writer,
    ):
        for frame in frames(3):
            writer.write(frame)
        raise KeyboardInterrupt
    assert not path.exists()
    assert writer.partial.exists() == writer.keeps_partial
    if writer.keeps_partial:
        session = Session(writer.partial)
        assert session.truncated
        assert len(list(session)) == 3


def cut_off(path: Path, whole: Path, size: int) -> Path:
    path.write_bytes(whole.read_bytes()[:size])
    return path


@given(share=st.floats(0, 1, exclude_max=True))
@law
def test_cut_anywhere_it_is_a_prefix_that_repair_keeps_or_an_error(tmp_path, whole, share):
    cut = cut_off(tmp_path / "cut.mcap.partial", whole, int(share * whole.stat().st_size))
    before, path = cut.read_bytes(), tmp_path / "cut.mcap"
    try:
        session = Session(cut)
        left = list(session)
    except CloudError as error:
        assert "\n" not in str(error)
        with pytest.raises(CloudError):
            repair(cut)
        assert cut.read_bytes() == before and not path.exists()
        return
    assert session.truncated
    for original, copy in zip(frames(8), left, strict=False):
        assert_same(original, copy)
    done = repair(path)
    assert (done.path, done.frames, done.changed) == (path, len(left), True)
    assert done.damaged <= 1 and (done.lost_bytes > 0) == (done.damaged > 0)
    assert 0 <= done.lost_s <= 2 * PERIOD_NS * 1e-9
    mended = Session(path)
    assert not mended.truncated and not [note for note in mended.notes if "truncated" in note]
    assert (mended.name, mended.metadata) == ("rig 7", {"subject": "s01"})
    for a, b in zip(left, mended, strict=True):
        assert_same(a, b)
    with path.open("rb") as file:
        assert make_reader(file).get_summary() is not None
    assert cut.read_bytes() == before
    assert sorted(p.name for p in tmp_path.iterdir()) == ["cut.mcap", "cut.mcap.partial"]
    path.unlink()


def test_a_recording_that_was_cut_off_is_found_by_its_name(annotate_cloud, tmp_path, whole):
    path, partial = tmp_path / "take.mcap", tmp_path / "take.mcap.partial"
    cut_off(partial, whole, whole.stat().st_size // 2)
    count = len(Session(path))
    for given_path in (path, partial):
        info = annotate_cloud("info", given_path, "--json").result
        assert (info["truncated"], info["frames"]) == (True, count)
        assert f"annotate-cloud repair {partial}" in " ".join(info["notes"])
    assert f"annotate-cloud repair {partial}" in annotate_cloud("validate", path).out
    done = annotate_cloud("repair", path, "--json").result
    expected = {"session": str(path), "frames": count, "lost_frames": None, "damaged": 1, "changed": True}
    assert done == done | expected and set(done) - set(expected) == {"lost_seconds", "lost_bytes"}
    assert 0 < done["lost_bytes"] < partial.stat().st_size / 4
    assert annotate_cloud("validate", path).code == 0
    assert annotate_cloud("repair", path).out == f"{path} is whole, with {count} frames; nothing to repair\n"
    assert_refused(annotate_cloud("repair", partial), path, "--overwrite")
    assert_refused(annotate_cloud("repair", tmp_path / "typo.mcap"), "typo.mcap", "does not exist")
    assert partial.exists() and annotate_cloud("repair", partial, "--overwrite").code == 0


def test_frames_come_in_the_order_of_their_stamps(tmp_path):
    shuffled = [frames(5)[i] for i in (2, 0, 4, 1, 3)]
    for original, copy in zip(frames(5), Session(record(tmp_path / "x.mcap", shuffled)), strict=True):
        assert_same(original, copy)


@given(data=st.data())
@law
def test_flipped_anywhere_it_is_an_error_or_what_was_recorded(tmp_path, whole, data):
    damaged = bytearray(whole.read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        damaged[data.draw(st.integers(0, len(damaged) - 1))] ^= data.draw(st.integers(1, 255))
    broken = tmp_path / "flipped.mcap"
    broken.write_bytes(damaged)
    try:
        copies = list(Session(broken))
    except CloudError as error:
        assert "\n" not in str(error)
        return
    for original, copy in zip(frames(8), copies, strict=False):
        np.testing.assert_array_equal(copy.depth_mm, original.depth_mm)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "empty"),
        (b"not an MCAP file", "not an MCAP"),
        (b"\x89MCAP0\r\n" + b"junk" * 20, "x.mcap"),
    ],
)
def test_what_is_no_session_is_named(tmp_path, content, says):
    path = tmp_path / "x.mcap"
    path.write_bytes(content)
    for action in (lambda: Session(path), lambda: repair(path, tmp_path / "y.mcap")):
        with pytest.raises(FormatError, match=says):
            action()
    assert not (tmp_path / "y.mcap").exists()


def test_the_writer_refuses_what_it_could_not_read_back(tmp_path):
    with SessionWriter(tmp_path / "a.mcap", RIG, "\x1b[31mred\n") as writer:
        with pytest.raises(CalibrationError, match="is 3x3 but"):
            writer.write_depth(np.ones((3, 3), np.uint16), 0)
        with pytest.raises(FormatError, match="JPEG or PNG"):
            writer.add(COLOR, color_message(b"GIF89a", 0), 0)
        with pytest.raises(FormatError, match="time -1"):
            writer.write_depth(np.ones((24, 32), np.uint16), -1)
        writer.write(frames(1)[0])
    session = Session(tmp_path / "a.mcap")
    assert (len(session), session.name) == (1, "[31mred")


def test_a_full_disk_leaves_no_final_file(tmp_path):
    if not Path("/dev/full").exists() or os.name != "posix":
        pytest.skip("no /dev/full on this system")
    path = tmp_path / "a.mcap"
    (tmp_path / "a.mcap.partial").symlink_to("/dev/full")
    with pytest.raises(OSError, match="space"), SessionWriter(path, RIG, "rig", overwrite=True) as writer:
        writer.write(frames(1)[0])
    assert not path.exists()
