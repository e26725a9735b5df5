"""Binary PCD and PLY files of records, which open3d cannot write: it forgets the grid of a cloud."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from sensors.rig.rig_calibration import Pose, quaternion_of

Records = NDArray[Any]
"""A structured array (n,), little-endian; fields of one value each, for PCD of several too."""
Shape = tuple[int, int]

_PLY_NAMES = {
    "f4": "float", "f8": "double", "u1": "uchar", "u2": "ushort", "u4": "uint", "i1": "char", "i2": "short",
    "i4": "int",
}  # fmt: skip


def write_pcd(records: Records, shape: Shape, viewpoint: Pose | None = None) -> bytes:
    """Return a binary PCD of a cloud of ``shape``: (h, w), (1, n) without a grid.

    viewpoint: the sensor's pose.
    """
    dtypes = {name: records.dtype[name] for name in records.dtype.names or ()}
    kind = {"f": "F", "u": "U", "i": "I"}
    pose = viewpoint or Pose.identity()
    x, y, z, w = quaternion_of(pose.rotation)
    lines = {
        "VERSION": "0.7",
        "FIELDS": " ".join(dtypes),
        "SIZE": " ".join(str(dtype.base.itemsize) for dtype in dtypes.values()),
        "TYPE": " ".join(kind[dtype.base.kind] for dtype in dtypes.values()),
        "COUNT": " ".join(str(int(np.prod(dtype.shape))) for dtype in dtypes.values()),
        "WIDTH": str(shape[1]),
        "HEIGHT": str(shape[0]),
        "VIEWPOINT": " ".join(f"{number:.9g}" for number in (*pose.translation_m, w, x, y, z)),
        "POINTS": str(len(records)),
        "DATA": "binary",
    }
    return "".join(f"{key} {value}\n" for key, value in lines.items()).encode() + records.tobytes()


def write_ply(records: Records, shape: Shape, viewpoint: Pose | None = None) -> bytes:
    """Return a binary little-endian PLY of vertices in a grid of ``shape``: (h, w), (1, n) without.

    The format has no place for a viewpoint, nor for fields of several values or of 8-byte whole numbers:
    they are left out.
    """
    del viewpoint
    names = [
        name
        for name in records.dtype.names or ()
        if records.dtype[name].subdtype is None and records.dtype[name].str[1:] in _PLY_NAMES
    ]
    kept = np.zeros(len(records), [(name, records.dtype[name]) for name in names])
    for name in names:
        kept[name] = records[name]
    fields = "".join(f"property {_PLY_NAMES[kept.dtype[name].str[1:]]} {name}\n" for name in names)
    grid = f"obj_info num_cols {shape[1]}\nobj_info num_rows {shape[0]}\n" if shape[0] > 1 else ""
    head = f"ply\nformat binary_little_endian 1.0\n{grid}element vertex {len(kept)}\n{fields}end_header\n"
    return head.encode() + kept.tobytes()
