"""A comparison kept on disk as JSON, with what a reader needs to repeat it."""

import base64
import json
import math
import zlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from annotate.labels import Status
from eval.compare import Comparison
from eval.counts import SHAPES, FrameCounts
from eval.joints import N_JOINTS
from eval.metrics import Counts
from eval.pairs import Digests
from eval.traits import Traits
from sensors.atomic import check_free, write_bytes
from sensors.errors import CloudError, FormatError

SCHEMA = 3
MAX_FRAMES = 200_000
"""Their counts are 600 MB in memory."""
MAX_BYTES = 512_000_000
"""MAX_FRAMES with their ids, traits, digests, joints and packed counts."""
PACKED = np.dtype("<i4")
"""More pixels than this can count no image has; sums of MAX_FRAMES stay exact."""
MISSED = "missed"
"""Stands for a joint that was not found, null for one that is not scored."""


@dataclass(frozen=True)
class Result:
    """A comparison and its title, e.g. "Network". facts: the command, hashes, where the sets lie."""

    title: str
    comparison: Comparison
    facts: Mapping[str, str] = field(default_factory=dict)


def check_size(frames: int) -> None:
    """Raise CloudError for more frames than a result keeps: before measuring, not after."""
    if frames > MAX_FRAMES:
        raise CloudError(
            f"a result keeps at most {MAX_FRAMES} frames, not {frames}; evaluate fewer at a time, or leave "
            "--out away"
        )


def save_result(path: Path, result: Result, overwrite: bool = False) -> None:
    """Write a result atomically.

    Raises ExistsError when the file is there and `overwrite` is not set, CloudError for more frames than
    `load_result` would read.
    """
    check_free(path, overwrite)
    comparison = result.comparison
    check_size(len(comparison.frame_ids))
    joints_mm = comparison.joints_mm
    value = {
        "schema": SCHEMA,
        "title": result.title,
        "facts": dict(result.facts),
        "summary": comparison.to_evaluation_json(),
        "frame_ids": comparison.frame_ids,
        "subjects": comparison.subjects,
        "traits": [_known(asdict(traits)) for traits in comparison.traits],
        "digests": [asdict(digests) for digests in comparison.digests],
        "extra_frames": comparison.extra_frames,
        "counts": {name: _packed(getattr(comparison.counts, name)) for name in SHAPES},
        "joints_mm": None if joints_mm is None else [[_joint(v) for v in row] for row in joints_mm],
    }
    data = (json.dumps(value, allow_nan=False, separators=(",", ":")) + "\n").encode()
    if len(data) > MAX_BYTES:
        raise CloudError(
            f"a result of {len(comparison.frame_ids)} frames is {len(data)} bytes, more than {MAX_BYTES}; "
            "evaluate fewer frames at a time"
        )
    write_bytes(path, data)


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
    except FormatError:
        raise
    except (
        CloudError,
        ValueError,
        KeyError,
        TypeError,
        AttributeError,
        OverflowError,
        RecursionError,
        zlib.error,
    ) as error:
        raise FormatError(f"{path} is no result ({error}); give a file that evaluate wrote") from error


def _parse(value: dict[str, Any]) -> Result:
    if len(value["frame_ids"]) > MAX_FRAMES:
        raise ValueError(f"more than {MAX_FRAMES} frames")
    comparison = Comparison(
        frame_ids=_texts(value["frame_ids"]),
        subjects=_texts(value["subjects"]),
        traits=tuple(_traits(traits) for traits in value["traits"]),
        digests=tuple(_digests(digests) for digests in value["digests"]),
        counts=FrameCounts(
            **{name: _counts(name, value["counts"][name], len(value["frame_ids"])) for name in SHAPES}
        ),
        joints_mm=None if value["joints_mm"] is None else _joints(value["joints_mm"]),
        extra_frames=int(value["extra_frames"]),
    )
    if comparison.extra_frames < 0:
        raise ValueError(f"{comparison.extra_frames} frames are left over")
    return Result(str(value["title"]), comparison, {str(k): str(v) for k, v in value["facts"].items()})


def _texts(values: list[Any]) -> tuple[str, ...]:
    return tuple(str(value) for value in values)


def _digests(value: dict[str, Any]) -> Digests:
    return Digests(str(value["depth"]), str(value["truth"]), str(value["predicted"]))


def _known(traits: dict[str, Any]) -> dict[str, Any]:
    """Traits without what is unknown, since JSON has no NaN."""
    return {k: v for k, v in traits.items() if not isinstance(v, float) or math.isfinite(v)}


def _traits(value: dict[str, Any]) -> Traits:
    numbers = {
        name: float(value.get(name, math.nan)) for name in ("distance_m", "invalid_share", "mm_per_px")
    }
    if not all(math.isnan(v) or 0 <= v < math.inf for v in numbers.values()):
        raise ValueError(f"{numbers} are no traits of a frame")
    for status in (value["status"], value["predicted_status"]):
        if status not in get_args(Status):
            raise ValueError(f"status {status!r} is unknown")
    return Traits(
        activity=str(value["activity"]),
        view=str(value["view"]),
        status=value["status"],
        predicted_status=value["predicted_status"],
        hard=_texts(value["hard"]),
        **numbers,
    )


def _joint(error_mm: float) -> float | str | None:
    if math.isnan(error_mm):
        return None
    return round(float(error_mm), 1) if math.isfinite(error_mm) else MISSED


def _joints(rows: list[list[Any]]) -> NDArray[np.float64]:
    special = {None: math.nan, MISSED: math.inf}
    errors = np.array([[special[v] if v in special else float(v) for v in row] for row in rows], np.float64)
    if errors.shape[1:] != (N_JOINTS,) or (errors < 0).any():
        raise ValueError(f"joints_mm holds something else than errors of {N_JOINTS} joints")
    return errors


def _packed(counts: Counts) -> str:
    """Counts as text: base64 of zlib's PACKED integers."""
    return base64.b64encode(zlib.compress(counts.astype(PACKED).tobytes(), 1)).decode()


def _counts(name: str, value: str, frames: int) -> Counts:
    """Inverse of `_packed`, never larger than the frames need."""
    shape = (frames, *SHAPES[name])
    size = math.prod(shape) * PACKED.itemsize
    inflate = zlib.decompressobj()
    data = inflate.decompress(base64.b64decode(value, validate=True), size + 1)
    if len(data) != size or not inflate.eof:
        raise ValueError(f"{name} holds something else than counts of {frames} frames")
    counts = np.frombuffer(data, PACKED).reshape(shape).astype(np.int64)
    if (counts < 0).any():
        raise ValueError(f"{name} holds negative counts")
    return counts
