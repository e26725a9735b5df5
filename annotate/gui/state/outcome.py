"""The outcome of a key or a stroke, and parts and strokes in words."""

from typing import Literal, NamedTuple

import numpy as np

from annotate.array_types import Int64
from annotate.correction.doubtful_places import part_title as title
from annotate.correction.doubtful_places import pixels_text
from annotate.labelset.stroke import Stroke

NOTHING: Int64 = np.empty(0, np.int64)
"""No pixels."""
NAMED = 3
"""Number of parts that a sentence names. Untuned."""
OPERATIONS = {
    "remove_islands": "Islands removed",
    "copy_previous": "Copied from the frame before",
    "propagate": "Carried over",
}
"""Operations in words, as their buttons have them."""


class Done(NamedTuple):
    """An outcome. text: a sentence for the status line. pixels: flat indices (n,) that look different now."""

    text: str
    tone: Literal["plain", "good", "warn", "bad"] = "plain"
    pixels: Int64 = NOTHING


def strokes_text(count: int) -> str:
    """A number of strokes in words."""
    return "1 stroke" if count == 1 else f"{count:,} strokes"


VERDICT_TITLES = {"accept": "Accepted", "agree": "Agreed", "reject": "Rejected"}
"""Verdicts as outcomes."""


def rejected_text(reason: str) -> str:
    """Return a rejection in words. reason: one of the dialog's or the person's own, which keeps its case."""
    first = reason[:1].lower() if reason[1:2].islower() else reason[:1]
    return f"Rejected ({first}{reason[1:]})"


def described(stroke: Stroke, limb: str = "") -> str:
    """A stroke in words: how many pixels went from which parts to which. limb: of a swap."""
    count = pixels_text(len(stroke.pixels))
    if stroke.operation in ("undo", "redo"):
        return f"{'Undone' if stroke.operation == 'undo' else 'Redone'}: {count}"
    if stroke.operation == "swap_left_right":
        return f"Left and right {limb} swapped: {count}"
    numbers = np.bincount(stroke.old, minlength=256)
    lost = [part for part in np.argsort(-numbers, kind="stable").tolist() if numbers[part]]
    sources = ", ".join(f"{numbers[part]:,} {title(part)}" for part in lost[:NAMED])
    sources += f" and {len(lost) - NAMED} more" if len(lost) > NAMED else ""
    if stroke.part is None:
        return f"{OPERATIONS.get(stroke.operation, 'Taken over')}: {count} ({sources})"
    if len(lost) == 1:
        return f"{count} from {title(lost[0])} to {title(stroke.part)}"
    return f"{count} to {title(stroke.part)} ({sources})"
