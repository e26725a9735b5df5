"""The bar above the views: the frame, its state, the progress of the set, and the colourings."""

from functools import partial

from PySide6.QtCore import Qt, Signal
from PySide6.QtWidgets import QButtonGroup, QHBoxLayout, QLabel, QSizePolicy, QToolButton, QWidget

from annotate.correction.replay import rejection
from annotate.gui.colors import Colouring, colourings
from annotate.gui.desk import Desk
from annotate.gui.frame_strip import STATE_NAMES, state_color
from annotate.gui.keys import Settings
from annotate.gui.theme import Theme
from annotate.gui.walk import Walk
from annotate.gui.widgets import laid, named

TITLES: dict[Colouring, str] = {
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
        for colouring, title in TITLES.items():
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


def _button(text: str) -> QToolButton:
    button = QToolButton()
    button.setText(text)
    button.setFocusPolicy(Qt.FocusPolicy.NoFocus)
    return button
