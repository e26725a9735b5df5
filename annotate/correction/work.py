"""A frame's state, and the summary of the work in its notes, from its entries in the journal."""

from collections import Counter
from collections.abc import Sequence
from typing import Any, Literal

from annotate.frame_labels import Status
from annotate.labelset.stroke import Stroke

State = Literal["auto", "touched", "accepted", "reviewed", "rejected"]
"""Not edited; edited; accepted by the annotator; agreed to by a reviewer; rejected."""
_BASE: dict[Status, State] = {
    "auto": "auto",
    "corrected": "accepted",
    "reviewed": "reviewed",
    "truth": "reviewed",
}


def state_of(strokes: Sequence[Stroke], saved: Status = "auto") -> State:
    """A frame's state after its entries. saved: its status before the first."""
    state = _BASE[saved]
    for stroke in strokes:
        if stroke.changes:
            state = "touched"
        elif stroke.operation == "accept":
            state = "accepted"
        elif stroke.operation == "agree":
            state = "reviewed"
        elif stroke.operation == "reject":
            state = "rejected"
    return state


def status_of(strokes: Sequence[Stroke], saved: Status = "auto") -> Status:
    """A frame's status on disk after its entries. saved: its status before the first."""
    state = state_of(strokes, saved)
    if state == "reviewed":
        return "reviewed"
    done = any(stroke.changes or stroke.operation in ("accept", "agree") for stroke in strokes)
    return "corrected" if done else saved


def rejection(strokes: Sequence[Stroke]) -> str | None:
    """The reason why a frame is rejected, or None."""
    if state_of(strokes) != "rejected":
        return None
    return next(stroke.reason for stroke in reversed(strokes) if stroke.operation == "reject")


def notes_of(strokes: Sequence[Stroke]) -> dict[str, Any]:
    """A frame's notes on the work: the last person and time, active seconds, counts of strokes, and the
    number of entries of the journal that its labels include."""
    operations = Counter(stroke.operation for stroke in strokes if stroke.operation != "leave")
    return {
        "who": strokes[-1].who if strokes else "",
        "when": strokes[-1].when if strokes else "",
        "active_seconds": round(sum(stroke.active_seconds for stroke in strokes), 3),
        "strokes": sum(is_stroke(stroke) for stroke in strokes),
        "undos": operations["undo"],
        "operations": dict(sorted(operations.items())),
        "accepted": state_of(strokes) in ("accepted", "reviewed"),
        "rejected": rejection(strokes),
        "journal": len(strokes),
    }


def is_stroke(stroke: Stroke) -> bool:
    """Whether an entry changed labels, other than by undo or redo."""
    return stroke.changes and stroke.operation not in ("undo", "redo")
