"""What a frame's entries in the journal come to: its state, and what its notes say of the work."""

from collections import Counter
from collections.abc import Sequence
from typing import Any, Literal

from annotate.frame_labels import Status
from annotate.labelset.stroke import Stroke

State = Literal["auto", "touched", "accepted", "reviewed", "rejected"]
"""Nobody has been here; begun; the annotator is done; a reviewer agrees; somebody rejects."""
_BASE: dict[Status, State] = {
    "auto": "auto",
    "corrected": "accepted",
    "reviewed": "reviewed",
    "truth": "reviewed",
}


def state_of(strokes: Sequence[Stroke], saved: Status = "auto") -> State:
    """A frame's state after its entries; ``saved`` is what it was before the first."""
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
    """The status that a frame is stored with after its entries."""
    state = state_of(strokes, saved)
    if state == "reviewed":
        return "reviewed"
    done = any(stroke.changes or stroke.operation in ("accept", "agree") for stroke in strokes)
    return "corrected" if done else saved


def rejection(strokes: Sequence[Stroke]) -> str | None:
    """Why a frame stands rejected, or None."""
    if state_of(strokes) != "rejected":
        return None
    return next(stroke.reason for stroke in reversed(strokes) if stroke.operation == "reject")


def notes_of(strokes: Sequence[Stroke]) -> dict[str, Any]:
    """What a frame's notes say of the work: who and when last, active seconds, strokes, and how many
    entries of the journal its labels include."""
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
    """Whether an entry changed labels, and not by going back or forth."""
    return stroke.changes and stroke.operation not in ("undo", "redo")
