"""Learning in the background: another process learns, and the window takes over its labels at the end."""

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
from annotate.gui.state.outcome import Done
from annotate.gui.window import CorrectionWindow, Read
from annotate.labelset.label_set import LabelSet
from sensors.errors import CloudError

SPOKEN = "annotate-cloud: "
"""Beginning of a command's error lines."""
PROGRESS = re.compile(r"(?:learn, )?(.+): (\d+)/(\d+), [^,]+, (.+) left")
"""Line of a command's progress: counted things, number done, total, time left."""
AGAIN_MS = 100
"""Interval in which the window tries again to take over what was learnt, in milliseconds: while it opens a
frame it cannot. Untuned."""
STOP_MS = 3000
"""How long a closing window waits for the process that it has killed, in milliseconds."""
Change = Callable[[], Relabelled | None]


@dataclass(frozen=True)
class Lesson:
    """Recipe for learning: the command, with its arguments, and the label set that it leaves."""

    command: tuple[str, ...]
    labels: Path


class Learner(QObject):
    """One learning at a time. lesson: None where the program that opened the window has none.

    The process is killed with the window; the next learning goes on with what it has done.
    """

    def __init__(self, window: CorrectionWindow, lesson: Lesson | None) -> None:
        super().__init__(window)
        self._window, self._lesson = window, lesson
        self._process = QProcess(self)
        self._heard, self._error, self._stopped = "", "", False
        self._process.readyReadStandardError.connect(self._hear)
        self._process.finished.connect(self._end)
        window.closed.connect(self.kill)

    @property
    def running(self) -> bool:
        """Whether something is being learnt."""
        return self._process.state() != QProcess.ProcessState.NotRunning

    def learn(self) -> Done:
        """Begin to learn from the frames accepted so far."""
        if self._lesson is None:
            return Done("Nothing here can learn: open the set with annotate-cloud fix", "warn")
        if self.running:
            stop = self._window.settings.key("stop_learning")
            return Done(f"Still learning; {stop} stops it")
        self._heard, self._error, self._stopped = "", "", False
        program, *arguments = self._lesson.command
        self._process.start(program, arguments)
        self._window.panel.show_learning("Learning: begun")
        return Done("Learning in the background; go on working")

    def stop_now(self) -> Done | None:
        """Stop the learning that runs; labels stay as they are."""
        if not self.running:
            return Done("Nothing is being learnt", "warn")
        self._stopped = True
        self._process.kill()
        return None

    def unlearn(self) -> Done | None:
        """Take back what the last learning changed, in all frames that nobody has worked on since."""

        def words(done: Relabelled | None) -> str:
            return done.text_of_taking_back if done else "There is no learning to take back"

        busy = "Restoring the labels from before the last learning…"
        self._take(busy, partial(take_back, self._window.correction), words)
        return None

    def kill(self) -> None:
        """Kill the process, if there is one."""
        if self.running:
            self._process.finished.disconnect(self._end)
            self._process.kill()
            self._process.waitForFinished(STOP_MS)

    def _hear(self) -> None:
        said = bytes(self._process.readAllStandardError().data()).decode(errors="replace")
        # The output read so far may end within a line.
        *lines, self._heard = (self._heard + said).splitlines(keepends=True) or [""]
        if self._heard.endswith("\n"):
            lines, self._heard = [*lines, self._heard], ""
        for line in lines:
            if progress := PROGRESS.fullmatch(line.strip()):
                what, done, total, left = progress.groups()
                share = int(done) / max(1, int(total))
                self._window.panel.show_learning(f"Learning: {what} {share:.0%}, {left} left")
            elif line.startswith(SPOKEN):
                self._error = line.removeprefix(SPOKEN).strip()

    def _end(self, code: int, status: QProcess.ExitStatus) -> None:
        self._window.panel.show_learning("")
        said = bytes(self._process.readAllStandardOutput().data()).decode(errors="replace")
        if self._stopped:
            self._show(Done("Learning is stopped; labels are unchanged", "warn"))
        elif status == QProcess.ExitStatus.CrashExit or (code and not self._error):
            self._show(Done("Learning stopped before it finished; labels are unchanged", "bad"))
        elif code:
            self._show(Done(f"Nothing learnt: {self._error}", "warn"))
        else:
            self._learnt(json.loads(said))

    def _learnt(self, result: dict[str, Any]) -> None:
        before, after = f"{result['before']:.1%}", f"{result['after']:.1%}"
        if result["labels"] is None:
            text = f"No improvement ({before} before, {after} now), so labels stay. Correct more frames"
            self._show(Done(text, "warn"))
            return
        held = f"Right on held-out frames: {before} before, {after} now"
        assert self._lesson is not None
        learnt = partial(_relabelled, self._window.correction, self._lesson.labels)
        self._take(
            "Taking over the learnt labels…", learnt, lambda done: f"{held}; {done.text}" if done else held
        )

    def _take(self, busy: str, change: Change, words: Callable[[Relabelled | None], str]) -> None:
        """Change labels beside the window, and show the open frame anew; later where the window is busy."""
        window = self._window
        if window.background.busy or window.held.shape:
            QTimer.singleShot(AGAIN_MS, self, partial(self._take, busy, change, words))
            return
        window.refresh_picture()
        window.leave_due.stop()
        try:
            # Here, in the window's thread, which owns the editors; beside it only labels change.
            window.correction.leave_all()
        except CloudError as error:
            self._show(Done(str(error), "bad"))
            return

        def read() -> Read:
            window.walk.forget()
            return window.walk.read(window.frame_id), window.walk.parts_before(window.frame_id)

        def work() -> tuple[Relabelled | None, Read]:
            return change(), read()

        def then(found: tuple[Relabelled | None, Read]) -> None:
            done, now = found
            window.act(partial(window.show_anew, now, Done(words(done), "good")))

        def failed(error: CloudError) -> None:
            # The editors were closed: the frame is opened as it stands.
            window.act(lambda: window.show_anew(read(), Done(str(error), "bad")))

        window.busy(busy, work, then, failed)

    def _show(self, done: Done) -> None:
        self._window.status.show_done(done, self._window.theme)


def _relabelled(correction: Correction, labels: Path) -> Relabelled:
    return relabel(correction, LabelSet.open(labels))
