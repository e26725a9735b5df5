"""The text header of a PCD or PLY file: size and layout, checked before the points are read.

open3d reads the points but drops an organised cloud's width and height, and trusts what a header claims.
"""

import os
import re
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from sensors.errors import FormatError
from sensors.files.bounded import MAX_IMAGE_SIDE

MAX_POINTS = 50_000_000
MAX_UNPACKED_BYTES = 1 << 30
"""Of a compressed PCD, which is unpacked as a whole."""
MAX_HEADER_LINES = 200
MAX_LINE_BYTES = 1000
_MAX_LZF_RATIO = 300  # the format's longest back reference makes 264 bytes of 3


@dataclass(frozen=True)
class CloudHeader:
    """Number of points, and (height, width) where the cloud is organised."""

    points: int
    shape: tuple[int, int] | None


def read_header(path: Path) -> CloudHeader:
    """Header of a .pcd or .ply file. Raises FormatError when it is malformed or promises too much."""
    try:
        with path.open("rb") as file:
            fields = _pcd_fields(file) if path.suffix.lower() == ".pcd" else _ply_fields(file)
            left = os.fstat(file.fileno()).st_size - file.tell()
            header = _pcd(fields, file, left) if path.suffix.lower() == ".pcd" else _ply(fields, left)
    except OSError as error:
        raise FormatError(f"{path} cannot be read ({error.strerror}); give a point cloud") from error
    except (ValueError, KeyError, IndexError, struct.error) as error:
        raise FormatError(f"{path} has a malformed header ({error}); give a valid PCD or PLY file") from error
    if not 0 < header.points <= MAX_POINTS:
        raise FormatError(f"{path} claims {header.points} points; give 1 to {MAX_POINTS}")
    return header


def _lines(file: BinaryIO) -> list[list[str]]:
    """Words of the header's lines, up to the one that ends it."""
    lines = []
    for _ in range(MAX_HEADER_LINES):
        raw = file.readline(MAX_LINE_BYTES)
        if not raw.endswith(b"\n"):
            raise ValueError("it does not end")
        words = raw.decode("ascii").split()
        if words:
            lines.append(words)
        if words[:1] in (["DATA"], ["end_header"]):
            return lines
    raise ValueError(f"more than {MAX_HEADER_LINES} lines")


def _pcd_fields(file: BinaryIO) -> dict[str, list[str]]:
    return {words[0]: words[1:] for words in _lines(file) if not words[0].startswith("#")}


def _pcd(fields: dict[str, list[str]], file: BinaryIO, left: int) -> CloudHeader:
    names, kinds = fields["FIELDS"], fields["TYPE"]
    sizes, counts = (
        [int(s) for s in fields["SIZE"]],
        [int(c) for c in fields.get("COUNT", ["1"] * len(names))],
    )
    if not len(names) == len(kinds) == len(sizes) == len(counts) <= 64:
        raise ValueError("FIELDS, SIZE, TYPE and COUNT differ in length")
    if not (set(kinds) <= set("FIU") and set(sizes) <= {1, 2, 4, 8} and all(0 < c <= 4096 for c in counts)):
        raise ValueError("impossible SIZE, TYPE or COUNT")
    for axis in "xyz":
        at = names.index(axis)
        if kinds[at] != "F" or sizes[at] not in (4, 8) or counts[at] != 1:
            raise ValueError(f"{axis} is not a float")
    width, height, points = (int(fields[name][0]) for name in ("WIDTH", "HEIGHT", "POINTS"))
    if width < 0 or width * height != points:
        raise ValueError(f"{width} x {height} are not {points} points")
    stride = sum(size * count for size, count in zip(sizes, counts, strict=True))
    _check_room(fields["DATA"], points, stride, sum(counts), file, left)
    organised = 1 < height <= MAX_IMAGE_SIDE and 1 < width <= MAX_IMAGE_SIDE
    return CloudHeader(points, (height, width) if organised else None)


def _check_room(data: list[str], points: int, stride: int, values: int, file: BinaryIO, left: int) -> None:
    """Raise ValueError when what follows the header cannot hold the points."""
    if data == ["binary_compressed"]:
        compressed, size = struct.unpack("<II", file.read(8))
        most = min(_MAX_LZF_RATIO * compressed, MAX_UNPACKED_BYTES)
        if compressed > left - 8 or size != points * stride or size > most:
            raise ValueError(f"{compressed} bytes for {size}, with {left - 8} in the file")
    elif data == ["binary"]:
        if points * stride > left:
            raise ValueError(f"{points} points need {points * stride} bytes, the file has {left}")
    elif data != ["ascii"] or points * values * 2 > left + 1:
        raise ValueError(f"{left} bytes of {' '.join(data)[:40]!r} data cannot be {points} points")


_TYPE = "(?:char|uchar|short|ushort|int|uint|float|double|u?int(?:8|16|32)|float(?:32|64))"
_PLY_WORDS = {
    "element": re.compile(r"\S+ \d{1,10}"),
    "property": re.compile(rf"(?:{_TYPE}|list {_TYPE} {_TYPE}) \S+"),
}
"""What follows the words that say how the bytes behind the header are laid out."""


def _ply_fields(file: BinaryIO) -> dict[str, list[str]]:
    """Vertex count, grid, format, and how many ``values`` all elements have, which open3d trusts."""
    lines = _lines(file)
    if lines[0] != ["ply"]:
        raise ValueError("it does not start with 'ply'")
    for words in lines:
        if words[0] in _PLY_WORDS and not _PLY_WORDS[words[0]].fullmatch(" ".join(words[1:])):
            raise ValueError(f"{' '.join(words)[:40]!r} declares nothing")
    fields = {" ".join(words[:2]): words[2:] for words in lines if len(words) > 2}
    return {**fields, "format": lines[1][1:2], "values": [str(_ply_values(lines))]}


def _ply_values(lines: list[list[str]]) -> int:
    """Values that all elements have together; an element without properties counts as one."""
    elements: list[list[int]] = []  # count, properties
    for words in lines:
        if words[0] == "element":
            elements.append([int(words[2]), 0])
            if elements[-1][0] > MAX_POINTS:
                raise ValueError(f"{words[2]} of {words[1][:40]!r}; give at most {MAX_POINTS}")
        elif words[0] == "property" and elements:
            elements[-1][1] += 1
    return sum(count * max(1, properties) for count, properties in elements)


def _ply(fields: dict[str, list[str]], left: int) -> CloudHeader:
    points = int(fields["element vertex"][0])
    columns, rows = (int(fields.get(f"obj_info num_{side}", ["0"])[0]) for side in ("cols", "rows"))
    least = 6 if fields["format"] == ["ascii"] else 12
    if points * least > left:
        raise ValueError(f"{points} points cannot be in {left} bytes")
    # A byte each, in a text file with a space; the last line may lack its end.
    values = int(fields["values"][0]) * (2 if fields["format"] == ["ascii"] else 1)
    if values > left + 1:
        raise ValueError(f"{values} bytes of elements cannot be in {left} bytes")
    organised = columns * rows == points and 1 < rows <= MAX_IMAGE_SIDE and 1 < columns <= MAX_IMAGE_SIDE
    return CloudHeader(points, (rows, columns) if organised else None)
