"""History of one frame: strokes and verdicts in effect, and undone ones."""

from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Self

import numpy as np

from annotate.labelset.stroke import VERDICTS, Stroke
from sensors.errors import FormatError


@dataclass
class History:
    """Strokes and verdicts of one frame, the last at the end.

    done: entries in effect. undone: entries to redo; a new stroke or verdict clears them. An undo without
    runs (pixel changes) takes a verdict back. Old journals also hold an undo that passes over later verdicts,
    and a redo of a stroke across a later verdict.
    """

    done: list[Stroke] = field(default_factory=list)
    undone: list[Stroke] = field(default_factory=list)
    _before_verdict: list[Stroke] = field(default_factory=list, init=False)

    @classmethod
    def of(cls, strokes: Iterable[Stroke]) -> Self:
        """Return the history of a frame's entries. Raises FormatError as ``add`` does."""
        history = cls()
        for stroke in strokes:
            history.add(stroke)
        return history

    def add(self, stroke: Stroke) -> None:
        """Add an entry. Raises FormatError for an undo or redo of any stroke but the last."""
        if stroke.operation == "undo":
            self.undone.append(_popped(self.done, stroke, undo=True))
        elif stroke.operation == "redo":
            self.done.append(_popped(self.undone or self._before_verdict, stroke, undo=False))
        elif stroke.operation in VERDICTS:
            self.done.append(stroke)
            self._before_verdict += self.undone
            self.undone.clear()
        elif stroke.changes and stroke.by_person:
            self.done.append(stroke)
            self._before_verdict.clear()
            self.undone.clear()


def standing(strokes: Sequence[Stroke]) -> list[Stroke]:
    """Return the strokes and verdicts in effect; an undo or redo that matches none of them is skipped."""
    history = History()
    for stroke in strokes:
        with suppress(FormatError):
            history.add(stroke)
    return history.done


def _popped(stack: list[Stroke], stroke: Stroke, undo: bool) -> Stroke:
    """Remove the last stroke of a stack and return it.

    stroke: the undo (``undo`` True) or redo entry. Raises FormatError if it does not match the last stroke.
    """
    while stack and stroke.changes and not stack[-1].changes:
        stack.pop()
    runs = (stack[-1].inverse_runs() if undo else stack[-1].runs) if stack else None
    if runs is None or not np.array_equal(runs, stroke.runs):
        raise FormatError(
            f"frame {stroke.frame_id}: entry {stroke.operation!r} does not fit the last stroke; restore "
            "journal.jsonl from a copy"
        )
    return stack.pop()
