"""The window's shell: its widgets in their places, the theme, and what is remembered of it."""

from dataclasses import replace

import numpy as np
from PySide6.QtCore import QPointF, QSize, Qt, QTimer, Signal
from PySide6.QtGui import QAction, QGuiApplication, QResizeEvent, QShowEvent
from PySide6.QtWidgets import QHBoxLayout, QMainWindow, QVBoxLayout, QWidget

from annotate.array_types import Int64
from annotate.gui.panels.bars import Header, ToolColumn, View
from annotate.gui.panels.frame_strip import FrameStrip
from annotate.gui.panels.hints import KeyPage, StatusLine
from annotate.gui.panels.panes import Panes
from annotate.gui.panels.part_palette import Palette
from annotate.gui.panels.progress_panel import ProgressPanel
from annotate.gui.settings import Memory, order_key, remember
from annotate.gui.state.edit_controller import Desk
from annotate.gui.state.frame_order import Walk
from annotate.gui.state.keys import Settings
from annotate.gui.state.outcome import NOTHING
from annotate.gui.state.point_colors import Colors, Look, colourings, legend
from annotate.gui.state.view_state import PREVIEW_RGB
from annotate.gui.views.cloud_view import CloudView
from annotate.gui.views.depth_pane import DepthPane
from annotate.gui.views.pointing import Hand
from annotate.gui.widgets.building_blocks import laid, line, named
from annotate.gui.widgets.overlay import outline
from annotate.gui.widgets.theme import DARK, Rgb, style_app, theme_of

STRIP_MS = 150
"""Time after a stroke until the frame's picture follows, in milliseconds. Untuned."""
FRAMED_MS = 200
"""Milliseconds after which the window manager has framed a new window (untuned)."""
EDGE = 0.1
"""Share of a view at each edge that is not well within it. Untuned."""


class Shell(QMainWindow):
    """requested: a button with a command's name was clicked. actions_by_name: what ``commands.bind`` made.

    known: what is remembered. pane: the view that the pointer was
    in last. peeking: whether the views are shown without parts. doubt: the frame's worst place in words.
    """

    requested = Signal(str)

    def __init__(self, desk: Desk, walk: Walk, settings: Settings, known: Memory) -> None:
        super().__init__()
        self.desk, self.walk, self.settings, self.known = desk, walk, settings, known
        chosen = settings.theme != "system"
        self.theme = theme_of(settings.theme if chosen or not self.known.theme else self.known.theme)
        # Before there are widgets: styling them one by one is quicker than all at once.
        self.style_app()
        self.hand = Hand(self.known.tool, radius_px=self.known.radius_px)
        self.cloud_view, self.depth_pane = CloudView(desk.scene, self.hand), DepthPane(desk.scene, self.hand)
        self.views: tuple[View, View] = (self.cloud_view, self.depth_pane)
        self.cloud_view.look, self.depth_pane.look = self.known.looks
        self.actions_by_name: dict[str, QAction] = {}
        self.tools, self.palette_, self.header = ToolColumn(settings), Palette(settings), Header()
        self.panel, self.status = ProgressPanel(), StatusLine(settings)
        self.strip = FrameStrip(desk.correction.frame, desk.correction.state, walk.confidence)
        self.panes = Panes(self.cloud_view, self.depth_pane, self.palette_, settings)
        self._central = self._lay_out()
        self.key_page = KeyPage(self._central, settings)
        self.picture_due = QTimer(self, singleShot=True, interval=STRIP_MS)
        self.picture_due.timeout.connect(self.refresh_picture)
        self.words_due = QTimer(self, singleShot=True, interval=0)
        self.words_due.timeout.connect(self._show_words)
        self.pane: View = self.cloud_view
        self.peeking = False
        self.doubt: str | None = None
        self._shown = desk.shown()
        self.setWindowTitle(f"{desk.correction.labels.path.resolve().name} - annotate-cloud")
        self._place(self.known)

    def style_app(self) -> None:
        """Give all widgets the theme's colours."""
        style_app(self.theme)

    def show_theme(self) -> None:
        """Give what draws itself the theme's colours."""
        self.key_page.theme = self.theme
        self.strip.set_theme(self.theme)
        self._show_grounds()

    def ground(self, view: View) -> Rgb:
        """Return the colour behind a view: a camera's picture has a dark ground in every theme.

        On a light ground, gaps of the depth would be white specks all over the picture.
        """
        is_picture = self.look(view).colouring == "colour" and "colour" in colourings(self.desk.scene)
        return (DARK if is_picture else self.theme).ground_rgb

    def _show_grounds(self) -> None:
        for view in self.views:
            view.set_ground(self.ground(view))

    def _lay_out(self) -> QWidget:
        """Everything in its place; the widget that holds it."""
        row = laid(QHBoxLayout(), self.tools, line(vertical=True), self.panes)
        row.setStretchFactor(self.panes, 1)
        foot = laid(QHBoxLayout(), self.panel, self.strip)
        foot.setStretchFactor(self.strip, 1)
        central = named(QWidget(), "panel")
        column = laid(QVBoxLayout(central), self.header, line(), row, line(), self.status, line(), foot)
        column.setStretchFactor(row, 1)
        self.setCentralWidget(central)
        return central

    def _place(self, known: Memory) -> None:
        """As large as it was, as far as the screen allows."""
        there = QGuiApplication.primaryScreen().availableSize()
        self.resize(min(known.size[0], there.width()), min(known.size[1], there.height()))
        self.panes.restore(known.splits, known.swapped)
        if known.maximized:
            self.setWindowState(Qt.WindowState.WindowMaximized)

    def showEvent(self, event: QShowEvent) -> None:  # noqa: N802
        """Qt's hook: the title bar, which only a window on the screen has, needs its place too."""
        super().showEvent(event)
        QTimer.singleShot(FRAMED_MS, self._fit_screen)

    def _fit_screen(self) -> None:
        """Shrink and move the window so that its frame lies on the screen."""
        there, framed = self.screen().availableGeometry(), self.frameGeometry()
        over = (framed.size() - there.size()).expandedTo(QSize(0, 0))
        if self.isMaximized() or self.isFullScreen() or there.contains(framed):
            return
        self.resize(self.size() - over)
        corner = framed.size() - over
        left = min(max(framed.left(), there.left()), there.left() + there.width() - corner.width())
        top = min(max(framed.top(), there.top()), there.top() + there.height() - corner.height())
        self.move(left, top)

    def resizeEvent(self, event: QResizeEvent) -> None:  # noqa: N802
        """Qt's hook."""
        super().resizeEvent(event)
        self.key_page.resize(self._central.size())

    def remember(self) -> None:
        """Write down what is remembered."""
        size = self.normalGeometry().size() if self.isMaximized() else self.size()
        memory = replace(
            self.known,
            size=(size.width(), size.height()),
            maximized=self.isMaximized(),
            swapped=self.panes.swapped,
            theme="dark" if self.theme is DARK else "light",
            tool=self.hand.tool,
            radius_px=self.hand.radius_px,
            looks=(self.cloud_view.look, self.depth_pane.look),
            splits=self.panes.splits(),
        )
        remember(memory.with_order(order_key(self.desk.correction), self.walk.order))

    # Showing

    def look(self, view: View) -> Look:
        """What a view shows now; without parts while one peeks."""
        if not self.peeking:
            return view.look
        there = colourings(self.desk.scene)
        wanted = view.look.colouring if view.look.colouring != "part" else "colour"
        return Look(wanted if wanted in there else "depth", outlines=False)

    def colors(self, view: View) -> Colors:
        """The colours of a view at this moment."""
        return self.desk.painting(self.look(view), self.ground(view))

    def recolor(self, pixels: Int64 | None = None) -> None:
        """Show new colours of some pixels and those beside them, or of all, and what is hidden or shown."""
        before, self._shown = self._shown, self.desk.shown()
        if pixels is not None:
            height, width = self.desk.parts.shape
            beside = np.concatenate([pixels + step for step in (0, -1, 1, -width, width)])
            pixels = np.unique(np.clip(beside, 0, height * width - 1))
            pixels = pixels[self.desk.scene.labels.depth_mm.ravel()[pixels] > 0]
        for view in self.views:
            if not np.array_equal(before, self._shown):
                view.set_shown(self._shown)
            view.recolor(pixels, self.colors(view))

    def set_look(self, view: View, look: Look) -> None:
        """Change what a view shows."""
        view.look = look
        view.set_ground(self.ground(view))
        view.recolor(None, self.colors(view))
        self.refresh()

    def refresh(self) -> None:
        """Update palette, tools, header and sentences, once all that is under way is done."""
        self.words_due.start()

    def _show_words(self) -> None:
        desk = self.desk
        if self.doubt is None:
            self.doubt = next((doubt.reason for doubt in desk.doubts()), "")
        self.palette_.show_desk(desk, self.theme)
        enabled = {name: action.isEnabled() for name, action in self.actions_by_name.items()}
        if enabled:
            self.tools.show_state(self.hand, desk.carrying, enabled, self.theme)
        self.header.show_desk(desk, self.walk, self.theme, self.doubt and f"look at {self.doubt}")
        self.panel.show_walk(self.walk, self.walk.progress())
        self.strip.frames.changed(desk.scene.labels.frame_id)
        self.status.show_desk(desk, self.theme)
        self.show_next()
        for view in self.views:
            self.panes.bars[view].show_look(view.look, desk)
            view.pointing.scale = legend(desk.scene, self.look(view).colouring)
            view.pointing.update()

    def show_next(self) -> None:
        """Show the effect of the next click, with the held keys and in the view under the pointer."""
        self.status.show_next(self.desk, self.hand, self.pane is self.depth_pane)

    def hover_again(self) -> None:
        """Show the facts under the pointer anew, after labels or the tool changed."""
        for view in self.views:
            if view.pointing.place is not None and not view.pointing.drawing:
                self.show_hovered(view, view.pointing.place)

    def refresh_picture(self) -> None:
        """Draw the frame's picture in the strip as its labels are now."""
        self.picture_due.stop()
        self.strip.frames.refresh(replace(self.desk.scene.labels, parts=self.desk.parts.copy()))

    def peek(self, peeking: bool) -> None:
        """Show all views without parts, or with them again."""
        if peeking != self.peeking:
            self.peeking = peeking
            self._show_grounds()
            self.recolor()
            self.refresh()

    def show_hovered(self, view: View, place: QPointF | None) -> None:
        other = self.depth_pane if view is self.cloud_view else self.cloud_view
        pixel = view.pixel_at(place) if place is not None else None
        if place is not None and view is not self.pane:
            self.pane = view
            self.show_next()
        other.mark(pixel)
        taken = NOTHING
        if self.hand.tool == "piece" and not self.hand.once and not self.key_page.isVisible():
            taken = self.desk.would_take(pixel)
        words = self.desk.read_out(pixel) if pixel is not None else ""
        for each in self.views:
            veil = None
            if len(taken):
                rgb = self.hand.color.red(), self.hand.color.green(), self.hand.color.blue()
                size = each.pointing.width(), each.pointing.height()
                veil = outline(*each.places(taken), size, rgb)
            each.pointing.show_under_pointer(veil, words if each is view else "")

    def show_place(self, pixels: Int64, middle: int) -> None:
        """Outline pixels in all views, moved only where their middle is not well within."""
        for view in self.views:
            size = np.array([view.pointing.width(), view.pointing.height()])
            place = view.places(np.array([middle]))[0][0] / size
            if not (np.abs(place - 0.5) < 0.5 - EDGE).all():
                view.bring(middle)
            veil = outline(*view.places(pixels), (int(size[0]), int(size[1])), PREVIEW_RGB)
            view.pointing.show_under_pointer(veil, "")
