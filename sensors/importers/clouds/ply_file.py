"""PLY files (Turk's Polygon File Format 1.0; text, both byte orders) as records of their vertices.

Elements may come in any order, hold lists, and have any names; comments may be of any encoding.
"""

import re
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sensors.importers.clouds.records import (
    MAX_POINTS,
    CloudRecords,
    grid_of,
    header_lines,
    opened_cloud,
    text_numbers,
)

TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4",
    "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4",
    "float32": "f4", "float64": "f8",
}  # fmt: skip
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_END = re.compile(rb"^end_header[ \t]*\r?\n", re.MULTILINE)
MAX_LIST = 1 << 20  # values of one list; untuned


class _Property(NamedTuple):
    """Property of an element. kind: type of its values; counted: type of a list's length, "" for a single
    value.
    """

    name: str
    kind: str
    counted: str = ""


class _Element(NamedTuple):
    """Element of the file, such as vertices or faces, with its properties."""

    name: str
    rows: int
    properties: list[_Property]

    def singles(self, order: str) -> list[tuple[str, str]]:
        """Return name and type of the properties that are not lists."""
        return [(prop.name, f"{order}{prop.kind}") for prop in self.properties if not prop.counted]


def read_ply(path: Path) -> CloudRecords:
    """Read all vertices of a PLY file. Raises FormatError where it is malformed or cut off."""
    with opened_cloud(path, "PLY") as file:
        lines = header_lines(file, _END)
        if lines[0][0] != "ply":
            raise ValueError("its header does not start with 'ply'")
        order, elements, grid = _header(lines)
        records = _vertices(file, order, elements, path.stat().st_size - file.tell())
    faces = sum(element.rows for element in elements if element.name == "face")
    return CloudRecords(records, grid_of(*grid, len(records)), None, faces)


def _header(lines: list[list[str]]) -> tuple[str, list[_Element], tuple[int, int]]:
    """Return byte order ("" for text), elements in the file's order, (width, height) of a grid or zeros."""
    order: str | None = None
    elements: list[_Element] = []
    grid = {"num_cols": 0, "num_rows": 0}
    for words in lines:
        if words[0] == "format":
            order = _ORDERS[words[1]]
        elif words[0] == "element":
            elements.append(_Element(words[1], int(words[2]), []))
        elif words[0] == "property" and words[1] == "list":
            elements[-1].properties.append(_Property(words[4], TYPES[words[3]], TYPES[words[2]]))
        elif words[0] == "property":
            elements[-1].properties.append(_Property(words[2], TYPES[words[1]]))
        elif words[0] == "obj_info" and words[1:2] and words[1] in grid:
            grid[words[1]] = int(words[2])
    if order is None:
        raise ValueError("it names no format")
    return order, elements, (grid["num_cols"], grid["num_rows"])


def _vertices(file: BinaryIO, order: str, elements: list[_Element], there: int) -> NDArray[Any]:
    names = [element.name for element in elements]
    if "vertex" not in names:
        raise ValueError("it has no vertices")
    before, vertex = elements[: names.index("vertex")], elements[names.index("vertex")]
    kept = {name for name, _ in vertex.singles(order)}
    if not {"x", "y", "z"} <= kept or len({prop.name for prop in vertex.properties}) < len(vertex.properties):
        raise ValueError("its vertices lack x, y or z, or have a property twice")
    for element in (*before, vertex):
        least = sum(np.dtype(p.counted or p.kind).itemsize if order else 2 for p in element.properties)
        if not 0 <= element.rows <= MAX_POINTS or element.rows * least > there + 1:
            raise ValueError(f"{there} bytes cannot hold its {element.rows} points or rows")
    if not vertex.rows:
        raise ValueError("it has 0 points")
    if not order:
        for _ in range(sum(element.rows for element in before)):
            file.readline()
        return _text(file, vertex)
    data, at = np.memmap(file, np.uint8, "r", file.tell()), 0
    for element in before:
        _, at = _rows(data, at, element, order)
    records, _ = _rows(data, at, vertex, order)
    return records.astype(records.dtype.newbyteorder("<"), copy=False)


def _text(file: BinaryIO, vertex: _Element) -> NDArray[Any]:
    single = vertex.singles("<")
    if len(single) < len(vertex.properties):
        rows = [_text_row(file.readline().split(), vertex) for _ in range(vertex.rows)]
        columns = np.array(rows, np.float64).T
    else:
        columns = text_numbers(file, vertex.rows, len(single)).T
    records = np.zeros(vertex.rows, single)
    with np.errstate(invalid="ignore", over="ignore"):
        for (name, _), column in zip(single, columns, strict=True):
            records[name] = column
    return records


def _text_row(words: list[bytes], vertex: _Element) -> list[float]:
    """Return the single values of a line, its lists skipped."""
    values, at = [], 0
    for prop in vertex.properties:
        if prop.counted:
            at += int(words[at])
        else:
            values.append(float(words[at]))
        at += 1
    return values


def _rows(data: NDArray[np.uint8], at: int, element: _Element, order: str) -> tuple[NDArray[Any], int]:
    """Return the single values of an element whose rows begin at ``at``, and the offset of their end.

    Rows are read in blocks of equal layout: nearly always all lists have one length (triangles).
    """
    single = element.singles(order)
    records = np.zeros(element.rows, single)
    row, block = 0, element.rows
    while element.properties and row < element.rows:
        layout = _layout(data, at, element, order)
        most = min(block, element.rows - row, (len(data) - at) // layout.itemsize)
        rows = data[at : at + most * layout.itemsize].view(layout)
        other = np.zeros(most, bool)
        for name in layout.names or ():
            if name.startswith("#"):
                other |= rows[name] != rows[name][:1]
        count = int(np.argmax(other)) if other.any() else most
        if not count:
            raise ValueError(f"it claims {element.rows} rows of {element.name} and is cut off")
        for name, _ in single:
            records[name][row : row + count] = rows[name][:count]
        row, at, block = row + count, at + count * layout.itemsize, 2 * count
    return records, at


def _layout(data: NDArray[np.uint8], at: int, element: _Element, order: str) -> np.dtype[Any]:
    """Return the type of the row at ``at``, with its lists as arrays of their length."""
    layout: list[Any] = []
    for number, prop in enumerate(element.properties):
        kind = f"{order}{prop.kind}"
        if not prop.counted:
            layout.append((prop.name, kind))
            continue
        counted = np.dtype(f"{order}{prop.counted}")
        begin = at + np.dtype(layout).itemsize
        word = data[begin : begin + counted.itemsize]
        length = int(word.view(counted)[0]) if len(word) == counted.itemsize else 0
        if not 0 <= length <= MAX_LIST:
            raise ValueError(f"a list has {length} values, not 0 to {MAX_LIST}")
        layout += [(f"#{number}", counted), (f"{number}", kind, (length,))]
    return np.dtype(layout)
