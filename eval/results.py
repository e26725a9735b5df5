"""A comparison kept on disk as JSON, with what a reader needs to repeat it."""

import base64
import json
import math
import zlib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from annotate.labels import Status
from eval.compare import Comparison
from eval.counts import WIDTH, FrameCounts
from eval.joints import N_JOINTS
from eval.metrics import Counts
from eval.pairs import Digests
from eval.room import blocks, room
from eval.traits import Traits
from sensors.atomic import check_free, replacing
from sensors.bounded import read_bounded
from sensors.errors import CloudError, FormatError

SCHEMA = 3
MAX_FRAMES = 200_000
"""Their counts are 600 MB in a file."""
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
    check_size(len(result.comparison.frame_ids))
    written = 0
    with replacing(path) as temporary, temporary.open("wb") as file:
        for piece in _pieces(result):
            written += file.write(piece)
            if written > MAX_BYTES:
                raise CloudError(
                    f"a result of {len(result.comparison.frame_ids)} frames is more than {MAX_BYTES} bytes; "
                    "evaluate fewer frames at a time"
                )


def _pieces(result: Result) -> Iterator[bytes]:
    """The file bit by bit: as one text it would be larger than all that it holds."""
    comparison, joints_mm = result.comparison, result.comparison.joints_mm
    yield b"{" + _entry("schema", SCHEMA) + b"," + _entry("title", result.title)
    yield b"," + _entry("facts", dict(result.facts))
    yield b"," + _entry("summary", comparison.to_evaluation_json())
    yield from _listed("frame_ids", comparison.frame_ids)
    yield from _listed("subjects", comparison.subjects)
    yield from _listed("traits", (_known(asdict(traits)) for traits in comparison.traits))
    yield from _listed("digests", (asdict(digests) for digests in comparison.digests))
    yield b"," + _entry("extra_frames", comparison.extra_frames) + b',"counts":{'
    for i, (name, counts) in enumerate(comparison.counts.by_name.items()):
        yield b"," * (i > 0) + json.dumps(name).encode() + b':"'
        yield from _packed(counts)
        yield b'"'
    yield b"}"
    if joints_mm is None:
        yield b"," + _entry("joints_mm", None)
    else:
        yield from _listed("joints_mm", ([_joint(v) for v in row] for row in joints_mm))
    yield b"}\n"


def _json(value: object) -> bytes:
    return json.dumps(value, allow_nan=False, separators=(",", ":")).encode()


def _entry(name: str, value: object) -> bytes:
    return _json(name) + b":" + _json(value)


def _listed(name: str, values: Iterable[object]) -> Iterator[bytes]:
    yield b"," + _json(name) + b":["
    for i, value in enumerate(values):
        yield b"," * (i > 0) + _json(value)
    yield b"]"


def load_result(path: Path) -> Result:
    """Read a result back; scores are derived anew from its counts. Raises FormatError if it is none."""
    try:
        # Decoded here, or its bytes would be held beside its text.
        value = json.loads(read_bounded(path, MAX_BYTES, "give a file that evaluate wrote").decode())
        if value["schema"] != SCHEMA:
            raise FormatError(f"{path} is not of schema {SCHEMA}; evaluate again with this version")
        return _parse(value)
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
    """Each list is let go once it is read: together they are many times what they hold."""
    if len(value["frame_ids"]) > MAX_FRAMES:
        raise ValueError(f"more than {MAX_FRAMES} frames")
    counts = _counts(value.pop("counts"), len(value["frame_ids"]))
    comparison = Comparison(
        frame_ids=_texts(value["frame_ids"]),
        subjects=_texts(value["subjects"]),
        traits=tuple(_traits(traits) for traits in value.pop("traits")),
        digests=tuple(_digests(digests) for digests in value.pop("digests")),
        counts=counts,
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


def _packed(counts: Counts) -> Iterator[bytes]:
    """Counts as text: base64 of zlib's PACKED integers."""
    deflate, rest = zlib.compressobj(1), b""
    for rows in blocks(len(counts)):
        rest += deflate.compress(counts[rows].astype(PACKED).tobytes())
        whole = len(rest) // 3 * 3
        yield base64.b64encode(rest[:whole])
        rest = rest[whole:]
    yield base64.b64encode(rest + deflate.flush())


def _counts(values: dict[str, str], frames: int) -> FrameCounts:
    """Inverse of `_packed`, never larger than the frames need."""
    counts = FrameCounts(room((frames, WIDTH), np.int32))
    for name, view in counts.by_name.items():
        size = view.size * PACKED.itemsize
        inflate = zlib.decompressobj()
        data = inflate.decompress(base64.b64decode(values.pop(name), validate=True), size + 1)
        if len(data) != size or not inflate.eof:
            raise ValueError(f"{name} holds something else than counts of {frames} frames")
        view[:] = np.frombuffer(data, PACKED).reshape(view.shape)
        if (view < 0).any():
            raise ValueError(f"{name} holds negative counts")
    return counts
