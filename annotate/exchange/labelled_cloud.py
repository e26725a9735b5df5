"""Labelled organised point clouds, one file per frame: PCD and PLY.

Every pixel is a point, row by row, in the camera frame in metres, NaN without depth. Fields: ``label`` (part
id), ``rgb`` or ``red green blue`` (the part's colour), and ``confidence`` and ``person`` if the label set has
them. PCL reads the PCD as PointXYZRGBL. Labels of a PLY have 8 bits, because Open3D does not read PCL's
32-bit labels. Formats: PCL's "The PCD file format", 0.7; Turk's PLY, 1.0 (grid as ``obj_info num_cols``,
``num_rows``).
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from annotate.array_types import UInt8
from annotate.exchange.companion import Companion, frame_files
from annotate.frame_labels import FrameLabels
from sensors.errors import FormatError
from sensors.importers.clouds.pcd_file import read_pcd
from sensors.importers.clouds.ply_file import TYPES, read_ply
from sensors.importers.clouds.records import CloudRecords
from sensors.rig.camera import Intrinsics, unproject
from sensors.rig.frame import mm_from_metres
from sensors.rig.rig_calibration import Pose, quaternion_of

Records = NDArray[Any]
"""Structured array (n,), little-endian."""
Shape = tuple[int, int]
PLY_NAMES = {kind: name for name, kind in reversed(TYPES.items())}


@dataclass(frozen=True)
class CloudFile:
    """File format of clouds.

    label_type: dtype of labels and person numbers. colors: function from colours uint8 (n, 3) to the format's
    fields. write: function from records, shape and sensor pose to the file's bytes.
    """

    suffix: str
    label_type: str
    colors: Callable[[UInt8], dict[str, NDArray[Any]]]
    write: Callable[[Records, Shape, Pose | None], bytes]
    read: Callable[[Path], CloudRecords]


def write_pcd(records: Records, shape: Shape, viewpoint: Pose | None = None) -> bytes:
    """Return a binary PCD of a cloud of ``shape``: (h, w), or (1, n) without a grid."""
    dtypes = {name: records.dtype[name] for name in records.dtype.names or ()}
    pose = viewpoint or Pose.identity()
    x, y, z, w = quaternion_of(pose.rotation)
    lines = {
        "VERSION": "0.7",
        "FIELDS": " ".join(dtypes),
        "SIZE": " ".join(str(dtype.base.itemsize) for dtype in dtypes.values()),
        "TYPE": " ".join(dtype.base.kind.upper() for dtype in dtypes.values()),
        "COUNT": " ".join(str(int(np.prod(dtype.shape))) for dtype in dtypes.values()),
        "WIDTH": str(shape[1]),
        "HEIGHT": str(shape[0]),
        "VIEWPOINT": " ".join(f"{number:.9g}" for number in (*pose.translation_m, w, x, y, z)),
        "POINTS": str(len(records)),
        "DATA": "binary",
    }
    return "".join(f"{key} {value}\n" for key, value in lines.items()).encode() + records.tobytes()


def write_ply(records: Records, shape: Shape, _: Pose | None = None) -> bytes:
    """Return a binary PLY of vertices in a grid of ``shape``: (h, w), or (1, n) without.

    Left out, because PLY has none: viewpoint, fields of several values, 8-byte integers.
    """
    kinds = {name: records.dtype[name].str[1:] for name in records.dtype.names or ()}
    names = [name for name, kind in kinds.items() if not records.dtype[name].subdtype and kind in PLY_NAMES]
    kept = np.zeros(len(records), [(name, records.dtype[name]) for name in names])
    for name in names:
        kept[name] = records[name]
    fields = "".join(f"property {PLY_NAMES[kinds[name]]} {name}\n" for name in names)
    grid = f"obj_info num_cols {shape[1]}\nobj_info num_rows {shape[0]}\n" if shape[0] > 1 else ""
    head = f"ply\nformat binary_little_endian 1.0\n{grid}element vertex {len(kept)}\n{fields}end_header\n"
    return head.encode() + kept.tobytes()


def _packed(rgb: UInt8) -> dict[str, NDArray[Any]]:
    """Return PCL's packed colour field: the bits of an integer, as a float."""
    red, green, blue = rgb.astype(np.uint32).T
    return {"rgb": (red << 16 | green << 8 | blue).view(np.float32)}


def _separate(rgb: UInt8) -> dict[str, NDArray[Any]]:
    return dict(zip(("red", "green", "blue"), rgb.T, strict=True))


PCD = CloudFile(".pcd", "<u4", _packed, write_pcd, read_pcd)
PLY = CloudFile(".ply", "u1", _separate, write_ply, read_ply)


def write_clouds(kind: CloudFile, frames: Iterator[FrameLabels], companion: Companion, out: Path) -> None:
    """Write one cloud file per frame into an empty folder."""
    for frame in frames:
        content = kind.write(_records(frame, companion.intrinsics, kind), frame.parts.shape, None)
        (out / f"{frame.frame_id}{kind.suffix}").write_bytes(content)


def read_clouds(kind: CloudFile, source: Path, companion: Companion) -> Iterator[FrameLabels]:
    """Yield the frames of files of ``write_clouds``. Raises FormatError."""
    for name, file in frame_files(source, kind.suffix):
        yield _frame(name, file, kind, companion)


def _records(frame: FrameLabels, camera: Intrinsics, kind: CloudFile) -> Records:
    points_m = unproject(camera, np.where(frame.depth_mm > 0, frame.depth_mm / 1000, np.nan)).reshape(-1, 3)
    columns: dict[str, NDArray[Any]] = dict(zip("xyz", points_m.astype("<f4").T, strict=True))
    columns |= kind.colors(frame.scheme.palette_rgb()[frame.parts.ravel()])
    columns["label"] = frame.parts.astype(kind.label_type)
    if frame.confidence is not None:
        columns["confidence"] = frame.confidence.astype("<f4")
    if frame.persons is not None:
        columns["person"] = frame.persons.astype(kind.label_type)
    records = np.zeros(len(points_m), [(name, values.dtype) for name, values in columns.items()])
    for name, values in columns.items():
        records[name] = values.ravel()
    return records


def _frame(frame_id: str, file: Path, kind: CloudFile, companion: Companion) -> FrameLabels:
    cloud = kind.read(file)
    records, shape = cloud.records, cloud.grid or (1, len(cloud.records))
    names = set(records.dtype.names or ())
    if not {"z", "label"} <= names or shape != companion.intrinsics.shape:
        raise FormatError(
            f"{file} has fields {', '.join(sorted(names))[:100]} and is {shape}; give an organised cloud of "
            f"{companion.intrinsics.shape} with z and label"
        )
    if records["z"].dtype.kind != "f":
        raise FormatError(f"{file}: z is {records['z'].dtype}; give metres as floats")
    parts = companion.own_ids(_ids(file, records, "label").reshape(shape))
    persons = _ids(file, records, "person").reshape(shape) if "person" in names else None
    confidence = records["confidence"].astype(np.float32).reshape(shape) if "confidence" in names else None
    depth_mm = mm_from_metres(records["z"].reshape(shape))
    return companion.labels(frame_id, depth_mm, parts, persons, confidence)


def _ids(file: Path, records: Records, name: str) -> UInt8:
    values = records[name]
    if values.dtype.kind not in "iu" or values.min() < 0 or values.max() > 255:
        raise FormatError(
            f"{file}: {name} is {values.dtype} {values.min()} to {values.max()}; give integers from 0 to 255"
        )
    return values.astype(np.uint8)
