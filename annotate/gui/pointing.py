"""The mouse over a view: draws shapes with the left button, and leaves moving the view to the view itself."""

from collections.abc import Callable
from functools import partial

import numpy as np
from PySide6.QtCore import QEvent, QObject, QPointF, Qt, Signal
from PySide6.QtGui import QColor, QMouseEvent, QPainter, QPaintEvent, QPen, QPolygonF, QWheelEvent
from PySide6.QtWidgets import QWidget

from annotate.gui.drawing import Drawing, Tool

BRUSH_PX = (3.0, 120.0)
"""Least and greatest radius of the brush in logical pixels. Chosen by eye."""
_MODIFIER = Qt.KeyboardModifier


class Overlay(QWidget):
    """A layer over a view: the shape being drawn, the brush, and a ring at the position in the other view.

    It repaints without rendering the view below again.
    """

    def __init__(self, view: QWidget) -> None:
        super().__init__(view)
        self.setAttribute(Qt.WidgetAttribute.WA_TransparentForMouseEvents)
        self.drawing: Drawing | None = None
        self.brush: tuple[QPointF, float] | None = None
        self.marker: QPointF | None = None
        self.color = QColor("white")

    def ring(self, place: QPointF | None) -> None:
        """Ring a position of the view, or none."""
        if place != self.marker:
            self.marker = place
            self.update()

    def paintEvent(self, event: QPaintEvent) -> None:  # noqa: N802
        """Qt's hook."""
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        if self.drawing:
            self._draw_shape(painter, self.drawing)
        if self.brush:
            self._stroke(painter, partial(painter.drawEllipse, self.brush[0], self.brush[1], self.brush[1]))
        if self.marker:
            self._stroke(painter, partial(painter.drawEllipse, self.marker, 6, 6))

    def _draw_shape(self, painter: QPainter, drawing: Drawing) -> None:
        points = [QPointF(x, y) for x, y in drawing.outline_px()]
        if drawing.tool == "brush":
            color = QColor(self.color)
            color.setAlpha(110)
            round_ = Qt.PenCapStyle.RoundCap, Qt.PenJoinStyle.RoundJoin
            painter.setPen(QPen(color, 2 * drawing.radius_px, Qt.PenStyle.SolidLine, *round_))
            painter.drawPolyline(QPolygonF(points)) if len(points) > 1 else painter.drawPoint(points[0])
            return
        fill = QColor(self.color)
        fill.setAlpha(90)
        painter.setBrush(fill)
        self._stroke(painter, partial(painter.drawPolygon, QPolygonF(points)))
        if drawing.tool == "polygon":
            for corner in points:
                self._stroke(painter, partial(painter.drawEllipse, corner, 3, 3))

    def _stroke(self, painter: QPainter, draw: Callable[[], None]) -> None:
        """A white line on a black one, visible on any ground, filled with the painter's brush."""
        brush = painter.brush()
        painter.setPen(QPen(QColor(0, 0, 0, 200), 4))
        draw()
        painter.setBrush(Qt.BrushStyle.NoBrush)
        painter.setPen(QPen(QColor("white"), 2))
        draw()
        painter.setBrush(brush)


class Pointing(QObject):
    """Filters a view's mouse events. The left button draws; the wheel with Shift sizes the brush.

    drawn: a finished Drawing. hovered: the pointer's position, or None when it left. sampled: Alt+click.
    """

    drawn = Signal(object)
    hovered = Signal(object)
    sampled = Signal(object)
    resized = Signal(float)

    def __init__(self, view: QWidget) -> None:
        super().__init__(view)
        self.tool: Tool = "piece"
        self.radius_px = 18.0
        self.through = self.only = self.room = False
        self.overlay = Overlay(view)
        self.place: QPointF | None = None
        self._view = view
        view.setMouseTracking(True)
        view.installEventFilter(self)

    def cancel(self) -> bool:
        """Drop the shape being drawn; returns whether there was one."""
        had, self.overlay.drawing = self.overlay.drawing is not None, None
        self.overlay.update()
        return had

    def set_tool(self, tool: Tool) -> None:
        """Change the tool; a shape begun with another one is dropped."""
        self.cancel()
        self.tool = tool
        self._show_brush()

    def set_radius(self, radius_px: float) -> None:
        """Change the brush's radius, in logical pixels."""
        self.radius_px = float(np.clip(radius_px, *BRUSH_PX))
        self._show_brush()

    def eventFilter(self, view: QObject, event: QEvent) -> bool:  # noqa: N802
        """Qt's hook: true for events that are handled here."""
        kind = event.type()
        if kind == QEvent.Type.Resize:
            self.overlay.resize(self._view.size())
        elif kind == QEvent.Type.Leave:
            self.place = None
            self._show_brush()
            self.hovered.emit(None)
        elif isinstance(event, QMouseEvent):
            return self._mouse(kind, event)
        elif isinstance(event, QWheelEvent) and event.modifiers() & _MODIFIER.ShiftModifier:
            # With Alt, and on some desktops with Shift, Qt turns the wheel sideways.
            turned = event.angleDelta().y() or event.angleDelta().x()
            self.resized.emit(self.radius_px * (1.15 if turned > 0 else 1 / 1.15))
            return True
        return False

    def _mouse(self, kind: QEvent.Type, event: QMouseEvent) -> bool:
        self.place = event.position()
        left = event.button() == Qt.MouseButton.LeftButton
        if kind == QEvent.Type.MouseMove:
            return self._moved(event)
        if kind == QEvent.Type.MouseButtonPress and left:
            self._pressed(event)
        elif kind == QEvent.Type.MouseButtonRelease and left:
            if self.overlay.drawing and self.overlay.drawing.tool != "polygon":
                self._finish()
        elif kind == QEvent.Type.MouseButtonDblClick and left:
            self._double_clicked(event)
        else:
            return False
        return True

    def _moved(self, event: QMouseEvent) -> bool:
        drawing, place = self.overlay.drawing, event.position()
        dragging = bool(event.buttons() & Qt.MouseButton.LeftButton)
        if drawing and dragging:
            drawing.drag(place.x(), place.y())
        self._show_brush()
        if not event.buttons():
            self.hovered.emit(self.place)
        return dragging

    def _pressed(self, event: QMouseEvent) -> None:
        x, y, held = event.position().x(), event.position().y(), event.modifiers()
        if held & _MODIFIER.AltModifier:
            self.sampled.emit(event.position())
        elif self.overlay.drawing and self.tool == "polygon":
            self.overlay.drawing.corner(x, y)
        else:
            ctrl, shift = (bool(held & m) for m in (_MODIFIER.ControlModifier, _MODIFIER.ShiftModifier))
            through, only = self.through ^ ctrl, self.only ^ shift
            self.overlay.drawing = Drawing(
                self.tool, (x, y), self.radius_px, through, only, self.room, held_keys=ctrl + shift
            )
        self.overlay.update()

    def _double_clicked(self, event: QMouseEvent) -> None:
        """Close a polygon; for every other tool the second press is a press like any other."""
        if self.tool == "polygon" and self.overlay.drawing:
            self._finish()
        else:
            self._pressed(event)

    def _finish(self) -> None:
        drawing, self.overlay.drawing = self.overlay.drawing, None
        self.overlay.update()
        if drawing and not drawing.is_slip:
            self.drawn.emit(drawing)

    def _show_brush(self) -> None:
        shown = self.tool == "brush" and self.place is not None
        self.overlay.brush = (self.place, self.radius_px) if shown and self.place else None
        self.overlay.update()
