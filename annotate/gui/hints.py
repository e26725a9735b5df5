"""The status line, which describes the next click, and the page of all keys."""

from collections.abc import Sequence
from html import escape

from PySide6.QtCore import Qt
from PySide6.QtGui import QColor, QMouseEvent, QPainter, QPaintEvent
from PySide6.QtWidgets import QFrame, QGridLayout, QHBoxLayout, QLabel, QSizePolicy, QVBoxLayout, QWidget

from annotate.gui.desk import Desk
from annotate.gui.keys import BODY_GRID, Settings, settings_path
from annotate.gui.outcome import Done, title
from annotate.gui.pointing import Hand
from annotate.gui.theme import DARK, Theme, part_color
from annotate.gui.widgets import laid, named
from annotate.parts import PARTS

MOUSE = (
    ("Left button", "use the tool"),
    ("Right button", "turn the cloud"),
    ("Middle button", "shift the cloud"),
    ("Wheel", "zoom in and out"),
    ("Shift + stroke", "replace only the part where it starts"),
    ("Ctrl + stroke", "through the body, not only its front"),
    ("Alt + click", "choose the part under the pointer"),
    ("Shift + wheel", "size of the brush"),
    ("Shift + part", "lock the part: it cannot gain or lose pixels"),
    ("Alt + part", "fade the part, hide it, show it again"),
)


def next_click(hand: Hand, part: int) -> str:
    """The effect of the left button now, as a sentence."""
    becomes = "is erased" if part == 0 else f"becomes {title(part)}"
    act = {
        "piece": f"Click: the piece {becomes} · click it again to grow it",
        "lasso": f"Drag round it: it {becomes}",
        "polygon": f"Click corners, double-click to close it: the inside {becomes}",
        "rectangle": f"Drag a rectangle: the inside {becomes}",
        "brush": f"Drag over it: it {becomes} · Shift+wheel: size",
    }[hand.tool]
    if hand.tool != "piece":
        if hand.only or hand.room:
            act += " · only the part where it starts" if hand.only else " · the room too"
        act += " · through the body" if hand.through else " · front only"
    return act


class StatusLine(QWidget):
    """Left: the effect of the next click. Right: the outcome of the last one, and whether all is saved."""

    def __init__(self, settings: Settings) -> None:
        super().__init__()
        self._accept_key = escape(settings.key("accept"))
        self.setObjectName("panel")
        self.setFixedHeight(36)
        self.chip = QLabel()
        self.chip.setFixedSize(14, 14)
        self.next, self.saved = named(QLabel(), "title"), named(QLabel(), "quiet")
        self.last, self.space = QLabel(), QLabel()
        self.next.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Preferred)
        labels = self.chip, self.next, self.last, self.space, self.saved
        laid(QHBoxLayout(self), *labels, gap=10, margins=(14, 0, 14, 0)).setStretchFactor(self.next, 1)

    def show_desk(self, desk: Desk, hand: Hand, theme: Theme) -> None:
        """Update the next click beside the part's colour, the key for accepting, and the unsaved strokes."""
        correction, color = desk.correction, part_color(desk.part, theme).name()
        self.chip.setStyleSheet(f"background: {color}; border: 1px solid {theme.quiet}; border-radius: 7px")
        read_only = "Read-only: nothing can be changed"
        self.next.setText(read_only if correction.read_only else next_click(hand, desk.part))
        verdict = correction.next_verdict(desk.scene.labels.frame_id)
        act = {"accept": "accept and go on", "agree": "agree and go on", "none": "go on"}[verdict]
        self.space.setText(f"{self._accept_key}: {act}")
        unsaved = correction.unsaved
        self.saved.setText(f"{unsaved} strokes not saved" if unsaved else "✓ saved")
        self.saved.setStyleSheet(f"color: {theme.bad if unsaved else theme.good}")

    def show_done(self, done: Done, theme: Theme) -> None:
        """The outcome of the last key or stroke."""
        color = {"plain": theme.quiet, "good": theme.good, "warn": theme.warn, "bad": theme.bad}[done.tone]
        self.last.setText(f'<span style="color:{color}">{escape(done.text)}</span>')


class KeyPage(QWidget):
    """All keys over the window; any click closes it."""

    def __init__(self, parent: QWidget, settings: Settings) -> None:
        super().__init__(parent)
        self.theme = DARK
        self.card = named(QFrame(self), "panel")
        QVBoxLayout(self).addWidget(self.card, 0, Qt.AlignmentFlag.AlignCenter)
        caption = _caption("Parts, laid out like a body that faces you")
        parts = laid(QVBoxLayout(), caption, _body(settings), gap=14)
        columns = [laid(QVBoxLayout(), parts, _list("Mouse", MOUSE), None, gap=14)]
        for groups in (("Tools", "View", "Choosing"), ("Edit", "Frames")):
            lists = [
                _list(group, [(b.key, b.description) for b in settings.bindings if b.group == group])
                for group in groups
            ]
            columns.append(laid(QVBoxLayout(), *lists, None, gap=14))
        head = named(QLabel("All keys lie under the left hand; the right hand has the mouse"), "title")
        text = f'Keys can be changed: write  undo = "Ctrl+K"  under [keys] in {settings_path()}'
        foot = named(QLabel(text, textFormat=Qt.TextFormat.PlainText), "quiet")
        row = laid(QHBoxLayout(), *columns, gap=40)
        laid(QVBoxLayout(self.card), head, row, foot, gap=14, margins=(28, 22, 28, 22))
        self.hide()

    def paintEvent(self, event: QPaintEvent) -> None:  # noqa: N802
        """Qt's hook: dims the window behind."""
        color = QColor(self.theme.ground)
        color.setAlpha(205)
        QPainter(self).fillRect(self.rect(), color)

    def mousePressEvent(self, event: QMouseEvent) -> None:  # noqa: N802
        """Qt's hook."""
        self.hide()


def _caption(text: str) -> QLabel:
    return named(QLabel(text.upper()), "caption")


def _list(name: str, rows: Sequence[tuple[str, str]]) -> QVBoxLayout:
    """A heading, and what each key does."""
    grid = QGridLayout()
    grid.setHorizontalSpacing(10)
    grid.setVerticalSpacing(3)
    grid.setColumnStretch(1, 1)
    for i, (key, description) in enumerate(rows):
        grid.addWidget(named(QLabel(key), "key"), i, 0, Qt.AlignmentFlag.AlignRight)
        grid.addWidget(QLabel(description), i, 1)
    return laid(QVBoxLayout(), _caption(name), grid, gap=5)


def _body(settings: Settings) -> QGridLayout:
    """The parts' keys where they lie."""
    grid = QGridLayout()
    grid.setHorizontalSpacing(6)
    grid.setVerticalSpacing(4)
    for row, parts in enumerate(BODY_GRID):
        for column, part in enumerate(parts):
            cap = named(QLabel(settings.key(PARTS[part].name)), "key")
            grid.addWidget(cap, row, 2 * column, Qt.AlignmentFlag.AlignRight)
            name = PARTS[part].title.split(" ", 1)[-1].capitalize() if part else "Erase"
            grid.addWidget(QLabel(name), row, 2 * column + 1)
    return grid
