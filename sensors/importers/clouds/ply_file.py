"""PLY files (Turk's Polygon File Format 1.0; text, both byte orders) as records of their vertices.

Elements may come in any order, hold lists, and have any names; comments may be of any encoding.
"""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from sensors.errors import FormatError
from sensors.importers.clouds.pcd_file import MAX_HEADER_BYTES, text_numbers
from sensors.importers.clouds.records import MAX_POINTS, CloudRecords, grid_of

_TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4",
    "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4",
    "float32": "f4", "float64": "f8",
}  # fmt: skip
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_END = re.compile(rb"^end_header[ \t]*\r?\n", re.MULTILINE)
MAX_BYTES = 1 << 32
"""Bytes that are read of a file with lists, or with other elements in front of its vertices; untuned."""
MAX_LIST = 1 << 20
"""Values of one list; untuned."""


@dataclass(frozen=True)
class _Property:
    """One property. kind: type of its values; counted: type of a list's length, "" for a single value."""

    name: str
    kind: str
    counted: str = ""


@dataclass(frozen=True)
class _Element:
    """One kind of rows: vertices, faces."""

    name: str
    rows: int
    properties: list[_Property]

    @property
    def lists(self) -> bool:
        """Whether a property is a list, so that rows differ in length."""
        return any(prop.counted for prop in self.properties)


def read_ply(path: Path) -> CloudRecords:
    """Read all vertices of a PLY file. Raises FormatError where it is malformed or cut off."""
    try:
        with path.open("rb") as file:
            head = file.read(MAX_HEADER_BYTES)
            end = _END.search(head)
            if end is None or head.split()[:1] != [b"ply"]:
                raise ValueError("its header does not start with 'ply' or does not end")
            lines = [line.split() for line in head[: end.end()].decode("utf-8", "replace").split("\n")]
            order, elements, grid = _header([words for words in lines if words])
            file.seek(end.end())
            records = _vertices(file, order, elements, path.stat().st_size - end.end())
    except OSError as error:
        raise FormatError(f"{path} cannot be read ({error.strerror}); give a point cloud") from error
    except (ValueError, KeyError, IndexError, TypeError, OverflowError) as error:
        why = f"{str(error)[:40]} is unknown" if isinstance(error, KeyError) else str(error)[:100]
        raise FormatError(f"{path} is malformed ({why}); give a valid PLY file") from error
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
            elements[-1].properties.append(_Property(words[4], _TYPES[words[3]], _TYPES[words[2]]))
        elif words[0] == "property":
            elements[-1].properties.append(_Property(words[2], _TYPES[words[1]]))
        elif words[0] == "obj_info" and words[1:2] and words[1] in grid:
            grid[words[1]] = int(words[2])
    if order is None:
        raise ValueError("it names no format")
    return order, elements, (grid["num_cols"], grid["num_rows"])


def _vertices(file: BinaryIO, order: str, elements: list[_Element], there: int) -> NDArray[Any]:
    names = [element.name for element in elements]
    if "vertex" not in names:
        raise ValueError("it has no vertices")
    at = names.index("vertex")
    vertex = elements[at]
    kept = {prop.name for prop in vertex.properties if not prop.counted}
    if not {"x", "y", "z"} <= kept or len({prop.name for prop in vertex.properties}) < len(vertex.properties):
        raise ValueError("its vertices lack x, y or z, or have a property twice")
    for element in elements[: at + 1]:
        least = sum(2 if not order else _bytes(prop) for prop in element.properties)
        if not 0 <= element.rows <= MAX_POINTS or element.rows * least > there + 1:
            raise ValueError(f"{there} bytes cannot hold its {element.rows} points or rows")
    if not vertex.rows:
        raise ValueError("it has 0 points")
    if not order:
        for element in elements[:at]:
            for _ in range(element.rows):
                file.readline()
        return _text(file, vertex)
    return _binary(file, order, elements[:at], vertex)


def _text(file: BinaryIO, vertex: _Element) -> NDArray[Any]:
    single = [prop for prop in vertex.properties if not prop.counted]
    records = np.zeros(vertex.rows, [(prop.name, f"<{prop.kind}") for prop in single])
    if vertex.lists:
        rows = [_text_row(file.readline().split(), vertex) for _ in range(vertex.rows)]
        columns = np.array(rows, np.float64).T
    else:
        count = vertex.rows * len(single)
        columns = text_numbers(file, count, f"{vertex.rows} points").reshape(-1, len(single)).T
    with np.errstate(invalid="ignore", over="ignore"):
        for prop, column in zip(single, columns, strict=True):
            records[prop.name] = column
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


def _bytes(prop: _Property) -> int:
    """Return the bytes of a property, at least."""
    return np.dtype(prop.counted or prop.kind).itemsize


def _binary(file: BinaryIO, order: str, before: list[_Element], vertex: _Element) -> NDArray[Any]:
    single = [prop for prop in vertex.properties if not prop.counted]
    layout = np.dtype([(prop.name, f"{order}{prop.kind}") for prop in single])
    if not any(element.rows for element in before) and not vertex.lists:
        records = np.fromfile(file, layout, vertex.rows)
        if len(records) != vertex.rows:
            raise ValueError(f"it claims {vertex.rows} points and holds {len(records)}")
        return records.astype(layout.newbyteorder("<"), copy=False)
    data = np.fromfile(file, np.uint8, MAX_BYTES)
    at = 0
    for element in before:
        _, at = _rows(data, at, element, order)
    records, _ = _rows(data, at, vertex, order)
    found = np.zeros(vertex.rows, layout.newbyteorder("<"))
    for prop in single:
        found[prop.name] = records[prop.name]
    return found


def _rows(data: NDArray[np.uint8], at: int, element: _Element, order: str) -> tuple[NDArray[Any], int]:
    """Return the records of an element whose rows begin at ``at``, and where they end.

    Lists are nearly always of one length (triangles); a file where they are not is read row by row.
    """
    if not element.rows or not element.properties:
        return np.zeros(element.rows, [("none", "u1")]), at
    layout = _layout(data, at, element, order)
    end = at + element.rows * layout.itemsize
    if end <= len(data):
        records = data[at:end].view(layout)
        counts = [records[f"#{n}"] for n, prop in enumerate(element.properties) if prop.counted]
        if all((count == count[0]).all() for count in counts):
            return records, end
    if not element.lists:
        raise ValueError(f"it claims {element.rows} points and is cut off")
    return _uneven(data, at, element, order)


def _layout(data: NDArray[np.uint8], at: int, element: _Element, order: str) -> np.dtype[Any]:
    """Return the type of the row at ``at``, with its lists as arrays of their length."""
    layout: list[Any] = []
    offset = at
    for number, prop in enumerate(element.properties):
        kind = f"{order}{prop.kind}"
        if not prop.counted:
            layout.append((prop.name, kind))
            offset += np.dtype(kind).itemsize
            continue
        counted = np.dtype(f"{order}{prop.counted}")
        word = data[offset : offset + counted.itemsize]
        if len(word) < counted.itemsize:
            raise ValueError(f"it claims {element.rows} rows of {element.name} and is cut off")
        length = int(word.view(counted)[0])
        if not 0 <= length <= MAX_LIST:
            raise ValueError(f"a list of {length} values")
        layout += [(f"#{number}", counted), (f"{number}", kind, (length,))]
        offset += counted.itemsize + length * np.dtype(kind).itemsize
    return np.dtype(layout)


def _uneven(data: NDArray[np.uint8], at: int, element: _Element, order: str) -> tuple[NDArray[Any], int]:
    """Return the records of the single values of rows that differ in length."""
    single = [prop for prop in element.properties if not prop.counted]
    records = np.zeros(
        element.rows, [(prop.name, f"{order}{prop.kind}") for prop in single] or [("none", "u1")]
    )
    for row in range(element.rows):
        layout = _layout(data, at, element, order)
        if at + layout.itemsize > len(data):
            raise ValueError(f"it claims {element.rows} rows of {element.name} and is cut off")
        values = data[at : at + layout.itemsize].view(layout)[0]
        for prop in single:
            records[row][prop.name] = values[prop.name]
        at += layout.itemsize
    return records, at
