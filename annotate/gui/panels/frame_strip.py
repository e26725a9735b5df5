"""Strip of the set's frames, with pictures and states."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from PySide6.QtCore import QAbstractListModel, QModelIndex, QPersistentModelIndex, QRectF, QSize, Qt, Signal
from PySide6.QtGui import QColor, QImage, QPainter
from PySide6.QtWidgets import QListView, QStyle, QStyledItemDelegate, QStyleOptionViewItem

from annotate.array_types import UInt8
from annotate.correction.replay import STATE_NAMES, State
from annotate.crop import window_of
from annotate.frame_labels import FrameLabels
from annotate.gui.widgets.building_blocks import draw_card
from annotate.gui.widgets.theme import DARK, Theme, scaled
from sensors.errors import CloudError

THUMBNAIL = QSize(78, 58)
CELL = QSize(90, 86)
Score = Callable[[str], float | None]
"""Mean confidence of a frame's labels, or None."""
ModelIndex = QModelIndex | QPersistentModelIndex


def state_color(state: State, theme: Theme) -> QColor:
    """Return the colour of a state's badge."""
    names = {"auto": theme.quiet, "touched": theme.warn, "accepted": theme.good}
    return QColor(names.get(state, theme.accent if state == "reviewed" else theme.bad))


def thumbnail(labels: FrameLabels) -> QImage:
    """Return a picture of a frame's parts over its depth, cropped to the person."""
    window = _window(labels.parts)
    parts, depth = labels.parts[window], labels.depth_mm[window].astype(np.float32)
    grey = np.where(depth > 0, 90 - np.clip(depth / 5000, 0, 1) * 70, 12)
    rgb: UInt8 = np.where((parts > 0)[..., None], labels.scheme.palette_rgb()[parts], grey[..., None])
    rgb = np.ascontiguousarray(rgb.astype(np.uint8))
    height, width = parts.shape
    image = QImage(rgb.data, width, height, 3 * width, QImage.Format.Format_RGB888)
    smooth = Qt.TransformationMode.SmoothTransformation
    return image.scaled(THUMBNAIL * 2, Qt.AspectRatioMode.KeepAspectRatio, smooth)


def _window(parts: UInt8) -> tuple[slice, slice]:
    """Return row and column slices around the person with a margin, in the picture's aspect ratio, inside the
    image.
    """
    there = parts > 0
    rows, columns = window_of(there if there.any() else np.ones_like(there))
    slope = THUMBNAIL.height() / THUMBNAIL.width()
    height = max(rows.stop - rows.start, (columns.stop - columns.start) * slope) * 1.12 + 2
    width = height / slope
    top, left = ((x.start + x.stop - size) / 2 for x, size in ((rows, height), (columns, width)))
    return slice(max(0, int(top)), int(top + height)), slice(max(0, int(left)), int(left + width))


class Frames(QAbstractListModel):
    """Qt model of the frames in the order shown. A thread draws the pictures of visible frames."""

    _drawn = Signal(str, QImage)

    def __init__(
        self, read: Callable[[str], FrameLabels], state: Callable[[str], State], score: Score
    ) -> None:
        super().__init__()
        self.frame_ids: list[str] = []
        self._read, self._state, self._score = read, state, score
        self._images: dict[str, QImage | None] = {}
        self._drawn.connect(self._keep)
        self._pool = ThreadPoolExecutor(1, "thumbnails")

    def order(self, frame_ids: list[str]) -> None:
        """Set the shown frames and their order."""
        self.beginResetModel()
        self.frame_ids = frame_ids
        self.endResetModel()

    def rowCount(self, parent: ModelIndex | None = None) -> int:  # noqa: N802
        """Return the number of frames (Qt's hook)."""
        return len(self.frame_ids)

    def data(self, index: ModelIndex, role: int = Qt.ItemDataRole.DisplayRole) -> object:
        """Return the frame's data for a role (Qt's hook)."""
        frame_id = self.frame_ids[index.row()]
        if role == Qt.ItemDataRole.DisplayRole:
            return frame_id
        if role in (Qt.ItemDataRole.ToolTipRole, Qt.ItemDataRole.AccessibleTextRole):
            score = self._score(frame_id)
            sure = "" if score is None else f", confidence {max(score, 0):.2f}"
            return f"Frame {frame_id}, {STATE_NAMES[self._state(frame_id)]}{sure}"
        if role == Qt.ItemDataRole.WhatsThisRole:
            score = self._score(frame_id)
            return "" if score is None else f"{max(score, 0):.2f}".lstrip("0")
        if role == Qt.ItemDataRole.StatusTipRole:
            return self._state(frame_id)
        if role == Qt.ItemDataRole.DecorationRole:
            return self._image(frame_id)
        return None

    def refresh(self, labels: FrameLabels) -> None:
        """Draw a frame's picture and state again, from its current labels."""
        self._images[labels.frame_id] = thumbnail(labels)
        self.changed(labels.frame_id)

    def forget(self) -> None:
        """Draw all pictures again, because labels changed in the background."""
        self._images.clear()
        self.order(self.frame_ids)

    def close(self) -> None:
        """Stop the thread."""
        self._pool.shutdown(cancel_futures=True)

    def _image(self, frame_id: str) -> QImage | None:
        if frame_id not in self._images:
            self._images[frame_id] = None
            self._pool.submit(self._draw, frame_id)
        return self._images[frame_id]

    def _draw(self, frame_id: str) -> None:
        """Draw a frame's picture in the thread; an empty one where the frame is broken."""
        try:
            image = thumbnail(self._read(frame_id))
        except CloudError:
            image = QImage()
        self._drawn.emit(frame_id, image)

    def _keep(self, frame_id: str, image: QImage) -> None:
        self._images[frame_id] = image
        self.changed(frame_id)

    def changed(self, frame_id: str) -> None:
        """Draw a frame's cell again, because its state may have changed."""
        if frame_id in self.frame_ids:
            index = self.index(self.frame_ids.index(frame_id))
            self.dataChanged.emit(index, index)


class _Cell(QStyledItemDelegate):
    theme: Theme = DARK

    def sizeHint(self, option: QStyleOptionViewItem, index: ModelIndex) -> QSize:  # noqa: N802
        return CELL

    def paint(self, painter: QPainter, option: QStyleOptionViewItem, index: ModelIndex) -> None:
        theme = self.theme
        painter.save()
        cell = QRectF(option.rect).adjusted(3, 3, -3, -3)
        chosen = bool(option.state & QStyle.StateFlag.State_Selected)
        draw_card(painter, cell, theme, chosen)
        image = index.data(Qt.ItemDataRole.DecorationRole)
        if isinstance(image, QImage) and not image.isNull():
            size = QSize(image.size()).scaled(THUMBNAIL, Qt.AspectRatioMode.KeepAspectRatio)
            left, top = (
                cell.center().x() - size.width() / 2,
                cell.top() + 4 + (THUMBNAIL.height() - size.height()) / 2,
            )
            painter.drawImage(QRectF(left, top, size.width(), size.height()), image)
        state = index.data(Qt.ItemDataRole.StatusTipRole)
        foot = QRectF(cell.left() + 8, cell.bottom() - 19, cell.width() - 16, 16)
        painter.setBrush(state_color(state, theme))
        painter.setPen(Qt.PenStyle.NoPen)
        painter.drawEllipse(QRectF(foot.left(), foot.center().y() - 4, 8, 8))
        painter.setPen(QColor(theme.text if chosen else theme.quiet))
        font = painter.font()
        font.setPixelSize(min(scaled(11), 15))
        painter.setFont(font)
        right = Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter
        left_ = Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignVCenter
        score = str(index.data(Qt.ItemDataRole.WhatsThisRole))
        painter.drawText(foot.adjusted(13, 0, 0, 0), left_, score)
        painter.drawText(foot, right, (str(index.data()).lstrip("0") or "0")[-6:])
        painter.restore()


class FrameStrip(QListView):
    """List view of frames in a row. opened: signal that a frame was clicked."""

    opened = Signal(str)

    def __init__(
        self, read: Callable[[str], FrameLabels], state: Callable[[str], State], score: Score
    ) -> None:
        super().__init__()
        self.model_ = Frames(read, state, score)
        self.setAccessibleName("Frames")
        self._cell = _Cell(self)
        self.setModel(self.model_)
        self.setItemDelegate(self._cell)
        self.setFlow(QListView.Flow.LeftToRight)
        self.setWrapping(False)
        self.setUniformItemSizes(True)
        self.setHorizontalScrollMode(QListView.ScrollMode.ScrollPerPixel)
        self.setVerticalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        self.setFixedHeight(CELL.height() + 12)
        self.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self.clicked.connect(lambda index: self.opened.emit(index.data()))

    def set_theme(self, theme: Theme) -> None:
        """Draw the strip in the colours of a theme."""
        self._cell.theme = theme
        self.viewport().update()

    def choose(self, frame_id: str) -> None:
        """Mark a frame as the open one, and scroll to it."""
        if frame_id in self.model_.frame_ids:
            index = self.model_.index(self.model_.frame_ids.index(frame_id))
            self.setCurrentIndex(index)
            self.scrollTo(index, QListView.ScrollHint.PositionAtCenter)
