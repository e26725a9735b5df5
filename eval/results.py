"""A comparison kept on disk as JSON, with what a reader needs to repeat it."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from eval.compare import Comparison
from eval.metrics import Counts
from sensors.atomic import write_bytes
from sensors.errors import ExistsError, FormatError

SCHEMA = 1
MAX_BYTES = 256_000_000
"""About ten times the JSON of the 4,984 frames of the paper's test set, all classes present."""

_COUNTS = ("matrices", "borders", "by_distance", "undefined")


@dataclass(frozen=True)
class Result:
    """A comparison and its title, e.g. "Network". facts: the command, hashes, where the sets lie."""

    title: str
    comparison: Comparison
    facts: Mapping[str, str] = field(default_factory=dict)


def save_result(path: Path, result: Result, overwrite: bool = False) -> None:
    """Write a result atomically. Raises ExistsError when the file is there and `overwrite` is not set."""
    if path.exists() and not overwrite:
        raise ExistsError(f"{path} exists already; choose another file or pass --overwrite")
    comparison = result.comparison
    value = {
        "schema": SCHEMA,
        "title": result.title,
        "facts": dict(result.facts),
        "summary": comparison.to_evaluation_json(),
        "frame_ids": comparison.frame_ids,
        "subjects": comparison.subjects,
        "extra_frames": comparison.extra_frames,
        **{name: getattr(comparison, name).tolist() for name in _COUNTS},
    }
    write_bytes(path, (json.dumps(value, allow_nan=False) + "\n").encode())


def load_result(path: Path) -> Result:
    """Read a result back; scores are derived anew from its counts. Raises FormatError if it is none."""
    try:
        if path.stat().st_size > MAX_BYTES:
            raise FormatError(f"{path} is larger than {MAX_BYTES} bytes; it is no result of evaluate")
        value = json.loads(path.read_bytes())
        if value["schema"] != SCHEMA:
            raise FormatError(f"{path} is not of schema {SCHEMA}; evaluate again with this version")
        return _parse(value)
    except OSError as error:
        raise FormatError(
            f"{path} cannot be read ({error.strerror}); give a file that evaluate wrote"
        ) from error
    except (ValueError, KeyError, TypeError, OverflowError, RecursionError) as error:
        raise FormatError(f"{path} is no result ({error}); give a file that evaluate wrote") from error


def _parse(value: dict[str, Any]) -> Result:
    comparison = Comparison(
        frame_ids=tuple(str(v) for v in value["frame_ids"]),
        subjects=tuple(str(v) for v in value["subjects"]),
        extra_frames=int(value["extra_frames"]),
        **{name: _counts(name, value[name]) for name in _COUNTS},
    )
    return Result(str(value["title"]), comparison, {str(k): str(v) for k, v in value["facts"].items()})


def _counts(name: str, value: list[Any]) -> Counts:
    counts = np.array(value)
    if not np.issubdtype(counts.dtype, np.integer) or counts.min(initial=0) < 0:
        raise ValueError(f"{name} holds something else than counts")
    return counts.astype(np.int64)
