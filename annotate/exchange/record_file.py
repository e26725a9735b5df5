"""Binary PCD and PLY files as arrays of records, which open3d cannot give: it forgets the grid of a cloud."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from sensors.errors import FormatError
from sensors.files.bounded import MAX_IMAGE_SIDE

Records = NDArray[Any]
"""A structured array (n,), little-endian, one scalar a field."""

MAX_HEADER_BYTES = 10_000
"""Largest header that is read, in bytes."""
_PLY_TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4",
    "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4",
    "float32": "f4", "float64": "f8",
}  # fmt: skip
_PLY_NAMES = {"f4": "float", "f8": "double", "u1": "uchar", "u2": "ushort", "u4": "uint", "i4": "int"}


def write_pcd(records: Records, shape: tuple[int, int]) -> bytes:
    """An organised cloud of ``shape`` (h, w); red, green, blue become PCL's one field ``rgb``."""
    packed = _with_rgb(records)
    fields = [(name, packed.dtype[name]) for name in packed.dtype.names or ()]
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
        "POINTS": str(len(packed)),
        "DATA": "binary",
    }
    return "".join(f"{key} {value}\n" for key, value in lines.items()).encode() + packed.tobytes()


def read_pcd(data: bytes, name: str) -> tuple[Records, tuple[int, int]]:
    """Records and (h, w) of a binary PCD of scalar fields. Raises FormatError."""
    head, body = _split(data, b"DATA ", name)
    try:
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
        shape = int(fields["HEIGHT"][0]), int(fields["WIDTH"][0])
    except (ValueError, KeyError, IndexError, TypeError) as error:
        raise _malformed(name, error) from error
    return _records(body, layout, shape, name), shape


def write_ply(records: Records, shape: tuple[int, int]) -> bytes:
    """A binary little-endian PLY of vertices in a grid of ``shape`` (h, w)."""
    fields = "".join(
        f"property {_PLY_NAMES[records.dtype[name].str[1:]]} {name}\n" for name in records.dtype.names or ()
    )
    grid = f"obj_info num_cols {shape[1]}\nobj_info num_rows {shape[0]}\n"
    head = f"ply\nformat binary_little_endian 1.0\n{grid}element vertex {len(records)}\n{fields}end_header\n"
    return head.encode() + records.tobytes()


def read_ply(data: bytes, name: str) -> tuple[Records, tuple[int, int]]:
    """Records and (h, w) of a binary little-endian PLY of vertices alone. Raises FormatError."""
    head, body = _split(data, b"end_header", name)
    try:
        fields = {" ".join(words[:2]): words[2:] for words in head if words[0] in ("obj_info", "element")}
        if ["format", "binary_little_endian", "1.0"] not in head:
            raise ValueError("only binary_little_endian 1.0 is read")
        layout = [(words[2], f"<{_PLY_TYPES[words[1]]}") for words in head if words[0] == "property"]
        shape = int(fields["obj_info num_rows"][0]), int(fields["obj_info num_cols"][0])
        if int(fields["element vertex"][0]) != shape[0] * shape[1]:
            raise ValueError("the grid is not that of the vertices")
    except (ValueError, KeyError, IndexError, TypeError) as error:
        raise _malformed(name, error) from error
    return _records(body, layout, shape, name), shape


def _with_rgb(records: Records) -> Records:
    names = list(records.dtype.names or ())
    kinds: list[tuple[str, str]] = [
        ("rgb", "<f4") if name == "red" else (name, records.dtype[name].str)
        for name in names
        if name not in ("green", "blue")
    ]
    packed = np.zeros(len(records), kinds)
    for name in packed.dtype.names or ():
        if name != "rgb":
            packed[name] = records[name]
    if "red" in names:
        red, green, blue = (records[name].astype(np.uint32) for name in ("red", "green", "blue"))
        packed["rgb"] = (red << 16 | green << 8 | blue).view(np.float32)
    return packed


def _split(data: bytes, last: bytes, name: str) -> tuple[list[list[str]], bytes]:
    """Words of the header's lines, and what comes after the line that begins with ``last``."""
    at = 0 if data.startswith(last) else data[:MAX_HEADER_BYTES].find(b"\n" + last) + 1
    end = data[: MAX_HEADER_BYTES + 100].find(b"\n", at)
    if at <= 0 or end < 0:
        raise _malformed(name, ValueError("its header does not end"))
    lines = data[: end + 1].decode("ascii", "replace").splitlines()
    return [line.split() for line in lines if line.split()], data[end + 1 :]


def _records(body: bytes, layout: list[Any], shape: tuple[int, int], name: str) -> Records:
    if not all(0 < side <= MAX_IMAGE_SIDE for side in shape) or not layout:
        raise _malformed(name, ValueError(f"it is {shape} of {len(layout)} fields"))
    try:
        dtype = np.dtype(layout)
        return np.frombuffer(body, dtype, count=shape[0] * shape[1])
    except (ValueError, TypeError) as error:
        raise _malformed(name, error) from error


def _malformed(name: str, error: Exception) -> FormatError:
    return FormatError(f"{name} is malformed ({str(error)[:100]}); give an organised cloud with labels")
