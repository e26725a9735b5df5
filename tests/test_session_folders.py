"""A folder of sessions is never one recording; a session that other programs rewrite stays a session."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer

from cli import sessions as batch
from sensors.errors import CloudError
from sensors.importers.bags.bag import Bag
from sensors.importers.open_source import open_source
from sensors.rig.pairing import CLOCK
from sensors.rig.rig_calibration import RigCalibration
from sensors.session.messages import COLOR, DEPTH, color_message
from sensors.session.reader import Session
from sensors.session.writer import SessionWriter
from tests.conftest import assert_refused
from tests.helpers.bags import STORAGES, realsense, write_bag
from tests.test_sensors_session import DEPTH_CAMERA, JPEG, RIG, assert_same, frames, record


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Path:
    return record(tmp_path_factory.mktemp("session") / "rig.mcap", frames(5))


@pytest.fixture
def two(tmp_path, whole) -> Path:
    folder = tmp_path / "sessions"
    folder.mkdir()
    for name in ("s2.mcap", "s10.mcap"):
        shutil.copy(whole, folder / name)
    return folder


def test_info_and_validate_list_each_session(annotate_cloud, two):
    found = annotate_cloud("info", two, "--json").result["recordings"]
    assert [(name, one["kind"], one["frames"]) for name, one in found.items()] == [
        ("s2.mcap", "Session", 5),
        ("s10.mcap", "Session", 5),
    ]
    text = annotate_cloud("info", two).out
    assert "s2.mcap" in text and "s10.mcap" in text
    data = bytearray((two / "s10.mcap").read_bytes())
    data[len(data) // 2] ^= 1
    (two / "s10.mcap").write_bytes(data)
    checked = annotate_cloud("validate", two, "--json")
    assert checked.code == 1 and checked.result["problems"]
    assert all(problem.startswith("s10.mcap: ") for problem in checked.result["problems"])


@pytest.mark.parametrize("beside", [False, True])
def test_a_folder_of_sessions_is_no_recording(annotate_cloud, tmp_path, two, beside):
    if beside:
        (bag,) = write_bag(tmp_path / "bag", STORAGES[1], realsense(2)).glob("*.mcap")
        shutil.copy(bag, two / "other.mcap")
    named = ("2 sessions", two / "s2.mcap", *(["other.mcap"] if beside else []))
    assert_refused(annotate_cloud("import", two, tmp_path / "x.mcap"), *named)
    assert_refused(annotate_cloud("live", two, "--no-window"), *named)
    with pytest.raises(CloudError, match="2 sessions"):
        open_source(two)
    assert bool(batch.sessions_in(two, None)) != beside
    if beside:
        assert_refused(annotate_cloud("predict", two, "--out", tmp_path / "p"), *named)
        assert "other.mcap" in annotate_cloud("info", two).out
    assert not list(tmp_path.glob("x.mcap*"))


def rewritten(
    source: Path,
    out: Path,
    *,
    metadata="",
    drop="",
    **how,
) -> Path:
    """A session as the plain mcap library rewrites it. metadata: first, last or "" for none."""
    size, compression = how.get("chunk_size", 1 << 20), how.get("compression", CompressionType.ZSTD)
    with source.open("rb") as file:
        reader = make_reader(file)
        messages = [m for m in reader.iter_messages() if not (drop and m[1].topic.startswith(drop))]
        records = list(reader.iter_metadata())
    if how.get("shuffle"):
        messages = [messages[i] for i in np.random.default_rng(0).permutation(len(messages))]
    with out.open("wb") as file:
        writer = Writer(file, size, compression, use_chunking=how.get("chunked", True))
        writer.start()
        channels: dict[str, int] = {}
        for record_ in records if metadata == "first" else ():
            writer.add_metadata(record_.name, record_.metadata)
        for schema, channel, message in messages:
            if channel.topic not in channels:
                number = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.topic] = writer.register_channel(
                    channel.topic, channel.message_encoding, number, channel.metadata
                )
            writer.add_message(channels[channel.topic], message.log_time, message.data, message.publish_time)
        for record_ in records if metadata == "last" else ():
            writer.add_metadata(record_.name, record_.metadata)
        writer.finish()
    return out


@pytest.mark.parametrize(
    ("metadata", "how"),
    [
        ("first", {}),
        ("last", {"shuffle": True}),
        ("", {"chunked": False}),
        ("last", {"compression": CompressionType.LZ4}),
        ("", {"compression": CompressionType.NONE, "shuffle": True}),
    ],
    ids=str,
)
def test_a_rewritten_session_is_one(tmp_path, whole, metadata, how):
    source = open_source(rewritten(whole, tmp_path / "x.mcap", metadata=metadata, **how))
    assert isinstance(source, Session)
    assert source.name == ("rig 7" if metadata else "x")
    for original, copy in zip(frames(5), source, strict=True):
        assert_same(original, copy)


@pytest.mark.parametrize("metadata", ["last", ""])
def test_without_its_colour_it_is_one(tmp_path, whole, metadata):
    """All of /color* is dropped, the pose in /tf remains."""
    source = open_source(rewritten(whole, tmp_path / "x.mcap", metadata=metadata, drop="/color"))
    assert isinstance(source, Session)
    assert source.calibration.color is None and source.calibration.thermal is not None
    assert "no colour images" in source.notes
    for original, copy in zip(frames(5), source, strict=True):
        assert copy.color_encoded is None
        np.testing.assert_array_equal(copy.thermal_c, original.thermal_c)
    alone = open_source(rewritten(whole, tmp_path / "y.mcap", metadata=metadata, drop="/tf"))
    assert alone.calibration == RigCalibration(DEPTH_CAMERA)


def test_what_a_rewriting_program_dropped_is_said(tmp_path, whole):
    path, depth = tmp_path / "rec.mcap", np.ones((24, 32), np.uint16)
    metadata = {f"{CLOCK}{topic}": topic for topic in (DEPTH, COLOR)}
    with SessionWriter(path, RIG, "rig", metadata=metadata) as writer:
        for i in range(3):
            writer.write_depth(depth, 10**9 + i * 10**8, 10**9 + i * 10**8 + 5_000_000)
            writer.add(COLOR, color_message(JPEG, i * 10**8), i * 10**8, 10**9 + i * 10**8 + 5_000_000)
    assert [frame.color_encoded is not None for frame in Session(path)] == [True] * 3
    assert not any("clock" in note for note in Session(path).notes)
    lost = Session(rewritten(path, tmp_path / "lost.mcap"))
    assert any("clock" in note for note in lost.notes)
    uncalibrated = Session(rewritten(path, tmp_path / "bare.mcap", metadata="first", drop="/tf"))
    assert "no calibration of the colour camera: its images cannot be fused" in uncalibrated.notes
    assert not any("clock" in note for note in uncalibrated.notes)


def test_another_programs_file_is_no_session(tmp_path):
    for storage in STORAGES[1:]:
        (bag,) = write_bag(tmp_path / "bag", storage, realsense(2)).glob("*.mcap")
        assert isinstance(open_source(bag), Bag) and isinstance(open_source(bag.parent), Bag)
        # A file that a killed recorder left has no summary.
        data = bag.read_bytes()
        with bag.open("rb") as file:
            *_, last = StreamReader(file, emit_chunks=True).records
        bag.write_bytes(data[: last.summary_start - 13])
        assert isinstance(open_source(bag), Bag)


def test_one_session_that_cannot_be_read_leaves_the_others(tmp_path):
    def work(name: str) -> str:
        if name == "b":
            raise OSError(5, "Input/output error", "b.mcap")
        return name

    done, failed = batch.each("work", work, {name: (name,) for name in "abc"}, None)
    assert done == {"a": "a", "c": "c"} and "Input/output error" in failed["b"]
