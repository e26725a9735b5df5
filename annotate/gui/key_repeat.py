"""Keys that are held down: their repetitions are told from presses by hand."""

from PySide6.QtCore import QEvent, QObject, Signal
from PySide6.QtGui import QKeyEvent
from PySide6.QtWidgets import QWidget


class HeldKeys(QObject):
    """Keeps from a window what Qt takes for new presses of a key that is held down.

    X11 repeats a held key as a release and a press of the same millisecond. Qt knows them for a repetition by
    reading both at once; a busy machine delivers them one by one, and the second would be a press. No hand is
    so fast. Events without a time pass. repeated: the number of a key of which such a press was kept back.
    """

    repeated = Signal(int)

    def __init__(self, window: QWidget) -> None:
        super().__init__(window)
        self._released = (0, 0)
        window.winId()  # From here on it has a handle, to which all its keys come first.
        window.windowHandle().installEventFilter(self)

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:  # noqa: N802
        """Qt's hook: whether the event goes no further."""
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
