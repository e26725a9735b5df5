"""PCD files (PCL's Point Cloud Data, 0.5 to 0.7; text, binary, compressed) as records.

Read here and not by Open3D: its reader maps all padding fields, which PCL calls ``_``, to one buffer and
corrupts the heap (isl-org/Open3D#6437, #6022). What may be absent from a header, and how, follows PCL's
``PCDReader::readHeader`` (io/src/pcd_io.cpp).
"""

import re
import warnings
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from sensors.errors import FormatError
from sensors.importers.clouds.records import MAX_POINTS, CloudRecords, grid_of
from sensors.rig.rig_calibration import Pose, rotation_of

MAX_HEADER_BYTES = 100_000
"""Largest header that is read, in bytes; untuned."""
MAX_POINT_BYTES = 1 << 20
"""Bytes of one point: room for a feature histogram; untuned."""
PADDING = "_"
"""PCL's name of fields without meaning; a file may have several."""
_END = re.compile(rb"^DATA[ \t][^\n]*\n", re.MULTILINE)
_KINDS = {"F": "f", "U": "u", "I": "i"}

Fields = list[tuple[str, str, int]]
"""Name, type as numpy writes it, and number of values of each field, in the file's order."""


def read_pcd(path: Path) -> CloudRecords:
    """Read all points of a PCD file. Raises FormatError where it is malformed or cut off."""
    try:
        with path.open("rb") as file:
            head = file.read(MAX_HEADER_BYTES)
            end = _END.search(head)
            if end is None:
                raise ValueError("its header does not end")
            header = _words(head[: end.end()])
            width, height, points = _counts(header)
            fields = _fields(header)
            file.seek(end.end())
            there = path.stat().st_size - end.end()
            records = _records(file, header["DATA"][0].lower(), fields, points, there)
        viewpoint = _viewpoint(header.get("VIEWPOINT", []))
    except OSError as error:
        raise FormatError(f"{path} cannot be read ({error.strerror}); give a point cloud") from error
    except (ValueError, KeyError, IndexError, TypeError) as error:
        why = f"no {error}" if isinstance(error, KeyError) else str(error)[:100]
        raise FormatError(f"{path} is malformed ({why}); give a valid PCD file") from error
    return CloudRecords(records, grid_of(width, height, points), viewpoint)


def _words(head: bytes) -> dict[str, list[str]]:
    """Return the words of each line of the header by its first; comments, of any encoding, left out."""
    lines = [line.split() for line in head.decode("utf-8", "replace").split("\n")]
    header = {words[0]: words[1:] for words in lines if words and not words[0].startswith("#")}
    if "COLUMNS" in header:
        header.setdefault("FIELDS", header["COLUMNS"])
    return header


def _counts(header: dict[str, list[str]]) -> tuple[int, int, int]:
    """Return width, height, points; each may be left out where the others give it."""
    width, height, points = (
        int(header[name][0]) if name in header else 0 for name in ("WIDTH", "HEIGHT", "POINTS")
    )
    if min(width, height, points) < 0:
        raise ValueError(f"{width} x {height}, {points} points")
    height = height or 1
    width = width or points // height
    points = points or width * height
    if width * height != points:
        raise ValueError(f"{width} x {height} are not {points} points")
    if not 0 < points <= MAX_POINTS:
        raise ValueError(f"it claims {points} points; 1 to {MAX_POINTS} are read")
    return width, height, points


def _fields(header: dict[str, list[str]]) -> Fields:
    names = header["FIELDS"]
    plain = {"SIZE": "4", "TYPE": "F", "COUNT": "1"}
    sizes, types, counts = (header.get(name, [value] * len(names)) for name, value in plain.items())
    fields, seen = [], set[str]()
    for number, (name, size, kind, count) in enumerate(zip(names, sizes, types, counts, strict=True)):
        if not 0 <= int(count) <= MAX_POINT_BYTES:
            raise ValueError(f"field {name[:20]} has {count[:20]} values")
        label = name if name == PADDING or name not in seen else f"{name}_{number}"
        seen.add(label)
        fields.append((label, f"<{_KINDS[kind]}{int(size)}", int(count)))
    for axis in "xyz":
        if (axis, "<f4", 1) not in fields and (axis, "<f8", 1) not in fields:
            raise ValueError(f"{axis} is no float")
    if _stride(fields) > MAX_POINT_BYTES:
        raise ValueError(f"a point has {_stride(fields)} bytes")
    return fields


def _stride(fields: Fields) -> int:
    return sum(np.dtype(kind).itemsize * count for _, kind, count in fields)


def _dtype(fields: Fields) -> np.dtype[Any]:
    """Return the record type of the fields; padding becomes a gap between them."""
    names, formats, offsets, end = [], [], [], 0
    for name, kind, count in fields:
        if name != PADDING:
            names.append(name)
            formats.append(np.dtype(kind if count == 1 else (kind, (count,))))
            offsets.append(end)
        end += np.dtype(kind).itemsize * count
    return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": end})


def _records(file: BinaryIO, data: str, fields: Fields, points: int, there: int) -> NDArray[Any]:
    if data == "ascii":
        return _text(file, fields, points, there)
    if data == "binary":
        if points * _stride(fields) > there:
            raise ValueError(f"it claims {points} points and holds {there // _stride(fields)}")
        return _packed(np.fromfile(file, _dtype(fields), points))
    if data == "binary_compressed":
        return _compressed(file, fields, points, there)
    raise ValueError(f"DATA is {data[:40]}; ascii, binary and binary_compressed are read")


def _text(file: BinaryIO, fields: Fields, points: int, there: int) -> NDArray[Any]:
    words = sum(count for _, _, count in fields)
    if 2 * points * words > there + 1:
        raise ValueError(f"it claims {points} points; {there} bytes of text cannot hold them")
    values = text_numbers(file, points * words, f"{points} points")
    return _columns(values.reshape(points, words).T, fields, points)


def text_numbers(file: BinaryIO, count: int, what: str) -> NDArray[np.float64]:
    """Return the next ``count`` numbers of a text, NaN and infinity among them.

    Raises ValueError for fewer.
    """
    with warnings.catch_warnings():
        # Of text that is no number; newer versions of numpy raise ValueError.
        warnings.simplefilter("error", DeprecationWarning)
        try:
            values = np.fromfile(file, np.float64, count, sep=" ")
        except (ValueError, DeprecationWarning) as error:
            raise ValueError(f"it claims {what}, and some of its text is no number") from error
    if len(values) != count:
        raise ValueError(f"it claims {what}, which are {count} numbers, and holds {len(values)}")
    return values


def _columns(values: NDArray[Any], fields: Fields, points: int) -> NDArray[Any]:
    """Return the records of columns (words, n) of text, in the fields' order."""
    kept = [field for field in fields if field[0] != PADDING]
    records, at = np.zeros(points, _packed_dtype(kept)), 0
    with np.errstate(invalid="ignore", over="ignore"):
        for name, _, count in fields:
            if name != PADDING:
                column = values[at] if count == 1 else values[at : at + count].T
                records[name] = column
            at += count
    return records


def _compressed(file: BinaryIO, fields: Fields, points: int, there: int) -> NDArray[Any]:
    """Read field after field: PCL leaves padding out when it compresses, others do not."""
    packed, size = np.frombuffer(file.read(8), "<u4").tolist()
    if packed > there - 8:
        raise ValueError(f"it is cut off: {there - 8} of {packed} compressed bytes are there")
    kept = [field for field in fields if field[0] != PADDING]
    stored = next((some for some in (kept, fields) if points * _stride(some) == size), None)
    if stored is None:
        raise ValueError(f"{size} bytes are not {points} points")
    # Imported here: it loads a compiler, which nothing else of a cloud needs.
    from sensors.importers.clouds.lzf import expand_lzf

    data, records, at = expand_lzf(file.read(packed), size), np.zeros(points, _packed_dtype(kept)), 0
    for name, kind, count in stored:
        length = points * count * np.dtype(kind).itemsize
        if name != PADDING:
            column = data[at : at + length].view(kind)
            records[name] = column if count == 1 else column.reshape(points, count)
        at += length
    return records


def _packed_dtype(fields: Fields) -> np.dtype[Any]:
    return np.dtype([(name, kind) if count == 1 else (name, kind, (count,)) for name, kind, count in fields])


def _packed(records: NDArray[Any]) -> NDArray[Any]:
    """Return the records without gaps."""
    from numpy.lib.recfunctions import repack_fields

    return np.asarray(repack_fields(records))


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
