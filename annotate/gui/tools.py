"""The tools in a column: one to a key, each with its picture."""

from functools import partial

from PySide6.QtCore import Qt, Signal
from PySide6.QtWidgets import QHBoxLayout, QLabel, QSizePolicy, QToolButton, QVBoxLayout, QWidget

from annotate.gui.drawing import TOOLS
from annotate.gui.keys import Settings
from annotate.gui.pointing import Hand
from annotate.gui.theme import Theme
from annotate.gui.widgets import ICON, icon, laid, named

SWITCHES = {"through": "Through", "only": "One part", "room": "Room too"}
"""Titles of the switches of ``Hand``."""
EDITS = {
    "undo": "Undo",
    "redo": "Redo",
    "swap": "Swap L/R",
    "neighbour": "Neighbour",
    "merge": "Merge",
    "remove_islands": "Islands",
    "fill_holes": "Holes",
    "copy_previous": "Copy",
    "propagate": "Carry on",
    "carry": "Always carry",
}
"""Titles of the commands; those that work at the pointer's position need their key."""
TITLES = {tool: tool.capitalize() for tool in TOOLS}
ROW_PX = 30
"""Height of a button in logical pixels. Chosen by eye."""


class ToolButton(QToolButton):
    """A row: picture, title, and the key at its right end."""

    def __init__(self, title: str, key: str) -> None:
        super().__init__()
        self.setText(title)
        self.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self.setToolButtonStyle(Qt.ToolButtonStyle.ToolButtonTextBesideIcon)
        self.setIconSize(ICON * 0.7)
        self.setFixedHeight(ROW_PX)
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Fixed)
        self.setStyleSheet("text-align: left; padding: 2px 6px; font-size: 12px")
        self.key = QLabel(key.replace("Ctrl+", "^").replace("Shift+", "\u21e7"))
        self.key.setAttribute(Qt.WidgetAttribute.WA_TransparentForMouseEvents)
        laid(QHBoxLayout(self), None, self.key, margins=(0, 0, 8, 0))


class ToolColumn(QWidget):
    """requested: a button with a command's name was clicked."""

    requested = Signal(str)

    def __init__(self, settings: Settings) -> None:
        super().__init__()
        self.setObjectName("panel")
        self.setFixedWidth(142)
        column = laid(QVBoxLayout(self), gap=4, margins=(8, 10, 8, 8))
        self.buttons: dict[str, ToolButton] = {}
        descriptions = {binding.name: binding.description for binding in settings.bindings}
        for heading, titles in (("TOOLS", TITLES), ("STROKES", SWITCHES), ("EDIT", EDITS)):
            column.addWidget(named(QLabel(heading), "caption"))
            for name, title in titles.items():
                button = self.buttons[name] = ToolButton(title, settings.key(name))
                button.setToolTip(descriptions[name])
                button.setCheckable(name not in EDITS)
                button.clicked.connect(partial(self.requested.emit, name))
                column.addWidget(button)
            column.addSpacing(8)
        column.addStretch(1)

    def show_state(self, hand: Hand, theme: Theme) -> None:
        """Press the buttons in that are on."""
        on = {hand.tool, *(name for name in SWITCHES if getattr(hand, name))}
        for name, button in self.buttons.items():
            button.setChecked(name in on)
            color = theme.on_accent if name in on else theme.text
            button.key.setStyleSheet(f"color: {theme.on_accent if name in on else theme.quiet}")
            # A blank picture keeps the titles of commands in line with those of tools.
            button.setIcon(icon(name, color, self.devicePixelRatioF()))
