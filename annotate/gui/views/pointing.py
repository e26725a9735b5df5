"""The mouse over a view: draws shapes with the left button, and leaves moving the view to the view itself."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from PySide6.QtCore import QEvent, QObject, QPointF, QRectF, Qt, Signal
from PySide6.QtGui import QColor, QMouseEvent, QPainter, QPaintEvent, QPen, QPolygonF, QWheelEvent
from PySide6.QtWidgets import QWidget

from annotate.array_types import UInt8
from annotate.gui.state.drawing import Drawing, Tool
from annotate.gui.widgets.overlay import Veil, draw_scale, draw_words

BRUSH_PX = (3.0, 120.0)
"""Least and greatest radius of the brush in logical pixels. Untuned."""
_MODIFIER = Qt.KeyboardModifier


@dataclass
class Hand:
    """The tool and its settings, shared by all views; see ``Drawing``.

    once: the command that the next click carries out instead, "" for none. ctrl, shift: whether the key is
    held, which turns a switch round for the next stroke.
    """

    tool: Tool = "piece"
    once: str = ""
    radius_px: float = 18.0
    through: bool = False
    only: bool = False
    room: bool = False
    ctrl: bool = False
    shift: bool = False
    color: QColor = field(default_factory=lambda: QColor("white"))

    @property
    def goes_through(self) -> bool:
        """Whether the next stroke goes through the body."""
        return self.through ^ self.ctrl

    @property
    def takes_only(self) -> bool:
        """Whether the next stroke replaces only the part that it starts on."""
        return self.only ^ self.shift

    def hold(self, modifiers: Qt.KeyboardModifier) -> bool:
        """Note the modifier keys that are held; returns whether they are others than before."""
        before = self.ctrl, self.shift
        self.ctrl, self.shift = (
            bool(modifiers & m) for m in (_MODIFIER.ControlModifier, _MODIFIER.ShiftModifier)
        )
        return before != (self.ctrl, self.shift)

    def set_radius(self, radius_px: float) -> None:
        """Change the brush's radius, in logical pixels."""
        self.radius_px = float(np.clip(radius_px, *BRUSH_PX))


class Pointing(QWidget):
    """A layer over a view that draws with the left button; the wheel with Shift sizes the brush.

    It shows the shape being drawn, the brush, a ring at the position in the other view, the outline of what a
    click would take (veil), words on the pixel under the pointer and the scale of the colours, and repaints
    without rendering the view below again. drawn: a finished Drawing. hovered: the pointer's position, or
    None when it left. sampled: a click with Alt, or one with Ctrl and the right button, since many window
    managers take Alt. held: other modifier keys are held than before.
    """

    drawn = Signal(object)
    hovered = Signal(object)
    sampled = Signal()
    held = Signal()

    def __init__(self, view: QWidget, hand: Hand) -> None:
        super().__init__(view)
        self.setAttribute(Qt.WidgetAttribute.WA_TransparentForMouseEvents)
        self.hand = hand
        self.drawing: Drawing | None = None
        self.place: QPointF | None = None
        self._marker: QPointF | None = None
        self._veil: Veil | None = None
        self._words = ""
        self.scale: tuple[str, str, UInt8] | None = None
        self._view = view
        view.setMouseTracking(True)
        view.installEventFilter(self)

    # Showing

    def ring(self, place: QPointF | None) -> None:
        """Ring a position of the view, or none."""
        if place != self._marker:
            self._marker = place
            self.update()

    def show_under_pointer(self, veil: Veil | None, words: str) -> None:
        """Show what a click would take, and what is under the pointer."""
        if veil is not None or self._veil is not None or words != self._words:
            self._veil, self._words = veil, words
            self.update()

    def paintEvent(self, event: QPaintEvent) -> None:  # noqa: N802
        """Qt's hook."""
        painter = QPainter(self)
        draw_scale(painter, QRectF(self.rect()), self.scale)
        draw_words(painter, QRectF(self.rect()), self._words)
        if self._veil and not self.drawing:
            painter.drawImage(self._veil.corner, self._veil.image)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        if self.drawing:
            self._draw_shape(painter, self.drawing)
        radius_px = self.hand.radius_px
        if self.place and self.hand.tool == "brush" and not self.hand.once:
            _stroke(painter, partial(painter.drawEllipse, self.place, radius_px, radius_px))
        if self._marker:
            _stroke(painter, partial(painter.drawEllipse, self._marker, 6, 6))

    def _draw_shape(self, painter: QPainter, drawing: Drawing) -> None:
        points = [QPointF(x, y) for x, y in drawing.outline_px()]
        corners = points
        if drawing.tool == "polygon" and self.place:
            # A rubber band from the last corner to the pointer.
            points = [*points, self.place]
        color = QColor(self.hand.color)
        color.setAlpha(110 if drawing.tool == "brush" else 90)
        if drawing.tool == "brush":
            round_ = Qt.PenCapStyle.RoundCap, Qt.PenJoinStyle.RoundJoin
            painter.setPen(QPen(color, 2 * drawing.radius_px, Qt.PenStyle.SolidLine, *round_))
            painter.drawPolyline(QPolygonF(points)) if len(points) > 1 else painter.drawPoint(points[0])
            return
        painter.setBrush(color)
        _stroke(painter, partial(painter.drawPolygon, QPolygonF(points)))
        if drawing.tool == "polygon":
            for corner in corners:
                _stroke(painter, partial(painter.drawEllipse, corner, 3, 3))

    # Drawing

    def cancel(self) -> bool:
        """Drop the shape being drawn; returns whether there was one."""
        had, self.drawing = self.drawing is not None, None
        self.update()
        return had

    def remove_corner(self) -> bool:
        """Remove the last corner of the polygon being drawn; returns whether any is left."""
        if self.drawing and not self.drawing.without_corner():
            self.drawing = None
        self.update()
        return self.drawing is not None

    def close_polygon(self) -> bool:
        """Finish the polygon being drawn; returns whether it has the corners for that."""
        if self.drawing is None or self.drawing.is_slip:
            return False
        self._finish()
        return True

    def eventFilter(self, view: QObject, event: QEvent) -> bool:  # noqa: N802
        """Qt's hook: true for events that are handled here."""
        kind = event.type()
        if kind == QEvent.Type.Resize:
            self.resize(self._view.size())
            self.show_under_pointer(None, "")
        elif kind == QEvent.Type.Leave:
            self.place = None
            self.update()
            self.hovered.emit(None)
        elif isinstance(event, QMouseEvent):
            return self._mouse(kind, event)
        elif isinstance(event, QWheelEvent) and event.modifiers() & _MODIFIER.ShiftModifier:
            # With Alt, and on some desktops with Shift, Qt turns the wheel sideways.
            turned = event.angleDelta().y() or event.angleDelta().x()
            self.hand.set_radius(self.hand.radius_px * (1.15 if turned > 0 else 1 / 1.15))
            self.update()
            return True
        return False

    def _mouse(self, kind: QEvent.Type, event: QMouseEvent) -> bool:
        self.place = event.position()
        if self.hand.hold(event.modifiers()):
            self.held.emit()
        if kind == QEvent.Type.MouseMove:
            return self._moved(event)
        if samples(event) and kind != QEvent.Type.MouseButtonRelease:
            self.sampled.emit()
            return True
        if event.button() != Qt.MouseButton.LeftButton:
            return False
        polygon = self.drawing is not None and self.drawing.tool == "polygon"
        if kind == QEvent.Type.MouseButtonRelease:
            if not polygon:
                self._finish()
        elif kind == QEvent.Type.MouseButtonDblClick and polygon:
            self._finish()
        else:
            # For every tool but the polygon, the second press of a double click is one like any other.
            self._pressed(event)
        return True

    def _moved(self, event: QMouseEvent) -> bool:
        dragging = bool(event.buttons() & Qt.MouseButton.LeftButton)
        if self.drawing and dragging:
            self.drawing.drag(event.position().x(), event.position().y())
        self.update()
        if not event.buttons():
            self.hovered.emit(self.place)
        return dragging

    def _pressed(self, event: QMouseEvent) -> None:
        x, y, held, hand = event.position().x(), event.position().y(), event.modifiers(), self.hand
        if held & _MODIFIER.AltModifier:
            self.sampled.emit()
        elif self.drawing and self.drawing.tool == "polygon":
            self.drawing.corner(x, y)
        else:
            options = hand.radius_px, hand.goes_through, hand.takes_only, hand.room
            tool: Tool = "piece" if hand.once else hand.tool
            self.drawing = Drawing(tool, (x, y), *options, held_keys=hand.ctrl + hand.shift)
        self.update()

    def _finish(self) -> None:
        drawing, self.drawing = self.drawing, None
        self.update()
        if drawing and not drawing.is_slip:
            self.drawn.emit(drawing)


def samples(event: QMouseEvent) -> bool:
    """Return whether a button is pressed that chooses the part under the pointer, or released again."""
    return event.button() == Qt.MouseButton.RightButton and bool(
        event.modifiers() & _MODIFIER.ControlModifier
    )


def _stroke(painter: QPainter, draw: Callable[[], None]) -> None:
    """A white line on a black one, visible on any ground, filled with the painter's brush."""
    brush = painter.brush()
    painter.setPen(QPen(QColor(0, 0, 0, 200), 4))
    draw()
    painter.setBrush(Qt.BrushStyle.NoBrush)
    painter.setPen(QPen(QColor("white"), 2))
    draw()
    painter.setBrush(brush)
