"""The strokes of one frame that can be undone and redone, rebuilt from the journal."""

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from annotate.labelset.stroke import Stroke
from sensors.errors import FormatError


@dataclass
class History:
    """Strokes done and undone, the last at the end. ``add`` takes every entry of a frame in turn."""

    done: list[Stroke] = field(default_factory=list)
    undone: list[Stroke] = field(default_factory=list)

    @classmethod
    def of(cls, strokes: Iterable[Stroke]) -> "History":
        """The history after a frame's entries. Raises FormatError as ``add`` does."""
        history = cls()
        for stroke in strokes:
            history.add(stroke)
        return history

    def add(self, stroke: Stroke) -> None:
        """Take one more entry. Raises FormatError for an undo or redo of anything but the last stroke."""
        if stroke.operation == "undo":
            self.undone.append(self._pop(self.done, stroke, undo=True))
        elif stroke.operation == "redo":
            self.done.append(self._pop(self.undone, stroke, undo=False))
        elif stroke.changes:
            self.done.append(stroke)
            self.undone.clear()

    @staticmethod
    def _pop(stack: list[Stroke], stroke: Stroke, undo: bool) -> Stroke:
        runs = (stack[-1].inverse_runs() if undo else stack[-1].runs) if stack else None
        if runs is None or not np.array_equal(runs, stroke.runs):
            raise FormatError(
                f"frame {stroke.frame_id}: its {stroke.operation} does not belong to the last stroke"
            )
        return stack.pop()
