"""Layout of all panels of the window."""

from PySide6.QtGui import QResizeEvent
from PySide6.QtWidgets import QHBoxLayout, QVBoxLayout, QWidget

from annotate.gui.panels.bars import Header, ToolColumn
from annotate.gui.panels.frame_strip import FrameStrip
from annotate.gui.panels.hints import KeyPage, StatusLine
from annotate.gui.panels.panes import Panes
from annotate.gui.panels.part_palette import Palette
from annotate.gui.panels.progress_panel import ProgressPanel
from annotate.gui.state.edit_controller import EditController
from annotate.gui.state.frame_order import FrameOrder
from annotate.gui.state.keys import Settings
from annotate.gui.views.view_pair import ViewPair
from annotate.gui.widgets.building_blocks import laid, line, named
from annotate.gui.widgets.theme import Theme


class Panels(QWidget):
    """Panels of the window: header, tools, views, palette, status line, frames, progress, and the page of
    keys over them.
    """

    def __init__(self, views: ViewPair, frames: FrameOrder, settings: Settings) -> None:
        super().__init__()
        self._views, self._frames = views, frames
        scheme = frames.correction.labels.scheme
        self.tools, self.palette_, self.header = ToolColumn(settings), Palette(scheme, settings), Header()
        self.progress, self.status = ProgressPanel(), StatusLine(settings)
        self.strip = FrameStrip(frames.correction.frame, frames.correction.state, frames.confidence)
        self.panes = Panes(views, self.palette_, settings)
        row = laid(QHBoxLayout(), self.tools, line(vertical=True), self.panes)
        row.setStretchFactor(self.panes, 1)
        foot = laid(QHBoxLayout(), self.progress, self.strip)
        foot.setStretchFactor(self.strip, 1)
        column = laid(
            QVBoxLayout(named(self, "panel")), self.header, line(), row, line(), self.status, line(), foot
        )
        column.setStretchFactor(row, 1)
        self.key_page = KeyPage(self, scheme, settings)

    def resizeEvent(self, event: QResizeEvent) -> None:  # noqa: N802
        """Fit the page of keys to the window (Qt's hook)."""
        super().resizeEvent(event)
        self.key_page.resize(self.size())

    def set_theme(self, theme: Theme) -> None:
        """Redraw the panels in the colours of a theme."""
        self.key_page.theme = theme
        self.strip.set_theme(theme)

    def show_edits(self, edits: EditController, theme: Theme, doubt: str, enabled: dict[str, bool]) -> None:
        """Update all panels.

        doubt: description of the frame's most doubtful place. enabled: by command, True if it can be used.
        """
        self.palette_.show_edits(edits, theme)
        if enabled:
            self.tools.show_state(self._views.options, enabled, theme)
        self.header.show_edits(edits, self._frames, theme, doubt)
        self.progress.show_frames(self._frames, self._frames.progress())
        self.strip.model_.changed(edits.frame.frame_id)
        self.status.show_edits(edits, theme)
        self.show_next(edits)
        for view in self._views:
            self.panes.bars[view].show_look(view.look, edits)

    def show_next(self, edits: EditController) -> None:
        """Update the effect of the next click, for the held keys and the view under the pointer."""
        self.status.show_next(edits, self._views.options, self._views.last is self._views.depth)
