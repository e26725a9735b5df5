"""Faults around the window: nothing is lost, and one line or dialog names the remedy."""

import builtins
import errno
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from PySide6.QtGui import QSurface
from PySide6.QtTest import QTest
from shiboken6 import Shiboken

from annotate.correction.correction import Correction
from annotate.gui.app import recording_of
from annotate.gui.background import Background, Task
from annotate.gui.display import check_opengl, check_screen
from annotate.labelset.journal import Journal
from annotate.labelset.label_set import LabelSet
from annotate.parts import PART_ID
from sensors.errors import CloudError
from tests.conftest import assert_refused, tree
from tests.helpers.gui_driver import Driver, answering

HEAD, TORSO = PART_ID["head"], PART_ID["torso"]


@pytest.fixture
def folder(rig_labels, tmp_path):
    shutil.copytree(rig_labels.path, tmp_path / "labels")
    return tmp_path / "labels"


def paint(driver: Driver) -> int:
    """Give the middle of the torso to the head; returns the pixel."""
    driver.key("head")
    pixel = driver.middle_of(TORSO)
    driver.click(driver.place(pixel))
    assert driver.parts.flat[pixel] == HEAD
    return pixel


# Before there is a window


def test_a_wrong_folder_and_a_missing_screen_are_one_line(annotate_cloud, folder, monkeypatch):
    assert_refused(annotate_cloud("fix", folder / "frames"), "not a label set", "labelset.json")
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    before = tree(folder)
    monkeypatch.setenv("DISPLAY", ":9876")
    assert_refused(annotate_cloud("fix", folder), ":9876", "cannot be reached")
    monkeypatch.delenv("DISPLAY")
    assert_refused(annotate_cloud("fix", folder), "no screen", "xvfb-run")
    assert tree(folder) == before


def test_without_the_extra_it_says_what_to_install(annotate_cloud, folder, monkeypatch):
    real = builtins.__import__

    def without_qt(name, *rest):
        if name.startswith("annotate.gui"):
            raise ImportError("No module named 'PySide6'")
        return real(name, *rest)

    monkeypatch.setattr(builtins, "__import__", without_qt)
    assert_refused(annotate_cloud("fix", folder), "PySide6", "annotate-cloud[gui]")


def test_old_graphics_are_named_with_the_remedy(display):
    for version, found in (("2.1", "OpenGL 2.1"), ("0.0", "no OpenGL")):
        with pytest.raises(CloudError, match=f"{found}.*LIBGL_ALWAYS_SOFTWARE"):
            check_opengl(version)
    check_opengl("3.2")
    check_opengl("4.6")
    check_screen()


def test_a_second_window_is_refused_with_its_owners_name(annotate_cloud, folder):
    with Correction.open(folder, "mia"):
        assert_refused(annotate_cloud("fix", folder, "--who", "ben"), "mia@")


def test_a_set_without_frames_is_refused(annotate_cloud, rig_labels, tmp_path, display):
    LabelSet.create(tmp_path / "empty", rig_labels.intrinsics, {})
    assert_refused(annotate_cloud("fix", tmp_path / "empty"), "no frames")
    assert not (tmp_path / "empty" / "claim.json").exists()


def catches(pid: int, number: int) -> bool:
    """Return whether a process has its own handler of a signal (proc(5), SigCgt)."""
    status = Path(f"/proc/{pid}/status").read_text()
    caught = int(re.search(r"SigCgt:\s+(\w+)", status)[1], 16)
    return bool(caught >> (number - 1) & 1)


def test_the_command_opens_the_window_and_ends_politely(display, folder):
    """In a process of its own, ended by a signal as a desktop ends it, as soon as it listens to one."""
    command = [sys.executable, "-m", "cli.main", "fix", str(folder), "--who", "mia"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        while process.poll() is None and not catches(process.pid, signal.SIGTERM):
            QTest.qWait(50)
        process.terminate()
        out, _ = process.communicate(timeout=120)
    assert process.returncode == 0 and "3 automatic" in out
    assert not (folder / "claim.json").exists()


# While it is open


def test_the_result_of_work_is_an_event_of_its_own(qapp):
    background, came = Background(), []
    background.run(Task("Working", lambda: 1, came.append), came.append, lambda: None)
    time.sleep(0.05)
    assert background.busy == "Working" and came == []
    while background.busy:
        QTest.qWait(5)
    assert came == [1]
    background.close()


def test_qts_binding_keeps_its_references(qapp, folder):
    """PySide6 6.12.0 gives one reference to None away at every call: Python 3.11 ends when none is left."""
    driver = Driver(folder)
    driver.settle()
    before = sys.getrefcount(None)
    for _ in range(20):
        driver.panels.palette_.repaint()
    assert sys.getrefcount(None) > before - 20
    driver.close()


def test_a_closed_window_leaves_no_surface_behind(qapp, folder):
    """Qt's binding would take another object at the same address for the surface of a closed window."""

    def surfaces() -> set[int]:
        return {id(one) for one in Shiboken.getAllValidWrappers() if type(one) is QSurface}

    before = surfaces()
    driver = Driver(folder)
    assert surfaces() - before, "of the cloud"
    driver.close()
    assert not surfaces() - before


def test_read_only_changes_nothing(qapp, folder):
    before = tree(folder)
    driver = Driver(folder, read_only=True)
    driver.key("head")
    pixel = driver.middle_of(TORSO)
    driver.click(driver.place(pixel))
    assert driver.parts.flat[pixel] == TORSO and "read-only" in driver.said
    assert "accept" not in driver.panels.status.space.text()
    assert not driver.panels.tools.buttons["swap"].isEnabled()
    driver.key("accept")
    driver.key("next")
    driver.key("colouring")
    driver.close()
    assert tree(folder) == before


@pytest.mark.parametrize(("answer", "restored"), [("Restore", True), ("Leave", False)])
def test_a_broken_frame_is_restored_if_one_wants(qapp, folder, answer, restored):
    driver = Driver(folder)
    pixel, frame_id = paint(driver), driver.window.frame_id
    painted = driver.parts.copy()
    driver.close()
    (folder / "frames" / f"{frame_id}.parts.png").write_bytes(b"\x89PNG broken")
    said = answering(answer)
    again = Driver(folder)
    assert any(frame_id in text for text in said())
    if restored:
        assert again.window.frame_id == frame_id and (again.parts == painted).all()
        assert LabelSet.open(folder).read(frame_id).parts.flat[pixel] == HEAD
    else:
        assert again.window.frame_id != frame_id
        assert (folder / "frames" / f"{frame_id}.parts.png").read_bytes() == b"\x89PNG broken"
    again.close()


def test_a_full_disk_loses_nothing(qapp, folder, monkeypatch):
    driver = Driver(folder)

    def full(journal, lines: bytes) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(folder / "journal.jsonl"))

    append = Journal._append
    monkeypatch.setattr(Journal, "_append", full)
    said = answering("Go on")
    pixel = paint(driver)
    assert any("No space left" in text for text in said())
    assert driver.correction.unsaved == 1 and "not saved" in driver.panels.status.saved.text()
    driver.key("undo")
    assert driver.parts.flat[pixel] == TORSO and driver.correction.unsaved == 2
    stays = answering("Stay")
    driver.window.close()
    assert any("could not be written" in text for text in stays()) and driver.window.isVisible()
    monkeypatch.setattr(Journal, "_append", append)
    driver.key("redo")
    assert driver.correction.unsaved == 0 and "saved" in driver.panels.status.saved.text()
    painted, frame_id = driver.parts.copy(), driver.window.frame_id
    driver.close()
    assert (LabelSet.open(folder).read(frame_id).parts == painted).all()


def test_a_fine_screen_selects_what_is_under_the_pointer(display, folder, tmp_path):
    """Twice the pixels (QT_SCALE_FACTOR), in a process of its own."""
    script = (
        "import sys; from pathlib import Path; from PySide6.QtWidgets import QApplication\n"
        "app = QApplication([]); from tests.helpers.gui_driver import Driver\n"
        "d = Driver(Path(sys.argv[1]), size=(760, 580)); assert d.window.devicePixelRatioF() == 2\n"
        "d.key('head'); p = d.middle_of(2); d.click(d.place(p)); shot = d.picture()\n"
        "place = d.place(p); c = shot[place.y() * 2, place.x() * 2].astype(int)\n"
        "print(d.parts.flat[p], shot.shape[1] / d.window.views.cloud.plotter.width(), c[0] > 2 * c[2])\n"
        "d.close()"
    )
    environment = {**os.environ, "QT_SCALE_FACTOR": "2"}
    command = [sys.executable, "-c", script, str(folder)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120, check=False)
    assert done.stdout.split() == ["1", "2.0", "True"], done.stderr


def test_a_frame_without_a_person_can_be_opened(qapp, rig_labels, tmp_path):
    frame = rig_labels.read(rig_labels.frame_ids[0])
    labels = LabelSet.create(tmp_path / "bare", rig_labels.intrinsics, {})
    labels.write(type(frame)("000000", frame.depth_mm, np.zeros_like(frame.parts)))
    driver = Driver(labels.path)
    driver.key("lasso")
    driver.drag(driver.circle(driver.place(100 * 512 + 200), 30))
    assert "Shift" in driver.said
    driver.close()


# The recording


def test_without_a_recording_the_first_sentence_names_the_option(qapp, folder, rig_session):
    for session in (None, rig_session):
        driver = Driver(folder, session)
        assert ("--session RECORDING" in driver.said) == (session is None)
        driver.close()


def test_a_recording_that_was_given_is_remembered_for_its_label_set(
    folder, rig_session, rig_labels, tmp_path, monkeypatch
):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    (tmp_path / "elsewhere").mkdir()
    here = shutil.copy(rig_session, tmp_path / "elsewhere" / "take.mcap")
    assert recording_of(folder, None) is None
    assert recording_of(folder, here) == here
    assert recording_of(folder, None) == here
    other = LabelSet.create(tmp_path / "other", rig_labels.intrinsics, {})
    assert recording_of(other.path, None) is None
    here.write_bytes(b"no session any more")
    assert recording_of(folder, None) is None
    here.unlink()
    assert recording_of(folder, None) is None
    with pytest.raises(CloudError):
        recording_of(folder, here)
