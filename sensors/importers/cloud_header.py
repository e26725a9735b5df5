"""Number of points and grid of a PCD or PLY file, by its header.

open3d forgets an organised cloud's grid, and makes up the points that a file which is cut off lacks.
"""

import re
from pathlib import Path
from typing import NamedTuple

from sensors.errors import FormatError
from sensors.files.bounded import MAX_IMAGE_SIDE

MAX_POINTS = 50_000_000
"""Points of a cloud, 24 bytes each in memory; chosen by eye."""
_HEADER_BYTES = 100_000
_END = re.compile(rb"^(?:DATA [^\n]*|end_header\r?)\n", re.MULTILINE)
_PLY_BYTES = {
    **dict.fromkeys(("char", "uchar", "int8", "uint8"), 1),
    **dict.fromkeys(("short", "ushort", "int16", "uint16"), 2),
    **dict.fromkeys(("int", "uint", "float", "int32", "uint32", "float32"), 4),
    **dict.fromkeys(("double", "float64"), 8),
}


class CloudHeader(NamedTuple):
    """Number of points, and (height, width) where the cloud is organised."""

    points: int
    shape: tuple[int, int] | None


def read_header(path: Path) -> CloudHeader:
    """Header of a .pcd or .ply file. Raises FormatError where it is malformed, or the file is cut off."""
    try:
        with path.open("rb") as file:
            head = file.read(_HEADER_BYTES)
            end = _END.search(head)
            if end is None:
                raise ValueError("it does not end")
            lines = [line.split() for line in head[: end.end()].decode("ascii").splitlines() if line.split()]
            points, width, height, least, is_text = (_pcd if path.suffix.lower() == ".pcd" else _ply)(lines)
            file.seek(end.end())
            there = sum(len(line.split()) for line in file) if is_text else path.stat().st_size - end.end()
        if not 0 < points <= MAX_POINTS or points * least > there:
            raise ValueError(f"it claims {points} points; 1 to {MAX_POINTS} are read, if all are there")
    except OSError as error:
        raise FormatError(f"{path} cannot be read ({error.strerror}); give a point cloud") from error
    except (ValueError, KeyError, IndexError) as error:
        raise FormatError(f"{path} has a malformed header ({error}); give a valid PCD or PLY file") from error
    organised = width * height == points and min(width, height) > 1 and max(width, height) <= MAX_IMAGE_SIDE
    return CloudHeader(points, (height, width) if organised else None)


def _pcd(lines: list[list[str]]) -> tuple[int, int, int, int, bool]:
    """Points, width, height, and the bytes of a point, or of text its words."""
    fields = {words[0]: words[1:] for words in lines}
    kinds = dict(zip(fields["FIELDS"], zip(fields["TYPE"], fields["SIZE"], strict=True), strict=True))
    if any(kinds[axis] not in (("F", "4"), ("F", "8")) for axis in "xyz"):
        raise ValueError("x, y or z is not a float")
    width, height, points = (int(fields[name][0]) for name in ("WIDTH", "HEIGHT", "POINTS"))
    if width < 0 or width * height != points:
        raise ValueError(f"{width} x {height} are not {points} points")
    sizes = [int(size) for size in fields["SIZE"]]
    counts = [int(count) for count in fields.get("COUNT", ["1"] * len(sizes))]
    stride = sum(size * count for size, count in zip(sizes, counts, strict=True))
    # What is compressed, open3d itself compares with its size.
    kind = fields["DATA"][0]
    least = {"binary": stride, "ascii": sum(counts), "binary_compressed": 0}[kind]
    return points, width, height, least, kind == "ascii"


def _ply(lines: list[list[str]]) -> tuple[int, int, int, int, bool]:
    """Points, width, height (0 without a grid), and the bytes of a point at least, or of text its words."""
    if lines[0] != ["ply"]:
        raise ValueError("it does not start with 'ply'")
    fields = {" ".join(words[:2]): words[2:] for words in lines}
    vertex = lines.index(["element", "vertex", *fields["element vertex"]])
    following = (i for i, words in enumerate(lines) if i > vertex and words[0] in ("element", "end_header"))
    properties = [words[1:] for words in lines[vertex : next(following)] if words[0] == "property"]
    is_text = "format ascii" in fields
    # A list has its count at least.
    kinds = [words[1] if words[0] == "list" else words[0] for words in properties]
    least = len(kinds) if is_text else sum(_PLY_BYTES[kind] for kind in kinds)
    width, height = (int(fields.get(f"obj_info num_{side}", ["0"])[0]) for side in ("cols", "rows"))
    return int(fields["element vertex"][0]), width, height, least, is_text
