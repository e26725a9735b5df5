"""Learning from the window: another process learns, the labels come in one step, and go in one."""

import shutil
import sys
import threading
import time

import numpy as np
import pytest
from PySide6.QtCore import Qt
from PySide6.QtTest import QTest

from annotate.correction.correction import Correction
from annotate.frame_labels import FrameLabels
from annotate.gui.commands import bind
from annotate.gui.learning import LearnCommand
from annotate.labelset.claim import ClaimedError
from annotate.labelset.journal import Journal
from annotate.labelset.label_set import LabelSet
from annotate.parts import PART_ID
from bench.window import figure
from sensors.errors import CloudError
from sensors.rig.camera import Intrinsics
from tests.helpers import gui_driver
from tests.helpers.gui_driver import CTRL, SHIFT

TORSO, HIP = PART_ID["torso"], PART_ID["hip"]
SHAPE, IDS = (212, 256), ("000000", "000001", "000002")
SAYS = "print('learn, images: 1/2', file=sys.stderr, flush=True);"
RESULT = 'print(\'{"before": 0.9, "after": 0.97, "labels": "learnt"}\')'


@pytest.fixture(scope="module")
def sets(tmp_path_factory):
    """A figure in three frames, and what was learnt: its torso is the hip."""
    path = tmp_path_factory.mktemp("sets")
    camera = Intrinsics(SHAPE[1], SHAPE[0], 183.0, 183.0, 128.0, 106.0)
    for name in ("labels", "learnt"):
        labels = LabelSet.create(path / name, camera, {})
        for i, frame_id in enumerate(IDS):
            depth, parts = figure(*SHAPE, 0.01 * i)
            sure = np.full(SHAPE, 0.5, np.float32)
            if name == "learnt":
                parts[parts == TORSO] = HIP
            labels.write(FrameLabels(frame_id, depth, parts, sure, notes={"confidence": 0.5}))
    return path


@pytest.fixture
def window(qapp, sets, tmp_path, monkeypatch, request):
    """A window on a copy of the set whose learning is a small program; its labels are there already."""
    folder = shutil.copytree(sets / "labels", tmp_path / "labels")
    program = f"import sys, time; {SAYS} {request.param}"
    lesson = LearnCommand((sys.executable, "-c", program), sets / "learnt")
    monkeypatch.setattr(gui_driver, "bind", lambda shown: bind(shown, lesson))
    driver = gui_driver.Driver(folder)
    driver.folder = folder
    yield driver
    driver.close()


def wait_until(driver, condition) -> None:
    """Let the window live until something is so, a minute at most."""
    end = time.monotonic() + 60
    while not condition():
        assert time.monotonic() < end, driver.said
        driver.settle()
        time.sleep(0.01)


@pytest.mark.parametrize("window", [RESULT], indirect=True)
def test_what_is_learnt_comes_in_one_step_and_is_taken_back_in_one(window, sets):
    window.key("accept")
    here = window.window.frame_id
    assert here == IDS[1]
    before = window.parts.copy()
    window.key("learn")
    wait_until(window, lambda: "labelled again" in window.said)
    assert "90.0% before, 97.0% now" in window.said
    assert window.window.frame_id == here and (window.parts[before == TORSO] == HIP).all()
    np.testing.assert_array_equal(window.edits.frame.scene.other, before)
    assert [window.correction.state(i) for i in IDS] == ["accepted", "auto", "auto"]
    window.window.open_frame(IDS[2])
    window.settle()
    window.key("undo")
    assert (window.parts == HIP).any() and not (window.parts == TORSO).any(), "undo is of strokes"
    window.key("unlearn")
    wait_until(window, lambda: "aken back" in window.said)
    for first in LabelSet.open(sets / "labels"):
        np.testing.assert_array_equal(window.correction.frame(first.frame_id).parts, first.parts)
    assert (window.parts == TORSO).any()
    window.key("unlearn")
    wait_until(window, lambda: "no learning to take back" in window.said)


@pytest.mark.parametrize("window", ["sys.exit('annotate-cloud: accept at least 3')"], indirect=True)
def test_why_nothing_was_learnt_is_said(window):
    before = window.parts.copy()
    window.key("learn")
    wait_until(window, lambda: "Nothing learnt: accept at least 3" in window.said)
    np.testing.assert_array_equal(window.parts, before)


@pytest.mark.parametrize("window", ["time.sleep(600)"], indirect=True)
def test_work_goes_on_beside_learning_and_closing_ends_it(window):
    window.key("learn")
    wait_until(window, lambda: "in the background" in window.said)
    window.key("accept")
    window.click(window.place(window.middle_of(TORSO)))
    assert window.window.frame_id == IDS[1]
    assert len(window.correction.journal.strokes(IDS[1])) == 1
    window.key("learn")
    assert "Still learning" in window.said
    began = time.monotonic()
    window.window.close()
    assert time.monotonic() - began < 60
    with Correction.open(window.folder, "mia") as correction:
        assert [correction.state(i) for i in IDS] == ["accepted", "touched", "auto"]


PROGRESS = "print('learn, steps: 25/75, 1.6/s, 31 s left', file=sys.stderr, flush=True); "
STAYS = 'print(\'{"before": 0.971, "after": 0.97, "labels": null}\')'


@pytest.mark.parametrize("window", [f"{PROGRESS} time.sleep(600)"], indirect=True)
def test_progress_is_shown_and_learning_can_be_stopped_and_begun_again(window):
    before = window.parts.copy()
    panel = window.panels.progress
    window.key("stop_learning")
    assert window.said == "Nothing is being learnt"
    for _ in range(2):
        window.key("learn")
        wait_until(window, lambda: panel.text.text() == "Learning: steps 33%, 31 s left")
        window.key("accept")
        assert "Learning" in panel.text.text(), "whatever else is done"
        window.key("stop_learning")
        wait_until(window, lambda: window.said == "Learning is stopped; labels are unchanged")
        assert "done" in panel.text.text()
        window.key("undo")
    np.testing.assert_array_equal(window.parts, before)


@pytest.mark.parametrize(
    "window",
    [f"{PROGRESS} import os; os.kill(os.getpid(), 9)", f"{PROGRESS} raise SystemExit(7)"],
    indirect=True,
)
def test_a_learning_that_is_killed_gives_no_progress_as_its_reason(window):
    before = window.parts.copy()
    window.key("learn")
    wait_until(window, lambda: window.said == "Learning stopped before it finished; labels are unchanged")
    np.testing.assert_array_equal(window.parts, before)


@pytest.mark.parametrize("window", [STAYS], indirect=True)
def test_where_nothing_is_gained_both_figures_are_said(window):
    before = window.parts.copy()
    window.key("learn")
    said = "No improvement (97.1% before, 97.0% now), so labels stay. Correct more frames"
    wait_until(window, lambda: window.said == said)
    np.testing.assert_array_equal(window.parts, before)


# Closing while something is under way


@pytest.fixture
def slowly(monkeypatch):
    """A journal that takes its time with a step of learning."""
    together = Journal.add_together

    def slow(journal, strokes) -> None:
        time.sleep(0.5)
        together(journal, strokes)

    monkeypatch.setattr(Journal, "add_together", slow)


@pytest.mark.parametrize("window", [RESULT], indirect=True)
@pytest.mark.parametrize("by_key", [True, False])
def test_the_set_is_released_after_the_work_that_writes_to_it(window, slowly, by_key):
    shown = window.window
    window.key("learn")
    wait_until_busy(shown)
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


def wait_until_busy(shown) -> None:
    while not shown.background.busy:
        QTest.qWait(5)


@pytest.mark.parametrize("window", [RESULT], indirect=True)
def test_the_windows_thread_alone_closes_editors(window, monkeypatch):
    threads, leave = [], Correction.leave

    def noted(correction, frame_id) -> None:
        threads.append(threading.current_thread())
        leave(correction, frame_id)

    monkeypatch.setattr(Correction, "leave", noted)
    window.key("learn")
    wait_until(window, lambda: "labelled again" in window.said)
    assert threads and set(threads) == {threading.main_thread()}


def test_a_set_that_is_released_is_not_written_to(sets, tmp_path):
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
