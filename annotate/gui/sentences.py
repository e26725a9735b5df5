"""Parts and strokes in words."""

import numpy as np

from annotate.labelset.stroke import Stroke
from annotate.parts import PARTS, UNDEFINED


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
