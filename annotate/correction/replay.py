"""Replay of a journal: the exact labels, the state and the notes of a frame."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Literal

from annotate.array_types import UInt8
from annotate.correction.history import standing
from annotate.frame_labels import FrameLabels, Status
from annotate.labelset.journal import Journal
from annotate.labelset.label_set import LEARNT, LabelSet
from annotate.labelset.stroke import VERDICTS, Stroke
from sensors.errors import FormatError

State = Literal["auto", "touched", "accepted", "reviewed", "rejected"]
_BASE: dict[Status, State] = {
    "auto": "auto",
    "corrected": "accepted",
    "reviewed": "reviewed",
    "truth": "reviewed",
}
STATE_NAMES: dict[State, str] = {
    "auto": "automatic",
    "touched": "in progress",
    "accepted": "accepted",
    "reviewed": "reviewed",
    "rejected": "rejected",
}
_VERDICT: dict[str, State] = {"accept": "accepted", "reject": "rejected"}


def replayed(labels: LabelSet, journal: Journal, frame_id: str) -> FrameLabels:
    """Return a frame after all entries, from its labels in ``original/`` or else in ``frames/``.

    Raises FormatError when the entries were made on other labels.
    """
    start = labels.read(frame_id, original=labels.has_original(frame_id))
    return noted(after(start, journal.strokes(frame_id), exact=True), journal, start.status)


def after(frame: FrameLabels, strokes: Sequence[Stroke], exact: bool = False) -> FrameLabels:
    """Return a frame after more entries. Raises FormatError for entries that do not fit the frame.

    exact: raise also where an entry was made on other labels.
    """
    parts = frame.parts.copy()
    for stroke in strokes:
        if exact and not _fits(stroke, parts):
            raise FormatError(
                f"strokes on frame {frame.frame_id} do not fit its labels; restore journal.jsonl from a copy"
            )
        stroke.apply_to(parts)
    if ((parts != frame.parts) & (frame.depth_mm == 0) & frame.scheme.on_part(parts)).any():
        raise FormatError(
            f"strokes on frame {frame.frame_id} label pixels without depth; restore journal.jsonl from a copy"
        )
    return replace(frame, parts=parts)


def begun_from(frame: FrameLabels, strokes: Sequence[Stroke]) -> FrameLabels:
    """Return the labels after any relabelling, on which people's work began. frame: first labels."""
    return after(frame, [stroke for stroke in strokes if stroke.operation == "relabel"], exact=True)


def _fits(stroke: Stroke, parts: UInt8) -> bool:
    # First, because runs are expanded to all pixels that they state.
    if stroke.end > parts.size:
        return False
    return bool((parts.ravel()[stroke.pixels] == stroke.old).all())


def noted(frame: FrameLabels, journal: Journal, before: Status) -> FrameLabels:
    """Return a frame with status and notes derived from its entries. before: status before the first
    entry.
    """
    strokes = journal.strokes(frame.frame_id)
    if not strokes:
        return frame
    state = state_of(strokes, before)
    done = state in ("accepted", "reviewed") or any(stroke.changes and stroke.by_person for stroke in strokes)
    status: Status = "reviewed" if state == "reviewed" else "corrected" if done else before
    return replace(frame, status=status, notes={**frame.notes, **_notes_of(strokes, state)})


def verdicts(strokes: Sequence[Stroke]) -> list[Stroke]:
    """Return the verdicts in effect, the last at the end."""
    return [stroke for stroke in standing(strokes) if stroke.operation in VERDICTS]


def state_of(strokes: Sequence[Stroke], saved: Status = "auto") -> State:
    """Return a frame's state after its entries. saved: its status before the first entry.

    A rejection that another person agrees with stays a rejection.
    """
    given = standing(strokes)
    agreed = bool(given) and given[-1].operation == "agree"
    while given and given[-1].operation == "agree":
        given.pop()
    if given and given[-1].operation not in VERDICTS:
        return "reviewed" if agreed else "touched"
    if given:
        last = _VERDICT[given[-1].operation]
        return "reviewed" if agreed and last == "accepted" else last
    base = "reviewed" if agreed else _BASE[saved]
    worked = any(stroke.changes and stroke.by_person for stroke in strokes)
    return "touched" if worked and base == "auto" else base


def rejected_by(strokes: Sequence[Stroke]) -> Stroke | None:
    """Return the rejection in effect, or None."""
    if state_of(strokes) != "rejected":
        return None
    return next(verdict for verdict in reversed(verdicts(strokes)) if verdict.operation == "reject")


def rejection(strokes: Sequence[Stroke]) -> str | None:
    """Return the reason why a frame is rejected, or None."""
    rejected = rejected_by(strokes)
    return rejected.reason if rejected else None


def _notes_of(strokes: Sequence[Stroke], state: State) -> dict[str, Any]:
    """Return a frame's notes on the work; ``journal`` is the number of entries."""
    operations = Counter(stroke.operation for stroke in strokes if stroke.operation != "leave")
    step = step_of(strokes)
    return {
        **({LEARNT: step} if step is not None else {}),
        "who": strokes[-1].who,
        "when": strokes[-1].when,
        "active_seconds": round(sum(stroke.active_seconds for stroke in strokes), 3),
        "strokes": sum(is_stroke(stroke) for stroke in strokes),
        "undos": operations["undo"],
        "operations": dict(sorted(operations.items())),
        "accepted": state in ("accepted", "reviewed"),
        "rejected": rejection(strokes),
        "journal": len(strokes),
    }


def is_stroke(stroke: Stroke) -> bool:
    """Return whether an entry changed labels, other than by undo or redo."""
    return stroke.changes and stroke.by_person and stroke.operation not in ("undo", "redo")


def step_of(strokes: Sequence[Stroke]) -> str | None:
    """Return the fine-tuning step that labelled a frame; "" after it was taken back, None without any
    step.
    """
    return next((s.reason for s in reversed(strokes) if s.operation == "relabel"), None)
