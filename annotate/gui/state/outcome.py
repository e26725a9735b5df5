"""Outcome of a key or a stroke, and texts for parts and strokes."""

from typing import Literal, NamedTuple

import numpy as np

from annotate.array_types import Int64
from annotate.correction.doubtful_places import pixels_text
from annotate.labelset.stroke import Stroke
from annotate.scheme.scheme import Scheme

NOTHING: Int64 = np.empty(0, np.int64)
NAMED = 3  # parts that a sentence names


class Outcome(NamedTuple):
    """Outcome of a command. text: for the status line. pixels: flat indices (n,) whose display changes."""

    text: str
    tone: Literal["plain", "good", "warn", "bad"] = "plain"
    pixels: Int64 = NOTHING


def strokes_text(count: int) -> str:
    """Return a number of strokes as text."""
    return "1 stroke" if count == 1 else f"{count:,} strokes"


def described(stroke: Stroke, scheme: Scheme, limb: str = "") -> str:
    """Return a text on a stroke: number of pixels, old and new parts. limb: name of the limb, for a swap."""
    count, title = pixels_text(len(stroke.pixels)), scheme.title
    if stroke.operation in ("undo", "redo"):
        return f"{'Undone' if stroke.operation == 'undo' else 'Redone'}: {count}"
    if stroke.operation == "swap_left_right":
        return f"Left and right {limb} swapped: {count}"
    numbers = np.bincount(stroke.old, minlength=256)
    lost = [part for part in np.argsort(-numbers, kind="stable").tolist() if numbers[part]]
    sources = ", ".join(f"{numbers[part]:,} {title(part)}" for part in lost[:NAMED])
    sources += f" and {len(lost) - NAMED} more" if len(lost) > NAMED else ""
    if stroke.part is None:
        names = {"remove_islands": "Islands removed", "copy_previous": "Copied from the frame before"}
        return f"{names.get(stroke.operation, 'Taken over')}: {count} ({sources})"
    if len(lost) == 1:
        return f"{count} from {title(lost[0])} to {title(stroke.part)}"
    return f"{count} to {title(stroke.part)} ({sources})"
