"""Labelled organised point clouds, one file per frame: PCD and PLY.

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
from annotate.exchange.record_file import Records, Shape, write_pcd, write_ply
from annotate.frame_labels import FrameLabels
from annotate.parts import palette_rgb
from sensors.errors import FormatError
from sensors.importers.clouds.pcd_file import read_pcd
from sensors.importers.clouds.ply_file import read_ply
from sensors.importers.clouds.records import CloudRecords
from sensors.rig.camera import Intrinsics, unproject
from sensors.rig.frame import mm_from_metres
from sensors.rig.rig_calibration import Pose


@dataclass(frozen=True)
class CloudFile:
    """One file format of clouds. suffix: of its files; label_type: dtype of labels and person numbers;
    colors: its fields for colours uint8 (n, 3)."""

    suffix: str
    label_type: str
    colors: Callable[[UInt8], dict[str, NDArray[Any]]]
    write: Callable[[Records, Shape, Pose | None], bytes]
    read: Callable[[Path], CloudRecords]


def _packed(rgb: UInt8) -> dict[str, NDArray[Any]]:
    """PCL's one field: the bits of a whole number as a float."""
    red, green, blue = rgb.astype(np.uint32).T
    return {"rgb": (red << 16 | green << 8 | blue).view(np.float32)}


def _separate(rgb: UInt8) -> dict[str, NDArray[Any]]:
    return dict(zip(("red", "green", "blue"), rgb.T, strict=True))


PCD = CloudFile(".pcd", "<u4", _packed, write_pcd, read_pcd)
PLY = CloudFile(".ply", "u1", _separate, write_ply, read_ply)


def write_clouds(kind: CloudFile, frames: Iterator[FrameLabels], camera: Intrinsics, out: Path) -> None:
    """Write one file per frame into an empty folder."""
    for frame in frames:
        records = _records(frame, camera, kind)
        (out / f"{frame.frame_id}{kind.suffix}").write_bytes(kind.write(records, frame.parts.shape, None))


def read_clouds(kind: CloudFile, source: Path, companion: Companion) -> Iterator[FrameLabels]:
    """The inverse of ``write_clouds``. Raises FormatError."""
    for name, file in frame_files(source, kind.suffix):
        yield _frame(name, file, kind, companion)


def _records(frame: FrameLabels, camera: Intrinsics, kind: CloudFile) -> Records:
    """Records (h * w,) of a frame, row by row."""
    points_m = unproject(camera, np.where(frame.depth_mm > 0, frame.depth_mm / 1000, np.nan)).reshape(-1, 3)
    columns: dict[str, NDArray[Any]] = dict(zip("xyz", points_m.astype("<f4").T, strict=True))
    columns |= kind.colors(palette_rgb()[frame.parts.ravel()])
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
