"""The status line, which describes the next click, and the page of all keys."""

from collections import defaultdict
from collections.abc import Sequence
from html import escape

from PySide6.QtCore import Qt
from PySide6.QtGui import QColor, QMouseEvent, QPainter, QPaintEvent
from PySide6.QtWidgets import QFrame, QGridLayout, QHBoxLayout, QLabel, QSizePolicy, QVBoxLayout, QWidget

from annotate.gui.done import Done
from annotate.gui.keys import BODY_GRID, Binding, Settings, settings_path
from annotate.gui.pointing import Pointing
from annotate.gui.sentences import title
from annotate.gui.theme import DARK, Theme, named, part_color
from annotate.parts import PART_ID, PARTS

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


def next_click(pointing: Pointing, part: int) -> str:
    """The effect of the left button now, as a sentence."""
    becomes = "is erased" if part == 0 else f"becomes {title(part)}"
    act = {
        "piece": f"Click: the piece {becomes} · click it again to grow it",
        "lasso": f"Drag round it: it {becomes}",
        "polygon": f"Click corners, double-click to close it: the inside {becomes}",
        "rectangle": f"Drag a rectangle: the inside {becomes}",
        "brush": f"Drag over it: it {becomes} · Shift+wheel: size",
    }[pointing.tool]
    if pointing.tool != "piece":
        act += (
            " · only the part where it starts"
            if pointing.only
            else " · the room too"
            if pointing.room
            else ""
        )
        act += " · through the body" if pointing.through else " · front only"
    return act


class StatusLine(QWidget):
    """Left: the effect of the next click. Right: the outcome of the last one, and whether all is saved."""

    def __init__(self) -> None:
        super().__init__()
        self.setObjectName("panel")
        self.setFixedHeight(36)
        row = QHBoxLayout(self)
        row.setContentsMargins(14, 0, 14, 0)
        row.setSpacing(10)
        self.chip = QLabel()
        self.chip.setFixedSize(14, 14)
        self.next, self.last, self.saved = QLabel(), QLabel(), named(QLabel(), "quiet")
        self.space = QLabel()
        self.next.setObjectName("title")
        self.next.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Preferred)
        for label in (self.chip, self.next, self.last, self.space, self.saved):
            row.addWidget(label, 1 if label is self.next else 0)

    def show_next(self, text: str, part: int, theme: Theme) -> None:
        """The sentence on the next click, beside the part's colour."""
        self.next.setText(text)
        color = part_color(part, theme).name()
        self.chip.setStyleSheet(f"background: {color}; border: 1px solid {theme.quiet}; border-radius: 7px")

    def show_accept(self, key: str, verdict: str) -> None:
        """The effect of the key for accepting."""
        act = {"accept": "accept and go on", "agree": "agree and go on", "none": "go on"}[verdict]
        self.space.setText(f"{escape(key)}: {act}")

    def show_done(self, done: Done, theme: Theme) -> None:
        """The outcome of the last key or stroke."""
        color = {"plain": theme.quiet, "good": theme.good, "warn": theme.warn, "bad": theme.bad}[done.tone]
        self.last.setText(f'<span style="color:{color}">{escape(done.text)}</span>')

    def show_saved(self, unsaved: int, theme: Theme) -> None:
        """The number of strokes that are only in memory."""
        self.saved.setText(f"{unsaved} strokes not saved" if unsaved else "✓ saved")
        self.saved.setStyleSheet(f"color: {theme.bad if unsaved else theme.good}")


class KeyPage(QWidget):
    """All keys over the window; any click closes it."""

    def __init__(self, parent: QWidget, settings: Settings) -> None:
        super().__init__(parent)
        self.theme = DARK
        self.card = named(QFrame(self), "panel")
        outer = QVBoxLayout(self)
        outer.addWidget(self.card, 0, Qt.AlignmentFlag.AlignCenter)
        column = QVBoxLayout(self.card)
        column.setContentsMargins(28, 22, 28, 22)
        column.setSpacing(14)
        heading = "All keys lie under the left hand; the right hand has the mouse"
        column.addWidget(named(QLabel(heading), "title"))
        row = QHBoxLayout()
        row.setSpacing(40)
        column.addLayout(row)
        groups: dict[str, list[Binding]] = defaultdict(list)
        for binding in settings.bindings:
            groups[binding.group].append(binding)
        parts = QVBoxLayout()
        parts.addWidget(named(QLabel("PARTS, LAID OUT LIKE A BODY THAT FACES YOU"), "caption"))
        parts.addLayout(_body(settings))
        row.addLayout(_stacked(parts, _list("Mouse", MOUSE)))
        more = [binding for binding in groups["Parts"] if binding.name not in PART_ID]
        for names in (("Tools", "View"), ("Edit", "Frames")):
            lists = [_list(name, [(b.key, b.description) for b in groups[name]]) for name in names]
            if "View" in names:
                lists.append(_list("Choosing", [(b.key, b.description) for b in more]))
            row.addLayout(_stacked(*lists))
        foot = f'Keys can be changed: write  undo = "Ctrl+K"  under [keys] in {settings_path()}'
        column.addWidget(named(QLabel(foot, textFormat=Qt.TextFormat.PlainText), "quiet"))
        self.hide()

    def paintEvent(self, event: QPaintEvent) -> None:  # noqa: N802
        """Qt's hook: dims the window behind."""
        color = QColor(self.theme.ground)
        color.setAlpha(205)
        QPainter(self).fillRect(self.rect(), color)

    def mousePressEvent(self, event: QMouseEvent) -> None:  # noqa: N802
        """Qt's hook."""
        self.hide()


def _stacked(*layouts: QVBoxLayout) -> QVBoxLayout:
    column = QVBoxLayout()
    column.setSpacing(14)
    for layout in layouts:
        column.addLayout(layout)
    column.addStretch(1)
    return column


def _list(name: str, rows: Sequence[tuple[str, str]]) -> QVBoxLayout:
    """A heading, and what each key does."""
    column = QVBoxLayout()
    column.setSpacing(5)
    column.addWidget(named(QLabel(name.upper()), "caption"))
    grid = QGridLayout()
    grid.setHorizontalSpacing(10)
    grid.setVerticalSpacing(3)
    grid.setColumnStretch(1, 1)
    for i, (key, description) in enumerate(rows):
        grid.addWidget(named(QLabel(key), "key"), i, 0, Qt.AlignmentFlag.AlignRight)
        grid.addWidget(QLabel(description), i, 1)
    column.addLayout(grid)
    return column


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
