"""Cloud and depth view with their bars, and the part palette, divided by splitters; the views can swap
places.
"""

from PySide6.QtCore import Qt
from PySide6.QtGui import QResizeEvent
from PySide6.QtWidgets import QSplitter, QVBoxLayout, QWidget

from annotate.gui.panels.bars import PaneBar
from annotate.gui.panels.part_palette import Palette
from annotate.gui.settings import Memory
from annotate.gui.state.keys import Settings
from annotate.gui.views.view_pair import View, ViewPair
from annotate.gui.widgets.building_blocks import laid, named
from annotate.gui.widgets.theme import scaled

SIDE_PX, PANE_PX = 344, 150  # least width of the side, for its buttons, and least height of its view
PALETTE_PX, PALETTE_SHARE = 390, 0.52  # height of the parts if there is room, and else their share


class Panes(QSplitter):
    """Splitters of views and palette. bars: over each view. swapped: True if the depth image has the large
    place.
    """

    def __init__(self, views: ViewPair, palette: Palette, settings: Settings) -> None:
        super().__init__(Qt.Orientation.Horizontal)
        self.swapped, self._palette = False, palette
        self.bars = {view: PaneBar(view, settings) for view in views}
        self._framed = [self._frame(view) for view in views]
        self._side = named(QSplitter(Qt.Orientation.Vertical), "panel")
        for splitter, widgets in (
            (self._side, (self._framed[1], palette)),
            (self, (self._framed[0], self._side)),
        ):
            for widget in widgets:
                splitter.addWidget(widget)
            splitter.setStretchFactor(0, 1)
            splitter.setStretchFactor(1, 0)
            splitter.setHandleWidth(7)
            splitter.setChildrenCollapsible(False)
        self._side.setMinimumWidth(scaled(SIDE_PX))
        self.setSizes([1030, scaled(SIDE_PX)])
        self._moved = False
        self._side.splitterMoved.connect(self._keep)

    def resizeEvent(self, event: QResizeEvent) -> None:  # noqa: N802
        """Set the palette to its natural height, or to about half of a low window (Qt's hook).

        A palette of many parts takes what it needs, as long as the view has its least height.
        """
        super().resizeEvent(event)
        if not self._moved:
            parts = min(scaled(PALETTE_PX), round(PALETTE_SHARE * self.height()))
            parts = max(parts, self._palette.needed_px)
            parts = max(0, min(parts, self.height() - PANE_PX))
            self._side.setSizes([self.height() - parts, parts])

    def _keep(self) -> None:
        self._moved = True

    def swap(self) -> None:
        """Exchange the places of cloud and depth image."""
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

    def remember(self, memory: Memory) -> None:
        """Store the arrangement, but sizes of the side column only if the user changed them."""
        memory.put("swapped", self.swapped)
        memory.put("panes", self.saveState())
        memory.put("side", self._side.saveState() if self._moved else "")

    def restore(self, memory: Memory) -> None:
        """Restore the stored arrangement."""
        if memory.choice("swapped", (False, True), False):
            self.swap()
        self.restoreState(memory.state("panes"))
        self._moved = self._side.restoreState(memory.state("side"))

    def _frame(self, view: View) -> QWidget:
        frame = named(QWidget(), "panel")
        laid(QVBoxLayout(frame), self.bars[view], view).setStretchFactor(view, 1)
        return frame
