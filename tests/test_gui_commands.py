"""Commands as people give them: each in reach, verdicts safe, one click or key does what it says."""

import shutil
from dataclasses import replace

import numpy as np
import pytest
from PySide6.QtCore import QPoint, QRect, Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QAbstractButton, QLineEdit, QMenu

from annotate.correction.correction import Correction
from annotate.correction.review_queue import review_queue
from annotate.gui.state.keys import Settings, load_settings
from annotate.gui.views.drawing_layer import StrokeOptions
from annotate.labelset.label_set import LabelSet
from annotate.parts import PART_ID
from tests.helpers.figure_sets import figure_set, judge
from tests.helpers.gui_driver import Driver

HEAD, TORSO, RIGHT_ARM, LEFT_ARM = (
    PART_ID[name] for name in ("head", "torso", "right_upper_arm", "left_upper_arm")
)
CONFIDENCES = (0.9, 0.8, 0.5, 0.7, 0.6)


@pytest.fixture(scope="module")
def figures(tmp_path_factory):
    """Five frames of a figure that moves to its left, and another set that takes its torso for the hip."""
    path = tmp_path_factory.mktemp("figures")
    labels = figure_set(path / "labels", CONFIDENCES)
    figure_set(path / "other", CONFIDENCES, instead={TORSO: PART_ID["hip"]})
    first = labels.read("000000")
    sure = np.where(first.parts == LEFT_ARM, np.float32(0.3), np.float32(1))
    labels.write(replace(first, confidence=sure))
    return path


@pytest.fixture(scope="module")
def one_window(qapp, figures):
    driver = Driver(figures / "labels", other=LabelSet.open(figures / "other"))
    yield driver
    driver.close()


@pytest.fixture
def hand(one_window):
    """The window as it was when it opened, apart from the journal."""
    one_window.start_again()
    return one_window


def states(driver: Driver) -> list[str]:
    return [driver.correction.state(frame_id) for frame_id in driver.window.frames.all_ids]


# Verdicts


def test_a_held_key_accepts_one_frame(hand):
    hand.hold(0x20, 1.2)
    assert states(hand) == ["accepted", "auto", "auto", "auto", "auto"]


def test_no_command_works_behind_the_page_of_keys(hand):
    hand.key("help")
    hand.key("accept")
    hand.key("torso")
    assert states(hand) == ["auto"] * 5 and hand.edits.part == HEAD
    QTest.mouseClick(hand.panels.key_page, Qt.MouseButton.LeftButton, pos=QPoint(3, 3))
    hand.key("torso")
    assert not hand.panels.key_page.isVisible() and hand.edits.part == TORSO


def test_a_verdict_is_taken_back_and_given_again(hand):
    first, second = hand.window.frames.all_ids[:2]
    hand.key("accept")
    hand.key("accept")
    for left, state in ((second, "auto"), (first, "auto")):
        hand.key("undo")
        assert hand.window.frame_id == left and hand.correction.state(left) == state
    hand.key("redo")
    assert hand.correction.state(first) == "accepted" and "Accepted again" in hand.said
    hand.window.open_frame(second)
    hand.click(hand.place(hand.middle_of(TORSO)))
    hand.key("undo")
    assert hand.window.frame_id == second, "strokes on the frame itself come first"


def test_space_goes_to_the_next_unfinished_frame_and_wraps(hand):
    ids = hand.window.frames.all_ids
    hand.window.open_frame(ids[3])
    seen = []
    for _ in range(5):
        hand.settle()
        seen.append(hand.window.frame_id)
        hand.key("accept")
    assert seen == [ids[i] for i in (3, 4, 0, 1, 2)] and states(hand) == ["accepted"] * 5
    assert "No unfinished frames left" in hand.said and "5 of 5 done" in hand.panels.progress.text.text()


def test_the_order_by_doubt_opens_the_worst_and_leaves_none(hand):
    ids, seen = hand.window.frames.all_ids, []
    hand.key("order")
    for _ in range(5):
        seen.append(ids.index(hand.window.frame_id))
        hand.key("accept")
    assert seen == np.argsort(CONFIDENCES).tolist() and states(hand) == ["accepted"] * 5


def test_reviewers_get_the_frames_of_others_and_the_reasons(figures, tmp_path):
    folder = shutil.copytree(figures / "other", tmp_path / "labels")
    judge(folder, "mia", f0="accept", f1="accept", f2="accept", f4="blurred")
    with Correction.open(folder, "mia", read_only=True) as correction:
        assert review_queue(correction) == []
    with Correction.open(folder, "ben", read_only=True) as correction:
        queue = review_queue(correction)
    assert [queued.frame_id for queued in queue] == ["000004", "000002", "000001", "000000"]
    assert queue[0].reason == "rejected by mia: blurred" and "confidence 0.50" in queue[1].reason


# Buttons, menus, keys


def test_every_command_is_in_a_menu_and_has_a_name_for_every_ear(hand):
    window = hand.window
    entries = {entry for menu in window.panels.header.menus.findChildren(QMenu) for entry in menu.actions()}
    for command in window.settings.commands:
        action = window.actions_by_name[command.name]
        assert action in entries and action.text(), command.name
    for widget in (*window.findChildren(QAbstractButton), *window.findChildren(QLineEdit)):
        if not widget.objectName().startswith("qt_"):
            assert widget.accessibleName() or widget.text(), widget
    assert all(
        tile.accessibleName() and tile.accessibleDescription()
        for tile in window.panels.palette_.tiles.values()
    )


def test_a_button_that_needs_a_place_takes_the_next_click(hand):
    arm, part = hand.middle_of(RIGHT_ARM), hand.edits.part
    button = hand.panels.tools.buttons["swap"]
    QTest.mouseClick(button, Qt.MouseButton.LeftButton)
    hand.settle()
    assert "Click an arm" in hand.panels.status.next.text()
    hand.click(hand.place(arm))
    assert hand.parts.flat[arm] == LEFT_ARM and len(hand.strokes()) == 1
    hand.click(hand.place(arm))
    assert hand.parts.flat[arm] == part, "the next click paints again"
    QTest.mouseClick(button, Qt.MouseButton.LeftButton)
    hand.key("cancel")
    assert not hand.window.options.once


def test_a_burst_of_changes_updates_the_panels_once(hand, monkeypatch):
    panels, shown = hand.panels, []
    show = panels.show_edits
    monkeypatch.setattr(panels, "show_edits", lambda *what: (shown.append(what), show(*what)))
    for _ in range(3):
        hand.window.refresh()
    assert not shown
    hand.settle()
    assert len(shown) == 1


@pytest.mark.parametrize(("layout", "key"), [("qwertz", "Y"), ("azerty", "W")])
def test_one_setting_moves_the_keys_to_another_keyboard(hand, tmp_path, layout, key):
    (tmp_path / "window.toml").write_text(f'layout = "{layout}"')
    settings = load_settings(tmp_path / "window.toml")
    driver = Driver(hand.correction.labels.path, read_only=True, settings=settings)
    driver.press(key)
    assert driver.edits.part == PART_ID["right_lower_leg"]
    driver.close()


def test_a_number_leads_to_its_frame(hand):
    hand.key("go_to")
    field = hand.panels.progress.number
    QTest.keyClicks(field, "3 ")
    assert hand.edits.part == HEAD, "keys in the field are not commands"
    QTest.keyClick(field, Qt.Key.Key_Return)
    hand.settle()
    assert hand.window.frame_id == "000003" and not field.hasFocus()


# Seeing


def test_what_is_outlined_is_what_a_click_takes(hand):
    pixel = hand.middle_of(TORSO)
    for _ in range(2):
        hand.hover(hand.place(pixel))
        wanted = hand.edits.would_take(pixel)
        shown = hand.views.cloud.layer._outline, hand.views.depth.layer._outline
        assert len(wanted) and all(veil is not None for veil in shown)
        hand.click(hand.place(pixel))
        np.testing.assert_array_equal(hand.strokes()[-1].pixels, wanted)


def test_a_stroke_leaves_its_outline_in_every_colouring(hand):
    pane, pixel = hand.views.depth, hand.middle_of(TORSO)
    hand.look("depth", view=pane)
    before = pane._rgb.copy()
    hand.click(hand.place(pixel))
    changed = (before != pane._rgb).any(axis=2)
    taken = np.zeros(changed.shape, bool)
    taken.flat[hand.strokes()[-1].pixels] = True
    assert changed[taken].any() and not changed[taken].all(), "a line, not a blot"


def test_a_hidden_part_is_hidden_in_the_depth_image_too(hand):
    pane = hand.views.depth
    hand.press("Alt+W")
    hand.press("Alt+W")
    assert (pane._rgb[hand.parts == TORSO] == hand.window.theme.ground_rgb).all()


def test_the_next_doubtful_place_is_shown_with_its_reason(hand):
    assert "look at" in hand.panels.header.facts.text()
    hand.key("doubt")
    assert "1 of 2: torso" in hand.said and "hip in the other set" in hand.said
    hand.key("doubt")
    assert "2 of 2: left upper arm" in hand.said and "confidence 0.30" in hand.said
    assert hand.views.depth.layer._outline is not None


def test_the_pointer_reads_out_part_depth_and_the_other_set(hand):
    pixel = hand.middle_of(TORSO)
    hand.hover(hand.place(pixel))
    words = hand.views.cloud.layer._words
    assert all(word in words for word in ("torso", " m", "confidence 1.00", "other set: hip"))


def test_strokes_take_over_the_other_set_or_the_frame_before(hand):
    pixel = hand.middle_of(TORSO)
    hand.key("from_other")
    hand.click(hand.place(pixel))
    assert hand.parts.flat[pixel] == PART_ID["hip"]
    assert "as in the other set" in hand.panels.status.next.text()
    for name in ("from_before", "copy_previous"):
        hand.key(name)
        assert "No frame lies before" in hand.said
    hand.key("head")
    assert hand.edits.giver == "part"
    hand.key("next")
    before = hand.edits.frame.before
    hand.key("copy_previous")
    both = (hand.edits.frame.scene.labels.parts > 0) & (before > 0)
    np.testing.assert_array_equal(hand.parts[both], before[both])


def test_the_frames_picture_and_state_follow_a_stroke(hand):
    frames, frame_id = hand.panels.strip.model_, hand.window.frame_id
    before = frames.data(frames.index(0), Qt.ItemDataRole.DecorationRole)
    hand.key("lasso")
    hand.drag(hand.circle(hand.place(hand.middle_of(TORSO)), 40))
    QTest.qWait(200)
    hand.settle()
    assert frames.data(frames.index(0), Qt.ItemDataRole.DecorationRole) != before
    assert "in progress" in frames.data(frames.index(0), Qt.ItemDataRole.ToolTipRole)
    assert hand.correction.state(frame_id) == "touched"


def test_the_views_swap_places_and_a_double_click_centres(hand):
    window, pixel = hand.window, hand.middle_of(LEFT_ARM)
    width = window.views.depth.width()
    hand.key("swap_views")
    assert window.views.depth.width() > width and window.views.cloud.isVisible()
    hand.key("swap_views")
    for view in window.views:
        place = hand.on_window(hand.place(pixel, view), view)
        QTest.mouseDClick(window.windowHandle(), Qt.MouseButton.RightButton, pos=place)
        QTest.mouseRelease(window.windowHandle(), Qt.MouseButton.RightButton, pos=place)
        hand.settle()
        middle = view.layer.rect().center() - hand.place(pixel, view)
        assert middle.manhattanLength() < 12


# Screens


def test_all_of_it_fits_a_small_screen(hand):
    window = hand.window
    window.resize(1280, 680)
    hand.settle()
    assert (window.width(), window.height()) == (1280, 680)
    assert window.panels.tools.verticalScrollBar().maximum() == 0, "every tool is in sight"
    inside = QRect(QPoint(0, 0), window.size())
    panels = window.panels
    for widget in (panels.status, panels.strip, panels.tools, panels.palette_, panels.header, *window.views):
        place = QRect(widget.mapTo(window, QPoint(0, 0)), widget.size())
        assert inside.contains(place) and place.height() > 25, widget
    hand.key("help")
    assert window.panels.key_page.rect().contains(window.panels.key_page.area.geometry())
    hand.key("help")
    window.resize(1000, 760)


def test_size_colours_tool_and_order_are_remembered(qapp, figures, tmp_path):
    memory = tmp_path / "state" / "window.ini"
    driver = Driver(figures / "labels", read_only=True, memory=memory, size=(1040, 700))
    driver.key("brush")
    driver.key("larger")
    driver.key("order")
    driver.look("depth", tint=0.5)
    driver.key("theme")
    radius = driver.window.options.radius_px
    driver.close()
    system = Settings("system")
    again = Driver(figures / "labels", read_only=True, memory=memory, size=None, settings=system)
    window = again.window
    assert (window.width(), window.height()) == (1040, 700) and window.theme.ground == "#eef0f4"
    assert (window.options.tool, window.options.radius_px, window.frames.order) == ("brush", radius, "worst")
    look = window.views.cloud.look
    assert look == replace(look, colouring="depth", tint=0.5)
    again.close()
    memory.write_text("[General]\ntool=hammer\nradius_px=nan\ngeometry=9\n[cloud]\ntint=2\nx")
    third = Driver(figures / "labels", read_only=True, memory=memory)
    assert third.window.options == StrokeOptions(color=third.window.options.color)
    third.close()
