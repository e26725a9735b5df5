"""Remaining work on a label set: a reviewer's queue with reasons, progress, and the time left.

Constants are untuned.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median

from annotate.correction.correction import Correction
from annotate.correction.replay import is_stroke, rejected_by, verdicts
from annotate.labelset.stroke import Stroke
from annotate.segmentation.labels_of_frame import confidence_in, remarks_in
from annotate.segmentation.segment import UNSURE_ISLAND
from sensors.errors import CloudError

HASTY_S = 1.5  # active seconds on an accepted frame below which a review is worth while
LEAST_DONE = 3  # finished frames before the time left is estimated, because first frames take longer
UNSURE = 0.9  # mean confidence below which labels that were accepted unchanged are worth a look


@dataclass(frozen=True)
class Queued:
    """Frame that waits for a reviewer, with the reason. urgency: sort key of the queue."""

    frame_id: str
    reason: str
    urgency: float


@dataclass(frozen=True)
class Progress:
    """Numbers of frames by state.

    left_s: active seconds for the remaining frames at this person's median, None at the start.
    """

    done: int
    total: int
    left_s: float | None

    @property
    def text(self) -> str:
        """Return the progress as text, such as "12 of 40 done, 9 min left"."""
        if self.left_s is None or self.done == self.total:
            return f"{self.done} of {self.total} done"
        minutes = self.left_s / 60
        left = f"{self.left_s:.0f} s" if minutes < 1 else f"{minutes:.0f} min"
        return f"{self.done} of {self.total} done, {left if minutes < 90 else f'{minutes / 60:.1f} h'} left"


def review_queue(correction: Correction) -> list[Queued]:
    """Return the frames that wait for a reviewer (``is_queued``), the most urgent first."""
    queue = [
        Queued(i, *_why(correction.journal.strokes(i), confidence_of(correction, i)))
        for i in correction.labels.frame_ids
        if is_queued(correction, i)
    ]
    return sorted(queue, key=lambda queued: (-queued.urgency, queued.frame_id))


def is_queued(correction: Correction, frame_id: str) -> bool:
    """Return whether a frame is accepted or rejected, but not by this person, and no one has agreed."""
    if correction.state(frame_id) not in ("accepted", "rejected"):
        return False
    standing = verdicts(correction.journal.strokes(frame_id))
    return not standing or (standing[-1].who != correction.who and standing[-1].operation != "agree")


def progress(correction: Correction, frame_ids: list[str]) -> Progress:
    """Return the progress of the work on frames."""
    done = [i for i in frame_ids if correction.state(i) not in ("auto", "touched")]
    spent = [
        sum(stroke.active_seconds for stroke in strokes if stroke.who == correction.who)
        for strokes in map(correction.journal.strokes, done)
    ]
    known = [seconds for seconds in spent if seconds > 0]
    left = (len(frame_ids) - len(done)) * median(known) if len(known) >= LEAST_DONE else None
    return Progress(len(done), len(frame_ids), left)


def confidence_of(correction: Correction, frame_id: str) -> float | None:
    """Return the mean confidence in a frame's notes; None if unknown, -1 for corrupt notes."""
    try:
        return confidence_in(correction.labels.notes(frame_id))
    except CloudError:
        return -1.0


def has_unsure_island(correction: Correction, frame_id: str) -> bool:
    """Return whether a frame's notes name a piece apart from the body; False for corrupt notes."""
    try:
        return UNSURE_ISLAND in remarks_in(correction.labels.notes(frame_id))
    except CloudError:
        return False


def _why(entries: Sequence[Stroke], confidence: float | None) -> tuple[str, float]:
    """Return the reason, and its urgency: a whole number for the kind plus the mean doubt (1 -
    confidence).
    """
    doubt = 0.0 if confidence is None else min(1.0, 1 - confidence)
    unsure = "" if confidence is None else f", confidence {max(confidence, 0):.2f}"
    if (rejected := rejected_by(entries)) is not None:
        return f"rejected by {rejected.who}: {rejected.reason}", 4 + doubt
    given = verdicts(entries) or entries
    who = given[-1].who if given else "another tool"
    work = [stroke for stroke in entries if is_stroke(stroke)]
    seconds = sum(stroke.active_seconds for stroke in entries)
    if not work and confidence is not None and confidence < UNSURE:
        return f"accepted unchanged by {who} in {seconds:.1f} s{unsure}", 3 + doubt
    if seconds < HASTY_S:
        return f"accepted by {who} in {seconds:.1f} s{unsure}", 2 + doubt
    strokes_text = "1 stroke" if len(work) == 1 else f"{len(work)} strokes"
    return f"{strokes_text} by {who}{unsure}", 1 + doubt
