"""Verdicts in the window, each followed by opening the next frame that waits, and undo across frames."""

from annotate.correction.replay import rejected_by
from annotate.gui.state.outcome import Outcome
from annotate.gui.widgets.dialogs import ask_reason
from annotate.gui.window import CorrectionWindow
from annotate.labelset.stroke import Gesture


class Verdicts:
    """Actions for verdicts on the frames of a window."""

    def __init__(self, window: CorrectionWindow) -> None:
        self._window = window
        # Frame that was judged, frame that was opened then, and the number of its strokes at that moment.
        self._way: list[tuple[str, str, int]] = []

    @property
    def _rejected(self) -> bool:
        return self._window.correction.state(self._window.frame_id) == "rejected"

    def accept(self) -> Outcome | None:
        """Accept the frame, or agree with its verdict, and open the next; a rejected frame stays rejected."""
        window = self._window
        if window.correction.read_only:
            return self._go_on(Outcome("Read-only"))
        verdict = window.correction.next_verdict(window.frame_id)
        if verdict != "none":
            window.edits.editor().judge(verdict)
        texts = {"accept": "Accepted", "agree": "Agreed", "none": "Already accepted"}
        if self._rejected:
            texts = {"agree": "Agreed with the rejection", "none": "It stays rejected"}
        return self._go_on(Outcome(texts[verdict]))

    def reject(self) -> Outcome | None:
        """Reject the frame for a reason, or agree with another person's rejection; open the next frame."""
        window = self._window
        if self._rejected and window.correction.next_verdict(window.frame_id) == "agree":
            return self.accept()
        if not (reason := ask_reason(window)):
            return Outcome("Not rejected")
        window.edits.editor().judge("reject", reason, Gesture("key", keys=2))
        # A reason of the dialog begins small; a person's own words keep their case.
        first = reason[:1].lower() if reason[1:2].islower() else reason[:1]
        return self._go_on(Outcome(f"Rejected ({first}{reason[1:]})"))

    def overrule(self) -> Outcome | None:
        """Accept a rejected frame, and open the next."""
        window = self._window
        if not self._rejected:
            key = window.settings.key("accept")
            return Outcome(f"This frame is not rejected: {key} accepts it", "warn")
        rejection = rejected_by(window.correction.journal.strokes(window.frame_id))
        window.edits.editor().judge("accept", how=Gesture("key", keys=3))
        whose = f" of {rejection.who}" if rejection else ""
        return self._go_on(Outcome(f"Accepted: the rejection{whose} is overruled"))

    def undo(self) -> Outcome | None:
        """Undo the last stroke.

        If this frame was opened by a verdict and has no stroke since, undo that verdict and reopen its frame.
        """
        window, editor = self._window, self._window.edits.frame.editor
        if self._way and editor and not window.edits.preview:
            judged, opened, strokes = self._way[-1]
            if opened == window.frame_id and len(editor.history.done) <= strokes:
                self._way.pop()
                window.open_frame(judged, window.edits.undo)
                return None
        return window.edits.undo()

    def _go_on(self, done: Outcome) -> Outcome | None:
        window, judged = self._window, self._window.frame_id
        window.refresh_picture()
        following = window.frames.next_unfinished(judged)
        if following is None or following == judged:
            left = f". {window.frames.all_done()}" if following is None else ""
            return Outcome(f"{done.text}{left}", "good")

        def arrived() -> None:
            if editor := window.edits.frame.editor:
                self._way.append((judged, window.frame_id, len(editor.history.done)))

        window.open_frame(following, arrived)
        return None
