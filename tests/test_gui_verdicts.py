"""Verdicts in the window: no rejection is overruled by the way; each can be taken back and given again."""

from collections.abc import Callable

import numpy as np
import pytest
from PySide6.QtCore import QPoint, Qt, QTimer
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QComboBox, QWidget

from annotate.correction.correction import Correction
from annotate.correction.replay import rejection
from annotate.gui.panels.frame_strip import state_color
from annotate.gui.widgets.dialogs import REASONS
from annotate.parts import PART_ID
from tests.helpers.figure_sets import figure_set, judge
from tests.helpers.gui_driver import Driver

TORSO, LEFT_ARM = PART_ID["torso"], PART_ID["left_upper_arm"]


@pytest.fixture
def folder(tmp_path):
    """Six frames; anna rejected 1 and 2, and accepted 4."""
    figure_set(tmp_path / "labels", [0.9] * 6)
    judge(tmp_path / "labels", "anna", f1="blurred", f2="feet cut off", f4="accept")
    return tmp_path / "labels"


@pytest.fixture
def ben(qapp, folder):
    driver = Driver(folder, who="ben")
    yield driver
    driver.close()


@pytest.fixture
def alone(qapp, tmp_path):
    """A window on an untouched set."""
    figure_set(tmp_path / "labels", [0.9] * 4)
    driver = Driver(tmp_path / "labels")
    yield driver
    driver.close()


def number(driver: Driver) -> int:
    return int(driver.window.frame_id)


def states(driver: Driver) -> list[str]:
    return [driver.correction.state(frame_id) for frame_id in driver.window.frames.all_ids]


def opened(driver: Driver, frame: int) -> None:
    driver.window.open_frame(f"{frame:06d}")
    driver.settle()


def order(driver: Driver, name: str) -> None:
    while driver.window.frames.order != name:
        driver.key("order")


# Rejections of others


def test_in_review_space_agrees_with_what_stands(ben):
    order(ben, "review")
    seen, offered = [], []
    for _ in range(3):
        seen.append(number(ben))
        offered.append(ben.panels.status.space.text())
        ben.key("accept")
    assert seen == [1, 2, 4], "the rejected frames, which come first, are opened too"
    assert offered == ["Space: agree with the rejection and go on"] * 2 + ["Space: agree and go on"]
    assert states(ben) == ["auto", "rejected", "rejected", "auto", "reviewed", "auto"]
    assert (
        ben.said == "Agreed. Nothing is left to review" and "3 of 6 done" in ben.panels.progress.text.text()
    )
    opened(ben, 1)
    assert "rejected by anna: blurred; ben agrees" in ben.panels.header.facts.text()
    with Correction.open(ben.correction.labels.path, "carl", read_only=True) as third:
        assert third.state("000001") == "rejected"


def test_outside_review_space_does_not_overrule_a_rejection_either(ben):
    for state in ("rejected", "rejected, and this person agrees"):
        opened(ben, 1)
        assert "rejected by anna: blurred" in ben.panels.header.facts.text()
        ben.key("accept")
        assert states(ben)[1] == "rejected" and number(ben) == 3, state


def test_overruling_a_rejection_is_a_command_of_its_own_that_can_be_taken_back(ben):
    opened(ben, 2)
    ben.key("overrule")
    assert states(ben)[2] == "accepted" and number(ben) == 3
    ben.key("undo")
    assert states(ben)[2] == "rejected" and number(ben) == 2
    opened(ben, 0)
    ben.key("overrule")
    assert states(ben)[0] == "auto" and "not rejected" in ben.said


def test_the_reject_key_agrees_with_a_colleagues_rejection_without_a_question(ben):
    opened(ben, 1)
    ben.key("reject")
    assert states(ben)[1] == "rejected" and number(ben) == 3
    last = ben.correction.journal.strokes("000001")[-1]
    assert (last.operation, last.who) == ("agree", "ben")


# Back and forth


def test_redo_gives_strokes_and_verdict_back_in_their_order(alone):
    """Stroke, verdict; both undone; both redone: accepted again, and the strip's dot with it."""
    pixel = alone.middle_of(TORSO)
    alone.click(alone.place(pixel))
    painted = alone.parts.copy()
    alone.key("accept")
    alone.key("undo")
    alone.key("undo")
    assert number(alone) == 0 and alone.parts.flat[pixel] == TORSO
    alone.key("redo")
    alone.key("redo")
    np.testing.assert_array_equal(alone.parts, painted)
    assert states(alone)[0] == "accepted" and alone.said == "Accepted again"


def test_accepting_leaves_nothing_to_redo(alone):
    alone.hover(alone.place(alone.middle_of(LEFT_ARM)))
    before = alone.parts.copy()
    alone.key("swap")
    assert (alone.parts != before).any()
    alone.key("undo")
    alone.key("accept")
    alone.key("undo")
    for _ in range(2):
        alone.key("redo")
    np.testing.assert_array_equal(alone.parts, before)
    assert number(alone) == 0 and states(alone)[0] == "accepted"


def dot(driver: Driver):
    """The colour of the open frame's dot in the strip, as the screen shows it."""
    strip = driver.panels.strip
    place = strip.visualRect(strip.currentIndex())
    at = strip.viewport().mapToGlobal(place.bottomLeft() + QPoint(15, -14))
    QTest.qWait(50)
    return driver.window.screen().grabWindow(0, at.x(), at.y(), 1, 1).toImage().pixelColor(0, 0)


def test_the_strips_dot_follows_a_verdict_taken_back_and_given_again(alone):
    alone.key("accept")
    alone.key("undo")
    for key, state in (("redo", "accepted"), ("undo", "auto"), ("redo", "accepted")):
        alone.key(key)
        assert alone.correction.state(alone.window.frame_id) == state
        assert dot(alone) == state_color(state, alone.window.theme)


def test_the_end_is_said_in_words_of_what_is_left(alone):
    alone.key("filter")  # unfinished
    for _ in range(3):
        alone.key("accept")
    opened(alone, 0)
    alone.window.arrange("time", "accepted")
    alone.key("accept")
    assert alone.said == "Already accepted. No unfinished frame among those shown"
    assert "not among" not in alone.panels.header.facts.text()
    opened(alone, 3)
    assert "not among the 3 shown" in alone.panels.header.facts.text()
    alone.window.arrange("time", "all")
    alone.key("accept")
    assert alone.said == "Accepted. No unfinished frames left"


def test_a_number_without_a_frame_names_the_numbers_there_are(alone):
    alone.window.act(lambda: alone.window.go_to("4"))
    assert "Frame 4" in alone.said and "0 to 3" in alone.said


# The dialog of reasons


def answered(driver: Driver, keys: Callable[[QWidget], None]) -> None:
    """Press the reject key, and keys in the dialog that comes."""

    def come() -> None:
        if (dialog := QApplication.activeModalWidget()) is None:
            QTimer.singleShot(50, come)
            return
        keys(dialog.findChild(QComboBox))
        dialog.close()

    QTimer.singleShot(100, come)
    driver.key("reject")


def chosen(box: QWidget) -> None:
    for _ in range(2):
        QTest.keyClick(box, Qt.Key.Key_Down)
    QTest.keyClick(box, Qt.Key.Key_Return)


def typed(box: QWidget) -> None:
    """Type words with spaces, which accept frames in the window behind, and with a reason's beginning."""
    QTest.keyClicks(box, "Body behind 2 feet")
    QTest.keyClick(box, Qt.Key.Key_Return)


@pytest.mark.parametrize(("keys", "reason"), [(chosen, REASONS[1]), (typed, "Body behind 2 feet")])
def test_a_reason_is_chosen_or_typed(alone, keys, reason):
    answered(alone, lambda box: QTest.keyClick(box, Qt.Key.Key_Escape))
    assert states(alone) == ["auto"] * 4 and alone.said == "Not rejected"
    answered(alone, keys)
    assert rejection(alone.correction.journal.strokes("000000")) == reason
    assert states(alone) == ["rejected", "auto", "auto", "auto"]
    opened(alone, 0)
    assert reason in alone.panels.header.facts.text()
    assert alone.panels.header.facts.textFormat() == Qt.TextFormat.PlainText


# Opening again


def test_each_set_and_person_has_an_order_and_the_window_opens_at_its_first_frame(qapp, tmp_path):
    memory = tmp_path / "window.json"
    one, other = (figure_set(tmp_path / name, [0.9, 0.8, 0.5, 0.7]).path for name in ("one", "other"))
    driver = Driver(one, memory=memory)
    order(driver, "worst")
    assert number(driver) == 2
    driver.key("accept")
    driver.close()
    again = Driver(one, memory=memory)
    assert again.window.frames.order == "worst" and number(again) == 3
    again.close()
    for path, who in ((other, "mia"), (one, "ben")):
        fresh = Driver(path, memory=memory, who=who)
        assert fresh.window.frames.order == "time" and number(fresh) == 0
        fresh.close()
    reviewer = Driver(one, memory=memory, who="ben")
    order(reviewer, "review")
    reviewer.close()
    reviewer = Driver(one, memory=memory, who="ben")
    assert reviewer.window.frames.order == "review" and number(reviewer) == 2
    reviewer.close()
