"""The outcome of a key or a stroke, and parts and strokes in words."""

from typing import Literal, NamedTuple

import numpy as np

from annotate.array_types import Int64
from annotate.labelset.stroke import Stroke
from annotate.parts import PARTS, UNDEFINED

NOTHING: Int64 = np.empty(0, np.int64)
"""No pixels."""


class Done(NamedTuple):
    """An outcome. text: a sentence for the status line. pixels: flat indices (n,) that look different now."""

    text: str
    tone: Literal["plain", "good", "warn", "bad"] = "plain"
    pixels: Int64 = NOTHING


def title(part: int) -> str:
    """A part's name in sentences."""
    return "undefined" if part == UNDEFINED else PARTS[part].title.lower()


def described(stroke: Stroke, limb: str) -> str:
    """A stroke in words. limb: of a swap."""
    count = f"{len(stroke.pixels):,} pixels"
    if stroke.operation in ("undo", "redo"):
        return f"{'Undone' if stroke.operation == 'undo' else 'Redone'}: {count}"
    if stroke.operation == "swap_left_right":
        return f"Left and right {limb} swapped: {count}"
    if stroke.part is None:
        return f"{stroke.operation.replace('_', ' ').capitalize()}: {count}"
    source = int(np.bincount(stroke.old).argmax())
    return f"{count} from {title(source)} to {title(stroke.part)}"
