"""The two views with their bars and the parts, divided by splitters; the views can swap places."""

from PySide6.QtCore import Qt
from PySide6.QtGui import QResizeEvent
from PySide6.QtWidgets import QSplitter, QVBoxLayout, QWidget

from annotate.gui.panels.bars import PaneBar, View
from annotate.gui.panels.part_palette import Palette
from annotate.gui.state.keys import Settings
from annotate.gui.views.cloud_view import CloudView
from annotate.gui.views.depth_pane import DepthPane
from annotate.gui.widgets.building_blocks import laid, named
from annotate.gui.widgets.theme import scaled

HANDLE_PX = 7
"""Width of the handles between the panes in logical pixels. Untuned."""
SIDE_PX, PANE_PX = 344, 150
"""Least width of the side, for the buttons over its view, and least height of that view, where the window is
high enough; in logical pixels (untuned)."""
PALETTE_PX, PALETTE_SHARE = 390, 0.52
"""Height of the parts where there is room for it, in logical pixels, and else their share. Untuned."""


class Panes(QSplitter):
    """bars: the bar over each view. swapped: whether the depth image has the large place."""

    def __init__(self, cloud: CloudView, depth: DepthPane, palette: Palette, settings: Settings) -> None:
        super().__init__(Qt.Orientation.Horizontal)
        self.swapped = False
        self.bars = {view: PaneBar(view, settings) for view in (cloud, depth)}
        self._framed = [self._frame(view) for view in (cloud, depth)]
        self._side = named(QSplitter(Qt.Orientation.Vertical), "panel")
        for splitter, widgets in (
            (self._side, (self._framed[1], palette)),
            (self, (self._framed[0], self._side)),
        ):
            for widget in widgets:
                splitter.addWidget(widget)
            splitter.setStretchFactor(0, 1)
            splitter.setStretchFactor(1, 0)
            splitter.setHandleWidth(HANDLE_PX)
            splitter.setChildrenCollapsible(False)
        self._side.setMinimumWidth(scaled(SIDE_PX))
        self.setSizes([1030, scaled(SIDE_PX)])
        self._moved = False
        self._side.splitterMoved.connect(self._keep)

    def resizeEvent(self, event: QResizeEvent) -> None:  # noqa: N802
        """Qt's hook: the parts get their height, or about half of a low window."""
        super().resizeEvent(event)
        if not self._moved:
            parts = min(scaled(PALETTE_PX), round(PALETTE_SHARE * self.height()))
            parts = max(0, min(parts, self.height() - PANE_PX))
            self._side.setSizes([self.height() - parts, parts])

    def _keep(self) -> None:
        self._moved = True

    def swap(self) -> None:
        """Let cloud and depth image swap places."""
        sizes = self.sizes(), self._side.sizes()
        self.swapped = not self.swapped
        large, small = self._framed[:: -1 if self.swapped else 1]
        self._side.insertWidget(0, small)
        self.insertWidget(0, large)
        for splitter, size in zip((self, self._side), sizes, strict=True):
            splitter.setStretchFactor(0, 1)
            splitter.setSizes(size)
        for view in self.bars:
            view.fit()

    def splits(self) -> tuple[tuple[int, ...], ...]:
        """Sizes of the panes of both splitters."""
        sizes = tuple(self.sizes()), tuple(self._side.sizes())
        return sizes if self._moved else sizes[:1]

    def restore(self, splits: tuple[tuple[int, ...], ...], swapped: bool) -> None:
        """The sizes and places of an earlier time."""
        if swapped:
            self.swap()
        self._moved = len(splits) > 1
        for splitter, sizes in zip((self, self._side), splits, strict=False):
            if len(sizes) == splitter.count():
                splitter.setSizes(list(sizes))

    def _frame(self, view: View) -> QWidget:
        frame = named(QWidget(), "panel")
        laid(QVBoxLayout(frame), self.bars[view], view).setStretchFactor(view, 1)
        return frame
