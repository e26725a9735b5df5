"""Files of weights, seen to be whole by their outlines, before the libraries that load them are imported."""

import json
import struct
from pathlib import Path
from typing import BinaryIO

from sensors.errors import FormatError

GRAPH = 7
"""Number of the field of an ONNX model that holds its network (onnx.proto)."""
MAX_HEADER_BYTES = 100_000_000
"""Of a safetensors file: its format's own bound."""
ONNX_REMEDY = "give an exported network (.onnx)"
SAFETENSORS_REMEDY = "give a .safetensors that 'train' wrote"


def check_onnx(path: Path) -> None:
    """Check that a file has the outline of an ONNX model. Raises FormatError where it has not, or is cut off.

    What is damaged within is found by whoever loads it.
    """
    _check_file(path, ONNX_REMEDY)
    try:
        with path.open("rb") as file:
            whole = _is_model(file, path.stat().st_size)
    except OSError as error:
        raise FormatError(f"{path} cannot be read ({error.strerror}); {ONNX_REMEDY}") from error
    if not whole:
        raise FormatError(f"weights {path} are cut off, or no ONNX file; {ONNX_REMEDY}")


def check_safetensors(path: Path) -> None:
    """Check that a file is as long as its header says. Raises FormatError where it is not."""
    _check_file(path, SAFETENSORS_REMEDY)
    try:
        size = path.stat().st_size
        with path.open("rb") as file:
            (length,) = struct.unpack("<Q", file.read(8))
            if length > min(size, MAX_HEADER_BYTES):
                raise ValueError("its header is longer than the file")
            header = json.loads(file.read(length))
        ends = [entry["data_offsets"][1] for name, entry in header.items() if name != "__metadata__"]
        if 8 + length + max(ends, default=0) != size:
            raise ValueError("it is cut off")
    except OSError as error:
        raise FormatError(f"{path} cannot be read ({error.strerror}); {SAFETENSORS_REMEDY}") from error
    except (ValueError, struct.error, RecursionError, LookupError, AttributeError, TypeError) as error:
        raise FormatError(
            f"{path} is not a safetensors file or is cut off ({str(error)[:80]}); {SAFETENSORS_REMEDY}"
        ) from error


def _check_file(path: Path, remedy: str) -> None:
    # Pipes block, and devices never end.
    if not path.is_file():
        raise FormatError(f"{path} is not a file; {remedy}")


def _is_model(file: BinaryIO, size: int) -> bool:
    """Whether protobuf's fields follow each other to the very end of a file, the network among them."""
    numbers = set()
    while file.tell() < size:
        key = _varint(file)
        if key is None:
            return False
        numbers.add(key >> 3)
        # How many bytes follow: a number's own, eight, as many as a number says, four; other kinds are none.
        match key & 7:
            case 0:
                follow = None if _varint(file) is None else 0
            case 1:
                follow = 8
            case 2:
                follow = _varint(file)
            case 5:
                follow = 4
            case _:
                follow = None
        if follow is None or file.tell() + follow > size:
            return False
        file.seek(follow, 1)
    return GRAPH in numbers


def _varint(file: BinaryIO) -> int | None:
    """Protobuf's number of one to ten bytes; None where there is none."""
    value = 0
    for shift in range(0, 70, 7):
        byte = file.read(1)
        if not byte:
            return None
        value |= (byte[0] & 0x7F) << shift
        if byte[0] < 0x80:
            return value
    return None
