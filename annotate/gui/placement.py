"""Placement of a window on its screen, stored with the settings of its views and tools."""

from typing import get_args

from PySide6.QtCore import QEvent, QObject, QSize, QTimer
from PySide6.QtGui import QGuiApplication
from PySide6.QtWidgets import QMainWindow

from annotate.gui.panels.panes import Panes
from annotate.gui.settings import Memory
from annotate.gui.state.drawing import TOOLS
from annotate.gui.state.point_colors import TINTS, Colouring, Look
from annotate.gui.views.view_pair import ViewPair

FRAMED_MS = 200  # delay in which the window manager has framed a new window; untuned
SIZE = QSize(1440, 900)  # of a first window, in logical pixels
LOOKS = {"cloud": Look(), "depth": Look("colour", tint=TINTS[1])}


class Placement(QObject):
    """Position and size of a window, and settings of its views and tools.

    The stored ones are restored at once, and ``remember`` stores the current ones.
    """

    def __init__(self, window: QMainWindow, memory: Memory, views: ViewPair, panes: Panes) -> None:
        super().__init__(window)
        self._window, self._memory, self._views, self._panes = window, memory, views, panes
        options = views.options
        options.tool = memory.choice("tool", TOOLS, options.tool)
        options.set_radius(memory.number("radius_px", options.radius_px))
        for (key, default), view in zip(LOOKS.items(), views, strict=True):
            view.look = Look(
                memory.choice(f"{key}/colouring", get_args(Colouring), default.colouring),
                memory.choice(f"{key}/outlines", (False, True), default.outlines),
                memory.choice(f"{key}/tint", TINTS, default.tint),
            )
        if not window.restoreGeometry(memory.state("geometry")):
            window.resize(SIZE.boundedTo(QGuiApplication.primaryScreen().availableSize()))
        panes.restore(memory)
        window.installEventFilter(self)

    def remember(self) -> None:
        """Store position, size and settings."""
        memory = self._memory
        memory.put("geometry", self._window.saveGeometry())
        memory.put("tool", self._views.options.tool)
        memory.put("radius_px", self._views.options.radius_px)
        for key, view in zip(LOOKS, self._views, strict=True):
            for name in ("colouring", "outlines", "tint"):
                memory.put(f"{key}/{name}", getattr(view.look, name))
        self._panes.remember(memory)
        memory.save()

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:  # noqa: N802
        """Fit the window to the screen once it is shown, because only then its title bar is known (Qt's
        hook).
        """
        if event.type() == QEvent.Type.Show:
            QTimer.singleShot(FRAMED_MS, self, self._fit_screen)
        return False

    def _fit_screen(self) -> None:
        """Shrink and move the window so that its frame lies on the screen."""
        window = self._window
        there, framed = window.screen().availableGeometry(), window.frameGeometry()
        if window.isMaximized() or window.isFullScreen() or there.contains(framed):
            return
        over = (framed.size() - there.size()).expandedTo(QSize(0, 0))
        window.resize(window.size() - over)
        corner = framed.size() - over
        left = min(max(framed.left(), there.left()), there.left() + there.width() - corner.width())
        top = min(max(framed.top(), there.top()), there.top() + there.height() - corner.height())
        window.move(left, top)
