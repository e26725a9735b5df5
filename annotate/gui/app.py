"""Open a window on a label set or a rig and run it until it is closed."""

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
from annotate.gui.display import check_screen
from annotate.gui.learning import LearnCommand
from annotate.gui.live.live_window import LiveWindow
from annotate.gui.settings import Memory, memory_path
from annotate.gui.state.keys import load_settings, settings_path
from annotate.gui.state.scene import SceneReader
from annotate.gui.widgets.theme import theme_of
from annotate.gui.window import CorrectionWindow
from annotate.labelset.label_set import LabelSet
from annotate.labelset.source_recording import Recorded, find_session
from annotate.live.pipeline import LivePipeline
from sensors.errors import CloudError

LISTEN_MS = 300  # interval in which Python handles signals, which Qt's loop does not; untuned


def run_window(
    correction: Correction, session: Path | None, other: Path | None, learn: LearnCommand
) -> dict[str, int]:
    """Open the correction window on a label set until it is closed; return the number of frames by state.

    session, other: recording and label set to compare, if any. learn: command for fine-tuning. The label
    set's lock is released in any case. Raises CloudError where session, the other set, settings or screen
    cannot be used.
    """
    try:
        settings = load_settings(settings_path().expanduser(), correction.labels.scheme)
        reader = SceneReader(correction, session, LabelSet.open(other) if other else None)
        check_screen()
        app = QApplication.instance() or QApplication(sys.argv[:1])
        window = CorrectionWindow(correction, reader, settings, memory_path())
        bind(window, learn)
    except BaseException:
        correction.abandon()
        raise
    window.show()
    _close_on_signals(window)
    app.exec()
    states = [STATE_NAMES[correction.state(frame_id)] for frame_id in correction.labels.frame_ids]
    return {state: states.count(state) for state in sorted(set(states))}


def recording_of(path: Path, given: Path | None) -> Path | None:
    """Return the recording of a label set: ``given``, the recording given last, or one beside the set.

    A given recording is stored for the set; a stored recording that no longer fits is skipped. Raises
    CloudError where the set cannot be read or does not fit the given recording.
    """
    labels, memory = LabelSet.open(path), Memory(memory_path())
    if given:
        Recorded(labels, given)
        memory.put_recording(path, given)
        return given
    if before := memory.recording(path):
        with suppress(CloudError):
            Recorded(labels, before)
            return before
    return find_session(labels)


def run_live(
    pipeline: LivePipeline, takes: Iterator[Path], subject: str, seconds: float, ending: Callable[[], bool]
) -> None:
    """Show a running pipeline until the window is closed, the seconds are over, or ``ending`` is true.

    Raises CloudError where settings or screen cannot be used.
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
    """Close the window on SIGINT and SIGTERM as its button does, with everything saved.

    The close runs within Qt's loop, because a window that closes before the loop does not end it.
    """
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: QTimer.singleShot(0, window.close))
    timer = QTimer(window, interval=LISTEN_MS)
    timer.timeout.connect(lambda: None)
    timer.start()
