"""Parts of all widgets: layouts, cards, lines of text, and icons of tools and tiles as SVG."""

from html import escape
from typing import TypeVar

from PySide6.QtCore import QRectF, QSize, Qt
from PySide6.QtGui import QColor, QIcon, QPainter, QPainterPath, QPaintEvent, QPen, QPixmap
from PySide6.QtSvg import QSvgRenderer
from PySide6.QtWidgets import QBoxLayout, QFrame, QLabel, QLayout, QSizePolicy, QToolButton, QWidget

from annotate.gui.widgets.theme import Theme

B = TypeVar("B", bound=QBoxLayout)
W = TypeVar("W", bound=QWidget)

ICON = QSize(30, 30)  # of a tool, in logical pixels
_LOCK = '<path d="M3.5 8h10v7.5h-10z" fill="COLOR" stroke-linejoin="round"/>'
_EYE = '<path d="M1.5 10Q8.5 2 15.5 10Q8.5 18 1.5 10"/><circle cx="8.5" cy="10" r="2.2"'
_SHAPES = {
    "piece": '<g fill="COLOR" stroke="none"><path d="M14 12h7v7h-7z"/><path opacity=".35" d="M4 5h7v7h-7z'
    'M13 3h7v7h-7zM21 8h7v7h-7zM6 14h7v7h-7zM22 17h7v7h-7zM9 22h7v7h-7zM17 21h7v7h-7z"/></g>',
    "lasso": '<ellipse cx="15" cy="12" rx="11" ry="7"/><path d="M14.5 15.8A5 6 0 1 1 7.3 23.1"/>',
    "polygon": '<path d="M5 10L17 4L26 13L21 25L8 22Z"/><path fill="COLOR" stroke="none" '
    'd="M2.5 7.5h5v5h-5zM14.5 1.5h5v5h-5zM23.5 10.5h5v5h-5zM18.5 22.5h5v5h-5zM5.5 19.5h5v5h-5z"/>',
    "rectangle": '<path d="M5 7h20v16h-20z" stroke-dasharray="8 4"/>',
    "brush": '<path d="M25 4L14 17"/><circle cx="10" cy="21" r="5" fill="COLOR"/>',
    "through": '<path d="M5 5h13v13h-13z"/><path d="M12 12h13v13h-13z" stroke-dasharray="2 4"/>',
    "only": '<circle cx="15" cy="15" r="10"/><circle cx="15" cy="15" r="4" fill="COLOR"/>',
    "room": '<circle cx="15" cy="9" r="4"/><path d="M22 24A7 9 0 0 0 8 24M4 26V4H26V26"/>',
    "undo": '<path d="M11 5L5 11L11 17"/><path d="M5 11H18A7 6 0 0 1 18 24H11"/>',
    "redo": '<path d="M19 5L25 11L19 17"/><path d="M25 11H12A7 6 0 0 0 12 24H19"/>',
    "swap": '<path d="M4 10H26M20 4L26 10L20 16M26 20H4M10 14L4 20L10 26"/>',
    "neighbour": '<path d="M4 6h10v18h-10z" fill="COLOR" fill-opacity=".4"/><path d="M14 6h12v18h-12z'
    'M10 15H21M17 11L21 15L17 19"/>',
    "merge": '<path d="M4 4h10v10h-10z"/><path d="M16 16h10v10h-10z" fill="COLOR"/><path d="M15 15L19 19"/>',
    "remove_islands": '<ellipse cx="13" cy="17" rx="9" ry="8"/><circle cx="25" cy="6" r="2.5"/>'
    '<path d="M20 2L29 11"/>',
    "fill_holes": '<ellipse cx="15" cy="15" rx="11" ry="10"/><circle cx="16" cy="14" r="4" fill="COLOR"/>',
    "copy_previous": '<path d="M4 8h13v17h-13z" stroke-dasharray="3 3"/><path d="M12 4h14v17h-14z"/>',
    "learn": '<path d="M2 12L15 6L28 12L15 18Z"/><path d="M8 15V22Q15 27 22 22V15M28 12V21"/>',
    "locked": _LOCK + '<path d="M11.5 8A3 4.5 0 0 0 5.5 8"/>',
    "unlocked": _LOCK + '<path d="M14.5 8A3 4.5 0 0 0 8.5 8"/>',
    "shown": _EYE + ' fill="COLOR"/>',
    "faded": _EYE + "/>",
    "hidden": _EYE + ' fill="COLOR"/><path d="M2.5 16L14.5 4"/>',
}


def named(widget: W, name: str) -> W:
    """Set a widget's name, which the style sheet refers to, and return the widget."""
    widget.setObjectName(name)
    return widget


def laid(
    layout: B,
    *items: QWidget | QLayout | int | None,
    gap: int = 0,
    margins: tuple[int, int, int, int] = (0, 0, 0, 0),
) -> B:
    """Fill a layout with widgets, layouts, spaces in logical pixels, and None for a stretch; return it.

    margins: left, top, right, bottom.
    """
    layout.setSpacing(gap)
    layout.setContentsMargins(*margins)
    for item in items:
        if isinstance(item, QWidget):
            layout.addWidget(item)
        elif isinstance(item, QLayout):
            layout.addLayout(item)
        elif item is None:
            layout.addStretch(1)
        else:
            layout.addSpacing(item)
    return layout


class Elided(QLabel):
    """Label of one line that shortens its text with an ellipsis; its tool tip holds the whole text."""

    def __init__(self) -> None:
        super().__init__(textFormat=Qt.TextFormat.PlainText)
        self.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Preferred)

    @property
    def shown(self) -> str:
        """Return the visible part of the text, with the ellipsis."""
        room = self.contentsRect().width()
        return self.fontMetrics().elidedText(self.text(), Qt.TextElideMode.ElideRight, room)

    def setText(self, text: str) -> None:  # noqa: N802
        """Set the text and its tool tip (Qt's setter)."""
        super().setText(text)
        # Always as rich text, because Qt otherwise guesses by the contents.
        self.setToolTip(f"<span>{escape(text, quote=False)}</span>" if text else "")

    def paintEvent(self, event: QPaintEvent) -> None:  # noqa: N802
        """Draw the text with an ellipsis (Qt's hook)."""
        painter = QPainter(self)
        painter.setPen(self.palette().color(self.foregroundRole()))
        painter.drawText(self.contentsRect(), self.alignment(), self.shown)


def line(vertical: bool = False) -> QFrame:
    """Return a thin line between areas."""
    made = named(QFrame(), "line")
    if vertical:
        made.setStyleSheet("max-height: 100000px; min-width: 1px; max-width: 1px")
    return made


def button(text: str) -> QToolButton:
    """Return a text button that never takes the keyboard focus."""
    made = QToolButton()
    made.setText(text)
    made.setFocusPolicy(Qt.FocusPolicy.NoFocus)
    return made


def draw_card(
    painter: QPainter, place: QRectF, theme: Theme, chosen: bool, stripe: QColor | None = None
) -> None:
    """Draw a raised area with round corners, with an accent if it is chosen. stripe: colour of its edge."""
    painter.setRenderHints(QPainter.RenderHint.Antialiasing | QPainter.RenderHint.SmoothPixmapTransform)
    path = QPainterPath()
    path.addRoundedRect(place, 8, 8)
    painter.fillPath(path, QColor(theme.raised))
    if stripe:
        painter.setClipPath(path)
        painter.fillRect(QRectF(place.left(), place.top(), 6, place.height()), stripe)
        painter.setClipping(False)
    painter.setPen(QPen(QColor(theme.accent if chosen else theme.line), 2.5 if chosen else 1))
    painter.drawPath(path)


def icon(name: str, color: str, ratio: float) -> QIcon:
    """Return the icon of a tool in a colour. ratio: the screen's pixel ratio."""
    pixmap = QPixmap(ICON * ratio)
    pixmap.setDevicePixelRatio(ratio)
    pixmap.fill(Qt.GlobalColor.transparent)
    painter = QPainter(pixmap)
    draw_icon(painter, QRectF(0, 0, ICON.width(), ICON.height()), name, color, 2.0)
    painter.end()
    return QIcon(pixmap)


def draw_icon(painter: QPainter, place: QRectF, name: str, color: str, line_px: float) -> None:
    """Draw the icon of a tool, a lock or an eye, each 18 x 20 logical pixels."""
    shapes = _SHAPES.get(name, "").replace("COLOR", color)
    box = f'viewBox="0 0 {place.width():g} {place.height():g}"'
    style = f'fill="none" stroke="{color}" stroke-width="{line_px}"'
    svg = f'<svg xmlns="http://www.w3.org/2000/svg" {box} {style}>{shapes}</svg>'
    QSvgRenderer(svg.encode()).render(painter, place)
