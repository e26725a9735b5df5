"""Relabelling: untouched frames get the labels of a fine-tuned network, as one step of the journal.

Every such frame gets one entry ``relabel`` that names the step; all entries of a step are written together.
Taking a step back writes a step of the same kind. A frame with a person's work, even undone, is never
changed. A step keeps its confidences in ``learnt/``.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from annotate.array_types import UInt8
from annotate.correction.correction import Correction
from annotate.correction.replay import after, step_of
from annotate.labelset.journal import nothing_changed
from annotate.labelset.label_set import LabelSet
from annotate.labelset.stroke import Gesture, Stroke, difference
from sensors.errors import CloudError


@dataclass(frozen=True)
class Relabelled:
    """Result of relabelling, or of taking it back.

    step: name of the fine-tuning step whose labels the frames now have; "" = labels from before all steps.
    frames: number of frames that changed. changed: share of the person's pixels with another part than
    before.
    """

    step: str
    frames: int
    changed: float

    @property
    def text(self) -> str:
        """Return the result of a relabelling as a sentence."""
        return f"{self._frames} labelled again: {self.changed:.1%} of the person is another part"

    @property
    def text_of_taking_back(self) -> str:
        """Return the result of taking a fine-tuning step back as a sentence."""
        return f"The last learning is taken back: {self._frames} restored"

    @property
    def _frames(self) -> str:
        return "1 frame" if self.frames == 1 else f"{self.frames} frames"


def untouched(correction: Correction) -> list[str]:
    """Return the ids of automatic frames without strokes or verdicts of a person; undone ones count too."""
    free = [i for i in correction.labels.frame_ids if correction.state(i) == "auto"]
    return [i for i in free if not any(stroke.by_person for stroke in correction.journal.strokes(i))]


def relabel(correction: Correction, learnt: LabelSet) -> Relabelled:
    """Give untouched frames their labels from another set of the same recording.

    Frames that the set lacks, or has with another depth image, stay as they are. Raises CloudError for a set
    of another camera or scheme, NotSavedError, and as ``Correction.frame`` does.
    """
    if learnt.intrinsics.shape != correction.labels.intrinsics.shape:
        raise CloudError(
            f"{learnt.path} has images of {learnt.intrinsics.shape}, {correction.labels.path} of "
            f"{correction.labels.intrinsics.shape}; run learn again"
        )
    if learnt.scheme != correction.labels.scheme:
        raise CloudError(
            f"{learnt.path} has scheme {learnt.scheme.name!r}, {correction.labels.path} has "
            f"{correction.labels.scheme.name!r}; run learn again"
        )
    step, there = _next_step(correction), set(learnt.frame_ids)
    strokes = []
    for frame_id in untouched(correction):
        if frame_id not in there:
            continue
        frame, new = correction.frame(frame_id), learnt.read(frame_id)
        if not np.array_equal(frame.depth_mm, new.depth_mm):
            continue
        if new.confidence is not None:
            with nothing_changed(correction.labels.path):
                correction.labels.write_confidence(frame_id, step, new.confidence)
        strokes.append(_stroke(correction, frame_id, step, frame.parts, new.parts))
    return _recorded(correction, strokes, step)


def take_back(correction: Correction) -> Relabelled | None:
    """Give untouched frames their labels from before the last fine-tuning step; None without one."""
    steps = {i: step_of(correction.journal.strokes(i)) or "" for i in untouched(correction)}
    last = max(steps.values(), default="")
    if not last:
        return None
    strokes, earlier = [], ""
    for frame_id in (i for i, step in steps.items() if step == last):
        entries = correction.journal.strokes(frame_id)
        first = next(n for n, stroke in enumerate(entries) if stroke.reason == last)
        before = after(correction.labels.read(frame_id, original=True), entries[:first])
        earlier = step_of(entries[:first]) or ""
        now = correction.frame(frame_id).parts
        strokes.append(_stroke(correction, frame_id, earlier, now, before.parts))
    return _recorded(correction, strokes, earlier)


def before_step(correction: Correction, frame_id: str) -> UInt8 | None:
    """Return the parts (h, w) of a frame before the last fine-tuning step on it, or None."""
    entries = correction.journal.strokes(frame_id)
    last = max((n for n, stroke in enumerate(entries) if stroke.operation == "relabel"), default=-1)
    if last < 0:
        return None
    return after(correction.labels.read(frame_id, original=True), entries[:last]).parts


def _recorded(correction: Correction, strokes: Sequence[Stroke], step: str) -> Relabelled:
    correction.record_together(strokes)
    moved = [stroke for stroke in strokes if stroke.changes]
    changed = sum(int(stroke.runs[:, 1].sum()) for stroke in moved)
    body = sum(int(correction.frame(s.frame_id).on_person.sum()) for s in moved)
    return Relabelled(step, len(moved), changed / body if body else 0.0)


def _next_step(correction: Correction) -> str:
    """Return an unused name for a fine-tuning step."""
    journal = correction.journal
    entries = (stroke for i in journal.frame_ids for stroke in journal.strokes(i))
    used = (int(stroke.reason or 0) for stroke in entries if stroke.operation == "relabel")
    return f"{1 + max(used, default=0):04}"


def _stroke(correction: Correction, frame_id: str, step: str, old: UInt8, new: UInt8) -> Stroke:
    everywhere = np.arange(old.size)
    runs = difference(everywhere, old.ravel(), new.ravel())
    return Stroke(
        frame_id, "relabel", runs, None, Gesture("key"), correction.who, correction.now(), reason=step
    )
