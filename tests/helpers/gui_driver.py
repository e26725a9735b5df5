"""Drive the correction window by mouse and key events, with places in the depth image."""

import ctypes
import ctypes.util
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PySide6.QtCore import QPoint, QPointF, Qt, QTimer
from PySide6.QtGui import QCursor, QKeySequence
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QLabel, QPushButton

from annotate.correction.correction import Correction
from annotate.gui.commands import bind
from annotate.gui.placement import LOOKS
from annotate.gui.state.keys import Settings, commands_of
from annotate.gui.state.point_colors import Look
from annotate.gui.state.scene import SceneReader
from annotate.gui.views.cloud_view import CloudView
from annotate.gui.views.drawing_layer import StrokeOptions
from annotate.gui.window import CorrectionWindow
from annotate.labelset.stroke import Stroke

NO_MODIFIER = Qt.KeyboardModifier.NoModifier
SHIFT = Qt.KeyboardModifier.ShiftModifier
CTRL = Qt.KeyboardModifier.ControlModifier
ALT = Qt.KeyboardModifier.AltModifier


class Driver:
    """Window on a label set, and a person at mouse and keys. said: last outcome in the status line."""

    def __init__(self, path: Path, session: Path | None = None, **options) -> None:
        settings = options.pop("settings", None)
        other, memory = options.pop("other", None), options.pop("memory", None)
        size = options.pop("size", (1000, 760))
        self._begun: dict[str, int] = {}
        self.correction = Correction.open(path, options.pop("who", "mia"), **options)
        settings = settings or Settings("dark", commands_of(self.correction.labels.scheme))
        reader = SceneReader(self.correction, session, other)
        self.window = CorrectionWindow(self.correction, reader, settings, memory)
        bind(self.window)
        self.panels, self.views, self.edits = self.window.panels, self.window.views, self.window.edits
        if size:
            self.window.resize(*size)
        # The screen's own pointer, under the window, would interfere.
        QCursor.setPos(self.window.width() + 200, self.window.height() + 200)
        self.window.show()
        self.window.activateWindow()
        assert QTest.qWaitForWindowActive(self.window)
        self.settle()

    def start_again(self) -> None:
        """Restore the state of a new window, and take back all strokes and verdicts."""
        window, first = self.window, self.window.frames.all_ids[0]
        window.frames.arrange("time", "all", window.frame_id)
        for frame_id in window.frames.all_ids:
            if len(self.correction.journal.strokes(frame_id)) > self._begun.get(frame_id, 0):
                window.open_frame(frame_id)
                self.settle()
                while window.edits.frame.editor.undo():
                    pass
        window.open_frame(first)
        self.settle()
        assert window.frame_id == first
        fresh = StrokeOptions()
        for name in ("tool", "once", "radius_px", "through", "only", "room"):
            setattr(window.options, name, getattr(fresh, name))
        edits = window.edits
        edits.display.alone = edits.display.onion = False
        edits.display.visibility.clear()
        edits.locks.clear()
        window.arrange("time", "all")
        window.choose(1)
        for view, look in zip(window.views, LOOKS.values(), strict=True):
            view.look = look
        edits.open(edits.frame)
        window.views.cloud.look_ahead()
        window.views.depth.fit()
        window.show_frame()
        self.settle()
        self._begun = {i: len(self.correction.journal.strokes(i)) for i in window.frames.all_ids}

    def strokes(self) -> list[Stroke]:
        """The entries on the open frame since the test began."""
        frame_id = self.window.frame_id
        return list(self.correction.journal.strokes(frame_id)[self._begun[frame_id] :])

    def look(self, colouring: str, view=None, **options) -> None:
        """Choose a view's colouring."""
        view = view or self.window.views.cloud
        self.window.views.set_look(view, Look(colouring, **options))
        self.settle()

    @property
    def said(self) -> str:
        return self.window.panels.status.last.text()

    @property
    def parts(self) -> NDArray[np.uint8]:
        return self.window.edits.parts

    def settle(self) -> None:
        """Let all due work happen: beside the window, events, timers at once, repaints."""
        while self.window.background.busy:
            QApplication.processEvents()
            time.sleep(0.002)
        for _ in range(3):
            QApplication.processEvents()

    def key(self, name: str) -> None:
        """Press the key that a binding has."""
        self.press(self.window.settings.key(name))

    def press(self, sequence: str) -> None:
        """Press a key such as "Ctrl+Z"."""
        if not self.window.isActiveWindow():
            # A screen without a window manager does not give the focus back after a dialog.
            self.window.activateWindow()
            assert QTest.qWaitForWindowActive(self.window)
        combination = QKeySequence(sequence)[0]
        QTest.keyClick(self.window, combination.key(), combination.keyboardModifiers())
        self.settle()

    def hold(self, keysym: int, seconds: float) -> None:
        """Hold a key down, as its number in X11's keysymdef.h, so that the screen repeats it."""
        names = [ctypes.util.find_library(name) for name in ("X11", "Xtst")]
        if not all(names):
            pytest.skip("no libXtst to hold a key with: apt install libxtst6")
        x11, test = map(ctypes.CDLL, names)
        x11.XOpenDisplay.restype = ctypes.c_void_p
        display = ctypes.c_void_p(x11.XOpenDisplay(None))
        code = x11.XKeysymToKeycode(display, keysym)
        for pressed, until in ((1, seconds), (0, 0.1)):
            test.XTestFakeKeyEvent(display, code, pressed, 0)
            x11.XFlush(display)
            end = time.monotonic() + until
            while time.monotonic() < end:
                QApplication.processEvents()
                time.sleep(0.01)
        x11.XCloseDisplay(display)
        self.settle()

    def place(self, pixel: int, view=None) -> QPoint:
        """Return the place of a pixel on a view's widget."""
        view = view or self.window.views.cloud
        if isinstance(view, CloudView):
            x, y = view.view().xy_px[pixel]
            return QPoint(round(float(x)), round(float(y)))
        return view.place_of(pixel).toPoint()

    def on_window(self, place: QPoint | QPointF, view=None) -> QPoint:
        """Return a place of a view as one of the window, to which all events are sent."""
        view = view or self.window.views.cloud
        canvas = view.plotter if isinstance(view, CloudView) else view
        return canvas.mapTo(self.window, QPointF(place).toPoint())

    def hover(self, place: QPoint, view=None) -> None:
        handle, point = self.window.windowHandle(), self.on_window(place, view)
        # A pointer that is there already would not move.
        QTest.mouseMove(handle, point + QPoint(1, 0))
        QTest.mouseMove(handle, point)
        self.settle()

    def click(self, place: QPoint, modifier=NO_MODIFIER, view=None) -> None:
        self.hover(place, view)
        handle, point = self.window.windowHandle(), self.on_window(place, view)
        QTest.mouseClick(handle, Qt.MouseButton.LeftButton, modifier, point)
        self.settle()

    def double_click(self, place: QPoint, view=None) -> None:
        handle, point = self.window.windowHandle(), self.on_window(place, view)
        QTest.mouseDClick(handle, Qt.MouseButton.LeftButton, NO_MODIFIER, point)
        self.settle()

    def drag(
        self,
        places: Sequence[QPoint | QPointF],
        modifier=NO_MODIFIER,
        view=None,
        button=Qt.MouseButton.LeftButton,
    ) -> None:
        """Press at the first place, move through all, release at the last."""
        self.press_and_draw(places, modifier, view, button)()
        self.settle()

    def press_and_draw(
        self,
        places: Sequence[QPoint | QPointF],
        modifier=NO_MODIFIER,
        view=None,
        button=Qt.MouseButton.LeftButton,
    ) -> Callable[[], None]:
        """Do as ``drag`` without the release, which is returned."""
        handle, points = self.window.windowHandle(), [self.on_window(p, view) for p in places]
        QTest.mouseMove(handle, points[0])
        QTest.mousePress(handle, button, modifier, points[0])
        for point in points[1:]:
            QTest.mouseMove(handle, point)
        return lambda: QTest.mouseRelease(handle, button, modifier, points[-1])

    def circle(self, middle: QPoint, radius: float) -> list[QPoint]:
        """Return places round a place."""
        angles = np.linspace(0, 2 * np.pi, 20)
        return [middle + QPointF(radius * np.cos(a), radius * np.sin(a)).toPoint() for a in angles]

    def middle_of(self, part: int) -> int:
        """Return a pixel in the middle of a part."""
        pixels = np.flatnonzero(self.parts.ravel() == part)
        v, u = np.divmod(pixels, self.parts.shape[1])
        return int(pixels[np.hypot(v - np.median(v), u - np.median(u)).argmin()])

    def picture(self) -> NDArray[np.uint8]:
        """Return the picture of the 3D view (h, w, 3)."""
        self.settle()
        return np.asarray(self.window.views.cloud.plotter.screenshot(return_img=True))

    def close(self) -> None:
        self.settle()
        self.window.close()
        self.window.deleteLater()
        self.settle()


def answering(text: str) -> Callable[[], list[str]]:
    """Click the button that begins with ``text`` in the next dialog; return its texts, once it has come."""
    said: list[str] = []

    def click() -> None:
        dialog = QApplication.activeModalWidget()
        if dialog is None:
            QTimer.singleShot(50, click)
            return
        said.extend(label.text() for label in dialog.findChildren(QLabel))
        next(b for b in dialog.findChildren(QPushButton) if b.text().startswith(text)).click()

    QTimer.singleShot(50, click)
    return lambda: said
