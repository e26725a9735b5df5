"""The bars of buttons: above the views the frame, its state and the colourings; at their left the tools."""

from functools import partial

from PySide6.QtCore import Qt, Signal
from PySide6.QtWidgets import (
    QButtonGroup,
    QHBoxLayout,
    QLabel,
    QSizePolicy,
    QToolButton,
    QVBoxLayout,
    QWidget,
)

from annotate.correction.replay import rejection
from annotate.gui.colors import Colouring, colourings
from annotate.gui.desk import Desk
from annotate.gui.drawing import TOOLS
from annotate.gui.frame_strip import STATE_NAMES, state_color
from annotate.gui.keys import Settings
from annotate.gui.pointing import Hand
from annotate.gui.theme import Theme
from annotate.gui.walk import Walk
from annotate.gui.widgets import ICON, icon, laid, named

COLOURINGS: dict[Colouring, str] = {
    "part": "Parts",
    "colour": "Colour",
    "temperature": "Heat",
    "confidence": "Confidence",
    "disagreement": "Difference",
}
MISSING: dict[Colouring, str] = {
    "colour": "No colour: give the recording with --session",
    "temperature": "No temperature: give the recording with --session",
    "confidence": "These labels carry no confidence",
    "disagreement": "Nothing to compare: give another label set with --compare",
}
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


class Header(QWidget):
    """coloured: a colouring was clicked. requested: a button with a command's name was."""

    coloured = Signal(str)
    requested = Signal(str)

    def __init__(self, settings: Settings) -> None:
        super().__init__()
        self.setObjectName("panel")
        self.setFixedHeight(48)
        self.frame, self.badge = named(QLabel(), "title"), named(QLabel(), "badge")
        # Plain text: a reason or a name is not markup.
        self.facts = named(QLabel(textFormat=Qt.TextFormat.PlainText), "quiet")
        self.facts.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Preferred)
        key = named(QLabel(settings.key("colouring")), "key")
        row = laid(QHBoxLayout(self), self.frame, self.badge, self.facts, key, gap=8, margins=(14, 0, 12, 0))
        for widget in (self.frame, self.badge, key):
            row.setAlignment(widget, Qt.AlignmentFlag.AlignVCenter)
        row.setStretchFactor(self.facts, 1)
        self.colourings: dict[Colouring, QToolButton] = {}
        group = QButtonGroup(self)
        for colouring, title in COLOURINGS.items():
            button = self.colourings[colouring] = _button(title)
            button.setCheckable(True)
            button.clicked.connect(partial(self.coloured.emit, colouring))
            group.addButton(button)
            row.addWidget(button)
        row.addSpacing(10)
        for name, title in (("order", "Order"), ("theme", "Theme"), ("help", "Keys")):
            button = _button(f"{title}  {settings.key(name)}")
            button.clicked.connect(partial(self.requested.emit, name))
            row.addWidget(button)

    def show_desk(self, desk: Desk, walk: Walk, theme: Theme) -> None:
        """Update the frame's name, state and place, and the colourings."""
        frame_id = desk.scene.labels.frame_id
        state = desk.correction.state(frame_id)
        place = f"{walk.frame_ids.index(frame_id) + 1} of {len(walk.frame_ids)}"
        self.frame.setText(f"Frame {frame_id.lstrip('0') or '0'}")
        self.badge.setText(STATE_NAMES[state])
        color = state_color(state, theme).name()
        self.badge.setStyleSheet(f"color: {color}; border: 1px solid {color}")
        why = rejection(desk.correction.journal.strokes(frame_id))
        facts = [place + (", worst first" if walk.worst_first else ""), f"{walk.done(frame_id)} done"]
        facts.append(f"because: {why}" if why else "")
        facts.append("READ-ONLY" if desk.correction.read_only else f"{desk.correction.who}")
        self.facts.setText("   ·   ".join(filter(None, facts)))
        there = colourings(desk.scene)
        for colouring, button in self.colourings.items():
            button.setEnabled(colouring in there)
            button.setChecked(colouring == desk.colouring)
            button.setToolTip("" if colouring in there else MISSING[colouring])


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


def _button(text: str) -> QToolButton:
    button = QToolButton()
    button.setText(text)
    button.setFocusPolicy(Qt.FocusPolicy.NoFocus)
    return button
