"""PCD files (PCL's Point Cloud Data, 0.5 to 0.7; text, binary, compressed) as records.

Open3D's reader is not used, because it maps all padding fields, which PCL calls ``_``, to one buffer and
corrupts the heap (isl-org/Open3D#6437, #6022). Entries that a header may lack, and their defaults, follow
PCL's ``PCDReader::readHeader`` (io/src/pcd_io.cpp).
"""

import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from numpy.lib.recfunctions import repack_fields
from numpy.typing import NDArray

from sensors.importers.clouds.records import (
    MAX_POINTS,
    CloudRecords,
    grid_of,
    header_lines,
    opened_cloud,
    text_numbers,
)
from sensors.rig.rig_calibration import Pose, rotation_of

MAX_POINT_BYTES = 1 << 20  # room for a feature histogram; untuned
MOST_EXPANSION = 90  # bytes from one byte of LZF: three give a run of 264 (liblzf)
_END = re.compile(rb"^DATA[ \t][^\n]*\n", re.MULTILINE)
_DEFAULTS = {"SIZE": "4", "TYPE": "F", "COUNT": "1"}
_KINDS = {"F": "f", "U": "u", "I": "i"}


class _Field(NamedTuple):
    """A field of a point. name: begins with a space for padding. kind: as numpy writes it."""

    name: str
    kind: str
    values: int

    @property
    def kept(self) -> bool:
        return not self.name.startswith(" ")

    @property
    def size(self) -> int:
        return np.dtype(self.kind).itemsize * self.values


def read_pcd(path: Path) -> CloudRecords:
    """Read all points of a PCD file. Raises FormatError where it is malformed or cut off."""
    with opened_cloud(path, "PCD") as file:
        header = {words[0]: words[1:] for words in header_lines(file, _END) if words[0][0] != "#"}
        if "COLUMNS" in header:
            header.setdefault("FIELDS", header["COLUMNS"])
        width, height, points = _counts(header)
        there = path.stat().st_size - file.tell()
        records = _records(file, header, points, there)
        return CloudRecords(records, grid_of(width, height, points), _viewpoint(header.get("VIEWPOINT", [])))


def _counts(header: dict[str, list[str]]) -> tuple[int, int, int]:
    """Return width, height and number of points; the header may omit one that follows from the others."""
    width, height, points = (
        int(header[name][0]) if name in header else 0 for name in ("WIDTH", "HEIGHT", "POINTS")
    )
    if min(width, height, points) < 0:
        raise ValueError(f"its header states {width} x {height} and {points} points")
    height = height or 1
    width = width or points // height
    points = points or width * height
    if width * height != points:
        raise ValueError(f"{width} x {height} are not {points} points")
    if not 0 < points <= MAX_POINTS:
        raise ValueError(f"it claims {points} points; 1 to {MAX_POINTS} are read")
    return width, height, points


def _fields(header: dict[str, list[str]]) -> list[_Field]:
    """Return the fields in the file's order; a repeated name gets the field's number as suffix."""
    names = header["FIELDS"]
    sizes, types, counts = (header.get(key, [value] * len(names)) for key, value in _DEFAULTS.items())
    fields: list[_Field] = []
    for number, (name, size, kind, count) in enumerate(zip(names, sizes, types, counts, strict=True)):
        if not 0 <= int(count) <= MAX_POINT_BYTES:
            raise ValueError(f"field {name[:20]} has {count[:20]} values, not 0 to {MAX_POINT_BYTES}")
        name = f" {number}" if name == "_" else name
        name = f"{name}_{number}" if name in {field.name for field in fields} else name
        fields.append(_Field(name, f"<{_KINDS[kind]}{int(size)}", int(count)))
    for axis in "xyz":
        if (axis, "<f4", 1) not in fields and (axis, "<f8", 1) not in fields:
            raise ValueError(f"{axis} is missing or is not a float")
    if _stride(fields) > MAX_POINT_BYTES:
        raise ValueError(f"a point has {_stride(fields)} bytes, over {MAX_POINT_BYTES}")
    return fields


def _stride(fields: list[_Field]) -> int:
    return sum(field.size for field in fields)


def _dtype(fields: list[_Field]) -> np.dtype[Any]:
    return np.dtype([(f.name, f.kind) if f.values == 1 else (f.name, f.kind, (f.values,)) for f in fields])


def _records(file: BinaryIO, header: dict[str, list[str]], points: int, there: int) -> NDArray[Any]:
    fields, data = _fields(header), header["DATA"][0].lower()
    if data == "binary":
        if points * _stride(fields) > there:
            raise ValueError(f"it claims {points} points and holds {there // _stride(fields)}")
        records = np.fromfile(file, _dtype(fields), points)
        return np.asarray(repack_fields(records[[field.name for field in fields if field.kept]]))
    if data == "ascii":
        words = sum(field.values for field in fields)
        if 2 * points * words > there + 1:
            raise ValueError(f"it claims {points} points; {there} bytes of text cannot hold them")
        ends = np.cumsum([field.values for field in fields])[:-1]
        return _filled(fields, np.split(text_numbers(file, points, words), ends, axis=1), points)
    if data == "binary_compressed":
        return _compressed(file, fields, points, there)
    raise ValueError(f"DATA is {data[:40]}; ascii, binary and binary_compressed are read")


def _filled(fields: list[_Field], columns: Iterable[NDArray[Any]], points: int) -> NDArray[Any]:
    """Return records with the columns of the fields, without padding."""
    records = np.zeros(points, _dtype([field for field in fields if field.kept]))
    with np.errstate(invalid="ignore", over="ignore"):
        for field, column in zip(fields, columns, strict=True):
            if field.kept:
                records[field.name] = column.reshape(records[field.name].shape)
    return records


def _compressed(file: BinaryIO, fields: list[_Field], points: int, there: int) -> NDArray[Any]:
    """Read compressed columns one field after the other; padding may be absent, as PCL writes it, or
    present.
    """
    packed, size = np.frombuffer(file.read(8), "<u4").tolist()
    if packed > there - 8:
        raise ValueError(f"it is cut off: {there - 8} of {packed} compressed bytes are there")
    kept = [field for field in fields if field.kept]
    stored = next((some for some in (kept, fields) if points * _stride(some) == size), None)
    if stored is None:
        raise ValueError(f"{size} bytes are not {points} points")
    data = np.frombuffer(_expand(file.read(packed), size), np.uint8)
    ends = np.cumsum([points * field.size for field in stored])[:-1]
    columns = [part.view(field.kind) for part, field in zip(np.split(data, ends), stored, strict=True)]
    return _filled(stored, columns, points)


def _expand(data: bytes, size: int) -> bytearray:
    """Expand LZF (liblzf's format, as PCL's ``lzf.cpp`` reads it) to exactly ``size`` bytes."""
    if size > MOST_EXPANSION * len(data):
        raise ValueError(f"{len(data)} compressed bytes cannot hold {size}")
    out, at = bytearray(), 0
    while at < len(data) and len(out) <= size:
        control = data[at]
        at += 1
        if control < 32:
            out += data[at : at + control + 1]
            at += control + 1
            continue
        run = control >> 5
        if run == 7:
            run += data[at]
            at += 1
        distance = ((control & 31) << 8) + data[at] + 1
        at += 1
        if distance > len(out):
            raise ValueError("its compressed data is damaged")
        begin = len(out) - distance
        piece = out[begin : begin + run + 2]
        out += (piece * ((run + 2) // len(piece) + 1))[: run + 2]
    if len(out) != size or at != len(data):
        raise ValueError(f"its compressed data is damaged or is not {size} bytes")
    return out


def _viewpoint(words: list[str]) -> Pose | None:
    """Return the sensor's pose in the cloud's frame, of tx ty tz qw qx qy qz; None for the identity."""
    if len(words) < 7:
        return None
    numbers = np.array([float(word) for word in words[:7]])
    if not np.isfinite(numbers).all() or not np.any(numbers[3:]):
        return None
    rotation = rotation_of(numbers[[4, 5, 6, 3]])
    if np.allclose(rotation, np.eye(3), atol=1e-9) and not numbers[:3].any():
        return None
    return Pose(rotation, numbers[:3])
