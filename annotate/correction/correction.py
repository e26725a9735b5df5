"""Correction session over a label set that can be killed at any time and continued.

On disk: ``frames/`` holds the labels as last saved, ``journal.jsonl`` every stroke, ``original/`` each
corrected frame's labels before the first stroke. A frame's note "journal" counts the entries that the saved
labels include; later entries are applied when the frame is read. The journal is written first, and an entry
applied twice has no further effect. Frames are saved on a verdict, on leaving, and after a killed session.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, Self

from annotate.correction.edit import ActiveTime, Editor, steady_time
from annotate.correction.history import History
from annotate.correction.replay import State, after, noted, replayed, state_of, step_of, verdicts
from annotate.frame_labels import FrameLabels, Status
from annotate.labelset.claim import Claim, login
from annotate.labelset.journal import REMEDY, Journal, NotSavedError, nothing_changed
from annotate.labelset.label_set import LEARNT, LabelSet
from annotate.labelset.stroke import Stroke
from sensors.errors import CloudError, FormatError


class RestorableError(FormatError):
    """Error of corrupt labels that ``Correction.restore`` can rebuild."""


class Correction:
    """Correction of one label set by one person; a context manager that saves and releases the set.

    A stroke is on disk when an editor's operation returns. If the disk refuses the stroke, the operation
    raises NotSavedError after its effect in memory; the next stroke writes refused ones again.
    """

    def __init__(self, labels: LabelSet, who: str, claim: Claim | None, clock: Callable[[], float]) -> None:
        """Set up a correction; use ``open`` instead."""
        self.labels, self.who, self.journal = labels, who, Journal.of(labels.path, labels.scheme)
        self._claim, self._clock = claim, clock
        self._opened: dict[str, tuple[FrameLabels, Editor]] = {}
        self._unsaved: set[str] = set()
        self._statuses: dict[str, Status] = {}
        self._states: dict[str, tuple[int, State]] = {}

    @classmethod
    def open(
        cls, path: Path, who: str = "", *, read_only: bool = False, clock: Callable[[], float] = steady_time
    ) -> Self:
        """Open the label set at ``path`` with all earlier corrections.

        who: "" for the current user. Raises FormatError for a corrupt set or journal, and CloudError for a
        set that cannot be written to. Raises ClaimedError with the name of another person who corrects the
        set.
        """
        labels, who = LabelSet.open(path), who or login()
        claim = None if read_only else Claim.take(path, who)
        try:
            correction = cls(labels, who, claim, clock)
            if claim:
                correction._recover()
            return correction
        except BaseException:
            if claim:
                claim.release()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    @property
    def read_only(self) -> bool:
        """Return True if strokes are refused."""
        return self._claim is None

    @property
    def unsaved(self) -> int:
        """Return the number of entries in memory that the disk refused."""
        return len(self.journal.pending)

    def frame(self, frame_id: str) -> FrameLabels:
        """Read a frame with all strokes applied. Any thread may call this.

        Raises RestorableError when corrupt labels can be rebuilt, else FormatError.
        """
        try:
            saved = self.labels.read(frame_id)
        except FormatError as error:
            if self.can_restore(frame_id):
                raise RestorableError(
                    f"{error}, or let fix rebuild it from original/ and the journal"
                ) from error
            raise
        return self._learnt(after(saved, self._later(frame_id, saved.notes)))

    def _learnt(self, frame: FrameLabels) -> FrameLabels:
        """Return a frame with the confidence of the fine-tuning step that labelled it."""
        step = step_of(self.journal.strokes(frame.frame_id))
        if step is None or step == frame.notes.get(LEARNT):
            return frame
        confidence = self.labels.confidence(frame.frame_id, step)
        body = frame.on_body
        sure = 0.0 if confidence is None or not body.any() else float(confidence[body].mean())
        notes = {**frame.notes, LEARNT: step, "confidence": round(sure, 4)}
        return replace(frame, confidence=confidence, notes=notes)

    def edit(self, frame_id: str) -> Editor:
        """Return an editor of a frame with the history of its strokes, and save the frames edited before.

        Every stroke goes to the journal. Raises as ``frame`` does, and CloudError when read-only.
        """
        self._refuse_read_only()
        opened = self._opened.get(frame_id)
        editor = opened[1] if opened else self.begin(self.frame(frame_id))
        self.leave_others(frame_id)
        return editor

    def begin(self, frame: FrameLabels) -> Editor:
        """Return an editor of a frame from ``frame``; other edited frames stay open until
        ``leave_others``.
        """
        self._refuse_read_only()
        frame_id = frame.frame_id
        if frame_id in self._opened:
            return self._opened[frame_id][1]
        frame, history = self._with_history(frame), History.of(self.journal.strokes(frame_id))
        editor = Editor(frame, self.who, self._record, ActiveTime(self._clock), history)
        editor.time.mark("looking")
        self._opened[frame_id] = frame, editor
        return editor

    def leave_others(self, frame_id: str) -> None:
        """Save and close all other edited frames; frames that the disk refuses stay open."""
        for other in [i for i in self._opened if i != frame_id]:
            with suppress(NotSavedError):
                self.leave(other)

    def save(self, frame_id: str) -> None:
        """Write a frame's labels to the label set.

        Raises NotSavedError when the disk refuses; the strokes stay in the journal.
        """
        frame, editor = self._opened[frame_id]
        if not self.journal.strokes(frame_id):
            return
        with _saving(self.labels.path):
            self.flush()
            self._write(replace(frame, parts=editor.parts.copy()))
        self._unsaved.discard(frame_id)

    def leave_all(self) -> None:
        """Save and close all edited frames. Raises NotSavedError when the disk refuses."""
        for frame_id in list(self._opened):
            self.leave(frame_id)

    def leave(self, frame_id: str) -> None:
        """Save an edited frame, and close its editor."""
        editor = self._opened[frame_id][1]
        editor.leave()
        if frame_id in self._unsaved:
            self.save(frame_id)
        del self._opened[frame_id]

    def now(self) -> str:
        """Return the clock's time as ISO 8601 in UTC."""
        return ActiveTime(self._clock).now()

    def flush(self) -> None:
        """Write the entries that the disk refused. Raises NotSavedError when it refuses them again."""
        with _saving(self.labels.path):
            for frame_id in sorted({stroke.frame_id for stroke in self.journal.pending}):
                self.labels.keep_original(frame_id)
            self.journal.flush()

    def record_together(self, strokes: Sequence[Stroke]) -> None:
        """Add entries of untouched frames atomically: all or, after a crash, none.

        Any thread may call this, but no editor may be open (``leave_all``). Raises NotSavedError, and
        CloudError when read-only.
        """
        self._refuse_read_only()
        assert not self._opened, f"frames {sorted(self._opened)} are being edited"
        with nothing_changed(self.labels.path):
            for stroke in strokes:
                self.labels.keep_original(stroke.frame_id)
        self.journal.add_together(strokes)
        with _saving(self.labels.path):
            for stroke in strokes:
                self._write(self.frame(stroke.frame_id))

    def state(self, frame_id: str) -> State:
        """Return the state of a frame after its strokes and verdicts."""
        strokes = self.journal.strokes(frame_id)
        known = self._states.get(frame_id)
        # Kept, because the window needs all states after every stroke, and no other program writes the set.
        if known is None or known[0] != len(strokes):
            known = self._states[frame_id] = len(strokes), state_of(strokes, self._first_status(frame_id))
        return known[1]

    def _first_status(self, frame_id: str) -> Status:
        """Return a frame's status from before its first entry."""
        if frame_id not in self._statuses:
            original = bool(self.journal.strokes(frame_id)) and self.labels.has_original(frame_id)
            self._statuses[frame_id] = self.labels.status(frame_id, original)
        return self._statuses[frame_id]

    def next_verdict(self, frame_id: str) -> Literal["accept", "agree", "none"]:
        """Return the verdict that the accept key gives next; a rejection is never overruled.

        "accept" without a verdict, "agree" after another person's verdict, "none" after this person's.
        """
        if self.state(frame_id) in ("auto", "touched"):
            return "accept"
        standing = verdicts(self.journal.strokes(frame_id))
        return "none" if standing and standing[-1].who == self.who else "agree"

    def can_restore(self, frame_id: str) -> bool:
        """Return whether a frame's labels from before the first correction can be read."""
        try:
            self.labels.read(frame_id, original=True)
        except CloudError:
            return False
        return True

    def restore(self, frame_id: str) -> FrameLabels:
        """Rebuild a frame's labels and notes from ``original/`` and the journal, and save them.

        Raises FormatError when the original is corrupt, or the journal is incomplete or of another set.
        """
        self._refuse_read_only()
        try:
            notes = self.labels.notes(frame_id)
        except FormatError:
            notes = {}
        self._later(frame_id, notes)
        frame = replayed(self.labels, self.journal, frame_id)
        with _saving(self.labels.path):
            self.labels.write_labels(frame)
        return frame

    def close(self) -> None:
        """Save the open frames and release the set.

        Raises NotSavedError when the disk refuses strokes; the set stays claimed until ``abandon``.
        """
        if not self.read_only:
            self.leave_all()
            self.flush()
        self.abandon()

    def abandon(self) -> None:
        """Release the set without saving; later writes are refused."""
        claim, self._claim = self._claim, None
        if claim:
            claim.release()

    def _later(self, frame_id: str, notes: dict[str, Any]) -> Sequence[Stroke]:
        """Return the entries that a saved frame with these notes does not include.

        A copy of a set without journal and originals has no entries.
        """
        strokes, included = self.journal.strokes(frame_id), notes.get("journal", 0)
        if not strokes and not self.labels.has_original(frame_id):
            return ()
        if type(included) is not int or not 0 <= included <= len(strokes):
            raise FormatError(
                f"{self.journal.path} holds {len(strokes)} entries of frame {frame_id}, but the labels state "
                f"that {str(included)[:20]} are applied; {REMEDY}"
            )
        return strokes[included:]

    def _with_history(self, frame: FrameLabels) -> FrameLabels:
        """Return the frame; in a copy of a set without its journal, remove the note ``journal``."""
        if frame.notes.get("journal") and not self.journal.strokes(frame.frame_id):
            frame = replace(frame, notes={k: v for k, v in frame.notes.items() if k != "journal"})
            with _saving(self.labels.path):
                self.labels.write_labels(frame)
        return frame

    def _recover(self) -> None:
        """Save the frames whose last strokes are in the journal alone, after a killed session."""
        for frame_id in sorted(set(self.journal.frame_ids) & set(self.labels.frame_ids)):
            # A corrupt frame is refused when it is opened; its strokes stay in the journal.
            with suppress(CloudError, OSError):
                if self._later(frame_id, self.labels.notes(frame_id)):
                    self._write(self.frame(frame_id))

    def _write(self, frame: FrameLabels) -> None:
        before = self.labels.status(frame.frame_id, self.labels.has_original(frame.frame_id))
        self.labels.write_labels(noted(frame, self.journal, before))

    def _record(self, stroke: Stroke) -> None:
        self._refuse_read_only()
        self.journal.add(stroke)
        self._unsaved.add(stroke.frame_id)
        self.flush()
        if stroke.operation != "leave" and not stroke.changes:
            # A verdict given, taken back or given again.
            self.save(stroke.frame_id)

    def _refuse_read_only(self) -> None:
        if self.read_only:
            raise CloudError(f"{self.labels.path} is closed or open read-only; open it again to correct it")


@contextmanager
def _saving(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise NotSavedError(
            f"{error.filename or path} cannot be written ({error.strerror}); the strokes are kept: free some "
            "space or repair the disk, and continue"
        ) from error
