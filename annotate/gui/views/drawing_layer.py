"""Layer over a view for drawing shapes with the left button; the view itself handles its own movement."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from PySide6.QtCore import QEvent, QObject, QPointF, QRectF, Qt, Signal
from PySide6.QtGui import QColor, QMouseEvent, QPainter, QPaintEvent, QPen, QPolygonF, QWheelEvent
from PySide6.QtWidgets import QWidget

from annotate.array_types import UInt8
from annotate.gui.state.drawing import Drawing, Tool
from annotate.gui.widgets.overlay import Outline, draw_scale, draw_words
from annotate.gui.widgets.witness import Witness, draw_witness

BRUSH_PX = (3.0, 120.0)  # least and greatest radius of the brush in logical pixels; untuned
_MODIFIER = Qt.KeyboardModifier


@dataclass
class StrokeOptions:
    """Tool and switches of the next stroke, shared by all views; see ``Drawing``.

    once: command that the next click carries out instead, "" for none. ctrl, shift: True while the key is
    held, which inverts a switch for the next stroke.
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
        """Return True if the next stroke also selects hidden points."""
        return self.through ^ self.ctrl

    @property
    def takes_only(self) -> bool:
        """Return True if the next stroke replaces only the part under its start."""
        return self.only ^ self.shift

    def hold(self, modifiers: Qt.KeyboardModifier) -> bool:
        """Store the modifier keys that are held; return whether they changed."""
        before = self.ctrl, self.shift
        self.ctrl, self.shift = (
            bool(modifiers & m) for m in (_MODIFIER.ControlModifier, _MODIFIER.ShiftModifier)
        )
        return before != (self.ctrl, self.shift)

    def set_radius(self, radius_px: float) -> None:
        """Change the brush's radius, in logical pixels."""
        self.radius_px = float(np.clip(radius_px, *BRUSH_PX))


class DrawingLayer(QWidget):
    """Transparent layer over a view; it repaints without rendering the view again.

    The layer shows the shape being drawn, the brush, a ring at the position in the other view, and the
    outline of a click. The corners show text on the pixel and the scale of colours. Signals: drawn, with a
    finished Drawing; hovered, with the position of the pointer, or None when it left; held, when other
    modifier keys are held; sampled, on a click with Alt, or with Ctrl and the right button, because window
    managers take Alt.
    """

    drawn = Signal(object)
    hovered = Signal(object)
    sampled = Signal()
    held = Signal()

    def __init__(self, view: QWidget, options: StrokeOptions) -> None:
        super().__init__(view)
        self.setAttribute(Qt.WidgetAttribute.WA_TransparentForMouseEvents)
        self.options = options
        self.drawing: Drawing | None = None
        self.place: QPointF | None = None
        self._marker: QPointF | None = None
        self._outline: Outline | None = None
        self._words = ""
        self.scale: tuple[str, str, UInt8] | None = None
        self.witness: Callable[[], Witness | None] = lambda: None
        self._view = view
        view.setMouseTracking(True)
        view.installEventFilter(self)

    def ring(self, place: QPointF | None) -> None:
        """Draw a ring at a position of the view; None removes it."""
        if place != self._marker:
            self._marker = place
            self.update()

    def show_under_pointer(self, outline: Outline | None, words: str) -> None:
        """Show the outline of a click's effect, and text on the pixel under the pointer."""
        if outline is not None or self._outline is not None or words != self._words:
            self._outline, self._words = outline, words
            self.update()

    def paintEvent(self, event: QPaintEvent) -> None:  # noqa: N802
        """Draw the shape, marks, text and scale (Qt's hook)."""
        painter = QPainter(self)
        draw_scale(painter, QRectF(self.rect()), self.scale)
        draw_words(painter, QRectF(self.rect()), self._words)
        if witness := self.witness():
            draw_witness(painter, witness)
        if self._outline and not self.drawing:
            painter.drawImage(self._outline.corner, self._outline.image)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        if self.drawing:
            self._draw_shape(painter, self.drawing)
        radius_px = self.options.radius_px
        if self.place and self.options.tool == "brush" and not self.options.once:
            _stroke(painter, partial(painter.drawEllipse, self.place, radius_px, radius_px))
        if self._marker:
            _stroke(painter, partial(painter.drawEllipse, self._marker, 6, 6))

    def _draw_shape(self, painter: QPainter, drawing: Drawing) -> None:
        points = [QPointF(x, y) for x, y in drawing.outline_px()]
        corners = points
        if drawing.tool == "polygon" and self.place:
            # A rubber band from the last corner to the pointer.
            points = [*points, self.place]
        color = QColor(self.options.color)
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

    def cancel(self) -> bool:
        """Drop the shape being drawn; return whether there was one."""
        had, self.drawing = self.drawing is not None, None
        self.update()
        return had

    def remove_corner(self) -> bool:
        """Remove the last corner of the polygon being drawn; return whether any is left."""
        if self.drawing and not self.drawing.without_corner():
            self.drawing = None
        self.update()
        return self.drawing is not None

    def close_polygon(self) -> bool:
        """Finish the polygon being drawn; return whether it has enough corners."""
        if self.drawing is None or self.drawing.is_slip:
            return False
        self._finish()
        return True

    def eventFilter(self, view: QObject, event: QEvent) -> bool:  # noqa: N802
        """Draw with the mouse over the view; return whether the event is filtered out (Qt's hook)."""
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
            self.options.set_radius(self.options.radius_px * (1.15 if turned > 0 else 1 / 1.15))
            self.update()
            return True
        return False

    def _mouse(self, kind: QEvent.Type, event: QMouseEvent) -> bool:
        self.place = event.position()
        if self.options.hold(event.modifiers()):
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
        x, y, options = event.position().x(), event.position().y(), self.options
        if event.modifiers() & _MODIFIER.AltModifier:
            self.sampled.emit()
        elif self.drawing and self.drawing.tool == "polygon":
            self.drawing.corner(x, y)
        else:
            tool: Tool = "piece" if options.once else options.tool
            switches = options.goes_through, options.takes_only, options.room
            held_keys = options.ctrl + options.shift
            self.drawing = Drawing(tool, (x, y), options.radius_px, *switches, held_keys=held_keys)
        self.update()

    def _finish(self) -> None:
        drawing, self.drawing = self.drawing, None
        self.update()
        if drawing and not drawing.is_slip:
            self.drawn.emit(drawing)


def samples(event: QMouseEvent) -> bool:
    """Return whether an event is the click that chooses the part under the pointer."""
    return event.button() == Qt.MouseButton.RightButton and bool(
        event.modifiers() & _MODIFIER.ControlModifier
    )


def _stroke(painter: QPainter, draw: Callable[[], None]) -> None:
    """Call ``draw`` with a black pen, then with a thinner white one, visible on any background.

    The painter's brush fills the shape.
    """
    brush = painter.brush()
    painter.setPen(QPen(QColor(0, 0, 0, 200), 4))
    draw()
    painter.setBrush(Qt.BrushStyle.NoBrush)
    painter.setPen(QPen(QColor("white"), 2))
    draw()
    painter.setBrush(brush)
