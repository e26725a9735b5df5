"""Panel for the order of frames: order, filter, field to jump to a frame, progress of work and of
fine-tuning.
"""

from collections.abc import Iterable
from functools import partial

from PySide6.QtCore import QEvent, QObject, Qt, Signal
from PySide6.QtGui import QKeyEvent
from PySide6.QtWidgets import QGridLayout, QLineEdit, QMenu, QProgressBar, QToolButton, QWidget

from annotate.correction.review_queue import Progress
from annotate.gui.state.frame_order import FILTERS, ORDERS, FrameOrder
from annotate.gui.widgets.building_blocks import Elided, button, named
from annotate.gui.widgets.theme import scaled


class ProgressPanel(QWidget):
    """Panel for the order of frames.

    ordered, filtered: signals that an order or filter was chosen by name. went: signal that a frame number
    was entered.
    """

    ordered = Signal(str)
    filtered = Signal(str)
    went = Signal(str)

    def __init__(self) -> None:
        super().__init__()
        self.setObjectName("panel")
        self.setFixedWidth(scaled(236))
        self.order, self.filter = button(""), button("")
        self.order.setAccessibleName("Order of the frames")
        self.filter.setAccessibleName("Frames shown")
        _choices(self.order, ORDERS.items(), self.ordered)
        _choices(self.filter, FILTERS.items(), self.filtered)
        self.number = QLineEdit(placeholderText="Go to…", maxLength=40)
        self.number.setFocusPolicy(Qt.FocusPolicy.ClickFocus)
        self.number.setAccessibleName("Number of a frame to go to")
        self.number.returnPressed.connect(self._go)
        self.number.installEventFilter(self)
        self.bar = QProgressBar(textVisible=False)
        self.bar.setFixedHeight(6)
        self.bar.setAccessibleName("Frames done")
        self.text = named(Elided(), "quiet")
        self._progress, self._learning = "", ""
        grid = QGridLayout(self)
        grid.setContentsMargins(8, 6, 8, 6)
        grid.setSpacing(4)
        grid.addWidget(self.order, 0, 0, 1, 2)
        grid.addWidget(self.filter, 1, 0)
        grid.addWidget(self.number, 1, 1)
        grid.addWidget(self.bar, 2, 0, 1, 2)
        grid.addWidget(self.text, 3, 0, 1, 2)

    def show_frames(self, frames: FrameOrder, progress: Progress) -> None:
        """Update order, filter and progress."""
        self.order.setText(f"{ORDERS[frames.order]} ▾")
        self.filter.setText(f"{FILTERS[frames.filter]} ▾")
        # Without updates, because a progress bar paints the whole window at once.
        self.bar.setUpdatesEnabled(False)
        self.bar.setRange(0, max(1, progress.total))
        self.bar.setValue(progress.done)
        self.bar.setUpdatesEnabled(True)
        self._progress = progress.text
        self._show_text()

    def show_learning(self, text: str) -> None:
        """Show the progress of fine-tuning instead of the work's; "" ends that."""
        self._learning = text
        self._show_text()

    def _show_text(self) -> None:
        self.text.setText(self._learning or self._progress)

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:  # noqa: N802
        """Leave the field on Escape, and keep its other keys from the commands (Qt's hook)."""
        if event.type() == QEvent.Type.ShortcutOverride and isinstance(event, QKeyEvent):
            event.accept()
        elif isinstance(event, QKeyEvent) and event.key() == Qt.Key.Key_Escape:
            self.number.clearFocus()
            return True
        return False

    def _go(self) -> None:
        text = self.number.text().strip()
        self.number.clear()
        self.number.clearFocus()
        if text:
            self.went.emit(text)


def _choices(item: QToolButton, choices: Iterable[tuple[str, str]], chosen: object) -> None:
    menu = QMenu(item)
    for name, title in choices:
        menu.addAction(title, partial(chosen.emit, name))  # type: ignore[attr-defined]
    item.setMenu(menu)
    item.setPopupMode(QToolButton.ToolButtonPopupMode.InstantPopup)
