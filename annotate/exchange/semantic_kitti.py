"""SemanticKITTI: ``sequences/00/velodyne/NNNNNN.bin`` and ``labels/NNNNNN.label``.

A point is x, y, z, remission (float32; x forward, y left, z up, metres; remission 0). Its label is a uint32:
part id in the low 16 bits, person in the high ones. ``index/NNNNNN.index`` (uint32) holds each point's pixel,
from which the depth image is rebuilt. Pixels with a label but no depth are points at the origin.
``semantic-kitti.yaml`` names classes and colours. Format: semantic-kitti.org, "Dataset";
PRBonn/semantic-kitti-api.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from annotate.array_types import Float64
from annotate.exchange.class_names import UNDEFINED_NAME
from annotate.exchange.companion import Companion, frame_files
from annotate.frame_labels import FrameLabels
from annotate.scheme.scheme import BACKGROUND_PART, UNDEFINED, Scheme
from sensors.errors import FormatError
from sensors.files.bounded import read_bounded
from sensors.rig.camera import Intrinsics, unproject
from sensors.rig.frame import mm_from_metres

SEQUENCE = Path("sequences") / "00"
POINTS, LABELS, INDEX, CONFIG = "velodyne", "labels", "index", "semantic-kitti.yaml"


def write_kitti(frames: Iterator[FrameLabels], companion: Companion, out: Path) -> None:
    """Write frames as a SemanticKITTI sequence into an empty folder."""
    for name in (POINTS, LABELS, INDEX):
        (out / SEQUENCE / name).mkdir(parents=True)
    for number, frame in enumerate(frames):
        persons = np.zeros_like(frame.parts) if frame.persons is None else frame.persons
        pixels = np.flatnonzero((frame.depth_mm > 0) | (frame.parts > 0) | (persons > 0))
        labels = (frame.parts.astype(np.uint32) | persons.astype(np.uint32) << 16).ravel()[pixels]
        for folder, suffix, values in (
            (POINTS, "bin", _points(frame, companion.intrinsics)[pixels].astype("<f4")),
            (LABELS, "label", labels.astype("<u4")),
            (INDEX, "index", pixels.astype("<u4")),
        ):
            (out / SEQUENCE / folder / f"{number:06d}.{suffix}").write_bytes(values.tobytes())
    (out / CONFIG).write_text(_config(companion.scheme), encoding="ascii")


def read_kitti(source: Path, companion: Companion) -> Iterator[FrameLabels]:
    """Yield the frames of a sequence that ``write_kitti`` wrote.

    companion: camera, and the frames' ids and fields that the format cannot hold. Raises FormatError for
    damaged files and for lidar scans, which have no ``index`` folder with the points' pixels.
    """
    folder, names = source / SEQUENCE, list(companion.frames)
    if not (folder / INDEX).is_dir():
        raise FormatError(
            f"{folder} has no folder {INDEX!r} with the pixel of each point; give a folder that export wrote"
        )
    for number, file in frame_files(folder / LABELS, ".label"):
        at = int(number) if number.isdecimal() and len(number) <= 9 else len(names)
        frame_id = names[at] if at < len(names) else number
        yield _frame(folder, number, frame_id, file, companion)


def _points(frame: FrameLabels, camera: Intrinsics) -> Float64:
    """Return points (h * w, 4): forward, left, up, 0; zero without depth."""
    right, down, forward = np.moveaxis(unproject(camera, frame.depth_mm / 1000.0), -1, 0)
    return np.stack([forward, -right, -down, np.zeros_like(forward)], axis=-1).reshape(-1, 4)


def _frame(folder: Path, number: str, frame_id: str, file: Path, companion: Companion) -> FrameLabels:
    labels = np.frombuffer(_words(file), "<u4")
    points = np.frombuffer(_words(folder / POINTS / f"{number}.bin"), "<f4")
    pixels = np.frombuffer(_words(folder / INDEX / f"{number}.index"), "<u4").astype(np.int64)
    height, width = companion.intrinsics.shape
    if not len(points) == 4 * len(labels) == 4 * len(pixels):
        raise FormatError(
            f"{file} has {len(labels)} labels for {len(points) / 4:g} points and {len(pixels)} pixel "
            "indices; restore the three files from a copy"
        )
    if (pixels >= height * width).any():
        raise FormatError(
            f"{folder / INDEX / number}.index has pixel {pixels.max()} of an image of {width}x{height}; "
            "restore it from a copy"
        )
    ids = np.stack([labels & 0xFFFF, labels >> 16])
    if (ids > 255).any():
        raise FormatError(
            f"{file} holds part ids up to {ids[0].max()} and track ids up to {ids[1].max()}; give both "
            "up to 255"
        )
    images = np.zeros((3, height * width), np.uint16)
    images[:, pixels] = mm_from_metres(points[::4]), *ids
    depth_mm, parts, persons = images.reshape(3, height, width)
    own = companion.own_ids(parts.astype(np.uint8))
    return companion.labels(frame_id, depth_mm, own, persons.astype(np.uint8))


def _words(file: Path) -> bytes:
    data = read_bounded(file)
    if len(data) % 4:
        raise FormatError(f"{file} is cut off; restore it from a copy")
    return data


def _config(scheme: Scheme) -> str:
    palette = scheme.palette_rgb()
    names = {part.id: part.name for part in (BACKGROUND_PART, *scheme.parts)}
    ids = {**names, UNDEFINED: UNDEFINED_NAME}
    learned = {number: (0 if number == UNDEFINED else index) for index, number in enumerate(ids, 1)}
    back = sorted((index, number) for number, index in learned.items())
    tables: dict[str, dict[Any, Any]] = {
        "labels": ids,
        "color_map: # blue, green, red": {number: palette[number, ::-1].tolist() for number in ids},
        "learning_map": learned,
        "learning_map_inv": dict(back),
        "learning_ignore": {index: "true" if index == 0 else "false" for index, _ in back},
        "split": {"train": [0], "valid": [0], "test": [0]},
    }
    lines = []
    for name, table in tables.items():
        lines += [name if "#" in name else f"{name}:", *(f"  {key}: {value}" for key, value in table.items())]
    return "\n".join([*lines, ""])
