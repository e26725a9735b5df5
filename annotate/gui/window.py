"""The correction window: lays out the views, and shows in all of them what changes in one."""

from collections.abc import Callable
from functools import partial

import numpy as np
from PySide6.QtCore import QPointF, Qt
from PySide6.QtGui import QCloseEvent, QColor, QResizeEvent
from PySide6.QtWidgets import QApplication, QFrame, QHBoxLayout, QMainWindow, QSplitter, QVBoxLayout, QWidget

from annotate.array_types import Int64, UInt8
from annotate.correction.correction import Correction
from annotate.gui import dialogs
from annotate.gui.bars import Header, ToolColumn
from annotate.gui.cloud_view import CloudView
from annotate.gui.colors import Colouring
from annotate.gui.depth_pane import DepthPane
from annotate.gui.desk import Desk
from annotate.gui.drawing import Drawing, Tool
from annotate.gui.frame_strip import FrameStrip
from annotate.gui.hints import KeyPage, StatusLine
from annotate.gui.keys import Settings
from annotate.gui.outcome import Done
from annotate.gui.palette import Palette
from annotate.gui.pointing import Hand
from annotate.gui.scene import SceneReader
from annotate.gui.theme import DARK, LIGHT, part_color, qt_palette, style_sheet, theme_of
from annotate.gui.walk import Walk
from annotate.gui.widgets import laid, named
from annotate.labelset.journal import NotSavedError
from annotate.labelset.stroke import Activity
from sensors.errors import CloudError


class CorrectionWindow(QMainWindow):
    """Corrects one label set, and closes it when it is closed itself. ``commands.bind`` gives it its keys.

    Raises CloudError when none of its frames can be opened.
    """

    def __init__(self, correction: Correction, reader: SceneReader, settings: Settings) -> None:
        super().__init__()
        self.correction, self.settings = correction, settings
        self.walk = Walk(correction, reader, lambda error: dialogs.ask_restore(None, error))
        self.desk = Desk(correction, *self.walk.first())
        self.theme = theme_of(settings.theme)
        # Before there are widgets: styling them one by one is quicker than all at once.
        self._style_app()
        self._retry_declined = False
        self.hand = Hand()
        scene = self.desk.scene
        self.cloud_view, self.depth_pane = CloudView(scene, self.hand), DepthPane(scene, self.hand)
        self.views = (self.cloud_view, self.depth_pane)
        self.tools, self.palette_, self.header = ToolColumn(settings), Palette(settings), Header(settings)
        self.strip, self.status = FrameStrip(correction.frame, correction.state), StatusLine(settings)
        self._central = self._lay_out()
        self.key_page = KeyPage(self._central, settings)
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
        """Open another frame; returns whether it could be opened."""
        left = self.frame_id
        if frame_id == left:
            return True
        try:
            self.desk.put(*self.walk.open(frame_id))
        except CloudError as error:
            self.strip.choose(left)
            self.status.show_done(Done(str(error), "bad"), self.theme)
            return False
        self.strip.frames.refresh(left)
        self.show_frame()
        return True

    def step(self, by: int) -> bool:
        """Open the frame ``by`` places on; returns whether there is one that can be opened."""
        frame_id = self.walk.beside(self.frame_id, by)
        return frame_id is not None and self.open_frame(frame_id)

    def reorder(self) -> Done:
        """Switch between the order by time and the worst first."""
        self.walk.reorder()
        self.strip.frames.order(self.walk.frame_ids)
        self.strip.choose(self.frame_id)
        return Done("Frames: the worst first" if self.walk.worst_first else "Frames by time")

    # Showing

    def show_frame(self) -> None:
        """Show the frame on the desk everywhere."""
        self._shown = self.desk.shown()
        for view in self.views:
            view.pointing.cancel()
            view.load(self.desk.scene, self.colors, self._shown)
        self.strip.choose(self.frame_id)
        self.refresh()
        self.status.show_done(Done(self.desk.scene.remark, "warn"), self.theme)

    def colors(self, pixels: Int64) -> UInt8:
        """Colours (n, 3) of flat pixels (n,) at this moment."""
        return self.desk.colors(pixels, self.theme.ground_rgb)

    def recolor(self, pixels: Int64 | None = None) -> None:
        """Show new colours of some pixels, or of all, and what is hidden or shown with them."""
        before, self._shown = self._shown, self.desk.shown()
        for view in self.views:
            view.recolor(pixels, self.colors)
            if not np.array_equal(before, self._shown):
                view.set_shown(self._shown)

    def refresh(self) -> None:
        """Update palette, tools, header and sentences."""
        desk = self.desk
        self.palette_.show_desk(desk, self.theme)
        self.tools.show_state(self.hand, self.theme)
        self.header.show_desk(desk, self.walk, self.theme)
        self.status.show_desk(desk, self.hand, self.theme)
        for view in self.views:
            view.pointing.update()

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

    # Settings that keys change

    def choose(self, part: int) -> None:
        """Choose the part that strokes give."""
        self.desk.part = part
        self.hand.color = part_color(part, self.theme) if part else QColor("white")
        if self.desk.alone:
            self.recolor()

    def set_tool(self, tool: Tool) -> None:
        """Choose another tool; a shape begun with the last one is dropped."""
        self.hand.tool = tool
        self.cancel_stroke()

    def cancel_stroke(self) -> bool:
        """Drop the shapes being drawn; returns whether there were any."""
        return sum(view.pointing.cancel() for view in self.views) > 0

    def toggle(self, name: str) -> None:
        """Switch "through", "only" or "room", until it is switched back."""
        setattr(self.hand, name, not getattr(self.hand, name))

    def set_colouring(self, name: Colouring) -> None:
        """Choose a colouring."""
        self.desk.colouring = name
        self.recolor()
        self.refresh()

    def look_ahead(self) -> None:
        """Show the person as the depth camera sees them."""
        self.cloud_view.look_ahead()
        self.depth_pane.fit()

    def toggle_theme(self) -> None:
        """Switch between light and dark."""
        self.theme = LIGHT if self.theme is DARK else DARK
        self._style_app()
        self._show_theme()
        self.recolor()

    def toggle_help(self) -> None:
        """Show or hide the page of all keys."""
        self.key_page.setVisible(not self.key_page.isVisible())
        self.key_page.raise_()

    # Actions

    def act(self, action: Callable[[], Done | None]) -> None:
        """Do something, and show its outcome or error."""
        try:
            done = action()
        except NotSavedError as error:
            # The stroke took effect nevertheless.
            self.recolor()
            done = self._not_saved(error)
        except CloudError as error:
            done = Done(str(error), "bad")
        if done is not None:
            if len(done.pixels):
                self.recolor(done.pixels)
            self.status.show_done(done, self.theme)
        self._retry_declined = self._retry_declined and self.correction.unsaved > 0
        self.refresh()

    def under_pointer(self) -> int | None:
        """The pixel under the pointer, in whichever view it is."""
        for view in self.views:
            if view.pointing.place is not None:
                return view.pixel_at(view.pointing.place)
        return None

    def _not_saved(self, error: NotSavedError) -> Done:
        """Ask whether to write again what the disk refused; once declined, not until it was written."""
        while not self._retry_declined and dialogs.ask_retry(self, str(error), self.correction.unsaved):
            try:
                self.correction.flush()
                return Done("Everything is saved again", "good")
            except NotSavedError as again:
                error = again
        self._retry_declined = True
        return Done(str(error), "bad")

    def _drawn(self, view: CloudView | DepthPane, drawing: Drawing) -> None:
        start = view.pixel_at(QPointF(*drawing.start_px))
        if drawing.tool == "piece":
            self.act(lambda: self.desk.piece(start, drawing))
        else:
            self.act(lambda: self.desk.stroke(drawing, start, view.pixels_in(drawing)))

    def _hovered(self, view: CloudView | DepthPane, place: QPointF | None) -> None:
        other = self.depth_pane if view is self.cloud_view else self.cloud_view
        other.mark(view.pixel_at(place) if place is not None else None)

    def mark(self, activity: Activity) -> None:
        """Count the time since the last event for an activity."""
        if self.desk.editor:
            self.desk.editor.time.mark(activity)

    def lock(self, part: int) -> None:
        """Lock a part, or unlock it."""
        self.act(partial(self.desk.toggle_lock, part))

    def fade(self, part: int) -> None:
        """Switch a part from shown to faded, to hidden, and to shown again."""
        self.act(partial(self.desk.fade, part))

    # Building

    def _lay_out(self) -> QWidget:
        """Everything in its place; the widget that holds it."""
        side = named(QSplitter(Qt.Orientation.Vertical), "panel")
        middle = QSplitter(Qt.Orientation.Horizontal)
        for splitter, *views in ((side, self.depth_pane, self.palette_), (middle, self.cloud_view, side)):
            for view in views:
                splitter.addWidget(view)
            splitter.setStretchFactor(0, 1)
            splitter.setHandleWidth(1)
            splitter.setChildrenCollapsible(False)
        side.setMinimumWidth(318)
        middle.setSizes([1030, 318])
        row = laid(QHBoxLayout(), self.tools, _line(vertical=True), middle)
        row.setStretchFactor(middle, 1)
        central = named(QWidget(), "panel")
        beneath = _line(), self.status, _line(), self.strip
        laid(QVBoxLayout(central), self.header, _line(), row, *beneath).setStretchFactor(row, 1)
        self.setCentralWidget(central)
        return central

    def _connect(self) -> None:
        for view in self.views:
            view.pointing.drawn.connect(partial(self._drawn, view))
            view.pointing.hovered.connect(partial(self._hovered, view))
            view.moved.connect(partial(self.mark, "navigating"))
        self.palette_.chosen.connect(lambda part: self.act(lambda: self.choose(part)))
        self.palette_.locked.connect(self.lock)
        self.palette_.faded.connect(self.fade)
        self.header.coloured.connect(self.set_colouring)
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
            if not dialogs.ask_close(self, self.correction.unsaved):
                event.ignore()
                return
            self.correction.abandon()
        self.walk.close()
        self.strip.frames.close()
        self.cloud_view.plotter.close()
        event.accept()


def _line(vertical: bool = False) -> QFrame:
    line = named(QFrame(), "line")
    if vertical:
        line.setStyleSheet("max-height: 100000px; min-width: 1px; max-width: 1px")
    return line
