"""Opening a session reads its index, which is what a scan of the whole file finds, or is not used."""

import json
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.writer import Writer

from sensors.errors import FormatError
from sensors.importers.folder import ImageFolder
from sensors.importers.open_source import open_source
from sensors.rig.frame import RigFrame
from sensors.rig.rig_calibration import RigCalibration, calibration_to_json
from sensors.session import index as index_module
from sensors.session import mcap_records
from sensors.session.index import read_contents, scan
from sensors.session.mcap_records import record_offsets
from sensors.session.messages import DEPTH
from sensors.session.reader import Session
from sensors.session.stored_index import NAME, ContradictionError, StoredIndex, read_index
from sensors.session.summary import read_summary
from sensors.session.writer import SessionWriter
from tests.conftest import assert_refused
from tests.helpers.depth_files import NUMBERS, depth_image, png, write
from tests.test_sensors_session import (
    DEPTH_CAMERA,
    PERIOD_NS,
    assert_same,
    cut_off,
    frames,
    law,
    record,
)
from tests.test_session_foreign import EMPTY, packed


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Path:
    return record(tmp_path_factory.mktemp("session") / "rig.mcap", frames(8))


def bytes_read() -> int:
    """Return the bytes that this process has read, caches included (proc(5), "rchar")."""
    return int(Path("/proc/self/io").read_text().split()[1])


def assert_alike(one, other) -> None:
    assert calibration_to_json(one.calibration) == calibration_to_json(other.calibration)
    assert (one.metadata, one.events) == (other.metadata, other.events)
    assert one.places.keys() == other.places.keys()
    for topic, places in one.places.items():
        np.testing.assert_array_equal(places, other.places[topic])


def scanned(path: Path):
    with path.open("rb") as file:
        return scan(file)


@given(data=st.data())
@law
def test_the_index_is_what_a_scan_of_the_whole_file_finds(tmp_path, data):
    """Colour beside, before and behind depth; chunks that end by their size or by a frame."""
    path, times = tmp_path / "x.mcap", st.integers(0, 10**6)
    recorded = frames(3)
    with SessionWriter(path, RigCalibration(DEPTH_CAMERA), "x", overwrite=True) as writer:
        for number in data.draw(st.lists(st.integers(0, 2), min_size=1, max_size=12)):
            if data.draw(st.booleans()):
                writer.event(data.draw(times), "marked", data.draw(times))
            if data.draw(st.booleans()):
                writer.flush()
            writer.write_depth(recorded[number].depth_mm, data.draw(times), data.draw(times))
    with path.open("rb") as file:
        assert read_index(file, read_summary(file)) is not None
    assert_alike(read_contents(path), scanned(path))


def test_opening_reads_a_twentieth_of_the_file_at_most(tmp_path):
    path, rng = tmp_path / "x.mcap", np.random.default_rng(0)
    images = rng.integers(500, 4000, (4, 48, 64)).astype(np.uint16)
    camera = DEPTH_CAMERA.__class__(64, 48, 60.0, 60.0, 32.0, 24.0)
    with SessionWriter(path, RigCalibration(camera), "x") as writer:
        for i in range(1000):
            writer.write(RigFrame(i, 10**9 + i * PERIOD_NS, images[i % 4]))
    before = bytes_read()
    session = Session(path)
    opening = bytes_read() - before
    assert len(session) == 1000
    assert opening < path.stat().st_size / 20
    session.frame(900)
    assert bytes_read() - before - opening < path.stat().st_size / 20


def test_what_has_no_index_or_another_files_is_scanned(tmp_path, whole, monkeypatch):
    cut = cut_off(tmp_path / "cut.mcap", whole, whole.stat().st_size - 1)
    spoilt = bytearray(whole.read_bytes())
    with whole.open("rb") as file:
        summary = read_summary(file)
    (at,) = (each.offset for each in summary.attachments if each.name == NAME)
    spoilt[at + 100] ^= 1
    bad = tmp_path / "bad.mcap"
    bad.write_bytes(spoilt)
    # A program that drops messages and copies the attachment.
    copied = tmp_path / "copied.mcap"
    with whole.open("rb") as file, copied.open("wb") as sink:
        reader, writer, channels = make_reader(file), Writer(sink), {}
        writer.start()
        for schema, channel, message in reader.iter_messages():
            if channel.id not in channels:
                number = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.id] = writer.register_channel(channel.topic, "protobuf", number)
            if channel.topic != DEPTH or message.publish_time != frames(8)[3].stamp_ns:
                times = message.log_time, message.publish_time
                writer.add_message(channels[channel.id], times[0], message.data, times[1])
        for each in reader.iter_attachments():
            writer.add_attachment(each.create_time, each.log_time, each.name, each.media_type, each.data)
        for each in reader.iter_metadata():
            writer.add_metadata(each.name, each.metadata)
        writer.finish()
    whole_files = []
    monkeypatch.setattr(index_module, "scan", lambda file: whole_files.append(file.name) or scan(file))
    assert_alike(read_contents(bad), read_contents(whole))
    assert len(read_contents(cut).places[DEPTH]) == 8
    assert len(read_contents(copied).places[DEPTH]) == 7
    assert whole_files == [str(bad), str(cut), str(copied)]


@given(data=st.binary(max_size=200), cut=st.integers(0, 10**4), flip=st.integers(0, 10**5))
@law
def test_a_spoilt_index_is_refused(whole, data, cut, flip):
    with whole.open("rb") as file:
        summary = read_summary(file)
        encoded = read_index(file, summary).encode()
    spoilt = bytearray(encoded)
    spoilt[flip % len(spoilt)] ^= 1 << flip % 8
    for bad in (data, encoded[: cut % len(encoded)], bytes(spoilt)):
        try:
            index = StoredIndex.decode(bad)
        except ContradictionError:
            continue
        assert index.columns.shape[0] == 5


@pytest.mark.parametrize("hidden", [False, True])
def test_a_damaged_chunk_costs_its_frame_alone(annotate_cloud, tmp_path, whole, hidden):
    """It opens; `validate`, `info` and `label` name the frame, and the others are labelled.

    hidden: the opcode of a chunk is made unknown.
    """
    data, path = bytearray(whole.read_bytes()), tmp_path / "x.mcap"
    with whole.open("rb") as file:
        at = [offset for offset in record_offsets(file) if data[offset] == Opcode.CHUNK][4]
    data[at if hidden else at + 200] ^= 0x70
    path.write_bytes(data)
    session = Session(path)
    broken = []
    for i, original in enumerate(frames(8)):
        try:
            assert_same(original, session.frame(i))
        except FormatError as error:
            assert f"annotate-cloud repair {path}" in str(error)
            broken.append(i)
    assert len(broken) == 1
    name = f"frame {broken[0]:06d}"
    assert name in annotate_cloud("validate", path).out
    assert annotate_cloud("info", path).code == 0
    done = annotate_cloud("label", path, "--out", tmp_path / "labels", "--json")
    assert done.code == 3 and done.result["frames"] == 7 and name in done.err


def test_many_empty_messages_are_refused_without_their_objects(tmp_path, monkeypatch):
    """A few kilobytes that unpack to 3 MB of messages of 31 bytes each, which as objects take 20 MB."""
    monkeypatch.setattr(mcap_records, "MAX_CHUNK_RECORDS", 50_000, raising=False)
    bomb = packed(tmp_path / "bomb.mcap", EMPTY * 100_000)
    assert bomb.stat().st_size < 20_000
    tracemalloc.start()
    try:
        with pytest.raises(FormatError, match="a chunk has more than"):
            Session(bomb)
        with pytest.raises(FormatError, match="a chunk has more than"):
            open_source(bomb)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 12_000_000


def test_a_session_of_too_many_messages_is_refused(annotate_cloud, tmp_path, whole, monkeypatch):
    cut = cut_off(tmp_path / "cut.mcap", whole, whole.stat().st_size - 1)
    monkeypatch.setattr(index_module, "MAX_MESSAGES", 20)
    assert_refused(annotate_cloud("info", cut), "more than 20 messages")


def test_a_frame_of_a_folder_is_read_without_the_others(tmp_path, monkeypatch):
    write(tmp_path / "intrinsics.json", json.dumps(NUMBERS).encode())
    image = png(depth_image())
    for number in range(300):
        write(tmp_path / "depth" / f"{number}.png", image)
    source = ImageFolder(tmp_path)
    before = bytes_read()
    frame = source.frame(250)
    assert bytes_read() - before < 3 * len(image)
    assert (frame.index, frame.stamp_ns) == (250, source.times_ns[250])
    with pytest.raises(IndexError):
        source.frame(300)
    with pytest.raises(IndexError):
        source.frame(-1)


def test_a_session_cut_in_front_of_its_first_image_is_named(rig_session, tmp_path):
    data = rig_session.read_bytes()
    path = tmp_path / "cut.mcap"
    for size in (400, 2000, 4000):
        path.write_bytes(data[:size])
        with pytest.raises(FormatError, match="was cut off in front of its first depth image"):
            open_source(path)
