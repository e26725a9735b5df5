"""Files of other programs and hostile files are read within bounds, or refused in one line."""

import struct
from pathlib import Path

import lz4.frame
import numpy as np
import pytest
import zstandard
from mcap.opcode import Opcode
from mcap.records import Chunk
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer
from mcap_protobuf.schema import register_schema

from sensors.errors import CalibrationError, FormatError
from sensors.rig.rig_calibration import RigCalibration
from sensors.session import index, mcap_records
from sensors.session import messages as messages_module
from sensors.session.messages import (
    COLOR,
    DEPTH,
    SCHEMAS,
    calibration_from,
    calibration_messages,
    image_message,
)
from sensors.session.reader import Session
from sensors.session.repair import repair
from tests.test_sensors_session import DEPTH_CAMERA, cut_off


def foreign(path: Path, messages: list, compression=CompressionType.NONE, encoding="protobuf") -> Path:
    """An MCAP file that another program wrote: (topic, message) pairs."""
    with path.open("wb") as file:
        writer = Writer(file, compression=compression)
        writer.start()
        for i, (topic, message) in enumerate(messages):
            schema = register_schema(writer, type(message))
            channel = writer.register_channel(topic, encoding, schema)
            writer.add_message(channel, i, message.SerializeToString(), i)
        writer.finish()
    return path


CALIBRATION = list(calibration_messages(RigCalibration(DEPTH_CAMERA), 0))
IMAGE = image_message(np.ones((24, 32), np.uint16), "depth", 0)


def altered(**fields):
    message = type(IMAGE)()
    message.CopyFrom(IMAGE)
    for name, value in fields.items():
        setattr(message, name, value)
    return message


@pytest.mark.parametrize(
    ("messages", "kwargs", "error", "says"),
    [
        (CALIBRATION, {}, FormatError, "no depth images"),
        ([(DEPTH, IMAGE)], {}, CalibrationError, "no /depth/calibration"),
        ([*CALIBRATION, (DEPTH, IMAGE)], {"encoding": "cdr"}, FormatError, "not protobuf"),
        ([*CALIBRATION, (COLOR, IMAGE)], {}, FormatError, "CompressedImage"),
        ([*CALIBRATION, (DEPTH, altered(encoding="32FC1"))], {}, FormatError, "32FC1"),
        ([*CALIBRATION, (DEPTH, altered(width=2**31))], {}, FormatError, "bytes a row"),
        ([*CALIBRATION, (DEPTH, altered(height=2**31, step=0))], {}, FormatError, "bytes a row"),
        ([*CALIBRATION, (DEPTH, altered(width=24, height=32, step=48))], {}, CalibrationError, "24x32"),
    ],
)
def test_foreign_files_are_refused_in_one_line(tmp_path, messages, kwargs, error, says):
    with pytest.raises(error, match=says) as caught:
        list(Session(foreign(tmp_path / "x.mcap", messages, **kwargs)))
    assert "\n" not in str(caught.value)


def test_a_decompression_bomb_is_refused(tmp_path):
    """A chunk whose zstd frame unpacks to more than the chunk claims."""
    path = foreign(tmp_path / "x.mcap", [(DEPTH, IMAGE)] * 50, CompressionType.ZSTD)
    data = bytearray(path.read_bytes())
    at = data.index(b"\x04\x00\x00\x00zstd") - 12  # uncompressed_size, then its CRC
    data[at : at + 8] = (100).to_bytes(8, "little")
    path.write_bytes(data)
    with pytest.raises(FormatError, match="more or less than the 100 bytes"):
        Session(path)


def packed(path: Path, data: bytes, compression=CompressionType.ZSTD) -> Path:
    """An MCAP file of one chunk with these bytes."""
    pack = {CompressionType.ZSTD: zstandard.compress, CompressionType.LZ4: lz4.frame.compress}
    stored = pack[compression](data) if compression in pack else data
    name = {CompressionType.ZSTD: b"zstd", CompressionType.LZ4: b"lz4"}.get(compression, b"")
    head = struct.pack("<QQQII", 0, 0, len(data), 0, len(name)) + name + struct.pack("<Q", len(stored))
    chunk = struct.pack("<BQ", Opcode.CHUNK, len(head + stored)) + head + stored
    path.write_bytes(b"\x89MCAP0\r\n" + chunk)
    return path


EMPTY = struct.pack("<BQ22x", Opcode.MESSAGE, 22)
CHANNEL = struct.pack("<HHIII", 1, 0, 0, 0, 0)


def test_a_record_may_be_longer_than_is_known(tmp_path):
    data = struct.pack("<BQ", Opcode.CHANNEL, len(CHANNEL) + 3) + CHANNEL + b"new" + EMPTY
    with packed(tmp_path / "x.mcap", data).open("rb") as file:
        assert [type(record).__name__ for record in mcap_records.records_at(file, 8)] == [
            "Channel",
            "Message",
        ]


def test_of_schemas_and_channels_there_may_be_many(tmp_path):
    path = tmp_path / "x.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        for i in range(1500):
            writer.register_channel(f"{i}", "protobuf", writer.register_schema(f"{i}", "", b""))
        for i, (topic, message) in enumerate([(DEPTH, IMAGE), *CALIBRATION]):
            channel = writer.register_channel(topic, "protobuf", register_schema(writer, type(message)))
            writer.add_message(channel, i, message.SerializeToString(), i)
        writer.finish()
    assert len(Session(path)) == 1
    cut_off(tmp_path / "cut.mcap", path, path.stat().st_size - 1)
    assert repair(tmp_path / "cut.mcap").frames == 1


@pytest.mark.parametrize("compression", [CompressionType.NONE, CompressionType.ZSTD, CompressionType.LZ4])
def test_a_chunk_is_read_up_to_the_bound_and_no_further(tmp_path, monkeypatch, compression):
    path = foreign(tmp_path / "x.mcap", [(DEPTH, IMAGE), *CALIBRATION], compression)
    with path.open("rb") as file:
        size = max(
            r.uncompressed_size for r in StreamReader(file, emit_chunks=True).records if isinstance(r, Chunk)
        )
    monkeypatch.setattr(mcap_records, "MAX_RECORD_BYTES", 2 * size)
    assert len(Session(path)) == 1
    monkeypatch.setattr(mcap_records, "MAX_RECORD_BYTES", size - 1)
    with pytest.raises(FormatError, match=r"damaged at byte .* states [0-9]+ bytes, over"):
        Session(path)


@pytest.mark.parametrize("topic", ["/tf", "/depth/calibration"])
def test_a_calibration_that_would_unpack_to_much_is_never_decoded(tmp_path, monkeypatch, topic):
    for module in (index, messages_module):
        monkeypatch.setattr(module, "MAX_CALIBRATION_BYTES", 1000)
    with pytest.raises(CalibrationError, match=f"{topic} is larger than 1000 bytes"):
        calibration_from({topic: b"\x0a\x00" * 501})
    large = SCHEMAS[topic](**({"transforms": [{}] * 501} if topic == "/tf" else {"D": [0.0] * 126}))
    with pytest.raises(CalibrationError, match=f"{topic} is larger than 1000 bytes"):
        Session(foreign(tmp_path / "x.mcap", [(DEPTH, IMAGE), (topic, large), *CALIBRATION]))
