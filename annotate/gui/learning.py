"""Learning in the background: another process learns, and the window takes over its labels at the end."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from PySide6.QtCore import QObject, QProcess, QTimer

from annotate.correction.relabel import Relabelled, relabel, take_back
from annotate.gui.outcome import Done
from annotate.gui.window import CorrectionWindow, Read
from annotate.labelset.store import LabelSet
from sensors.errors import CloudError

AGAIN_MS = 100
"""Interval in which the window tries again to take over what was learnt, in milliseconds: while it opens a
frame it cannot. Chosen by eye."""
STOP_MS = 3000
"""How long a closing window waits for the process that it has killed, in milliseconds."""


@dataclass(frozen=True)
class Lesson:
    """Recipe for learning: the command, with its arguments, and the label set that it leaves."""

    command: tuple[str, ...]
    labels: Path


class Learner(QObject):
    """One learning at a time. lesson: None where the program that opened the window knows of none.

    The process is killed with the window; the next learning goes on with what it has done.
    """

    def __init__(self, window: CorrectionWindow, lesson: Lesson | None) -> None:
        super().__init__(window)
        self._window, self._lesson = window, lesson
        self._process = QProcess(self)
        self._errors = ""
        self._process.readyReadStandardError.connect(self._hear)
        self._process.finished.connect(self._end)
        window.closed.connect(self.stop)

    @property
    def running(self) -> bool:
        """Whether something is being learnt."""
        return self._process.state() != QProcess.ProcessState.NotRunning

    def learn(self) -> Done:
        """Begin to learn from the frames accepted so far."""
        if self._lesson is None:
            return Done("Nothing here can learn: open the set with annotate-cloud fix", "warn")
        if self.running:
            return Done(f"Still learning: {self._errors or 'it has just begun'}")
        self._errors = ""
        program, *arguments = self._lesson.command
        self._process.start(program, arguments)
        return Done("Learning from the accepted frames, beside your work")

    def unlearn(self) -> Done | None:
        """Take back what the last learning changed, in all frames that nobody has worked on since."""
        self._take(partial(take_back, self._window.correction), "taken back: ")
        return None

    def stop(self) -> None:
        """Kill the process, if there is one."""
        if self.running:
            self._process.finished.disconnect(self._end)
            self._process.kill()
            self._process.waitForFinished(STOP_MS)

    def _hear(self) -> None:
        said = bytes(self._process.readAllStandardError().data()).decode(errors="replace").strip()
        self._errors = said.rpartition("\n")[2].removeprefix("annotate-cloud: ") or self._errors

    def _end(self, code: int) -> None:
        said = bytes(self._process.readAllStandardOutput().data()).decode(errors="replace")
        if code:
            self._show(Done(f"Nothing learnt: {self._errors or f'the process ended with {code}'}", "warn"))
            return
        result = json.loads(said)
        if result["labels"] is None:
            self._show(Done(self._errors[:1].upper() + self._errors[1:], "warn"))
            return
        held = f"right on held-out frames: {result['before']:.1%} before, {result['after']:.1%} now; "
        self._take(self._relabelled, held)

    def _relabelled(self) -> Relabelled:
        assert self._lesson is not None
        return relabel(self._window.correction, LabelSet.open(self._lesson.labels))

    def _take(self, change: Callable[[], Relabelled | None], words: str) -> None:
        """Change labels beside the window, and show the open frame anew; later where it is busy."""
        window = self._window
        if window.background.busy:
            QTimer.singleShot(AGAIN_MS, self, partial(self._take, change, words))
            return
        window.refresh_picture()

        def work() -> tuple[Relabelled | None, Read]:
            done = change()
            window.walk.forget()
            return done, (window.walk.read(window.frame_id), window.walk.parts_before(window.frame_id))

        def then(found: tuple[Relabelled | None, Read]) -> None:
            done, read = found
            text = f"{words}{done.text}" if done else "There is nothing learnt to take back"
            window.act(partial(window.show_anew, read, Done(text[0].upper() + text[1:], "good")))

        def failed(error: CloudError) -> None:
            # The editors were closed: the frame is opened as it stands.
            window.walk.forget()
            read = window.walk.read(window.frame_id), window.walk.parts_before(window.frame_id)
            window.act(partial(window.show_anew, read, Done(str(error), "bad")))

        window.busy("Taking over the learnt labels…", work, then, failed)

    def _show(self, done: Done) -> None:
        self._window.status.show_done(done, self._window.theme)
