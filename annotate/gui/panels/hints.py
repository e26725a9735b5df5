"""Status line, which describes the effect of the next click, and the page of all keys."""

from collections.abc import Sequence
from html import escape

from PySide6.QtCore import QEvent, QObject, QSize, Qt, Signal
from PySide6.QtGui import QColor, QMouseEvent, QPainter, QPaintEvent, QResizeEvent
from PySide6.QtWidgets import (
    QFrame,
    QGridLayout,
    QHBoxLayout,
    QLabel,
    QScrollArea,
    QVBoxLayout,
    QWidget,
)

from annotate.gui.state.edit_controller import EditController
from annotate.gui.state.keys import Settings, settings_path
from annotate.gui.state.outcome import Outcome, strokes_text
from annotate.gui.views.drawing_layer import StrokeOptions
from annotate.gui.widgets.building_blocks import Elided, laid, named
from annotate.gui.widgets.theme import DARK, Theme, part_color, scaled
from annotate.scheme.body_grid import body_grid, thing_grid
from annotate.scheme.limbs import limb_names
from annotate.scheme.scheme import BACKGROUND, UNDEFINED, Scheme

MOUSE = (
    ("Left button", "use the tool"),
    ("Right button", "turn the cloud"),
    ("Middle button", "shift the cloud"),
    ("Wheel", "zoom at the pointer"),
    ("Right double click", "centre on it"),
    ("Shift + stroke", "replace only the part where it starts"),
    ("Ctrl + stroke", "through the body, not only its surface"),
    ("Alt + click", "choose the part under the pointer"),
    ("Ctrl + right click", "the same, where the desktop takes Alt"),
    ("Backspace", "remove a polygon's last corner"),
    ("Shift + wheel", "size of the brush"),
    ("Shift + part", "lock the part: it cannot gain or lose pixels"),
    ("Alt + part", "fade the part, hide it, show it again"),
)
ONCE = {
    "swap": "Click LIMB: left and right are swapped",
    "neighbour": "Click a patch: it goes to the part that it touches most",
    "merge": "Click a part: all of it becomes",
    "pick": "Click a part to choose it",
}
"""Effect of the next click after a command that needs a place. LIMB: the scheme's limbs."""


def next_click(options: StrokeOptions, edits: EditController, in_image: bool) -> str:
    """Return a description of a left click's effect with the held keys.

    in_image: True if the pointer is in the depth image, where no pixel hides another.
    """
    title = edits.scheme.title
    if options.once:
        whole = ONCE[options.once].replace("LIMB", limb_names(edits.scheme))
        whole += f" {title(edits.part)}" if options.once == "merge" else ""
        return f"{whole} · Esc cancels"
    becomes = "is erased" if edits.part == 0 else f"becomes {title(edits.part)}"
    if edits.giver != "part":
        becomes = f"becomes as in the {'other set' if edits.giver == 'other' else 'frame before'}"
    act = {
        "piece": f"Click: the piece {becomes} · click it again to grow it",
        "lasso": f"Draw a loop: the inside {becomes}",
        "polygon": f"Click corners, Return closes: the inside {becomes}",
        "rectangle": f"Drag a rectangle: the inside {becomes}",
        "brush": f"Drag over it: it {becomes}",
    }[options.tool]
    if options.tool == "piece":
        return act
    limits = (
        ["only the part I start on"] if options.takes_only else ["background too"] if options.room else []
    )
    if not in_image:
        limits.append("through the body" if options.goes_through else "visible surface only")
    return f"{act} ({', '.join(limits)})" if limits else act


class StatusLine(QWidget):
    """Status line: effect of the next click at the left; the last outcome and the saved state at the
    right.
    """

    def __init__(self, settings: Settings) -> None:
        super().__init__()
        self._accept_key = escape(settings.key("accept"))
        self.setObjectName("panel")
        self.setFixedHeight(scaled(30))
        self.chip = QLabel()
        self.chip.setFixedSize(14, 14)
        self.next, self.saved = named(Elided(), "title"), named(QLabel(), "quiet")
        self.last, self.space = Elided(), QLabel()
        for label, name in ((self.next, "Next click"), (self.last, "Last outcome"), (self.saved, "Saved")):
            label.setAccessibleName(name)
        self.last.setAlignment(Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter)
        labels = self.chip, self.next, self.last, self.space, self.saved
        row = laid(QHBoxLayout(self), *labels, gap=10, margins=(14, 0, 14, 0))
        row.setStretchFactor(self.next, 1)
        row.setStretchFactor(self.last, 1)

    def show_next(self, edits: EditController, options: StrokeOptions, in_image: bool) -> None:
        """Update the effect of the next click. in_image: True if the pointer is in the depth image."""
        read_only = "Read-only: nothing can be changed"
        self.next.setText(read_only if edits.correction.read_only else next_click(options, edits, in_image))

    def show_edits(self, edits: EditController, theme: Theme) -> None:
        """Update the chosen part's colour, the key for accepting, and the number of unsaved strokes."""
        correction, color = edits.correction, part_color(edits.scheme, edits.part, theme).name()
        self.chip.setStyleSheet(f"background: {color}; border: 1px solid {theme.quiet}; border-radius: 7px")
        frame_id = edits.frame.frame_id
        verdict = correction.next_verdict(frame_id)
        agree = "agree with the rejection" if correction.state(frame_id) == "rejected" else "agree"
        act = {"accept": "accept and go on", "agree": f"{agree} and go on", "none": "go on"}[verdict]
        self.space.setText(f"{self._accept_key}: {'go on' if correction.read_only else act}")
        unsaved = correction.unsaved
        self.saved.setText(f"{strokes_text(unsaved)} not saved" if unsaved else "✓ saved")
        self.saved.setStyleSheet(f"color: {theme.bad if unsaved else theme.good}")

    def show_done(self, done: Outcome, theme: Theme) -> None:
        """Show the outcome of the last key or stroke."""
        color = {"plain": theme.quiet, "good": theme.good, "warn": theme.warn, "bad": theme.bad}[done.tone]
        self.last.setStyleSheet(f"color: {color}")
        self.last.setText(done.text)


class KeyPage(QWidget):
    """Page of all keys over the window. closed: signal of a click outside the scroll bar."""

    closed = Signal()

    def __init__(self, parent: QWidget, scheme: Scheme, settings: Settings) -> None:
        super().__init__(parent)
        self.theme = DARK
        self.setAccessibleName("All keys")
        self.card = named(QFrame(), "panel")
        self.area = QScrollArea(self, widgetResizable=True)
        self.area.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self.area.setWidget(self.card)
        self.area.viewport().installEventFilter(self)
        caption = _caption("Parts, laid out like a body that faces you")
        parts = laid(QVBoxLayout(), caption, _body(scheme, settings), gap=10)
        rows = {
            menu: [
                (c.key, (c.hint or c.title) + (f" (or {c.also})" if c.also else ""))
                for c in settings.commands
                if c.menu == menu and c.key and c.part in (None, UNDEFINED)
            ]
            for menu in ("Parts", "Tools", "Edit", "Frames", "View", "File", "Help")
        }
        rows["Mouse"] = list(MOUSE)
        columns = [
            laid(QVBoxLayout(), *above, *(_list(name, rows[name]) for name in names), None, gap=10)
            for above, names in (
                ([parts], ("Mouse", "Frames")),
                ([], ("Parts", "Tools", "File", "Help")),
                ([], ("Edit", "View")),
            )
        ]
        head = named(QLabel("Parts and tools lie under the left hand; the right hand has the mouse"), "title")
        text = (
            f'Keys can be changed: layout = "qwertz", or  undo = "Ctrl+K"  under [keys], in {settings_path()}'
        )
        foot = named(QLabel(text, textFormat=Qt.TextFormat.PlainText), "quiet")
        row = laid(QHBoxLayout(), *columns, gap=20)
        laid(QVBoxLayout(self.card), head, row, foot, gap=10, margins=(14, 12, 14, 12))
        self.hide()

    def resizeEvent(self, event: QResizeEvent) -> None:  # noqa: N802
        """Put the page in the middle, with scroll bars if it is larger than the window (Qt's hook)."""
        wanted = self.card.sizeHint() + QSize(12, 4)
        size = wanted.boundedTo(self.size())
        self.area.setGeometry((self.width() - size.width()) // 2, (self.height() - size.height()) // 2, 0, 0)
        self.area.resize(size)

    def paintEvent(self, event: QPaintEvent) -> None:  # noqa: N802
        """Dim the window behind (Qt's hook)."""
        color = QColor(self.theme.ground)
        color.setAlpha(205)
        QPainter(self).fillRect(self.rect(), color)

    def mousePressEvent(self, event: QMouseEvent) -> None:  # noqa: N802
        """Close the page (Qt's hook)."""
        self.closed.emit()

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:  # noqa: N802
        """Close the page on a click on it (Qt's hook)."""
        if event.type() == QEvent.Type.MouseButtonPress:
            self.closed.emit()
        return False


def _caption(text: str) -> QLabel:
    return named(QLabel(text.upper()), "caption")


def _list(name: str, rows: Sequence[tuple[str, str]]) -> QVBoxLayout:
    """Return a layout with a heading, and rows of keys with their effects."""
    grid = QGridLayout()
    grid.setHorizontalSpacing(10)
    grid.setVerticalSpacing(3)
    grid.setColumnStretch(1, 1)
    for i, (key, description) in enumerate(rows):
        grid.addWidget(named(QLabel(key), "key"), i, 0, Qt.AlignmentFlag.AlignRight)
        grid.addWidget(QLabel(description), i, 1)
    return laid(QVBoxLayout(), _caption(name), grid, gap=5)


def _body(scheme: Scheme, settings: Settings) -> QGridLayout:
    """Return a layout of the parts' keys, placed like the body's parts, and of the things' below."""
    grid = QGridLayout()
    grid.setHorizontalSpacing(6)
    grid.setVerticalSpacing(4)
    for row, parts in enumerate((*body_grid(scheme), *thing_grid(scheme))):
        for column, part in enumerate(parts):
            if part is None:
                continue
            if key := settings.part_key(part):
                grid.addWidget(named(QLabel(key), "key"), row, 2 * column, Qt.AlignmentFlag.AlignRight)
            name = "Erase" if part == BACKGROUND else scheme.short_title(part)
            grid.addWidget(QLabel(name), row, 2 * column + 1)
    return grid
