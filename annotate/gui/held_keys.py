"""Keys that are held down: filter of repetitions, and effect on a stroke and on the view."""

from PySide6.QtCore import QEvent, QObject, Qt, QTimer, Signal
from PySide6.QtGui import QKeyEvent
from PySide6.QtWidgets import QWidget

from annotate.gui.state.outcome import Outcome
from annotate.gui.views.drawing_layer import DrawingLayer
from annotate.gui.views.view_pair import ViewPair

PEEK_MS = 50
"""Delay from the release of the key for peeking, because X servers repeat a held key as release and press."""
POLYGON_KEYS = (Qt.Key.Key_Return, Qt.Key.Key_Enter, Qt.Key.Key_Backspace)
"""Keys that close a polygon being drawn or remove its last corner, in place of their commands."""
MODIFIERS = {
    Qt.Key.Key_Control: Qt.KeyboardModifier.ControlModifier,
    Qt.Key.Key_Shift: Qt.KeyboardModifier.ShiftModifier,
}


class KeyRepeatFilter(QObject):
    """Filter of the presses that repeat a held key.

    X11 repeats a held key as a release and a press of the same millisecond. A busy machine reads the two
    events apart, so Qt takes the second for a press. Events without a time are not filtered. repeated: signal
    with the Qt key whose repetition was filtered out.
    """

    repeated = Signal(int)

    def __init__(self, window: QWidget) -> None:
        super().__init__(window)
        self._released = (0, 0)
        window.winId()  # Creates the handle, to which all keys come first.
        window.windowHandle().installEventFilter(self)

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:  # noqa: N802
        """Filter out a repetition; return whether the event was one (Qt's hook)."""
        if not isinstance(event, QKeyEvent):
            return False
        at = (event.key(), event.timestamp())
        if event.type() == QEvent.Type.KeyRelease:
            self._released = at
        elif event.timestamp() and at == self._released and not event.isAutoRepeat():
            event.accept()
            if event.type() == QEvent.Type.KeyPress:
                self.repeated.emit(event.key())
            return True
        return False


class HeldKeys(QObject):
    """Handler of keys that act while they are held or while a polygon is drawn.

    These are the keys of a polygon, Shift and Ctrl, and the key that hides part colours. peek_key: the last
    of these, set with the commands. said: signal with an outcome to show. changed: signal that the held
    modifiers changed.
    """

    said = Signal(object)
    changed = Signal()

    def __init__(self, window: QWidget, views: ViewPair) -> None:
        super().__init__(window)
        self._views, self.peek_key = views, 0
        self.peek_due = QTimer(self, singleShot=True, interval=PEEK_MS)
        self.peek_due.timeout.connect(lambda: views.peek(False))
        window.installEventFilter(self)

    @property
    def _layer(self) -> DrawingLayer | None:
        """Return the layer on which a shape is being drawn, or None."""
        return next((view.layer for view in self._views if view.layer.drawing), None)

    @property
    def _polygon(self) -> DrawingLayer | None:
        layer = self._layer
        return layer if layer and layer.drawing and layer.drawing.tool == "polygon" else None

    @property
    def shape(self) -> str:
        """Return an instruction for finishing the shape being drawn; "" where none is drawn."""
        if self._polygon:
            return "A polygon is being drawn: Return closes it, Backspace removes a corner, Esc drops it"
        drawing = self._layer.drawing if self._layer else None
        return f"A {drawing.tool} is being drawn: release the button, or Esc drops it" if drawing else ""

    def remove_corner(self) -> Outcome | None:
        """Remove the last corner of the polygon being drawn; None where none is drawn."""
        if self._polygon is None:
            return None
        return Outcome("Corner removed" if self._polygon.remove_corner() else "Polygon dropped")

    def repeated(self, key: int) -> None:
        """Keep the part colours hidden if ``key`` hides them, because auto-repeat made its release."""
        if key == self.peek_key:
            self.peek_due.stop()

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:  # noqa: N802
        """Handle held keys; return whether the event is filtered out (Qt's hook)."""
        if event.type() == QEvent.Type.WindowDeactivate:
            self._hold(Qt.KeyboardModifier.NoModifier)
        elif isinstance(event, QKeyEvent) and event.key() in POLYGON_KEYS and (polygon := self._polygon):
            if event.type() == QEvent.Type.KeyPress:
                if event.key() == Qt.Key.Key_Backspace:
                    self.said.emit(self.remove_corner())
                elif not polygon.close_polygon():
                    self.said.emit(Outcome("A polygon needs three corners", "warn"))
            # Also as a shortcut of something else.
            event.accept()
            return True
        elif isinstance(event, QKeyEvent) and event.type() in (QEvent.Type.KeyPress, QEvent.Type.KeyRelease):
            pressed = event.type() == QEvent.Type.KeyPress
            own = MODIFIERS.get(Qt.Key(event.key()), Qt.KeyboardModifier.NoModifier)
            # Systems differ in whether a modifier's own press and release count it.
            self._hold(event.modifiers() | own if pressed else event.modifiers() & ~own)
            self._peek(event, pressed)
        return False

    def _hold(self, modifiers: Qt.KeyboardModifier) -> None:
        if self._views.options.hold(modifiers):
            self.changed.emit()

    def _peek(self, event: QKeyEvent, pressed: bool) -> None:
        if event.key() != self.peek_key:
            return
        if pressed:
            self.peek_due.stop()
            self._views.peek(True)
        elif not event.isAutoRepeat():
            self.peek_due.start()
