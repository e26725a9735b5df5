"""Bars of buttons: menus and the frame's state at the top, a bar over each view, tools at the left."""

from collections.abc import Mapping
from functools import partial

from PySide6.QtCore import Qt, Signal
from PySide6.QtGui import QAction
from PySide6.QtWidgets import (
    QHBoxLayout,
    QLabel,
    QMenu,
    QMenuBar,
    QScrollArea,
    QSizePolicy,
    QToolButton,
    QVBoxLayout,
    QWidget,
)

from annotate.correction.replay import STATE_NAMES, rejected_by, verdicts
from annotate.gui.panels.frame_strip import state_color
from annotate.gui.state.drawing import TOOLS
from annotate.gui.state.edit_controller import EditController
from annotate.gui.state.frame_order import FrameOrder
from annotate.gui.state.keys import Settings
from annotate.gui.state.point_colors import Colouring, Look, colourings
from annotate.gui.views.drawing_layer import StrokeOptions
from annotate.gui.views.view_pair import View
from annotate.gui.widgets.building_blocks import ICON, Elided, button, icon, laid, named
from annotate.gui.widgets.theme import Theme, scaled

COLOURINGS: dict[Colouring, str] = {
    "part": "Parts",
    "colour": "Colour",
    "temperature": "Heat",
    "depth": "Depth",
    "confidence": "Confidence",
    "disagreement": "Difference",
}
MISSING: dict[Colouring, str] = {
    "colour": "no colour: give the recording with --session",
    "temperature": "no temperature: give the recording with --session",
    "confidence": "these labels carry no confidence",
}
SWITCHES = ("through", "only", "room")  # of ``StrokeOptions``
EDITS = (
    *("undo", "redo", "swap", "neighbour", "merge", "remove_islands", "fill_holes"),
    *("copy_previous", "learn"),
)
CHANGING = {*EDITS, "reject", "overrule", "stop_learning", "unlearn"}
"""Commands that a set open read-only refuses."""
ROW_PX = 25  # height of a row of the tool column, so that all rows fit on a screen of 1280 x 720
COLUMN_PX = 242  # width of the tool column: the longest title and its key


class Header(QWidget):
    """Header of the window: menus, the frame, its state, and the reason for its place in the order."""

    def __init__(self) -> None:
        super().__init__()
        self.setObjectName("panel")
        self.setFixedHeight(scaled(40))
        self.menus = QMenuBar()
        self.menus.setSizePolicy(QSizePolicy.Policy.Fixed, QSizePolicy.Policy.Preferred)
        self.frame, self.badge = named(QLabel(), "title"), named(QLabel(), "badge")
        self.facts = named(Elided(), "quiet")
        items = self.menus, self.frame, self.badge, self.facts
        row = laid(QHBoxLayout(self), *items, gap=10, margins=(4, 0, 12, 0))
        for widget in items[:-1]:
            row.setAlignment(widget, Qt.AlignmentFlag.AlignVCenter)
        row.setStretchFactor(self.facts, 1)

    def show_edits(self, edits: EditController, frames: FrameOrder, theme: Theme, doubt: str) -> None:
        """Update the frame's name, state and place. doubt: description of its most doubtful place."""
        frame_id = edits.frame.frame_id
        state = edits.correction.state(frame_id)
        self.frame.setText(f"Frame {frame_id.lstrip('0') or '0'}")
        self.badge.setText(STATE_NAMES[state])
        color = state_color(state, theme).name()
        self.badge.setStyleSheet(f"color: {color}; border: 1px solid {color}")
        facts = ["READ-ONLY" if edits.correction.read_only else "", _place(frames, frame_id)]
        facts.append(_rejection(edits) or frames.reasons.get(frame_id, ""))
        facts.append(doubt)
        self.facts.setText("   ·   ".join(filter(None, facts)))


def _place(frames: FrameOrder, frame_id: str) -> str:
    """Return a frame's position among the shown frames, as text."""
    shown = len(frames.frame_ids)
    if not frames.passes(frame_id):
        return f"not among the {shown - 1} shown"
    return f"place {frames.frame_ids.index(frame_id) + 1} of {shown}"


def _rejection(edits: EditController) -> str:
    """Return the rejection in effect as text, with person, reason and agreement; "" for none."""
    strokes = edits.correction.journal.strokes(edits.frame.frame_id)
    if (rejected := rejected_by(strokes)) is None:
        return ""
    last = verdicts(strokes)[-1]
    agreed = f"; {last.who} agrees" if last.operation == "agree" else ""
    return f"rejected by {rejected.who}: {rejected.reason}{agreed}"


class PaneBar(QWidget):
    """Bar over a view. coloured: signal that a colouring was chosen. requested: signal with a command for
    this view.
    """

    coloured = Signal(str)
    requested = Signal(str)

    def __init__(self, view: View, settings: Settings) -> None:
        super().__init__()
        self.setObjectName("panel")
        self.setFixedHeight(scaled(32))
        self.colouring = button("")
        self.buttons: dict[str, QToolButton] = {}
        self.colouring.setPopupMode(QToolButton.ToolButtonPopupMode.InstantPopup)
        self.colouring.setAccessibleName(f"{view.name}: colouring")
        menu = QMenu(self)
        self.entries: dict[Colouring, QAction] = {}
        for colouring, title in COLOURINGS.items():
            self.entries[colouring] = menu.addAction(title, partial(self.coloured.emit, colouring))
        self.colouring.setMenu(menu)
        row = laid(QHBoxLayout(self), self.colouring, gap=2, margins=(3, 2, 3, 2))
        for name in ("outlines", "tint"):
            command = settings.command(name)
            item = self.buttons[name] = button(command.title)
            item.setAccessibleName(f"{view.name}: {command.title}")
            item.setToolTip(f"{command.hint} ({command.key})")
            item.clicked.connect(partial(self.requested.emit, name))
            row.addWidget(item)
        self.buttons["outlines"].setCheckable(True)
        self.buttons["outlines"].setText("Outlines")
        row.addStretch(1)
        swap = button("⇄")
        swap.setToolTip(f"{settings.command('swap_views').hint} ({settings.key('swap_views')})")
        swap.setAccessibleName("Swap cloud and depth image")
        swap.clicked.connect(partial(self.requested.emit, "swap_views"))
        row.addWidget(swap)

    def show_look(self, look: Look, edits: EditController) -> None:
        """Show a view's colouring, outlines and opacity on the buttons."""
        there = colourings(edits.frame.scene)
        shown = look.colouring if look.colouring in there else "part"
        self.colouring.setText(f"{COLOURINGS[shown]} ▾")
        for name, entry in self.entries.items():
            entry.setEnabled(name in there)
            missing = MISSING.get(name, edits.frame.scene.no_other)
            entry.setText(COLOURINGS[name] + ("" if name in there else f" ({missing})"))
        self.buttons["outlines"].setChecked(look.outlines and shown != "part")
        self.buttons["tint"].setText(f"Opacity {look.tint:.0%}")
        for item in self.buttons.values():
            item.setEnabled(shown != "part")


class ToolButton(QToolButton):
    """Button in a row: icon, title, and the key at the right end."""

    def __init__(self, title: str, key: str) -> None:
        super().__init__()
        self.setText(title)
        self.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self.setToolButtonStyle(Qt.ToolButtonStyle.ToolButtonTextBesideIcon)
        self.setIconSize(ICON * 0.6)
        self.setFixedHeight(scaled(ROW_PX))
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Fixed)
        self.setStyleSheet(f"text-align: left; padding: 1px 5px; font-size: {scaled(12)}px")
        short = key.replace("Ctrl+", "^").replace("Shift+", "\u21e7")
        self.key = QLabel(short)
        self.key.setAttribute(Qt.WidgetAttribute.WA_TransparentForMouseEvents)
        laid(QHBoxLayout(self), None, self.key, margins=(0, 0, 6, 0))


class ToolColumn(QScrollArea):
    """Column of tools. requested: signal that the button of a command was clicked."""

    requested = Signal(str)

    def __init__(self, settings: Settings) -> None:
        super().__init__()
        inner = named(QWidget(), "panel")
        self.setWidgetResizable(True)
        self.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        self.setFixedWidth(scaled(COLUMN_PX))
        self.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        column = laid(QVBoxLayout(inner), gap=1, margins=(6, 4, 6, 2))
        self.buttons: dict[str, ToolButton] = {}
        self._drawn: dict[str, tuple[str, str, float]] = {}
        for heading, names in (("TOOLS", TOOLS), ("STROKES", SWITCHES), ("EDIT", EDITS)):
            column.addWidget(named(QLabel(heading), "caption"))
            for name in names:
                command = settings.command(name)
                item = self.buttons[name] = ToolButton(command.title, command.key)
                item.setToolTip(f"{command.hint} ({command.key})")
                item.setAccessibleName(command.title)
                item.setAccessibleDescription(command.hint)
                item.setCheckable(name not in EDITS)
                item.clicked.connect(partial(self.requested.emit, name))
                column.addWidget(item)
            column.addSpacing(2)
        column.addStretch(1)
        self.setWidget(inner)

    def show_state(self, options: StrokeOptions, enabled: Mapping[str, bool], theme: Theme) -> None:
        """Update which tool buttons are pressed, and which commands are enabled."""
        on = {options.once or options.tool, *(name for name in SWITCHES if getattr(options, name))}
        ratio = self.devicePixelRatioF()
        for name, item in self.buttons.items():
            item.setEnabled(enabled[name])
            item.setCheckable(item.isCheckable() or name == options.once)
            item.setChecked(name in on)
            color = theme.on_accent if name in on else theme.text if enabled[name] else theme.quiet
            drawn = color, theme.on_accent if name in on else theme.quiet, ratio
            # Because drawing all icons anew takes longer than showing a frame.
            if self._drawn.get(name) != drawn:
                self._drawn[name] = drawn
                item.key.setStyleSheet(f"color: {drawn[1]}")
                item.setIcon(icon(name, color, ratio))
