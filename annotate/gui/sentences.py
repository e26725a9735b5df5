"""Parts and strokes in words."""

from collections import Counter

import numpy as np

from annotate.labelset.stroke import Stroke
from annotate.parts import PARTS, UNDEFINED


def title(part: int) -> str:
    """A part's name in sentences."""
    return "undefined" if part == UNDEFINED else PARTS[part].title.lower()


def told(stroke: Stroke, what: str) -> str:
    """A stroke in words."""
    count = f"{len(stroke.pixels):,} pixels"
    if stroke.operation in ("undo", "redo"):
        return f"{'Undone' if stroke.operation == 'undo' else 'Done again'}: {count}"
    if stroke.operation == "swap_left_right":
        return f"Left and right {what} swapped: {count}"
    if stroke.part is None:
        return f"{stroke.operation.replace('_', ' ').capitalize()}: {count}"
    taken = Counter(dict(zip(*(x.tolist() for x in np.unique(stroke.old, return_counts=True)), strict=True)))
    source = title(taken.most_common(1)[0][0])
    return f"{count} from {source} to {title(stroke.part)}"
