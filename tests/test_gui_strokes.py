"""Strokes: a begun shape is safe, and the window describes the next click."""

from dataclasses import replace

import numpy as np
import pytest
from PySide6.QtCore import QEvent, QPoint, Qt
from PySide6.QtGui import QKeyEvent
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication

from annotate.gui.held_keys import PEEK_MS
from annotate.gui.state.keys import Settings
from annotate.gui.widgets.overlay import outline
from annotate.gui.widgets.theme import DARK
from annotate.labelset.label_set import LabelSet
from annotate.parts import PART_ID
from tests.helpers.figure_sets import figure_set
from tests.helpers.gui_driver import CTRL, SHIFT, Driver

HEAD, TORSO = PART_ID["head"], PART_ID["torso"]
CORNERS = [QPoint(*by) for by in ((-20, -20), (20, -20), (20, 20), (-20, 20))]


@pytest.fixture(scope="module")
def one_window(qapp, tmp_path_factory):
    driver = Driver(figure_set(tmp_path_factory.mktemp("strokes") / "labels", [0.9] * 3).path)
    yield driver
    driver.close()


@pytest.fixture
def hand(one_window):
    one_window.start_again()
    return one_window


def corners(hand: Driver, count: int) -> None:
    """Begin a polygon about the torso with so many corners."""
    hand.key("polygon")
    middle = hand.place(hand.middle_of(TORSO))
    for by in CORNERS[:count]:
        hand.click(middle + by)


def drawing(hand: Driver):
    return hand.views.cloud.layer.drawing


# A begun polygon


def test_no_verdict_is_given_over_a_begun_polygon(hand):
    corners(hand, 3)
    frame_id = hand.window.frame_id
    for name in ("accept", "reject", "next", "copy_previous", "order"):
        hand.key(name)
        assert "polygon" in hand.said and "Esc" in hand.said, name
    hand.panels.strip.opened.emit(hand.window.frames.all_ids[1])
    hand.settle()
    assert hand.window.frame_id == frame_id and len(drawing(hand).points_px) == 3
    assert hand.correction.state(frame_id) != "accepted"
    hand.key("cancel")
    assert drawing(hand) is None
    hand.key("accept")
    assert hand.correction.state(frame_id) == "accepted"


def test_nor_over_a_stroke_whose_button_is_down(hand):
    hand.key("lasso")
    release = hand.press_and_draw(hand.circle(hand.place(hand.middle_of(TORSO)), 20))
    hand.key("accept")
    assert "lasso" in hand.said and hand.correction.state(hand.window.frame_id) != "accepted"
    release()
    hand.settle()
    assert hand.strokes()


@pytest.mark.parametrize("press", ["Ctrl+Z", "Backspace"])
def test_undo_takes_a_polygons_last_corner_and_no_stroke(hand, press):
    hand.click(hand.place(hand.middle_of(TORSO)))
    before, entries = hand.parts.copy(), len(hand.strokes())
    corners(hand, 3)
    for left in (2, 1):
        hand.press(press)
        assert len(drawing(hand).points_px) == left
    hand.press(press)
    assert drawing(hand) is None and len(hand.strokes()) == entries
    np.testing.assert_array_equal(hand.parts, before)
    hand.press("Ctrl+Z")
    assert len(hand.strokes()) == entries + 1


def test_return_closes_a_polygon_of_three_corners_even_where_it_accepts(qapp, tmp_path):
    """As in the documentation's example, accept = "Return"."""
    keys = tuple(replace(c, key="Return") if c.name == "accept" else c for c in Settings().commands)
    driver = Driver(figure_set(tmp_path / "labels", [0.9] * 2).path, settings=Settings("dark", keys))
    corners(driver, 2)
    driver.press("Return")
    assert "three corners" in driver.said and drawing(driver)
    driver.click(driver.place(driver.middle_of(TORSO)) + CORNERS[2])
    frame_id = driver.window.frame_id
    for state in ("touched", "accepted"):
        driver.press("Return")
        assert driver.correction.state(frame_id) == state
    driver.close()


def test_a_rubber_band_follows_the_pointer_from_the_last_corner(hand):
    """White on the line between the corner and the pointer, where nothing else is drawn."""
    corners(hand, 1)
    pointing, corner = hand.views.cloud.layer, hand.place(hand.middle_of(TORSO)) + CORNERS[0]
    for by in (QPoint(60, 0), QPoint(0, 60)):
        hand.hover(corner + by)
        image = pointing.grab().toImage()
        assert image.pixelColor(corner + by / 2).value() > 200


# What the next click does


def said(hand: Driver) -> str:
    return hand.panels.status.next.text()


def test_the_line_follows_shift_and_ctrl(hand):
    hand.key("lasso")
    hand.hover(hand.place(hand.middle_of(TORSO)))
    plain = said(hand)
    assert "becomes head" in plain and "visible surface only" in plain
    for key, words in (
        (Qt.Key.Key_Control, "through the body"),
        (Qt.Key.Key_Shift, "only the part I start on"),
    ):
        QTest.keyPress(hand.window, key)
        hand.settle()
        assert words in said(hand)
        QTest.keyRelease(hand.window, key)
        hand.settle()
        assert said(hand) == plain
    # A key that went down while another window had the focus shows in the pointer's own events.
    hand.drag([hand.place(hand.middle_of(TORSO))] * 2, CTRL | SHIFT)
    assert "start on, through" in said(hand)


def test_in_the_depth_image_nothing_is_said_of_a_surface(hand):
    hand.key("lasso")
    pane, pixel = hand.views.depth, hand.middle_of(TORSO)
    for view, words in ((pane, False), (hand.views.cloud, True)):
        hand.hover(hand.place(pixel, view), view=view)
        assert ("visible surface only" in said(hand)) == words


def test_outline_and_corner_are_of_the_labels_as_they_stand(hand):
    """After three clicks and two undos without a move of the mouse."""
    pixel = hand.middle_of(TORSO)
    hand.click(hand.place(pixel))
    hand.click(hand.place(pixel))
    hand.key("undo")
    hand.key("undo")
    view = hand.views.cloud
    size = view.layer.width(), view.layer.height()
    color = hand.window.options.color
    rgb = color.red(), color.green(), color.blue()
    wanted = outline(*view.places(hand.edits.would_take(pixel)), size, rgb)
    assert view.layer._outline.image == wanted.image and view.layer._outline.corner == wanted.corner
    assert view.layer._words.startswith("torso")
    arm = hand.middle_of(PART_ID["left_upper_arm"])
    hand.hover(hand.place(arm))
    hand.key("swap")
    assert view.layer._words.startswith("right upper arm")
    hand.key("lasso")
    assert view.layer._outline is None


def test_a_click_with_ctrl_and_the_right_button_chooses_the_part(hand):
    for view in hand.window.views:
        hand.key("head")
        place = hand.on_window(hand.place(hand.middle_of(TORSO), view), view)
        hand.hover(hand.place(hand.middle_of(TORSO), view), view)
        before = hand.views.cloud.orbit
        QTest.mouseClick(hand.window.windowHandle(), Qt.MouseButton.RightButton, CTRL, place)
        hand.settle()
        assert hand.edits.part == TORSO
        hand.hover(hand.place(hand.middle_of(TORSO), view) + QPoint(20, 0), view)
        assert hand.views.cloud.orbit == before, "nothing is gripped"


# Seeing


@pytest.mark.parametrize("within_a_millisecond", [True, False])
def test_peeking_lasts_while_a_server_repeats_the_key(hand, within_a_millisecond):
    """X11 repeats a held key as releases and presses, each pair within a millisecond or apart."""
    hand.look("depth", view=hand.views.depth)
    handle, due = hand.window.windowHandle(), hand.window.held.peek_due

    def send(kind: QEvent.Type, at_ms: int) -> None:
        event = QKeyEvent(kind, Qt.Key.Key_H, Qt.KeyboardModifier.NoModifier, "h")
        event.setTimestamp(at_ms)
        QApplication.sendEvent(handle, event)

    send(QEvent.Type.KeyPress, 10)
    for at_ms in (700, 740):
        due.setInterval(PEEK_MS if within_a_millisecond else 60_000)
        send(QEvent.Type.KeyRelease, at_ms)
        if not within_a_millisecond:
            QTest.qWait(10)
        send(QEvent.Type.KeyPress, at_ms if within_a_millisecond else at_ms + 10)
        QTest.qWait(2 * PEEK_MS)
        assert hand.views.peeking and hand.window.views.look(hand.views.depth).outlines is False
    due.setInterval(PEEK_MS)
    send(QEvent.Type.KeyRelease, 800)
    while hand.views.peeking:
        QTest.qWait(5)
    assert hand.views.look(hand.views.depth).outlines


def test_long_sentences_end_in_an_ellipsis_and_the_tool_tip_has_them_whole(hand):
    window = hand.window
    window.edits.locks.update(range(1, 12))
    hand.click(hand.place(hand.middle_of(TORSO)))
    line = window.panels.status.last
    assert line.fontMetrics().horizontalAdvance(line.text()) > line.width(), "too long for this window"
    assert line.shown.endswith("…") and line.toolTip() == f"<span>{line.text()}</span>"
    assert line.text().startswith(line.shown[:-1]) and len(line.shown) > 10
    for button in (window.panels.progress.order, window.panels.progress.filter):
        assert button.sizeHint().width() <= button.width() + 4, button.text()


def test_what_has_no_effect_here_says_so_and_changes_nothing(hand):
    """Outlines and opacity, over a view that shows the parts themselves."""
    pane = hand.views.cloud
    hand.look("part")
    hand.hover(hand.place(hand.middle_of(TORSO)))
    look, buttons = pane.look, hand.panels.panes.bars[pane].buttons
    for name, button in buttons.items():
        assert not button.isEnabled() and not button.isChecked()
        QTest.mouseClick(button, Qt.MouseButton.LeftButton)
        hand.key(name)
        assert pane.look == look and "F2" in hand.said
    hand.look("depth")
    hand.key("tint")
    assert pane.look.tint != look.tint


def test_without_another_set_the_option_is_named(hand):
    hand.look("disagreement")
    assert hand.views.cloud.layer.scale is None
    hand.key("from_other")
    assert "--compare" in hand.said


def test_another_set_that_does_not_fit_is_named_with_the_reason(qapp, tmp_path):
    labels = figure_set(tmp_path / "labels", [0.9] * 2)
    other = figure_set(tmp_path / "other", [0.9] * 2, step_m=0.05)
    driver = Driver(labels.path, other=LabelSet.open(other.path))
    driver.key("next")
    driver.key("from_other")
    assert "shows another depth image" in driver.said and "--compare" not in driver.said
    driver.close()


def test_missing_depth_is_dark_in_the_light_theme_too(hand):
    pane = hand.views.depth
    labels = hand.edits.frame.scene.labels
    hole = np.flatnonzero(labels.depth_mm.ravel() == 0)
    if not len(hole):
        hole = np.array([0])
        labels.depth_mm.flat[0] = 0
    hand.key("theme")
    hand.look("depth", view=pane)
    light = tuple(pane._rgb.reshape(-1, 3)[hole[0]])
    hand.key("theme")
    assert light == DARK.ground_rgb


def test_a_small_scaled_screen_shows_both_views_and_all_counts(hand):
    """1280 x 720 at 150 %: 853 x 480 logical pixels, less a title bar."""
    window = hand.window
    window.resize(853, 455)
    hand.settle()
    assert (window.width(), window.height()) == (853, 455)
    assert all(min(view.width(), view.height()) > 90 for view in window.views)
    tile, pictures = hand.panels.palette_.tiles[PART_ID["left_upper_leg"]], []
    assert tile.height() < 50
    for tile.count in (0, 1234):
        pictures.append(tile.grab().toImage())
    assert pictures[0] != pictures[1]
    window.resize(1000, 760)
    hand.settle()


def test_a_window_as_large_as_the_screen_makes_room_for_its_frame(qapp, tmp_path, monkeypatch):
    """A title bar of 24 pixels, which only a window manager draws."""
    driver = Driver(figure_set(tmp_path / "labels", [0.9]).path, size=None)
    window, there = driver.window, driver.window.screen().availableGeometry()
    framed = [-1, -24, 1, 1]
    monkeypatch.setattr(window, "frameGeometry", lambda: window.geometry().adjusted(*framed))
    window.hide()
    window.resize(there.size())
    window.show()
    for _ in range(100):
        if window.height() == there.height() - 25:
            break
        QTest.qWait(50)
    assert (window.width(), window.height()) == (there.width() - 2, there.height() - 25)
    driver.close()
