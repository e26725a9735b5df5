"""Parquet as Hugging Face ``datasets`` reads it, images as bytes: ``data/train-NNNNN-of-NNNNN.parquet``.

Columns: id, image (16-bit depth PNG), label (palette PNG of part ids), confidence and persons (8-bit PNGs, or
null), subject. The column ``annotation`` holds all other fields as JSON. The schema's metadata holds the
camera, and the features under ``huggingface`` (Hugging Face datasets, "Features"). Needs pyarrow (extra
``exchange``).
"""

import json
from collections.abc import Iterator
from dataclasses import asdict
from itertools import chain, islice
from pathlib import Path
from typing import Any

from annotate.exchange.companion import Companion, load_companion
from annotate.frame_labels import FrameLabels
from annotate.labelset import images
from sensors.errors import CalibrationError, FormatError
from sensors.files.natural_order import paths_in_order
from sensors.rig.camera import Intrinsics

DATA = "data"
ROWS_A_GROUP, GROUPS_A_FILE = 50, 100  # frames read together; groups in a file; untuned
MAX_GROUP_BYTES = 1 << 31  # largest row group, unpacked
IMAGES = ("image", "label", "confidence", "persons")
CAMERA = b"annotate-cloud intrinsics"
MALFORMED = (OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError, ArithmeticError)
"""Errors of a malformed file, beside pyarrow's own."""

Pyarrow = Any


def write_parquet(frames: Iterator[FrameLabels], camera: Intrinsics, out: Path) -> None:
    """Write frames as Parquet files into an empty folder."""
    pa = _pyarrow()
    (out / DATA).mkdir()
    schema = _schema(camera)
    files: list[Path] = []
    groups = iter(lambda: list(islice(frames, ROWS_A_GROUP)), [])
    for first in groups:
        files.append(out / DATA / f"{len(files):05d}")
        with pa.parquet.ParquetWriter(files[-1], schema) as writer:
            for group in chain([first], islice(groups, GROUPS_A_FILE - 1)):
                writer.write_table(pa.Table.from_pylist([*map(_row, group)], schema))
    for number, file in enumerate(files):
        file.rename(file.with_name(f"train-{number:05d}-of-{len(files):05d}.parquet"))


def is_parquet(source: Path) -> bool:
    """Return whether a folder, or its ``data/``, holds Parquet files."""
    return bool(_files(source))


def camera_of_parquet(source: Path, intrinsics: Path | None = None) -> Companion:
    """Return the camera of Parquet files; without one, ``load_companion``. Raises FormatError,
    CalibrationError.
    """
    camera = _camera(_files(source)[0])
    return Companion(camera) if camera else load_companion(source, intrinsics)


def read_parquet(source: Path, companion: Companion) -> Iterator[FrameLabels]:
    """Yield the frames of Parquet files; ``companion`` is not used. Raises FormatError."""
    for file in _files(source):
        yield from _frames(file)


def _pyarrow() -> Pyarrow:
    try:
        import pyarrow.parquet
    except ImportError as error:
        raise FormatError("Parquet needs pyarrow; pip install 'annotate-cloud[exchange]'") from error
    return pyarrow


def _files(source: Path) -> list[Path]:
    return paths_in_order(source.glob("*.parquet")) or paths_in_order((source / DATA).glob("*.parquet"))


def _schema(camera: Intrinsics) -> Pyarrow:
    pa = _pyarrow()
    picture = pa.struct([("bytes", pa.binary()), ("path", pa.string())])
    columns = [("id", pa.string()), *((name, picture) for name in IMAGES)]
    columns += [("subject", pa.string()), ("annotation", pa.string())]
    text, image = {"dtype": "string", "_type": "Value"}, {"_type": "Image"}
    features = {name: image if name in IMAGES else text for name, _ in columns}
    metadata = {
        b"huggingface": json.dumps({"info": {"features": features}}).encode(),
        CAMERA: json.dumps(asdict(camera)).encode(),
    }
    return pa.schema(columns, metadata)


def _row(frame: FrameLabels) -> dict[str, Any]:
    encoded = {
        "image": images.encode_png(frame.depth_mm),
        "label": images.encode_parts(frame.parts),
        "confidence": None if frame.confidence is None else images.encode_confidence(frame.confidence),
        "persons": None if frame.persons is None else images.encode_png(frame.persons),
    }
    pictures = {
        name: None if data is None else {"bytes": data, "path": f"{frame.frame_id}.{name}.png"}
        for name, data in encoded.items()
    }
    rest = {"status": frame.status, "subject": frame.subject, "notes": frame.notes}
    # UTF-8 has no lone surrogates; JSON has, and keeps the exact subject.
    subject = frame.subject.encode("utf-8", "replace").decode()
    return {"id": frame.frame_id, **pictures, "subject": subject, "annotation": json.dumps(rest)}


def _camera(file: Path) -> Intrinsics | None:
    pa = _pyarrow()
    try:
        metadata = pa.parquet.read_schema(file).metadata or {}
        return Intrinsics(**json.loads(metadata[CAMERA])) if CAMERA in metadata else None
    except (*MALFORMED, CalibrationError, pa.ArrowException) as error:
        raise _broken(file, error) from error


def _frames(file: Path) -> Iterator[FrameLabels]:
    pa = _pyarrow()
    try:
        with pa.parquet.ParquetFile(file) as parquet:
            # Group by group: one pass over the file would keep everything in memory.
            for group in range(parquet.num_row_groups):
                if parquet.metadata.row_group(group).total_byte_size > MAX_GROUP_BYTES:
                    raise FormatError(
                        f"{file} has a row group over {MAX_GROUP_BYTES} bytes; write it in smaller ones"
                    )
                for batch in parquet.iter_batches(ROWS_A_GROUP, [group], ["id", *IMAGES, "annotation"]):
                    yield from map(_frame, batch.to_pylist())
    except (*MALFORMED, pa.ArrowException) as error:
        raise _broken(file, error) from error


def _frame(row: dict[str, Any]) -> FrameLabels:
    """Return the frame of a row. Raises one of ``MALFORMED``."""
    data = {name: None if row[name] is None else row[name]["bytes"] for name in IMAGES}
    rest = json.loads(row["annotation"])
    if data["image"] is None or data["label"] is None or not isinstance(rest, dict):
        raise ValueError(f"row {str(row['id'])[:100]!r} lacks its images or its annotation")
    confidence, persons = data["confidence"], data["persons"]
    return FrameLabels(
        str(row["id"]),
        images.decode_depth(data["image"]),
        images.decode_parts(data["label"]),
        None if confidence is None else images.decode_confidence(confidence),
        rest["status"],
        str(rest["subject"]),
        dict(rest["notes"]),
        None if persons is None else images.decode_persons(persons),
    )


def _broken(file: Path, error: Exception) -> FormatError:
    why = " ".join(str(error).split())[:120]
    return FormatError(f"{file} cannot be read ({why}); give a Parquet file that export wrote")
