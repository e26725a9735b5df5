"""Stroke: one action on one frame, an entry of the journal, stored as the changed pixels."""

import json
from dataclasses import asdict, dataclass, field
from typing import Literal, get_args

import numpy as np

from annotate.array_types import Int64, UInt8
from annotate.scheme.scheme import UNDEFINED, Scheme
from sensors.errors import FormatError, fault_of
from sensors.files.bounded import MAX_IMAGE_SIDE

Operation = Literal[
    # change labels,
    "paint",
    "fill_holes",
    "remove_islands",
    "swap_left_right",
    "merge",
    "to_neighbour",
    "copy_previous",
    "propagate",
    # give an untouched frame the labels of a fine-tuned network,
    "relabel",
    # take changes back and do them again,
    "undo",
    "redo",
    # give a verdict on the frame,
    "accept",
    "agree",
    "reject",
    # or only record the time spent.
    "leave",
]
Verdict = Literal["accept", "agree", "reject"]
VERDICTS: tuple[Verdict, ...] = get_args(Verdict)
"""Judgements of a frame: annotator done, reviewer agrees, rejected with a reason."""

GestureKind = Literal["supervoxel", "grow", "lasso", "polygon", "rectangle", "brush", "key"]
Activity = Literal["looking", "painting", "navigating"]


@dataclass(frozen=True)
class Gesture:
    """Gesture that selected the pixels, in the quantities of the keystroke-level model.

    points: vertices of a lasso, polygon or brush path; path_px: its length on the screen. Raises FormatError
    for an unknown kind or an invalid number.
    """

    kind: GestureKind = "key"
    clicks: int = 0
    points: int = 0
    path_px: float = 0.0
    keys: int = 0

    def __post_init__(self) -> None:
        numbers = (self.clicks, self.points, self.path_px, self.keys)
        if self.kind not in get_args(GestureKind):
            known = ", ".join(get_args(GestureKind))
            raise FormatError(f"gesture {str(self.kind)[:40]!r} is unknown; use {known}")
        if not all(type(n) in (int, float) and 0 <= n < 1e9 for n in numbers):
            raise FormatError(f"gesture {self.kind} has counts {str(numbers)[:60]}, not numbers from 0")


KEY = Gesture("key", keys=1)


@dataclass(frozen=True)
class Stroke:
    """One action of a person on one frame, and its difference to the labels.

    part: the assigned part, None for several. runs: int64 (n, 4), each (start, length, old, new): pixels
    [start, start + length), row by row, changed from part id old to new; sorted, without overlap. Undo and
    redo carry their own runs. when: ISO 8601 UTC. seconds: active seconds since the previous entry, by
    activity. reason: of a rejection; for a relabelling, its step. Raises FormatError for an invalid field.
    """

    frame_id: str
    operation: Operation
    runs: Int64
    part: int | None = None
    how: Gesture = KEY
    who: str = ""
    when: str = ""
    seconds: dict[Activity, float] = field(default_factory=dict)
    reason: str = ""

    def __post_init__(self) -> None:
        if self.operation not in get_args(Operation):
            known = ", ".join(get_args(Operation))
            raise FormatError(f"operation {str(self.operation)[:40]!r} is unknown; use {known}")
        if self.part is not None and not (type(self.part) is int and 0 <= self.part <= UNDEFINED):
            raise FormatError(f"part id {str(self.part)[:40]} is not a whole number from 0 to {UNDEFINED}")
        texts = (self.frame_id, self.who, self.when, self.reason)
        if not all(isinstance(text, str) for text in texts):
            raise FormatError(f"frame_id, who, when and reason are {str(texts)[:80]}, not strings")
        if not isinstance(self.seconds, dict) or not all(
            kind in get_args(Activity) and type(s) in (int, float) and 0 <= s < 1e9
            for kind, s in self.seconds.items()
        ):
            known = ", ".join(get_args(Activity))
            raise FormatError(f"seconds {str(self.seconds)[:60]} are not numbers from 0 for {known}")
        _check_runs(self.runs)

    @property
    def changes(self) -> bool:
        """Return whether any pixel changed."""
        return len(self.runs) > 0

    @property
    def by_person(self) -> bool:
        """Return whether a person made this entry: changed labels, or gave or undid a verdict."""
        return self.operation not in ("leave", "relabel")

    @property
    def end(self) -> int:
        """Return the flat index after the last changed pixel; 0 without changes."""
        return int(self.runs[-1, :2].sum()) if len(self.runs) else 0

    @property
    def pixels(self) -> Int64:
        """Return the flat indices (n,) of the changed pixels, sorted."""
        start, length = self.runs[:, 0], self.runs[:, 1]
        ends = np.cumsum(length)
        return np.arange(ends[-1] if len(ends) else 0) + np.repeat(start - ends + length, length)

    @property
    def old(self) -> UInt8:
        """Return the old part ids (n,) of ``pixels``."""
        return np.repeat(self.runs[:, 2], self.runs[:, 1]).astype(np.uint8)

    @property
    def new(self) -> UInt8:
        """Return the new part ids (n,) of ``pixels``."""
        return np.repeat(self.runs[:, 3], self.runs[:, 1]).astype(np.uint8)

    @property
    def active_seconds(self) -> float:
        return float(sum(self.seconds.values()))

    def inverse_runs(self) -> Int64:
        """Return the runs that undo this stroke."""
        return self.runs[:, [0, 1, 3, 2]]

    def apply_to(self, parts: UInt8) -> None:
        """Apply the stroke to ``parts`` (h, w), contiguous, in place. Raises FormatError for pixels
        outside.
        """
        if self.end > parts.size:
            raise FormatError(
                f"a stroke on frame {self.frame_id} reaches pixel {self.end - 1} of {parts.size}; restore "
                "journal.jsonl from a copy"
            )
        parts.reshape(-1)[self.pixels] = self.new


def check_ids(stroke: Stroke, scheme: Scheme) -> None:
    """Raise FormatError for a part id that a scheme lacks."""
    ids = np.append(stroke.runs[:, 2:].ravel(), stroke.part or 0)
    if (unknown := ids[~scheme.is_label[ids]]).size:
        raise FormatError(
            f"part id {unknown[0]} is unknown in scheme {scheme.name!r}; use {scheme.label_text}"
        )


def difference(pixels: Int64, old: UInt8, new: UInt8) -> Int64:
    """Return the runs (n, 4) for sorted flat ``pixels`` whose ids change from ``old`` to ``new``, all
    (m,).
    """
    differs = old != new
    pixels, old, new = pixels[differs], old[differs], new[differs]
    if not len(pixels):
        return np.empty((0, 4), np.int64)
    first = np.ones(len(pixels), np.bool_)
    first[1:] = (np.diff(pixels) != 1) | (old[1:] != old[:-1]) | (new[1:] != new[:-1])
    at = np.flatnonzero(first)
    length = np.diff(at, append=len(pixels))
    return np.stack([pixels[at], length, old[at], new[at]], axis=1).astype(np.int64)


def to_line(stroke: Stroke) -> bytes:
    """Return a stroke as a line of JSON with its newline."""
    fields = {name: getattr(stroke, name) for name in Stroke.__dataclass_fields__}
    fields |= {"how": asdict(stroke.how), "runs": stroke.runs.ravel().tolist()}
    return json.dumps(fields, allow_nan=False, separators=(",", ":")).encode() + b"\n"


def from_line(line: bytes) -> Stroke:
    """Parse a line of ``to_line``. Raises FormatError."""
    try:
        fields = json.loads(line)
    except (ValueError, RecursionError) as error:
        raise FormatError(f"entry is not JSON ({error})") from error
    if not isinstance(fields, dict):
        raise FormatError("entry is not a JSON object")
    try:
        runs, how = _runs(fields.pop("runs")), Gesture(**fields.pop("how"))
        return Stroke(runs=runs, how=how, **fields)
    except (TypeError, KeyError) as error:
        raise FormatError(f"entry is malformed ({fault_of(error)[:100]})") from error


def _runs(numbers: object) -> Int64:
    if not isinstance(numbers, list) or len(numbers) % 4 or not all(type(n) is int for n in numbers):
        raise FormatError("field 'runs' is not a list of integers, four for each run of pixels")
    try:
        return np.array(numbers, np.int64).reshape(-1, 4)
    except OverflowError as error:
        raise FormatError("field 'runs' holds an integer beyond 64 bits") from error


def _check_runs(runs: Int64) -> None:
    if not len(runs):
        return
    start, length, old, new = runs.T
    if start[0] < 0 or length.min() < 1 or max(start.max(), length.max()) >= 1 << 31:
        raise FormatError("field 'runs' holds a run of no pixels or with an index below 0")
    if int(start[-1] + length[-1]) > MAX_IMAGE_SIDE**2:
        raise FormatError(f"field 'runs' ends at pixel {start[-1] + length[-1]}, beyond every image")
    if (start[1:] < (start + length)[:-1]).any():
        raise FormatError("field 'runs' overlaps or is not sorted")
    if min(old.min(), new.min()) < 0 or max(old.max(), new.max()) > UNDEFINED or (old == new).any():
        raise FormatError("field 'runs' holds an impossible part id, or changes nothing")
