"""Parquet as Hugging Face ``datasets`` reads it, images as bytes: ``data/train-NNNNN-of-NNNNN.parquet``.

Columns: id, image (16-bit depth PNG), label (palette PNG of part ids), confidence and persons (8-bit PNGs,
or null), subject, and ``annotation``, the rest as JSON. ``load_dataset("parquet", data_files=...)`` decodes
the images. The camera is in the files' own metadata. Needs pyarrow (extra ``exchange``).
Format: Hugging Face datasets, "Features"; parquet with ``huggingface`` in its schema's metadata.
"""

import json
from collections.abc import Iterator
from dataclasses import asdict
from importlib.util import find_spec
from itertools import islice
from pathlib import Path
from typing import Any

from annotate.exchange.companion import Companion, load_companion
from annotate.frame_labels import FrameLabels
from annotate.labelset.images import (
    decode_confidence,
    decode_depth,
    decode_parts,
    decode_persons,
    encode_confidence,
    encode_depth,
    encode_parts,
    encode_persons,
)
from sensors.errors import CalibrationError, FormatError
from sensors.rig.camera import Intrinsics

DATA = "data"
ROWS_A_FILE, ROWS_A_GROUP = 5000, 50
MAX_GROUP_BYTES = 1 << 31
MAX_ANNOTATION_BYTES = 16_000_000
"""As much as a label set's own file of it."""
IMAGES = ("image", "label", "confidence", "persons")
LEAVES = ["id", "annotation", *(f"{name}.{part}" for name in IMAGES for part in ("bytes", "path"))]
"""Columns kept as they are stored, each value once: rows of a file of 12 kB can share one of 40 MB."""
CAMERA = b"annotate-cloud intrinsics"

Pyarrow = Any
"""A schema or table of pyarrow, which need not be installed where the types are checked."""


def write_parquet(frames: Iterator[FrameLabels], companion: Companion, out: Path) -> None:
    """Write into an empty folder, ROWS_A_FILE frames a file."""
    _require()
    import pyarrow.parquet as pq

    (out / DATA).mkdir()
    schema = _schema(companion.intrinsics)
    files: list[Path] = []
    while chunk := list(islice(frames, ROWS_A_GROUP)):
        file = out / DATA / f"{len(files):05d}"
        files.append(file)
        with pq.ParquetWriter(file, schema) as writer:
            written = 0
            while chunk:
                writer.write_table(_table(chunk, schema))
                written += len(chunk)
                for frame in chunk:
                    companion.add(frame)
                left = min(ROWS_A_GROUP, ROWS_A_FILE - written)
                chunk = list(islice(frames, left)) if left else []
    for number, file in enumerate(files):
        file.rename(file.with_name(f"train-{number:05d}-of-{len(files):05d}.parquet"))


def is_parquet(source: Path) -> bool:
    """Whether a folder, or its ``data/``, holds Parquet files."""
    return bool(_files(source))


def read_parquet(source: Path) -> tuple[Companion, Iterator[FrameLabels]]:
    """The inverse of ``write_parquet``. Raises FormatError, CalibrationError."""
    _require()
    files = _files(source)
    camera = _camera(files[0])
    companion = Companion(camera) if camera else load_companion(source)
    return companion, (frame for file in files for frame in _frames(file))


def _require() -> None:
    if find_spec("pyarrow") is None:
        raise FormatError("Parquet needs pyarrow; pip install 'annotate-cloud[exchange]'")


def _files(source: Path) -> list[Path]:
    return sorted(source.glob("*.parquet")) or sorted((source / DATA).glob("*.parquet"))


def _schema(camera: Intrinsics) -> Pyarrow:
    import pyarrow as pa

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


def _table(frames: list[FrameLabels], schema: Pyarrow) -> Pyarrow:
    import pyarrow as pa

    return pa.Table.from_pylist([_row(frame) for frame in frames], schema)


def _row(frame: FrameLabels) -> dict[str, Any]:
    images = {
        "image": encode_depth(frame.depth_mm),
        "label": encode_parts(frame.parts),
        "confidence": None if frame.confidence is None else encode_confidence(frame.confidence),
        "persons": None if frame.persons is None else encode_persons(frame.persons),
    }
    pictures = {
        name: None if data is None else {"bytes": data, "path": f"{frame.frame_id}.{name}.png"}
        for name, data in images.items()
    }
    rest = {"status": frame.status, "subject": frame.subject, "notes": frame.notes}
    # UTF-8 has no lone surrogates, JSON does: the exact subject is there.
    subject = frame.subject.encode("utf-8", "replace").decode()
    return {"id": frame.frame_id, **pictures, "subject": subject, "annotation": json.dumps(rest)}


def _camera(file: Path) -> Intrinsics | None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        metadata = pq.read_schema(file).metadata or {}
        return Intrinsics(**json.loads(metadata[CAMERA])) if CAMERA in metadata else None
    except (
        CalibrationError, OSError, pa.ArrowException, ValueError, TypeError, KeyError, RecursionError,
    ) as error:  # fmt: skip
        raise _broken(file, error) from error


def _frames(file: Path) -> Iterator[FrameLabels]:
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        metadata = pq.read_metadata(file)
        there = {metadata.schema.column(i).path for i in range(metadata.num_columns)}
        leaves = [name for name in LEAVES if name in there]
        with pq.ParquetFile(file, metadata=metadata, read_dictionary=leaves) as parquet:
            groups = [parquet.metadata.row_group(i) for i in range(parquet.metadata.num_row_groups)]
            if any(group.total_byte_size > MAX_GROUP_BYTES for group in groups):
                raise FormatError(f"{file} has a row group of more than {MAX_GROUP_BYTES} bytes; split it")
            columns = ["id", *IMAGES, "annotation"]
            for group in range(len(groups)):
                # Group by group: one pass over the file would keep all that it has read.
                for batch in parquet.iter_batches(ROWS_A_GROUP, row_groups=[group], columns=columns):
                    for row in range(len(batch)):
                        yield _frame(batch.slice(row, 1).to_pylist()[0])
    except (OSError, pa.ArrowException, ValueError, TypeError, KeyError, AttributeError, RecursionError,
            MemoryError, OverflowError) as error:  # fmt: skip
        raise _broken(file, error) from error


def _frame(row: dict[str, Any]) -> FrameLabels:
    """A row as a frame; the errors of what it lacks are the caller's."""
    data = {name: None if row[name] is None else row[name]["bytes"] for name in IMAGES}
    if len(row["annotation"]) > MAX_ANNOTATION_BYTES:
        raise ValueError(f"an annotation of {len(row['annotation'])} characters")
    rest = json.loads(row["annotation"])
    if data["image"] is None or data["label"] is None or not isinstance(rest, dict):
        raise ValueError(f"row {str(row['id'])[:100]!r} lacks its images or its annotation")
    confidence, persons = data["confidence"], data["persons"]
    return FrameLabels(
        str(row["id"]),
        decode_depth(data["image"]),
        decode_parts(data["label"]),
        None if confidence is None else decode_confidence(confidence),
        rest["status"],
        str(rest["subject"]),
        dict(rest["notes"]),
        None if persons is None else decode_persons(persons),
    )


def _broken(file: Path, error: Exception) -> FormatError:
    why = " ".join(str(error).split())[:120]
    return FormatError(f"{file} cannot be read ({why}); give a Parquet file that export wrote")
