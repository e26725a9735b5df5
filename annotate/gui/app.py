"""Opens the window on a label set and runs it until it is closed."""

import math
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

from PySide6.QtCore import QTimer
from PySide6.QtWidgets import QApplication, QMainWindow

from annotate.correction.correction import Correction
from annotate.correction.replay import STATE_NAMES
from annotate.gui.commands import bind
from annotate.gui.learning import Lesson
from annotate.gui.live.live_window import LiveWindow
from annotate.gui.probe import check_screen
from annotate.gui.settings import memory_path, recall, remember
from annotate.gui.state.keys import load_settings, settings_path
from annotate.gui.state.scene import SceneReader
from annotate.gui.widgets.theme import theme_of
from annotate.gui.window import CorrectionWindow
from annotate.labelset.label_set import LabelSet
from annotate.labelset.source_recording import Recorded, find_session
from annotate.live.pipeline import LivePipeline
from sensors.errors import CloudError

LISTEN_MS = 300
"""Interval in which Python handles signals, in milliseconds: within Qt's loop it would not. Untuned."""


def run_window(
    path: Path, session: Path | None, other: Path | None, who: str, read_only: bool, lesson: Lesson
) -> dict[str, int]:
    """Correct the label set at ``path`` until the window is closed; frames by state.

    lesson: how to learn from its corrections. Raises CloudError where set, session, the set to compare,
    settings or screen are not what they must be.
    """
    settings = load_settings(settings_path().expanduser())
    compared = LabelSet.open(other) if other else None
    correction = Correction.open(path, who, read_only=read_only)
    try:
        reader = SceneReader(correction, session, compared)
        check_screen()
        app = QApplication.instance() or QApplication(sys.argv[:1])
        window = CorrectionWindow(correction, reader, settings, memory_path())
        bind(window, lesson)
    except BaseException:
        correction.abandon()
        raise
    window.show()
    _close_on_signals(window)
    app.exec()
    states = [STATE_NAMES[correction.state(frame_id)] for frame_id in correction.labels.frame_ids]
    return {state: states.count(state) for state in sorted(set(states))}


def recording_of(path: Path, given: Path | None) -> Path | None:
    """Return the recording of the label set at ``path``: the given one, the last given one, or one beside it.

    A given recording is stored for the set; a stored one that no longer fits is skipped.
    Raises CloudError where the set cannot be read or does not fit the recording that is given.
    """
    labels, known = LabelSet.open(path), recall(memory_path())
    if given:
        Recorded(labels, given)
        remember(known.with_session(path, given))
        return given
    if before := known.session(path):
        with suppress(CloudError):
            Recorded(labels, before)
            return before
    return find_session(labels)


def run_live(
    pipeline: LivePipeline, takes: Iterator[Path], subject: str, seconds: float, ending: Callable[[], bool]
) -> None:
    """Show a running pipeline until the window is closed, the seconds are over, or ``ending`` is true.

    Raises CloudError where settings or screen are not what they must be.
    """
    settings = load_settings(settings_path().expanduser())
    check_screen()
    app = QApplication.instance() or QApplication(sys.argv[:1])
    window = LiveWindow(pipeline, takes, theme_of(settings.theme), subject)
    window.show()
    timer = QTimer(window, interval=LISTEN_MS)
    timer.timeout.connect(lambda: window.close() if ending() else None)
    timer.start()
    if math.isfinite(seconds):
        QTimer.singleShot(round(1000 * seconds), window.close)
    app.exec()


def _close_on_signals(window: QMainWindow) -> None:
    """Ctrl-C and a polite kill close the window as its own button does: everything saved.

    Within Qt's loop: a window that closes before the loop runs would never end it.
    """
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: QTimer.singleShot(0, window.close))
    timer = QTimer(window, interval=LISTEN_MS)
    timer.timeout.connect(lambda: None)
    timer.start()
