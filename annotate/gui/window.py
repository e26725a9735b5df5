"""The correction window: lays out the views and carries what happens in one of them to the others."""

from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray
from PySide6.QtCore import QPointF, Qt
from PySide6.QtGui import QCloseEvent, QColor, QKeySequence, QResizeEvent, QShortcut
from PySide6.QtWidgets import QApplication, QFrame, QHBoxLayout, QMainWindow, QSplitter, QVBoxLayout, QWidget

from annotate.correction.correction import Correction
from annotate.gui import review
from annotate.gui.cloud_view import CloudView
from annotate.gui.colors import Colouring
from annotate.gui.commands import STROKE_SETUP, commands
from annotate.gui.depth_pane import DepthPane
from annotate.gui.desk import NOTHING, Desk, Done
from annotate.gui.drawing import Drawing, Tool
from annotate.gui.frame_strip import FrameStrip
from annotate.gui.header import Header
from annotate.gui.hints import KeyPage, StatusLine, next_click
from annotate.gui.keys import Settings
from annotate.gui.palette import Palette
from annotate.gui.scene import SceneReader
from annotate.gui.theme import DARK, LIGHT, named, part_color, qt_palette, style_sheet, theme_of
from annotate.gui.tools import ToolColumn
from annotate.gui.walk import Walk
from annotate.labelset.journal import NotSavedError
from annotate.parts import PARTS
from sensors.errors import CloudError


class CorrectionWindow(QMainWindow):
    """Corrects one label set, which it closes with itself.

    Raises CloudError when none of its frames can be opened.
    """

    def __init__(self, correction: Correction, reader: SceneReader, settings: Settings) -> None:
        super().__init__()
        self.correction, self.settings = correction, settings
        self.walk = Walk(correction, reader, lambda error: review.ask_restore(None, error))
        self.desk = Desk(correction, *self.walk.first())
        self.theme = theme_of(settings.theme)
        # Before there are widgets: styling them one by one is quicker than all at once.
        self._style_app()
        self._told_unsaved = False
        self.cloud_view, self.depth_pane = CloudView(), DepthPane()
        self.views = (self.cloud_view, self.depth_pane)
        self.tools, self.palette_, self.header = ToolColumn(settings), Palette(settings), Header(settings)
        self.strip, self.status = FrameStrip(correction.frame, correction.state), StatusLine()
        self._central = self._lay_out()
        self.key_page = KeyPage(self._central, settings)
        self.commands = commands(self)
        self._bind()
        self._connect()
        self.setWindowTitle(f"{correction.labels.path.resolve().name} - annotate-cloud")
        self.resize(1440, 900)
        self.strip.frames.order(self.walk.frame_ids)
        self.choose(self.desk.part)
        self._show_theme()
        self.show_frame()

    # Frames

    @property
    def frame_id(self) -> str:
        """The frame that is open."""
        return self.desk.scene.labels.frame_id

    def open_frame(self, frame_id: str) -> bool:
        """Open another frame; says whether it could be."""
        left = self.frame_id
        if frame_id == left:
            return True
        try:
            self.desk.put(*self.walk.open(frame_id))
        except CloudError as error:
            self.strip.choose(left)
            self.say(Done(NOTHING, str(error), "bad"))
            return False
        self.strip.frames.refresh(left)
        self.show_frame()
        return True

    def step(self, by: int) -> bool:
        """Open the frame ``by`` places on; says whether there is one that can be opened."""
        frame_id = self.walk.beside(self.frame_id, by)
        return frame_id is not None and self.open_frame(frame_id)

    def reorder(self) -> Done:
        """By time, or the worst first."""
        self.walk.reorder()
        self.strip.frames.order(self.walk.frame_ids)
        self.strip.choose(self.frame_id)
        return Done(NOTHING, "Frames: the worst first" if self.walk.worst_first else "Frames by time")

    # What is shown

    def show_frame(self) -> None:
        """Show the frame on the desk everywhere."""
        for view in self.views:
            view.pointing.cancel()
            view.load(self.desk.scene, self.colors, self.desk.shown())
        self.strip.choose(self.frame_id)
        self.refresh()
        self.say(Done(NOTHING, self.desk.scene.remark, "warn"))

    def colors(self, pixels: NDArray[np.int64]) -> NDArray[np.uint8]:
        """Colours (n, 3) of flat pixels (n,) at this moment."""
        return self.desk.colors(pixels, self.theme.ground_rgb)

    def recolor(self, pixels: NDArray[np.int64] | None = None) -> None:
        """Show new colours of some pixels, or of all."""
        for view in self.views:
            view.recolor(pixels, self.colors)
        if self.desk.alone or self.desk.visibility:
            self._show_shown()

    def reshow(self) -> None:
        """After a change of what is faded or hidden."""
        self._show_shown()
        self.recolor()

    def refresh(self) -> None:
        """Palette, tools, header and sentences as things stand."""
        desk, pointing = self.desk, self.cloud_view.pointing
        self.palette_.show_desk(desk, self.theme)
        self.tools.show_state(pointing, self.theme)
        self.header.show_desk(desk, self.walk, self.theme)
        text = next_click(pointing, desk.part)
        if self.correction.read_only:
            text = "Read-only: look, turn and colour; nothing is changed"
        self.status.say_next(text, desk.part, self.theme)
        self.status.say_space(self.settings.key("accept"), desk.next_verdict())
        self.status.say_saved(self.correction.unsaved, self.theme)

    def say(self, done: Done) -> None:
        """What came of the last key or stroke."""
        self.status.say(done, self.theme)

    def _show_shown(self) -> None:
        shown = self.desk.shown()
        for view in self.views:
            view.set_shown(shown)

    def _style_app(self) -> None:
        app = QApplication.instance()
        assert isinstance(app, QApplication)
        app.setPalette(qt_palette(self.theme))
        app.setStyleSheet(style_sheet(self.theme))

    def _show_theme(self) -> None:
        self.key_page.theme = self.theme
        self.strip.set_theme(self.theme)
        for view in self.views:
            view.set_ground(self.theme.ground_rgb)

    # What keys change

    def choose(self, part: int) -> None:
        """Choose the part that strokes give."""
        self.desk.part = part
        for view in self.views:
            view.pointing.overlay.color = part_color(part, self.theme) if part else QColor("white")
        if self.desk.alone:
            self.reshow()

    def set_tool(self, tool: Tool) -> None:
        """Take another tool."""
        for view in self.views:
            view.pointing.set_tool(tool)

    def set_radius(self, radius_px: float) -> None:
        """Size the brush."""
        for view in self.views:
            view.pointing.set_radius(radius_px)

    def toggle(self, name: str) -> None:
        """Switch "through", "only" or "room", until it is switched back."""
        for view in self.views:
            setattr(view.pointing, name, not getattr(view.pointing, name))

    def set_colouring(self, name: Colouring) -> None:
        """Colour by what was clicked."""
        self.desk.colouring = name
        self.recolor()
        self.refresh()

    def look_ahead(self) -> None:
        """Look as the depth camera does."""
        self.cloud_view.look_ahead()
        self.depth_pane.fit()

    def toggle_theme(self) -> None:
        """Light or dark."""
        self.theme = LIGHT if self.theme is DARK else DARK
        self._style_app()
        self._show_theme()
        self.recolor()

    def toggle_help(self) -> None:
        """Show or hide the page of all keys."""
        self.key_page.setVisible(not self.key_page.isVisible())
        self.key_page.raise_()

    # What happens

    def act(self, action: Callable[[], Done | None]) -> None:
        """Do something, show what came of it, and say what went wrong."""
        try:
            done = action()
        except NotSavedError as error:
            # The stroke has its effect all the same.
            self.recolor()
            done = self._not_saved(error)
        except CloudError as error:
            done = Done(NOTHING, str(error), "bad")
        if done is not None:
            if len(done.pixels):
                self.recolor(done.pixels)
            self.say(done)
        self._told_unsaved = self._told_unsaved and self.correction.unsaved > 0
        self.refresh()

    def command(self, name: str) -> None:
        """Run what a key is bound to."""
        self._mark()
        if name in STROKE_SETUP:
            self.desk.keys += 1 + self.settings.key(name).count("+")
        self.act(self.commands[name])

    def under_pointer(self) -> int | None:
        """The pixel under the pointer, in whichever view it is."""
        for view in self.views:
            if view.pointing.place is not None:
                return view.pixel_at(view.pointing.place)
        return None

    def _not_saved(self, error: NotSavedError) -> Done:
        """The disk takes no more: ask once, until it takes strokes again."""
        while not self._told_unsaved and review.ask_retry(self, str(error), self.correction.unsaved):
            try:
                self.correction.flush()
                return Done(NOTHING, "Everything is saved again", "good")
            except NotSavedError as again:
                error = again
        self._told_unsaved = True
        return Done(NOTHING, str(error), "bad")

    def _drawn(self, view: CloudView | DepthPane, drawing: Drawing) -> None:
        start = view.pixel_at(QPointF(*drawing.start_px))
        if drawing.tool == "piece":
            self.act(lambda: self.desk.piece(start, drawing))
        else:
            self.act(lambda: self.desk.stroke(drawing, start, view.pixels_in(drawing)))

    def _hovered(self, view: CloudView | DepthPane, place: QPointF | None) -> None:
        other = self.depth_pane if view is self.cloud_view else self.cloud_view
        other.mark(view.pixel_at(place) if place is not None else None)

    def _mark(self, kind: str = "looking") -> None:
        if self.desk.editor:
            self.desk.editor.time.mark("navigating" if kind == "navigating" else "looking")

    def _lock(self, part: int) -> None:
        self.act(lambda: self.desk.toggle_lock(part))

    def _fade(self, part: int) -> None:
        def fade() -> Done:
            done = self.desk.fade(part)
            self.reshow()
            return done

        self.act(fade)

    # Building

    def _lay_out(self) -> QWidget:
        """Everything in its place; the widget that holds it."""
        side = QSplitter(Qt.Orientation.Vertical)
        side.setObjectName("panel")
        side.addWidget(self.depth_pane)
        side.addWidget(self.palette_)
        side.setStretchFactor(0, 1)
        side.setMinimumWidth(318)
        middle = QSplitter(Qt.Orientation.Horizontal)
        middle.addWidget(self.cloud_view)
        middle.addWidget(side)
        middle.setStretchFactor(0, 1)
        middle.setSizes([1030, 318])
        for splitter in (side, middle):
            splitter.setHandleWidth(1)
            splitter.setChildrenCollapsible(False)
        row = QHBoxLayout()
        row.setSpacing(0)
        row.addWidget(self.tools)
        row.addWidget(_line(vertical=True))
        row.addWidget(middle, 1)
        central = named(QWidget(), "panel")
        column = QVBoxLayout(central)
        column.setContentsMargins(0, 0, 0, 0)
        column.setSpacing(0)
        column.addWidget(self.header)
        column.addWidget(_line())
        column.addLayout(row, 1)
        for widget in (_line(), self.status, _line(), self.strip):
            column.addWidget(widget)
        self.setCentralWidget(central)
        return central

    def _bind(self) -> None:
        for binding in self.settings.bindings:
            QShortcut(QKeySequence(binding.key), self, partial(self.command, binding.name))
        for part in PARTS:
            key = self.settings.key(part.name)
            if "+" not in key:
                QShortcut(QKeySequence(f"Shift+{key}"), self, partial(self._lock, part.id))
                QShortcut(QKeySequence(f"Alt+{key}"), self, partial(self._fade, part.id))

    def _connect(self) -> None:
        for view in self.views:
            view.pointing.drawn.connect(partial(self._drawn, view))
            view.pointing.hovered.connect(partial(self._hovered, view))
            view.pointing.sampled.connect(lambda _: self.command("pick"))
            view.pointing.resized.connect(self.set_radius)
            view.moved.connect(partial(self._mark, "navigating"))
        self.palette_.chosen.connect(lambda part: self.act(lambda: self.choose(part)))
        self.palette_.locked.connect(self._lock)
        self.palette_.faded.connect(self._fade)
        self.tools.asked.connect(self.command)
        self.header.coloured.connect(self.set_colouring)
        self.header.asked.connect(self.command)
        self.strip.opened.connect(self.open_frame)

    def resizeEvent(self, event: QResizeEvent) -> None:  # noqa: N802
        """Qt's hook."""
        super().resizeEvent(event)
        self.key_page.resize(self._central.size())

    def closeEvent(self, event: QCloseEvent) -> None:  # noqa: N802
        """Qt's hook: everything is saved, or the window stays."""
        try:
            self.correction.close()
        except NotSavedError:
            if not review.ask_close(self, self.correction.unsaved):
                event.ignore()
                return
            self.correction.abandon()
        self.walk.close()
        self.strip.frames.pool.waitForDone()
        self.cloud_view.close_view()
        event.accept()


def _line(vertical: bool = False) -> QFrame:
    line = named(QFrame(), "line")
    if vertical:
        line.setStyleSheet("max-height: 100000px; min-width: 1px; max-width: 1px")
    return line
