"""The tools in a column: one to a key, each with its picture."""

from collections.abc import Callable
from functools import partial

from PySide6.QtCore import QPointF, QRectF, QSize, Qt, Signal
from PySide6.QtGui import QColor, QIcon, QPainter, QPen, QPixmap, QPolygonF
from PySide6.QtWidgets import QHBoxLayout, QLabel, QSizePolicy, QToolButton, QVBoxLayout, QWidget

from annotate.gui.drawing import TOOLS
from annotate.gui.keys import Settings
from annotate.gui.pointing import Pointing
from annotate.gui.theme import Theme, named

SWITCHES = {"through": "Through", "only": "One part", "room": "Room too"}
"""Titles of the switches of ``Pointing``."""
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
ICON = QSize(30, 30)
Draw = Callable[[QPainter], None]


def _piece(painter: QPainter) -> None:
    cells = ((4, 5), (13, 3), (21, 8), (6, 14), (14, 12), (22, 17), (9, 22), (17, 21))
    for i, (x, y) in enumerate(cells):
        shape = QRectF(x, y, 7, 7)
        painter.setOpacity(1.0 if i == 4 else 0.35)
        painter.fillRect(shape, painter.pen().color())
    painter.setOpacity(1)


def _lasso(painter: QPainter) -> None:
    painter.drawEllipse(QRectF(4, 5, 22, 14))
    painter.drawArc(QRectF(7, 15, 10, 12), 60 * 16, -220 * 16)


def _polygon(painter: QPainter) -> None:
    corners = [QPointF(5, 10), QPointF(17, 4), QPointF(26, 13), QPointF(21, 25), QPointF(8, 22)]
    painter.drawPolygon(QPolygonF(corners))
    for corner in corners:
        painter.fillRect(QRectF(corner.x() - 2.5, corner.y() - 2.5, 5, 5), painter.pen().color())


def _rectangle(painter: QPainter) -> None:
    pen = QPen(painter.pen())
    pen.setStyle(Qt.PenStyle.DashLine)
    painter.setPen(pen)
    painter.drawRect(QRectF(5, 7, 20, 16))


def _brush(painter: QPainter) -> None:
    painter.drawLine(QPointF(25, 4), QPointF(14, 17))
    painter.setBrush(painter.pen().color())
    painter.drawEllipse(QPointF(10, 21), 5, 5)


def _through(painter: QPainter) -> None:
    painter.drawRect(QRectF(5, 5, 13, 13))
    pen = QPen(painter.pen())
    pen.setStyle(Qt.PenStyle.DotLine)
    painter.setPen(pen)
    painter.drawRect(QRectF(12, 12, 13, 13))


def _only(painter: QPainter) -> None:
    painter.drawEllipse(QPointF(15, 15), 10, 10)
    painter.setBrush(painter.pen().color())
    painter.drawEllipse(QPointF(15, 15), 4, 4)


def _room(painter: QPainter) -> None:
    painter.drawEllipse(QPointF(15, 9), 4, 4)
    painter.drawArc(QRectF(8, 15, 14, 18), 0, 180 * 16)
    painter.drawPolyline([QPointF(4, 26), QPointF(4, 4), QPointF(26, 4), QPointF(26, 26)])


DRAWN: dict[str, Draw] = {
    "piece": _piece,
    "lasso": _lasso,
    "polygon": _polygon,
    "rectangle": _rectangle,
    "brush": _brush,
    "through": _through,
    "only": _only,
    "room": _room,
}


def icon(name: str, color: str, ratio: float) -> QIcon:
    """A tool's picture in a colour, sharp at a screen's pixel ratio; blank for what has none."""
    pixmap = QPixmap(ICON * ratio)
    pixmap.setDevicePixelRatio(ratio)
    pixmap.fill(Qt.GlobalColor.transparent)
    painter = QPainter(pixmap)
    painter.setRenderHint(QPainter.RenderHint.Antialiasing)
    painter.setPen(QPen(QColor(color), 2))
    if name in DRAWN:
        DRAWN[name](painter)
    painter.end()
    return QIcon(pixmap)


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
        row = QHBoxLayout(self)
        row.setContentsMargins(0, 0, 8, 0)
        row.addWidget(self.key, 0, Qt.AlignmentFlag.AlignRight)


class ToolColumn(QWidget):
    """requested: a button with a command's name was clicked."""

    requested = Signal(str)

    def __init__(self, settings: Settings) -> None:
        super().__init__()
        self.setObjectName("panel")
        self.setFixedWidth(142)
        self._settings = settings
        self._column = QVBoxLayout(self)
        self._column.setContentsMargins(8, 10, 8, 8)
        self._column.setSpacing(4)
        self.buttons: dict[str, ToolButton] = {}
        for heading, titles in (("TOOLS", TITLES), ("STROKES", SWITCHES), ("EDIT", EDITS)):
            self._column.addWidget(named(QLabel(heading), "caption"))
            for name, title in titles.items():
                self._column.addWidget(self._button(name, title))
            self._column.addSpacing(8)
        self._column.addStretch(1)

    def _button(self, name: str, title: str) -> ToolButton:
        button = self.buttons[name] = ToolButton(title, self._settings.key(name))
        button.setToolTip(next(b.description for b in self._settings.bindings if b.name == name))
        button.setCheckable(name not in EDITS)
        button.clicked.connect(partial(self.requested.emit, name))
        return button

    def show_state(self, pointing: Pointing, theme: Theme) -> None:
        """Press the buttons in that are on."""
        on = {pointing.tool, *(name for name in SWITCHES if getattr(pointing, name))}
        for name, button in self.buttons.items():
            button.setChecked(name in on)
            color = theme.on_accent if name in on else theme.text
            button.key.setStyleSheet(f"color: {theme.on_accent if name in on else theme.quiet}")
            # A blank picture keeps the titles of commands in line with those of tools.
            button.setIcon(icon(name, color, self.devicePixelRatioF()))
