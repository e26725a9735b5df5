"""Labelled organised point clouds, one file a frame: PCD and PLY.

Every pixel is a point, row by row, in the camera frame in metres, NaN where there is no depth; with
``label`` (part id), ``rgb`` or ``red green blue`` (the part's colour), and where the label set has them
``confidence`` and ``person``. PCL reads the PCD as PointXYZRGBL, Open3D
both as tensor clouds (PCL asks a PLY for 32-bit labels, which Open3D does not read: there they have 8).
Formats: PCL's "The PCD file format", 0.7; Turk's PLY, 1.0 (grid as ``obj_info num_cols``, ``num_rows``).
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from annotate.array_types import UInt8
from annotate.exchange.companion import Companion, frame_files
from annotate.exchange.record_file import Records, read_pcd, read_ply, write_pcd, write_ply
from annotate.frame_labels import FrameLabels
from annotate.parts import palette_rgb
from sensors.errors import FormatError
from sensors.files.bounded import read_bounded
from sensors.rig.camera import Intrinsics, unproject
from sensors.rig.frame import mm_from_metres

MAX_CLOUD_BYTES = 1 << 31
"""Largest cloud that is read, in bytes."""


@dataclass(frozen=True)
class CloudFile:
    """One file format of clouds. suffix: of its files; label_type: dtype of labels and person numbers."""

    suffix: str
    label_type: str
    write: Callable[[Records, tuple[int, int]], bytes]
    read: Callable[[bytes, str], tuple[Records, tuple[int, int]]]


PCD = CloudFile(".pcd", "<u4", write_pcd, read_pcd)
PLY = CloudFile(".ply", "u1", write_ply, read_ply)


def write_clouds(kind: CloudFile, frames: Iterator[FrameLabels], camera: Intrinsics, out: Path) -> None:
    """Write one file a frame into an empty folder."""
    for frame in frames:
        records = _records(frame, camera, kind.label_type)
        (out / f"{frame.frame_id}{kind.suffix}").write_bytes(kind.write(records, frame.parts.shape))


def read_clouds(kind: CloudFile, source: Path, companion: Companion) -> Iterator[FrameLabels]:
    """The inverse of ``write_clouds``. Raises FormatError."""
    for name, file in frame_files(source, kind.suffix):
        yield _frame(name, file, kind, companion)


def _records(frame: FrameLabels, camera: Intrinsics, label_type: str) -> Records:
    """Records (h * w,) of a frame, row by row."""
    points_m = unproject(camera, np.where(frame.depth_mm > 0, frame.depth_mm / 1000, np.nan)).reshape(-1, 3)
    rgb = palette_rgb()[frame.parts.ravel()]
    columns: dict[str, tuple[str, NDArray[Any]]]
    columns = {name: ("<f4", points_m[:, axis]) for axis, name in enumerate("xyz")}
    columns |= {name: ("u1", rgb[:, channel]) for channel, name in enumerate(("red", "green", "blue"))}
    columns["label"] = (label_type, frame.parts)
    if frame.confidence is not None:
        columns["confidence"] = ("<f4", frame.confidence)
    if frame.persons is not None:
        columns["person"] = (label_type, frame.persons)
    records = np.zeros(len(points_m), [(name, dtype) for name, (dtype, _) in columns.items()])
    for name, (_, values) in columns.items():
        records[name] = values.ravel()
    return records


def _frame(frame_id: str, file: Path, kind: CloudFile, companion: Companion) -> FrameLabels:
    records, shape = kind.read(read_bounded(file, MAX_CLOUD_BYTES), str(file))
    names = set(records.dtype.names or ())
    if not {"z", "label"} <= names or shape != companion.intrinsics.shape:
        raise FormatError(
            f"{file} has fields {', '.join(sorted(names))[:100]} and is {shape}; give an organised cloud of "
            f"{companion.intrinsics.shape} with z and label"
        )
    if records["z"].dtype.kind != "f":
        raise FormatError(f"{file}: z is {records['z'].dtype}; give metres as floats")
    parts = _ids(file, records, "label").reshape(shape)
    persons = _ids(file, records, "person").reshape(shape) if "person" in names else None
    confidence = records["confidence"].astype(np.float32).reshape(shape) if "confidence" in names else None
    depth_mm = mm_from_metres(records["z"].reshape(shape))
    return companion.labels(frame_id, depth_mm, parts, persons, confidence)


def _ids(file: Path, records: Records, name: str) -> UInt8:
    """Whole numbers (n,) of a field. Raises FormatError for others than 0 to 255."""
    values = records[name]
    if values.dtype.kind not in "iu" or values.min() < 0 or values.max() > 255:
        raise FormatError(f"{file}: {name} is {values.dtype} {values.min()} to {values.max()}; give 0 to 255")
    return values.astype(np.uint8)
