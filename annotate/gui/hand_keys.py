"""Keys held or pressed while a hand draws: they change the stroke or the view, and are no commands."""

from PySide6.QtCore import QEvent, QObject, Qt, QTimer
from PySide6.QtGui import QKeyEvent

from annotate.gui.state.outcome import Done
from annotate.gui.views.pointing import Pointing
from annotate.gui.window_layout import Shell

PEEK_MS = 50
"""Milliseconds from the release of the key for peeking to the return of the parts, because X servers repeat a
held key as a release and a press (untuned)."""
POLYGON_KEYS = (Qt.Key.Key_Return, Qt.Key.Key_Enter, Qt.Key.Key_Backspace)
"""Keys that close a polygon being drawn or remove its last corner, in place of their commands."""
MODIFIERS = {
    Qt.Key.Key_Control: Qt.KeyboardModifier.ControlModifier,
    Qt.Key.Key_Shift: Qt.KeyboardModifier.ShiftModifier,
}
"""Keys that turn a switch of the hand round while they are held."""


class HandKeys(QObject):
    """Keys of a window's hand: those of a begun polygon, Shift and Ctrl, and the key for peeking."""

    def __init__(self, window: Shell) -> None:
        super().__init__(window)
        self._window = window
        self.peek_due = QTimer(self, singleShot=True, interval=PEEK_MS)
        self.peek_due.timeout.connect(lambda: window.peek(False))
        window.installEventFilter(self)

    @property
    def _drawing(self) -> Pointing | None:
        """The layer on which a shape is being drawn."""
        return next((view.pointing for view in self._window.views if view.pointing.drawing), None)

    @property
    def _polygon(self) -> Pointing | None:
        pointing = self._drawing
        return pointing if pointing and pointing.drawing and pointing.drawing.tool == "polygon" else None

    @property
    def shape(self) -> str:
        """Instruction that ends the shape being drawn; "" where none is drawn."""
        if self._polygon:
            return "A polygon is being drawn: Return closes it, Backspace removes a corner, Esc drops it"
        drawing = self._drawing.drawing if self._drawing else None
        return f"A {drawing.tool} is being drawn: release the button, or Esc drops it" if drawing else ""

    def remove_corner(self) -> Done | None:
        """Remove the last corner of the polygon being drawn; None where none is."""
        if self._polygon is None:
            return None
        return Done("Corner removed" if self._polygon.remove_corner() else "Polygon dropped")

    def repeated(self, key: int) -> None:
        """Handle a key that is still held although its release came (``HeldKeys``)."""
        if key == self._peek_key:
            self.peek_due.stop()

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:  # noqa: N802
        """Qt's hook: whether the event goes no further."""
        if event.type() == QEvent.Type.WindowDeactivate:
            self._hold(Qt.KeyboardModifier.NoModifier)
        elif isinstance(event, QKeyEvent) and event.key() in POLYGON_KEYS and self._polygon:
            if event.type() == QEvent.Type.KeyPress:
                erases = event.key() == Qt.Key.Key_Backspace
                if done := self.remove_corner() if erases else self._close_polygon():
                    self._window.status.show_done(done, self._window.theme)
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

    @property
    def _peek_key(self) -> int:
        return int(self._window.actions_by_name["peek"].data())

    def _close_polygon(self) -> Done | None:
        closed = self._polygon is None or self._polygon.close_polygon()
        return None if closed else Done("A polygon needs three corners", "warn")

    def _hold(self, modifiers: Qt.KeyboardModifier) -> None:
        """Note the modifier keys that are held."""
        if self._window.hand.hold(modifiers):
            self._window.show_next()

    def _peek(self, event: QKeyEvent, pressed: bool) -> None:
        if event.key() != self._peek_key:
            return
        if pressed and not self._window.key_page.isVisible():
            self.peek_due.stop()
            self._window.peek(True)
        elif not event.isAutoRepeat():
            self.peek_due.start()
