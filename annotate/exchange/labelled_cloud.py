"""Labelled organised point clouds, one file a frame: PCD and PLY.

Every pixel is a point, row by row, in the camera frame in metres, NaN where there is no depth; with
``label`` (part id), ``rgb`` or ``red green blue`` (the part's colour), and where the label set has them
``confidence`` and ``person``. PCL reads the PCD as PointXYZRGBL, Open3D
both as tensor clouds (PCL asks a PLY for 32-bit labels, which Open3D does not read: there they have 8).
Formats: PCL's "The PCD file format", 0.7; Turk's PLY, 1.0 (grid as ``obj_info num_cols``, ``num_rows``).
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from annotate.exchange.companion import Companion, frame_files, load_companion
from annotate.exchange.record_file import Records, read_pcd, read_ply, write_pcd, write_ply
from annotate.frame_labels import FrameLabels
from annotate.parts import palette_rgb
from sensors.errors import FormatError
from sensors.files.bounded import read_bounded
from sensors.rig.camera import Intrinsics, unproject
from sensors.rig.frame import mm_from_metres

PCD, PLY = ".pcd", ".ply"
MAX_CLOUD_BYTES = 1 << 31


def write_clouds_pcd(frames: Iterator[FrameLabels], companion: Companion, out: Path) -> None:
    """Write one PCD a frame into an empty folder."""
    for frame in frames:
        cloud = _records(frame, companion.intrinsics, "<u4")
        (out / f"{frame.frame_id}{PCD}").write_bytes(write_pcd(cloud, frame.parts.shape))
        companion.add(frame)


def write_clouds_ply(frames: Iterator[FrameLabels], companion: Companion, out: Path) -> None:
    """Write one PLY a frame into an empty folder."""
    for frame in frames:
        cloud = _records(frame, companion.intrinsics, "u1")
        (out / f"{frame.frame_id}{PLY}").write_bytes(write_ply(cloud, frame.parts.shape))
        companion.add(frame)


def is_pcd(source: Path) -> bool:
    """Whether a folder holds PCD files."""
    return any(source.glob(f"*{PCD}"))


def is_ply(source: Path) -> bool:
    """Whether a folder holds PLY files."""
    return any(source.glob(f"*{PLY}"))


def read_clouds_pcd(source: Path) -> tuple[Companion, Iterator[FrameLabels]]:
    """The inverse of ``write_clouds_pcd``. Raises FormatError, CalibrationError."""
    companion = load_companion(source)
    return companion, (
        _frame(name, file, read_pcd(_bytes(file), str(file)), companion)
        for name, file in frame_files(source, PCD)
    )


def read_clouds_ply(source: Path) -> tuple[Companion, Iterator[FrameLabels]]:
    """The inverse of ``write_clouds_ply``. Raises FormatError, CalibrationError."""
    companion = load_companion(source)
    return companion, (
        _frame(name, file, read_ply(_bytes(file), str(file)), companion)
        for name, file in frame_files(source, PLY)
    )


def _bytes(file: Path) -> bytes:
    return read_bounded(file, MAX_CLOUD_BYTES)


def _records(frame: FrameLabels, camera: Intrinsics, label_type: str) -> Records:
    """label_type: PCL's labels are 32 bits wide, of which Open3D's PLY reader knows none unsigned."""
    metres = np.where(frame.depth_mm > 0, frame.depth_mm / 1000, np.nan)
    points = unproject(camera, metres).reshape(-1, 3)
    kinds = [
        ("x", "<f4"),
        ("y", "<f4"),
        ("z", "<f4"),
        ("red", "u1"),
        ("green", "u1"),
        ("blue", "u1"),
        ("label", label_type),
    ]
    kinds += [("confidence", "<f4")] if frame.confidence is not None else []
    kinds += [("person", label_type)] if frame.persons is not None else []
    records = np.zeros(len(points), kinds)
    for axis, name in enumerate("xyz"):
        records[name] = points[:, axis]
    for channel, name in enumerate(("red", "green", "blue")):
        records[name] = palette_rgb()[frame.parts.ravel(), channel]
    records["label"] = frame.parts.ravel()
    if frame.confidence is not None:
        records["confidence"] = frame.confidence.ravel()
    if frame.persons is not None:
        records["person"] = frame.persons.ravel()
    return records


def _frame(
    frame_id: str, file: Path, cloud: tuple[Records, tuple[int, int]], companion: Companion
) -> FrameLabels:
    records, shape = cloud
    names = set(records.dtype.names or ())
    if not {"z", "label"} <= names or shape != companion.intrinsics.shape:
        raise FormatError(
            f"{file} has fields {', '.join(sorted(names))[:100]} and is {shape}; give an organised cloud of "
            f"{companion.intrinsics.shape} with z and label"
        )

    def image(name: str, kind: type[np.uint8]) -> NDArray[np.uint8] | None:
        if name not in names:
            return None
        values = records[name]
        if values.dtype.kind not in "iu" or values.min() < 0 or values.max() > np.iinfo(kind).max:
            raise FormatError(
                f"{file}: {name} is {values.dtype} {values.min()} to {values.max()}; give 0 to 255"
            )
        return values.astype(kind).reshape(shape)

    parts, persons = image("label", np.uint8), image("person", np.uint8)
    confidence = None
    if "confidence" in names:
        confidence = records["confidence"].astype(np.float32).reshape(shape)
    if parts is None or records["z"].dtype.kind != "f":
        raise FormatError(f"{file}: z is {records['z'].dtype}; give metres as floats")
    depth_mm = mm_from_metres(records["z"].reshape(shape))
    return companion.labels(frame_id, depth_mm, parts, persons, confidence)
