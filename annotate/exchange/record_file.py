"""Binary PCD and PLY files as arrays of records, which open3d cannot give: it forgets the grid of a cloud."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sensors.errors import FormatError
from sensors.files.bounded import MAX_IMAGE_SIDE

Records = NDArray[Any]
"""A structured array (n,), little-endian, one scalar a field."""
Shape = tuple[int, int]
Words = list[list[str]]
"""The words of each line of a header."""
Layout = tuple[list[Any], Shape]
"""The fields of a record as numpy names them, and (h, w)."""

MAX_HEADER_BYTES = 10_000
"""Largest header that is read, in bytes."""
_PLY_TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4",
    "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4",
    "float32": "f4", "float64": "f8",
}  # fmt: skip
_PLY_NAMES = {"f4": "float", "f8": "double", "u1": "uchar", "u2": "ushort", "u4": "uint", "i4": "int"}


def write_pcd(records: Records, shape: Shape) -> bytes:
    """A binary PCD of an organised cloud of ``shape`` (h, w)."""
    fields = [(name, records.dtype[name]) for name in records.dtype.names or ()]
    kind = {"f": "F", "u": "U", "i": "I"}
    lines = {
        "VERSION": "0.7",
        "FIELDS": " ".join(name for name, _ in fields),
        "SIZE": " ".join(str(dtype.itemsize) for _, dtype in fields),
        "TYPE": " ".join(kind[dtype.kind] for _, dtype in fields),
        "COUNT": " ".join("1" for _ in fields),
        "WIDTH": str(shape[1]),
        "HEIGHT": str(shape[0]),
        "VIEWPOINT": "0 0 0 1 0 0 0",
        "POINTS": str(len(records)),
        "DATA": "binary",
    }
    return "".join(f"{key} {value}\n" for key, value in lines.items()).encode() + records.tobytes()


def read_pcd(data: bytes, name: str) -> tuple[Records, Shape]:
    """Records and (h, w) of a binary PCD of scalar fields. Raises FormatError."""
    return _read(data, name, b"DATA ", _pcd_layout)


def write_ply(records: Records, shape: Shape) -> bytes:
    """A binary little-endian PLY of vertices in a grid of ``shape`` (h, w)."""
    fields = "".join(
        f"property {_PLY_NAMES[records.dtype[name].str[1:]]} {name}\n" for name in records.dtype.names or ()
    )
    grid = f"obj_info num_cols {shape[1]}\nobj_info num_rows {shape[0]}\n"
    head = f"ply\nformat binary_little_endian 1.0\n{grid}element vertex {len(records)}\n{fields}end_header\n"
    return head.encode() + records.tobytes()


def read_ply(data: bytes, name: str) -> tuple[Records, Shape]:
    """Records and (h, w) of a binary little-endian PLY of vertices alone. Raises FormatError."""
    return _read(data, name, b"end_header", _ply_layout)


def _pcd_layout(head: Words) -> Layout:
    fields = {words[0]: words[1:] for words in head if not words[0].startswith("#")}
    if fields["DATA"] != ["binary"]:
        raise ValueError(f"DATA is {fields['DATA']}, only binary is read")
    kinds = {"F": "f", "U": "u", "I": "i"}
    columns = zip(fields["FIELDS"], fields["TYPE"], fields["SIZE"], fields["COUNT"], strict=True)
    layout: list[Any] = []
    for number, (field, kind, size, count) in enumerate(columns):
        dtype = f"<{kinds[kind]}{int(size)}"
        if int(count) != 1 and field != "_":
            raise ValueError(f"field {field[:20]} has {count} values")
        # "_" is PCL's padding, and may occur more than once.
        layout.append((f"_{number}", dtype, (int(count),)) if field == "_" else (field, dtype))
    return layout, (int(fields["HEIGHT"][0]), int(fields["WIDTH"][0]))


def _ply_layout(head: Words) -> Layout:
    fields = {" ".join(words[:2]): words[2:] for words in head if words[0] in ("obj_info", "element")}
    if ["format", "binary_little_endian", "1.0"] not in head:
        raise ValueError("only binary_little_endian 1.0 is read")
    layout = [(words[2], f"<{_PLY_TYPES[words[1]]}") for words in head if words[0] == "property"]
    shape = int(fields["obj_info num_rows"][0]), int(fields["obj_info num_cols"][0])
    if int(fields["element vertex"][0]) != shape[0] * shape[1]:
        raise ValueError("the grid is not that of the vertices")
    return layout, shape


def _read(data: bytes, name: str, last: bytes, layout_of: Callable[[Words], Layout]) -> tuple[Records, Shape]:
    """Records and (h, w) of a file whose header ends with the line that begins with ``last``."""
    at = 0 if data.startswith(last) else data[:MAX_HEADER_BYTES].find(b"\n" + last) + 1
    end = data[: MAX_HEADER_BYTES + 100].find(b"\n", at)
    try:
        if at <= 0 or end < 0:
            raise ValueError("its header does not end")
        lines = data[: end + 1].decode("ascii", "replace").splitlines()
        layout, shape = layout_of([line.split() for line in lines if line.split()])
        if not all(0 < side <= MAX_IMAGE_SIDE for side in shape) or not layout:
            raise ValueError(f"it is {shape} of {len(layout)} fields")
        return np.frombuffer(data[end + 1 :], np.dtype(layout), count=shape[0] * shape[1]), shape
    except (ValueError, KeyError, IndexError, TypeError) as error:
        why = f"{name} is malformed ({str(error)[:100]}); give an organised cloud with labels"
        raise FormatError(why) from error
