"""Repair keeps every frame that is sound, bit for bit, states the losses, and leaves the source alone."""

import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.opcode import Opcode
from mcap.reader import make_reader

import sensors.session.repair
from sensors.errors import CloudError, ExistsError, FormatError
from sensors.rig.camera import Intrinsics
from sensors.rig.rig_calibration import RigCalibration, calibration_to_json
from sensors.session.mcap_records import record_offsets
from sensors.session.reader import Session
from sensors.session.repair import problems_of, repair
from sensors.session.summary import read_summary
from sensors.session.writer import SessionWriter
from tests.conftest import assert_refused
from tests.test_sensors_session import frames, law, record
from tests.test_session_folders import rewritten

COUNT = 12
REGIONS = (
    "any",
    "magic",
    "header",
    "metadata",
    "first chunk",
    "head of a chunk",
    "index of a chunk",
    "stored index",
    "begin of the summary",
    "summary",
    "footer",
    "killed",
)


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Path:
    return record(tmp_path_factory.mktemp("session") / "rig.mcap", frames(COUNT))


def flipped(path: Path, data: bytes, *bits: int) -> Path:
    """A copy of a file's bytes with bits changed."""
    spoilt = bytearray(data)
    for bit in bits:
        spoilt[bit // 8] ^= 1 << bit % 8
    path.write_bytes(spoilt)
    return path


def chunks_of(path: Path) -> list[int]:
    data = path.read_bytes()
    with path.open("rb") as file:
        return [offset for offset in record_offsets(file) if data[offset] == Opcode.CHUNK]


def kept(path: Path) -> int:
    """Number of frames, each of which is the original's to the bit."""
    originals = {frame.stamp_ns: frame for frame in frames(COUNT)}
    session = Session(path)
    for frame in session:
        original = originals[frame.stamp_ns]
        np.testing.assert_array_equal(frame.depth_mm, original.depth_mm)
        for copy, own in ((frame.thermal_c, original.thermal_c), (frame.infrared, original.infrared)):
            if copy is not None:
                np.testing.assert_array_equal(copy, own)
        assert frame.color_encoded in (None, original.color_encoded)
    return len(session)


def regions(path: Path) -> dict[str, tuple[int, int]]:
    """First and last byte + 1 of what lies in a session's file."""
    with path.open("rb") as file:
        summary, offsets = read_summary(file), list(record_offsets(file))
    chunks, size = chunks_of(path), path.stat().st_size
    return {
        "any": (0, size),
        "magic": (0, 8),
        "header": (8, offsets[1]),
        "metadata": (offsets[1], chunks[0]),
        "first chunk": (chunks[0], chunks[1]),
        "head of a chunk": (chunks[5], chunks[5] + 60),
        "index of a chunk": (offsets[offsets.index(chunks[5]) + 1], chunks[6]),
        "stored index": (summary.attachments[0].offset, summary.start),
        "begin of the summary": (summary.start, summary.start + 9),
        "summary": (summary.start, size - 37),
        "footer": (size - 37, size),
    }


@given(name=st.sampled_from(REGIONS), share=st.floats(0, 1, exclude_max=True))
@settings(law, max_examples=80)
def test_one_bit_costs_one_frame_at_most(tmp_path, whole, name, share):
    """Wherever it is; "killed": in a recording without a summary, behind its first chunk, which alone holds
    schemas, channels and calibration."""
    data, partial = whole.read_bytes(), name == "killed"
    if partial:
        low, high = chunks_of(whole)[1], regions(whole)["stored index"][0]
        data = data[:high]
    else:
        low, high = regions(whole)[name]
    path = flipped(tmp_path / "x.mcap", data, 8 * low + int(share * 8 * (high - low)))
    before, out = path.read_bytes(), tmp_path / "x.repaired.mcap"
    done = repair(path, overwrite=True)
    assert path.read_bytes() == before
    assert done.changed and done.path == out
    assert done.frames == kept(out) >= COUNT - 1
    session, original = Session(out), Session(whole)
    assert (session.name, session.metadata) == (original.name, original.metadata)
    assert calibration_to_json(session.calibration) == calibration_to_json(original.calibration)
    if not partial:
        assert done.lost_frames == COUNT - done.frames
        assert session.events == original.events
        assert (done.lost_bytes > 0) == (done.damaged > 0) >= (done.lost_frames > 0)
    assert problems_of(out) == [] and not repair(out).changed
    with out.open("rb") as file:
        assert len(list(make_reader(file, validate_crcs=True).iter_messages())) > 0


@given(data=st.data(), end=st.booleans())
@law
def test_many_bits_cost_as_many_frames(tmp_path, whole, data, end):
    """In as many chunks behind the first; end: the summary is spoilt too."""
    places = chunks_of(whole)[1:]
    spoilt = data.draw(st.lists(st.sampled_from(range(len(places) - 1)), max_size=4, unique=True))
    bits = [
        data.draw(st.integers(8 * places[number], 8 * places[number + 1] - 1), label="bit")
        for number in spoilt
    ]
    size = whole.stat().st_size
    bits += [8 * (size - 30)] * end
    path = flipped(tmp_path / "x.mcap", whole.read_bytes(), *bits)
    done = repair(path, overwrite=True)
    if bits:
        assert done.frames == kept(done.path) >= COUNT - len(spoilt)
        assert done.lost_s <= (len(spoilt) + 1) / 30 + 1e-6


def test_no_length_hides_what_follows(tmp_path, whole):
    """Each bit of the lengths of a chunk, its index and the metadata, in a recording that was killed."""
    high, at = regions(whole)["stored index"][0], chunks_of(whole)[4]
    data = whole.read_bytes()[:high]
    (length,) = struct.unpack_from("<Q", data, at + 1)
    for begin in (at + 1, at + 9 + length + 1, regions(whole)["metadata"][0] + 1):
        for bit in range(40):
            done = repair(flipped(tmp_path / "x.mcap", data, 8 * begin + bit), overwrite=True)
            assert done.frames == kept(done.path) >= COUNT - 1


def test_it_says_what_is_gone_and_replaces_nothing(annotate_cloud, tmp_path, whole):
    at = chunks_of(whole)[4]
    path = flipped(tmp_path / "take.mcap", whole.read_bytes(), 8 * (at + 200))
    before = path.read_bytes()
    done = annotate_cloud("repair", path)
    out = tmp_path / "take.repaired.mcap"
    assert done.code == 0
    for said in (out, f"{COUNT - 1} frames", "left out", "bytes", "1 frame", f"{path} stays as it is"):
        assert str(said) in done.out
    assert_refused(annotate_cloud("repair", path), out, "--overwrite")
    assert_refused(annotate_cloud("repair", path, "--out", path), path, "give another name")
    assert_refused(annotate_cloud("repair", path, "--out", path, "--overwrite"), path, "give another name")
    partial = tmp_path / "cut.mcap.partial"
    partial.write_bytes(whole.read_bytes()[: whole.stat().st_size // 2])
    assert f"{partial} stays as it is" in annotate_cloud("repair", tmp_path / "cut.mcap").out
    assert kept(tmp_path / "cut.mcap") > 3
    with pytest.raises(ExistsError):
        repair(partial)
    assert path.read_bytes() == before and partial.exists()
    assert sorted(file.name for file in tmp_path.iterdir()) == [
        "cut.mcap",
        "cut.mcap.partial",
        "take.mcap",
        "take.repaired.mcap",
    ]


@pytest.mark.parametrize("how", [{"metadata": "last", "chunk_size": 5000}, {"chunked": False}])
def test_sessions_of_other_writers_are_repaired(tmp_path, whole, how):
    other = rewritten(whole, tmp_path / "o.mcap", **how)
    data, size = other.read_bytes(), other.stat().st_size
    path = flipped(tmp_path / "x.mcap", data[: int(0.6 * size)])
    done = repair(path)
    assert 4 <= done.frames == kept(done.path)
    assert done.lost_frames is None


def test_nothing_to_save_is_an_error(tmp_path, whole):
    path, out = tmp_path / "x.mcap", tmp_path / "out.mcap"
    high, first = regions(whole)["stored index"][0], chunks_of(whole)[0]
    nameless = bytearray(whole.read_bytes()[:high])
    nameless[first + 100] ^= 1
    spoiled = bytearray(whole.read_bytes())
    for chunk in chunks_of(whole):
        spoiled[chunk + 100] ^= 1
    junk = (b"", b"junk" * 100, whole.read_bytes()[:300], bytes(10_000))
    for data in (*junk, bytes(nameless), bytes(spoiled)):
        path.write_bytes(data)
        with pytest.raises(CloudError) as error:
            repair(path, out)
        assert "annotate-cloud repair" not in str(error.value)
        assert path.read_bytes() == data and [f.name for f in tmp_path.iterdir()] == ["x.mcap"]


def test_small_images_share_a_chunk_and_too_many_are_refused(tmp_path, monkeypatch):
    """A chunk takes far more time than an empty message, of which a damaged file may hold millions."""
    path = tmp_path / "a.mcap"
    with SessionWriter(path, RigCalibration(Intrinsics(6, 4, 5, 5, 2.5, 1.5)), "a") as writer:
        for number in range(50):
            writer.write_depth(np.ones((4, 6), np.uint16), number)
    path.write_bytes(path.read_bytes()[:-50])
    done = repair(path)
    assert done.frames == len(Session(done.path)) == 50
    with done.path.open("rb") as file:
        assert len(read_summary(file).chunks) <= 3
    done.path.unlink()
    monkeypatch.setattr(sensors.session.repair, "MAX_MESSAGES", 20, raising=False)
    with pytest.raises(FormatError, match="more than 20 messages"):
        repair(path)
    assert list(tmp_path.iterdir()) == [path]
