"""Fine-tuning in the background: another process trains, and the window takes over its labels."""

import json
import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from PySide6.QtCore import QObject, QProcess, QTimer

from annotate.correction.correction import Correction
from annotate.correction.relabel import Relabelled, relabel, take_back
from annotate.gui.background import Task
from annotate.gui.state.frame_order import FrameRead
from annotate.gui.state.outcome import Outcome
from annotate.gui.window import CorrectionWindow
from annotate.labelset.label_set import LabelSet
from sensors.errors import CloudError

ERROR = "annotate-cloud: "  # beginning of a command's error lines
PROGRESS = re.compile(r"(?:learn, )?(.+): (\d+)/(\d+), [^,]+, (.+) left")
"""Line of a command's progress: counted things, number done, total, time left."""
AGAIN_MS = 100  # interval of the attempts to take over labels, which fail while a frame is opened; untuned
STOP_MS = 3000  # wait of a closing window for its killed process; untuned
Change = Callable[[], Relabelled | None]


@dataclass(frozen=True)
class LearnCommand:
    """Command line of a fine-tuning, and the label set that it writes."""

    command: tuple[str, ...]
    labels: Path


class Learner(QObject):
    """Runner of one fine-tuning process at a time.

    The process is killed with the window; the next process resumes from its files. command: None where the
    program that opened the window cannot fine-tune.
    """

    def __init__(self, window: CorrectionWindow, command: LearnCommand | None) -> None:
        super().__init__(window)
        self._window, self._command = window, command
        self._process = QProcess(self)
        self._rest, self._error, self._stopped = "", "", False
        self._process.readyReadStandardError.connect(self._read_progress)
        self._process.finished.connect(self._end)
        window.closed.connect(self.kill)

    @property
    def running(self) -> bool:
        """Return True while the process runs."""
        return self._process.state() != QProcess.ProcessState.NotRunning

    def learn(self) -> Outcome:
        """Start fine-tuning on the frames accepted so far."""
        if self._command is None:
            return Outcome("This window cannot learn: open the set with annotate-cloud fix", "warn")
        if self.running:
            stop = self._window.settings.key("stop_learning")
            return Outcome(f"Still learning; {stop} stops it")
        self._rest, self._error, self._stopped = "", "", False
        program, *arguments = self._command.command
        self._process.start(program, arguments)
        self._window.panels.progress.show_learning("Learning: begun")
        return Outcome("Learning in the background; go on working")

    def stop_now(self) -> Outcome | None:
        """Stop the running fine-tuning; labels stay unchanged."""
        if not self.running:
            return Outcome("Nothing is being learnt", "warn")
        self._stopped = True
        self._process.kill()
        return None

    def unlearn(self) -> None:
        """Restore the labels from before the last fine-tuning, in frames without later work of a person."""

        def words(done: Relabelled | None) -> str:
            return done.text_of_taking_back if done else "No learning is left to take back"

        busy = "Restoring the labels from before the last learning…"
        self._take(busy, partial(take_back, self._window.correction), words)

    def kill(self) -> None:
        """Kill the process, if one runs."""
        if self.running:
            self._process.finished.disconnect(self._end)
            self._process.kill()
            self._process.waitForFinished(STOP_MS)

    def _read_progress(self) -> None:
        text = bytes(self._process.readAllStandardError().data()).decode(errors="replace")
        # The output read so far may end within a line.
        *lines, self._rest = (self._rest + text).splitlines(keepends=True) or [""]
        if self._rest.endswith("\n"):
            lines, self._rest = [*lines, self._rest], ""
        for line in lines:
            if progress := PROGRESS.fullmatch(line.strip()):
                what, done, total, left = progress.groups()
                share = int(done) / max(1, int(total))
                self._window.panels.progress.show_learning(f"Learning: {what} {share:.0%}, {left} left")
            elif line.startswith(ERROR):
                self._error = line.removeprefix(ERROR).strip()

    def _end(self, code: int, status: QProcess.ExitStatus) -> None:
        self._window.panels.progress.show_learning("")
        text = bytes(self._process.readAllStandardOutput().data()).decode(errors="replace")
        if self._stopped:
            self._window.say(Outcome("Learning is stopped; labels are unchanged", "warn"))
        elif status == QProcess.ExitStatus.CrashExit or (code and not self._error):
            self._window.say(Outcome("Learning stopped before it finished; labels are unchanged", "bad"))
        elif code:
            self._window.say(Outcome(f"Nothing learnt: {self._error}", "warn"))
        else:
            self._learnt(json.loads(text))

    def _learnt(self, result: dict[str, Any]) -> None:
        held = f"Held-out frames: {result['text']}"
        if result["labels"] is None:
            text = f"{held}. No gain is certain, so labels stay. Correct more frames"
            self._window.say(Outcome(text, "warn"))
            return
        assert self._command is not None
        learnt = partial(_relabelled, self._window.correction, self._command.labels)
        self._take(
            "Taking over the learnt labels…", learnt, lambda done: f"{held}; {done.text}" if done else held
        )

    def _take(self, busy: str, change: Change, words: Callable[[Relabelled | None], str]) -> None:
        """Change labels in the background, then reload the open frame; if the window is busy, do so later.

        busy: text to show meanwhile. words: function that returns the text of the outcome.
        """
        window = self._window
        if window.background.busy or window.held.shape:
            QTimer.singleShot(AGAIN_MS, self, partial(self._take, busy, change, words))
            return
        window.refresh_picture()
        window.leave_due.stop()
        try:
            # In the window's thread, because it owns the editors.
            window.correction.leave_all()
        except CloudError as error:
            self._window.say(Outcome(str(error), "bad"))
            return

        def read() -> FrameRead:
            window.frames.forget()
            return window.frames.read(window.frame_id)

        def work() -> tuple[Relabelled | None, FrameRead]:
            return change(), read()

        def then(found: tuple[Relabelled | None, FrameRead]) -> None:
            done, now = found
            window.act(partial(window.show_anew, now, Outcome(words(done), "good")))

        def failed(error: CloudError) -> None:
            # The editors are closed, so the frame is opened as it stands.
            window.act(lambda: window.show_anew(read(), Outcome(str(error), "bad")))

        window.busy(Task(busy, work, then, failed))


def _relabelled(correction: Correction, labels: Path) -> Relabelled:
    return relabel(correction, LabelSet.open(labels))
