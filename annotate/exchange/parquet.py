"""Parquet as Hugging Face ``datasets`` reads it, images as bytes: ``data/train-NNNNN-of-NNNNN.parquet``.

Columns: id, image (16-bit depth PNG), label (palette PNG of part ids), confidence, persons, subject, classes.
Confidence and persons are 8-bit PNGs, or null; classes are the ids in the frame, with their names. The column
``annotation`` holds all other fields as JSON. The schema's metadata holds camera, scheme and cast, and the
features under ``huggingface`` (Hugging Face datasets, "Features"). Needs pyarrow (extra ``exchange``).
"""

import json
from collections.abc import Iterator
from dataclasses import asdict
from itertools import chain, islice
from pathlib import Path
from typing import Any

import numpy as np

from annotate.exchange.class_names import class_list
from annotate.exchange.companion import Companion, load_companion
from annotate.frame_labels import FrameLabels
from annotate.labelset import images
from annotate.labelset.cast_note import cast_note, cast_of
from annotate.labelset.scheme_note import scheme_in, scheme_note
from annotate.scheme.scheme import UNDEFINED
from sensors.errors import CalibrationError, FormatError, fault_of
from sensors.files.natural_order import paths_in_order
from sensors.rig.camera import Intrinsics

DATA = "data"
ROWS_A_GROUP, GROUPS_A_FILE = 50, 100  # frames read together; groups in a file; untuned
MAX_GROUP_BYTES = 1 << 31  # largest row group, unpacked
IMAGES = ("image", "label", "confidence", "persons")
CLASSES = "classes"
CAMERA, SET = b"annotate-cloud intrinsics", b"annotate-cloud set"
MALFORMED = (OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError, ArithmeticError)
"""Errors of a malformed file, beside pyarrow's own."""

Pyarrow = Any


def write_parquet(frames: Iterator[FrameLabels], companion: Companion, out: Path) -> None:
    """Write frames as Parquet files into an empty folder."""
    pa = _pyarrow()
    (out / DATA).mkdir()
    schema = _schema(companion)
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
    """Return camera, scheme and cast of Parquet files; without a camera, ``load_companion``.

    Raises FormatError, CalibrationError.
    """
    return _stored(_files(source)[0]) or load_companion(source, intrinsics)


def read_parquet(source: Path, companion: Companion) -> Iterator[FrameLabels]:
    """Yield the frames of Parquet files. Raises FormatError."""
    for file in _files(source):
        yield from _frames(file, companion)


def _pyarrow() -> Pyarrow:
    try:
        import pyarrow.parquet
    except ImportError as error:
        raise FormatError("Parquet needs pyarrow; pip install 'annotate-cloud[exchange]'") from error
    return pyarrow


def _files(source: Path) -> list[Path]:
    return paths_in_order(source.glob("*.parquet")) or paths_in_order((source / DATA).glob("*.parquet"))


def _schema(companion: Companion) -> Pyarrow:
    pa = _pyarrow()
    picture = pa.struct([("bytes", pa.binary()), ("path", pa.string())])
    columns = [("id", pa.string()), *((name, picture) for name in IMAGES)]
    columns += [("subject", pa.string()), ("annotation", pa.string())]
    text, image = {"dtype": "string", "_type": "Value"}, {"_type": "Image"}
    features: dict[str, Any] = {name: image if name in IMAGES else text for name, _ in columns}
    columns.append((CLASSES, pa.list_(pa.int64())))
    label = {"names": class_list(companion.scheme), "_type": "ClassLabel"}
    features[CLASSES] = {"feature": label, "_type": "List"}
    metadata = {
        b"huggingface": json.dumps({"info": {"features": features}}).encode(),
        CAMERA: json.dumps(asdict(companion.intrinsics)).encode(),
    }
    if note := cast_note(companion.cast) | scheme_note(companion.scheme):
        metadata[SET] = json.dumps(note).encode()
    return pa.schema(columns, metadata)


def _row(frame: FrameLabels) -> dict[str, Any]:
    encoded = {
        "image": images.encode_png(frame.depth_mm),
        "label": images.encode_parts(frame.parts, frame.scheme),
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
    present = np.unique(frame.parts)
    return {
        **{"id": frame.frame_id, **pictures, "subject": subject, "annotation": json.dumps(rest)},
        CLASSES: present[present != UNDEFINED].tolist(),
    }


def _stored(file: Path) -> Companion | None:
    """Return camera, scheme and cast of an exported file; None for a file without a camera."""
    pa = _pyarrow()
    try:
        metadata = pa.parquet.read_schema(file).metadata or {}
        if CAMERA not in metadata:
            return None
        camera, note = Intrinsics(**json.loads(metadata[CAMERA])), json.loads(metadata.get(SET, b"{}"))
        return Companion(camera, cast=cast_of(note), scheme=scheme_in(note, file), is_ours=True)
    except (*MALFORMED, CalibrationError, pa.ArrowException) as error:
        raise _broken(file, error) from error


def _frames(file: Path, companion: Companion) -> Iterator[FrameLabels]:
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
                    yield from (_frame(row, companion) for row in batch.to_pylist())
    except (*MALFORMED, pa.ArrowException) as error:
        raise _broken(file, error) from error


def _frame(row: dict[str, Any], companion: Companion) -> FrameLabels:
    """Return the frame of a row. Raises one of ``MALFORMED``."""
    data = {name: None if row[name] is None else row[name]["bytes"] for name in IMAGES}
    rest = json.loads(row["annotation"])
    if data["image"] is None or data["label"] is None or not isinstance(rest, dict):
        raise ValueError(f"row {str(row['id'])[:100]!r} lacks its images or its annotation")
    confidence, persons = data["confidence"], data["persons"]
    return FrameLabels(
        str(row["id"]),
        images.decode_depth(data["image"]),
        companion.own_ids(images.decode_parts(data["label"])),
        None if confidence is None else images.decode_confidence(confidence),
        rest["status"],
        str(rest["subject"]),
        dict(rest["notes"]),
        None if persons is None else images.decode_persons(persons),
        companion.scheme,
    )


def _broken(file: Path, error: Exception) -> FormatError:
    why = " ".join(fault_of(error).split())[:120]
    return FormatError(f"{file} cannot be read ({why}); give a Parquet file that export wrote")
