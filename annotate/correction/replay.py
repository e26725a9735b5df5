"""The labels that result from a journal, exactly, whatever computed its strokes."""

from collections.abc import Sequence
from dataclasses import replace

from annotate.array_types import UInt8
from annotate.correction.work import notes_of, status_of
from annotate.frame_labels import FrameLabels, Status
from annotate.labelset.journal import Journal
from annotate.labelset.store import LabelSet
from annotate.labelset.stroke import Stroke
from annotate.parts import BACKGROUND, UNDEFINED
from sensors.errors import FormatError


def replayed(labels: LabelSet, journal: Journal, frame_id: str) -> FrameLabels:
    """One frame after all of its entries, starting from its labels in ``original/``, or else from its own.

    Raises FormatError when
    the entries were made on other labels.
    """
    start = labels.read(frame_id, original=labels.has_original(frame_id))
    return noted(after(start, journal.strokes(frame_id), exact=True), journal, start.status)


def after(frame: FrameLabels, strokes: Sequence[Stroke], exact: bool = False) -> FrameLabels:
    """A frame after more entries. exact: whether each must meet the labels on which it was made.

    Raises FormatError when they do not fit the frame.
    """
    parts = frame.parts.copy()
    for stroke in strokes:
        if exact and not _fits(stroke, parts):
            raise FormatError(f"the journal's strokes on frame {frame.frame_id} were made on other labels")
        stroke.apply_to(parts)
    bare = frame.depth_mm == 0
    if ((parts != frame.parts) & bare & (parts != BACKGROUND) & (parts != UNDEFINED)).any():
        raise FormatError(f"the journal labels pixels of frame {frame.frame_id} that have no depth")
    return replace(frame, parts=parts)


def noted(frame: FrameLabels, journal: Journal, before: Status) -> FrameLabels:
    """A frame with the status and notes that its entries give it. before: its status before the first."""
    strokes = journal.strokes(frame.frame_id)
    if not strokes:
        return frame
    return replace(frame, status=status_of(strokes, before), notes={**frame.notes, **notes_of(strokes)})


def _fits(stroke: Stroke, parts: UInt8) -> bool:
    pixels = stroke.pixels
    return not len(pixels) or (pixels[-1] < parts.size and bool((parts.ravel()[pixels] == stroke.old).all()))
