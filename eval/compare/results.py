"""A comparison kept on disk as JSON, a line for every few hundred frames, with what it takes to repeat it."""

import base64
import json
import math
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from sys import intern
from typing import Any, cast, get_args

import numpy as np
from numpy.typing import NDArray

from annotate.frame_labels import Status
from eval.compare.compare import Comparison
from eval.compare.pairs import Digests
from eval.scores.big_arrays import room
from eval.scores.confusion import Counts
from eval.scores.counts import WIDTH, FrameCounts
from eval.scores.joints import N_JOINTS
from eval.scores.traits import Traits
from sensors.errors import CloudError, FormatError
from sensors.files.atomic import check_free, replacing

SCHEMA = 4
MAX_FRAMES = 200_000
"""Their counts are 600 MB in a file."""
FRAMES_A_LINE = 512
"""A reader holds one line at a time: 1 MB."""
MAX_LINE_BYTES = 16_000_000
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
        for line in _lines(result):
            written += file.write(line)
            if written > MAX_BYTES or len(line) >= MAX_LINE_BYTES:
                raise CloudError(
                    f"a result of {len(result.comparison.frame_ids)} frames is more than {MAX_BYTES} bytes; "
                    "evaluate fewer frames at a time"
                )


def _lines(result: Result) -> Iterator[bytes]:
    """The file line by line: a head, then frames, FRAMES_A_LINE in each."""
    comparison = result.comparison
    frames = len(comparison.frame_ids)
    yield _line(
        schema=SCHEMA,
        title=result.title,
        facts=dict(result.facts),
        summary=comparison.to_evaluation_json(),
        frames=frames,
        extra_frames=comparison.extra_frames,
        joints=comparison.joints_mm is not None,
    )
    for start in range(0, frames, FRAMES_A_LINE):
        yield _frames_line(comparison, slice(start, start + FRAMES_A_LINE))


def _frames_line(comparison: Comparison, rows: slice) -> bytes:
    joints_mm = comparison.joints_mm
    return _line(
        frame_ids=comparison.frame_ids[rows],
        subjects=comparison.subjects[rows],
        traits=[_known(asdict(traits)) for traits in comparison.traits[rows]],
        digests=[asdict(digests) for digests in comparison.digests[rows]],
        counts={name: _packed(counts[rows]) for name, counts in comparison.counts.by_name.items()},
        joints_mm=None if joints_mm is None else [[_joint(v) for v in row] for row in joints_mm[rows]],
    )


def _line(**values: object) -> bytes:
    return json.dumps(values, allow_nan=False, separators=(",", ":")).encode() + b"\n"


def load_result(path: Path) -> Result:
    """Read a result back; scores are derived anew from its counts. Raises FormatError if it is none."""
    try:
        with path.open("rb") as file:
            size = path.stat().st_size
            if size > MAX_BYTES:
                raise FormatError(f"{path} is larger than {MAX_BYTES} bytes; give a file that evaluate wrote")
            lines = iter(partial(file.readline, MAX_LINE_BYTES), b"")
            return _parse(path, size, (json.loads(line.decode()) for line in lines))
    except FormatError:
        raise
    except OSError as error:
        raise FormatError(
            f"{path} cannot be read ({error.strerror}); give a file that evaluate wrote"
        ) from error
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
        raise FormatError(f"{path} is not a result ({error}); give a file that evaluate wrote") from error


def _parse(path: Path, size: int, lines: Iterator[Any]) -> Result:
    head = next(lines, None)
    if head is None:
        raise ValueError("it is empty")
    if head["schema"] != SCHEMA:
        raise FormatError(f"{path} is not of schema {SCHEMA}; evaluate again with this version")
    frames, extra = int(head["frames"]), int(head["extra_frames"])
    # A frame takes more than a hundred bytes.
    if not 0 <= frames <= min(MAX_FRAMES, size // 100) or extra < 0:
        raise ValueError(f"{frames} frames and {extra} left over, in {size} bytes")
    counts = FrameCounts(room((frames, WIDTH), np.int32))
    joints_mm = np.empty((frames, N_JOINTS)) if head["joints"] else None
    listed: dict[str, list[Any]] = {name: [] for name in _LISTED}
    done = 0
    for line in lines:
        rows = slice(done, done + len(line["frame_ids"]))
        if not done < rows.stop <= frames:
            raise ValueError(f"it holds other frames than the {frames} it claims")
        done = rows.stop
        for name, read in _LISTED.items():
            listed[name] += map(read, line[name])
            if len(listed[name]) != done:
                raise ValueError(f"{len(listed[name])} {name} for {done} frames")
        _unpack(line["counts"], counts[rows])
        if joints_mm is not None:
            joints_mm[rows] = _joints(line["joints_mm"], rows.stop - rows.start)
    if done != frames:
        raise ValueError(f"it ends after {done} of {frames} frames")
    comparison = Comparison(
        **{name: tuple(values) for name, values in listed.items()},
        counts=counts,
        joints_mm=joints_mm,
        extra_frames=extra,
    )
    return Result(_text(head["title"]), comparison, {_text(k): _text(v) for k, v in head["facts"].items()})


def _text(value: object) -> str:
    """Text that can be written down again: half a surrogate pair cannot."""
    text = str(value)
    text.encode()
    return text


def _shared(value: object) -> str:
    """Text that many frames have in common, kept once."""
    return intern(_text(value))


def _digests(value: dict[str, Any]) -> Digests:
    return Digests(_text(value["depth"]), _text(value["truth"]), _text(value["predicted"]))


def _known(traits: dict[str, Any]) -> dict[str, Any]:
    """Traits without what is unknown, since JSON has no NaN."""
    return {k: v for k, v in traits.items() if not isinstance(v, float) or math.isfinite(v)}


def _traits(value: dict[str, Any]) -> Traits:
    numbers = {
        name: float(value.get(name, math.nan)) for name in ("distance_m", "invalid_share", "mm_per_px")
    }
    if not all(math.isnan(v) or 0 <= v < math.inf for v in numbers.values()):
        raise ValueError(f"{numbers} are not traits of a frame")
    return Traits(
        activity=_shared(value["activity"]),
        view=_shared(value["view"]),
        status=_status(value["status"]),
        predicted_status=_status(value["predicted_status"]),
        hard=tuple(map(_shared, value["hard"])),
        **numbers,
    )


def _status(value: object) -> Status:
    if value not in get_args(Status):
        raise ValueError(f"status {str(value)[:40]!r} is unknown")
    return cast(Status, _shared(value))


_LISTED = {"frame_ids": _text, "subjects": _shared, "traits": _traits, "digests": _digests}
"""What a line lists of its frames, and how each is read."""


def _joint(error_mm: float) -> float | str | None:
    if math.isnan(error_mm):
        return None
    return round(float(error_mm), 1) if math.isfinite(error_mm) else MISSED


def _joints(rows: list[list[Any]], frames: int) -> NDArray[np.float64]:
    special = {None: math.nan, MISSED: math.inf}
    errors = np.array([[special[v] if v in special else float(v) for v in row] for row in rows], np.float64)
    if errors.shape != (frames, N_JOINTS) or (errors < 0).any():
        raise ValueError(f"joints_mm holds something else than errors of {N_JOINTS} joints")
    return errors


def _packed(counts: Counts) -> str:
    """Counts as text: base64 of zlib's PACKED integers."""
    return base64.b64encode(zlib.compress(counts.astype(PACKED).tobytes(), 1)).decode()


def _unpack(values: dict[str, str], counts: FrameCounts) -> None:
    """Inverse of `_packed`, into place and never larger than it."""
    for name, view in counts.by_name.items():
        size = view.size * PACKED.itemsize
        inflate = zlib.decompressobj()
        data = inflate.decompress(base64.b64decode(values[name], validate=True), size + 1)
        if len(data) != size or not inflate.eof:
            raise ValueError(f"{name} holds something else than counts of {len(view)} frames")
        view[:] = np.frombuffer(data, PACKED).reshape(view.shape)
        if (view < 0).any():
            raise ValueError(f"{name} holds negative counts")
