"""Learning from the window: another process learns; the labels come in one step, and go in one."""

import shutil
import sys
import threading
import time

import numpy as np
import pytest
from PySide6.QtCore import Qt
from PySide6.QtTest import QTest

from annotate.correction.correction import Correction
from annotate.gui.commands import bind
from annotate.gui.learning import LearnCommand
from annotate.labelset.claim import ClaimedError
from annotate.labelset.journal import Journal
from annotate.labelset.label_set import LabelSet
from annotate.parts import PART_ID
from sensors.errors import CloudError
from tests.helpers import gui_driver
from tests.helpers.figure_sets import figure_set
from tests.helpers.gui_driver import CTRL, SHIFT

TORSO, HIP = PART_ID["torso"], PART_ID["hip"]
IDS = ("000000", "000001", "000002")
PROGRESS = "print('learn, steps: 25/75, 1.6/s, 31 s left', file=sys.stderr, flush=True); "
RESULT = 'print(\'{"text": "90.0% right before", "labels": "learnt"}\')'
NO_GAIN = 'print(\'{"text": "97.1% right before", "labels": null}\')'


@pytest.fixture(scope="module")
def sets(tmp_path_factory):
    """A figure in three frames, and its learnt labels: the torso is the hip."""
    path = tmp_path_factory.mktemp("sets")
    figure_set(path / "labels", [0.5] * 3)
    figure_set(path / "learnt", [0.5] * 3, instead={TORSO: HIP})
    return path


@pytest.fixture
def window(qapp, sets, tmp_path, monkeypatch, request):
    """A window on a copy of the set whose learning is a small program; its labels are there already."""
    folder = shutil.copytree(sets / "labels", tmp_path / "labels")
    command = LearnCommand((sys.executable, "-c", f"import sys, time; {request.param}"), sets / "learnt")
    monkeypatch.setattr(gui_driver, "bind", lambda shown: bind(shown, command))
    driver = gui_driver.Driver(folder)
    driver.folder = folder
    yield driver
    driver.close()


def wait_until(driver, condition) -> None:
    """Let the window work until a condition holds, a minute at most."""
    end = time.monotonic() + 60
    while not condition():
        assert time.monotonic() < end, driver.said
        driver.settle()
        time.sleep(0.01)


@pytest.mark.parametrize("window", [RESULT], indirect=True)
def test_learnt_labels_come_in_one_step_and_are_taken_back_in_one(window, sets, monkeypatch):
    threads, leave = [], Correction.leave

    def noted(correction, frame_id) -> None:
        threads.append(threading.current_thread())
        leave(correction, frame_id)

    monkeypatch.setattr(Correction, "leave", noted)
    window.key("accept")
    here, before = window.window.frame_id, window.parts.copy()
    assert here == IDS[1]
    window.key("learn")
    wait_until(window, lambda: "labelled again" in window.said)
    assert set(threads) == {threading.main_thread()}, "which owns the editors"
    assert "90.0% right before" in window.said
    assert window.window.frame_id == here and (window.parts[before == TORSO] == HIP).all()
    np.testing.assert_array_equal(window.edits.frame.scene.other, before)
    assert [window.correction.state(i) for i in IDS] == ["accepted", "auto", "auto"]
    window.window.open_frame(IDS[2])
    window.settle()
    window.key("undo")
    assert (window.parts == HIP).any() and not (window.parts == TORSO).any(), "undo is of strokes"
    window.key("unlearn")
    wait_until(window, lambda: "taken back: 2 frames" in window.said)
    for first in LabelSet.open(sets / "labels"):
        np.testing.assert_array_equal(window.correction.frame(first.frame_id).parts, first.parts)
    assert (window.parts == TORSO).any()
    window.key("unlearn")
    wait_until(window, lambda: "No learning is left" in window.said)


@pytest.mark.parametrize(
    ("window", "said"),
    [
        ("sys.exit('annotate-cloud: accept at least 3')", "Nothing learnt: accept at least 3"),
        (f"{PROGRESS} import os; os.kill(os.getpid(), 9)", "Learning stopped before it finished"),
        (f"{PROGRESS} raise SystemExit(7)", "Learning stopped before it finished"),
        (NO_GAIN, "97.1% right before. No gain is certain"),
    ],
    indirect=["window"],
)
def test_the_reason_is_shown_when_nothing_is_learnt(window, said):
    before = window.parts.copy()
    window.key("learn")
    wait_until(window, lambda: said in window.said)
    np.testing.assert_array_equal(window.parts, before)


@pytest.mark.parametrize("window", [f"{PROGRESS} time.sleep(600)"], indirect=True)
def test_work_goes_on_beside_learning_which_is_stopped_by_a_key_and_by_closing(window):
    progress = window.panels.progress
    window.key("stop_learning")
    assert window.said == "Nothing is being learnt"
    window.key("learn")
    wait_until(window, lambda: progress.text.text() == "Learning: steps 33%, 31 s left")
    window.key("accept")
    assert "Learning" in progress.text.text(), "whatever else is done"
    window.key("learn")
    assert "Still learning" in window.said
    window.key("stop_learning")
    wait_until(window, lambda: "Learning is stopped" in window.said)
    assert "done" in progress.text.text()
    window.key("learn")
    window.click(window.place(window.middle_of(TORSO)))
    began = time.monotonic()
    window.window.close()
    assert time.monotonic() - began < 60
    with Correction.open(window.folder, "mia") as correction:
        assert [correction.state(i) for i in IDS] == ["accepted", "touched", "auto"]


@pytest.mark.parametrize("window", [RESULT], indirect=True)
@pytest.mark.parametrize("by_key", [True, False])
def test_the_set_is_released_after_the_work_that_writes_to_it(window, monkeypatch, by_key):
    together = Journal.add_together

    def slow(journal, strokes) -> None:
        time.sleep(0.5)
        together(journal, strokes)

    monkeypatch.setattr(Journal, "add_together", slow)
    shown = window.window
    window.key("learn")
    while not shown.background.busy:
        QTest.qWait(5)
    if by_key:
        QTest.keyClick(shown, Qt.Key.Key_Q, CTRL | SHIFT)
    else:
        shown.close()
    assert shown.isVisible() and "Then the window closes" in window.said
    with pytest.raises(ClaimedError):
        Correction.open(window.folder, "ben")
    window.settle()
    assert not shown.isVisible()
    with Correction.open(window.folder, "ben") as correction:
        entries = [[entry.operation for entry in correction.journal.strokes(i)] for i in IDS]
        assert all("relabel" in operations for operations in entries), "the whole step"


def test_a_released_set_is_not_written_to(sets, tmp_path):
    folder = shutil.copytree(sets / "labels", tmp_path / "labels")
    for release in (Correction.close, Correction.abandon):
        correction = Correction.open(folder, "mia")
        editor = correction.edit(IDS[0])
        release(correction)
        with Correction.open(folder, "ben"):
            with pytest.raises(CloudError, match="closed"):
                editor.paint(editor.parts == TORSO, HIP)
            with pytest.raises(CloudError, match="closed"):
                correction.edit(IDS[1])
            correction.close()
        assert not (folder / "journal.jsonl").exists()
