"""The live window shows a running rig and warnings, and records with a key."""

import time
from dataclasses import replace
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest
from PySide6.QtCore import Qt, QTimer
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QLabel

from annotate.gui.live.live_pictures import TITLES, joints_px, pictures
from annotate.gui.live.live_tile import Tile
from annotate.gui.live.live_window import LiveWindow, takes
from annotate.gui.widgets.theme import DARK, LIGHT
from annotate.live.pipeline import LivePipeline
from annotate.live.warning import LiveWarning
from annotate.suit.palette import load_suit
from cli.live_view import labelling_by
from sensors.recording.playback import Playback
from sensors.session.reader import Session
from synth.rig.simulate import suit_path


@pytest.fixture(scope="module")
def window(display, rig_session):
    """A window that has shown a session to its end."""
    QApplication.instance() or QApplication([])
    rig = Playback(Session(rig_session))
    pipeline = LivePipeline(rig, labelling_by(load_suit(suit_path(rig_session))))
    shown = LiveWindow(pipeline, iter([Path("a.mcap")]), DARK, "anna")
    shown.show()
    rig.start()
    pipeline.start()
    end_s = time.monotonic() + 100
    while not pipeline.frames.ended and time.monotonic() < end_s:
        QTest.qWait(20)
    QTest.qWait(50)
    yield shown
    shown.close()
    shown.deleteLater()
    pipeline.close()
    rig.close()


def test_the_newest_frame_is_shown_with_its_joints_and_facing(window):
    frame = window._frame
    assert window.shown and frame.labels.frame_id == window.pipeline.frames.after(0, 0)[1].labels.frame_id
    assert frame.body_pose.posture in window.facts.text() and "person: anna" in window.facts.text()
    assert window.cloud_view.scene.labels is not None
    image = window.tiles["Parts"].grab().toImage()
    assert not image.isNull()


def test_parts_cover_the_person_and_joints_lie_on_them(window):
    shown = pictures(window._frame)
    assert tuple(shown) == TITLES
    parts = window._frame.labels.parts[::2, ::2]
    assert len(np.unique(shown["Parts"][parts > 0], axis=0)) == len(np.unique(parts[parts > 0]))
    u, v = joints_px(window._frame).round().astype(int).T
    assert (parts[v, u] > 0).mean() > 0.6


def test_a_complaint_is_a_banner_until_it_is_mended(window):
    window._show_banner((LiveWarning("dark", "it is <too> dark"),))
    assert window.banner.isVisible() and "&lt;too&gt;" in window.banner.text()
    window._show_banner(())
    assert not window.banner.isVisible()


def test_the_record_key_begins_and_ends_a_recording(window, monkeypatch):
    told, rig = [], window.pipeline.rig
    health = rig.health()
    monkeypatch.setattr(rig, "record", lambda path, subject: told.append((path, subject)))
    monkeypatch.setattr(rig, "end_recording", lambda: told.append("end"))
    window.update_view()
    assert window.buttons["record"].text() == "Record   Space"
    window.actions_by_name["record"].trigger()
    monkeypatch.setattr(rig, "health", lambda: replace(health, recording=Path("a.mcap"), recorded_s=61.0))
    window.update_view()
    assert "a.mcap" in window.state.text() and "1:01" in window.state.text()
    assert window.buttons["record"].text() == "End recording   Space"
    window.actions_by_name["record"].trigger()
    assert told == [(Path("a.mcap"), "anna"), "end"]


def test_the_end_of_a_playback_is_said(window):
    window.update_view()
    assert window.state.text() == "The recording is played to its end"
    assert "a second" not in window.facts.text() and "frames shown" in window.facts.text()


def pressed(window, key: Qt.Key, act) -> None:
    """Press a key that opens a dialogue, and do something to that."""

    def come() -> None:
        if dialog := QApplication.activeModalWidget():
            act(dialog)
            dialog.close()

    window.activateWindow()
    assert QTest.qWaitForWindowActive(window)
    QTimer.singleShot(500, come)
    QTest.keyClick(window, key)
    QApplication.processEvents()


def test_a_key_shows_all_keys(window):
    shown = []

    def read(dialog) -> None:
        shown.extend(label.text() for label in dialog.findChildren(QLabel))
        QTest.keyClick(dialog, Qt.Key.Key_Escape)

    pressed(window, Qt.Key.Key_F1, read)
    assert {"Space", "M", "Ctrl+Q", "F1"} <= set(shown)


def test_a_marked_event_is_confirmed(window, monkeypatch):
    marked, rig = [], window.pipeline.rig
    monkeypatch.setattr(rig, "mark", marked.append)

    def write(dialog) -> None:
        QTest.keyClicks(dialog.focusWidget(), "turned over")
        QTest.keyClick(dialog.focusWidget(), Qt.Key.Key_Return)

    health = rig.health()
    monkeypatch.setattr(rig, "health", lambda: replace(health, recording=Path("a.mcap"), recorded_s=1.0))
    pressed(window, Qt.Key.Key_M, write)
    window.update_view()
    assert marked == ["turned over"] and "Marked: turned over" in window.facts.text()
    assert "nothing is recorded" not in window.facts.text()


@pytest.mark.parametrize("theme", [LIGHT, DARK])
def test_titles_are_visible_in_both_themes(display, theme):
    QApplication.instance() or QApplication([])
    tile = Tile("Depth", theme)
    tile.resize(200, 150)
    image = tile.grab().toImage()
    values = [image.pixelColor(x, y).value() for x in range(4, 40) for y in range(2, 18)]
    assert min(values) < 130 and max(values) > 200


def test_takes_are_numbered_and_overwrite_nothing(tmp_path, monkeypatch):
    first = tmp_path / "a.mcap"
    names = takes(first)
    assert next(names) == first
    (tmp_path / "a-2.mcap").touch()
    assert next(names) == tmp_path / "a-3.mcap"
    monkeypatch.chdir(tmp_path)
    times = [datetime(2026, 5, 4, 9, minute, 1) for minute in (6, 7, 7, 8)]
    names = takes(None, lambda: times.pop(0))
    for wanted in ("090601", "090701", "090701-2", "090801"):
        path = next(names)
        assert path.name == f"take-20260504-{wanted}.mcap"
        path.touch()
        if wanted == "090701":
            times.insert(0, times[0])


def test_without_a_screen_one_line_says_so(annotate_cloud, rig_session, monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    done = annotate_cloud("live", rig_session)
    assert done.code == 1 and "no screen" in done.err and "Traceback" not in done.err
