"""Part palette: twelve tiles arranged like a body that faces the user; their keys are arranged in the same
way.
"""

from PySide6.QtCore import QRect, QRectF, Qt, Signal
from PySide6.QtGui import QColor, QFont, QMouseEvent, QPainter, QPaintEvent
from PySide6.QtWidgets import QGridLayout, QLabel, QScrollArea, QSizePolicy, QVBoxLayout, QWidget

from annotate.gui.state.edit_controller import EditController
from annotate.gui.state.keys import BODY_GRID, Settings
from annotate.gui.state.point_colors import Visibility
from annotate.gui.widgets.building_blocks import draw_card, draw_icon, laid, named
from annotate.gui.widgets.theme import DARK, Theme, part_color, scaled
from annotate.parts import BACKGROUND, PARTS, UNDEFINED

ICON_PX, HEIGHTS_PX = 16, (42, 62)  # size of lock and eye, least and greatest height of a tile; untuned


class PartTile(QWidget):
    """Tile of one part: its key, colour, name and number of pixels, with a lock and an eye to click."""

    def __init__(self, part: int, key: str, palette: "Palette") -> None:
        super().__init__()
        self.part, self.key, self.theme, self._palette = part, key, DARK, palette
        self.count, self.chosen, self.locked = 0, False, False
        self.visibility: Visibility = "shown"
        self.setMinimumSize(scaled(78), scaled(HEIGHTS_PX[0]))
        self.setMaximumHeight(scaled(HEIGHTS_PX[1]))
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Expanding)
        self.setMouseTracking(True)
        name = "Undefined" if part == UNDEFINED else PARTS[part].title
        self.setAccessibleName(name)
        self.setToolTip(f"{name}: {key} chooses it, Shift+{key} locks it, Alt+{key} fades, then hides it")

    @property
    def lock_rect(self) -> QRect:
        """Return the rectangle of the lock icon."""
        return QRect(self.width() - 2 * ICON_PX - 10, self._icon_top, ICON_PX + 2, ICON_PX + 4)

    @property
    def eye_rect(self) -> QRect:
        """Return the rectangle of the eye icon."""
        return QRect(self.width() - ICON_PX - 6, self._icon_top, ICON_PX + 2, ICON_PX + 4)

    @property
    def _is_low(self) -> bool:
        """Return True if the tile is too low for three lines of normal text."""
        return self.height() < scaled(HEIGHTS_PX[1] - 8)

    @property
    def _icon_top(self) -> int:
        if self.part == UNDEFINED:
            return (self.height() - ICON_PX - 4) // 2
        return -1 if self._is_low else 4

    def mousePressEvent(self, event: QMouseEvent) -> None:  # noqa: N802
        """Emit the signal of the lock, the eye or the tile under a click (Qt's hook)."""
        place = event.position().toPoint()
        if self.lock_rect.contains(place):
            self._palette.locked.emit(self.part)
        elif self.eye_rect.contains(place):
            self._palette.faded.emit(self.part)
        else:
            self._palette.chosen.emit(self.part)

    def paintEvent(self, event: QPaintEvent) -> None:  # noqa: N802
        """Draw the tile (Qt's hook)."""
        painter, theme = QPainter(self), self.theme
        body = QRectF(self.rect()).adjusted(1.5, 1.5, -1.5, -1.5)
        draw_card(painter, body, theme, self.chosen, part_color(self.part, theme))
        if self.visibility == "hidden":
            painter.setOpacity(0.5)
        self._write(painter)
        painter.setOpacity(1)
        lock, lock_color = ("locked", theme.warn) if self.locked else ("unlocked", theme.line)
        draw_icon(painter, QRectF(self.lock_rect), lock, lock_color, 1.5)
        draw_icon(painter, QRectF(self.eye_rect), self.visibility, theme.quiet, 1.5)

    def _write(self, painter: QPainter) -> None:
        """Draw the key at the top, the name in the middle, and the count at the bottom."""
        number = f"{self.count:,}" if self.count and self.part != BACKGROUND else ""
        name = {BACKGROUND: "Erase", UNDEFINED: "Undefined"}.get(self.part, "")
        name = name or PARTS[self.part].title.replace("Left ", "").replace("Right ", "").capitalize()
        quiet, low = self.theme.quiet, self._is_low
        sizes_px = (10, 12, 9) if low else (12, 12, 10)
        inside = self.rect().adjusted(14, 3 if low else 6, -7, -3 if low else -5)
        above, left = Qt.AlignmentFlag.AlignTop, Qt.AlignmentFlag.AlignLeft
        beneath, middle = Qt.AlignmentFlag.AlignBottom, Qt.AlignmentFlag.AlignVCenter
        side = left
        if self.part == UNDEFINED:
            # A low and wide tile: the name beside the key, the count at the right.
            above, middle, beneath, side = middle, middle, middle, Qt.AlignmentFlag.AlignRight
            inside = inside.adjusted(0, 0, -2 * ICON_PX - 8, 0)
        centre = inside.adjusted(scaled(56) if self.part == UNDEFINED else 0, 2 if low else 0, 0, 0)
        for place, align, text, size_px, bold, color in (
            (inside, left | above, self.key, sizes_px[0], True, quiet),
            (centre, left | middle, name, sizes_px[1], self.chosen, self.theme.text),
            (inside, side | beneath, number, sizes_px[2], False, quiet),
        ):
            font = QFont(self.font())
            font.setPixelSize(scaled(size_px))
            font.setBold(bold)
            painter.setFont(font)
            painter.setPen(QColor(color))
            painter.drawText(place, align, text)


class Palette(QScrollArea):
    """Scrollable palette of tiles. chosen, locked, faded: signals that a tile, its lock or its eye was
    clicked.
    """

    chosen = Signal(int)
    locked = Signal(int)
    faded = Signal(int)

    def __init__(self, settings: Settings) -> None:
        super().__init__()
        heading, grid = QGridLayout(), QGridLayout()
        heading.setContentsMargins(2, 0, 2, 0)
        aligns = Qt.AlignmentFlag.AlignLeft, Qt.AlignmentFlag.AlignCenter, Qt.AlignmentFlag.AlignRight
        for column, text in enumerate(("THEIR RIGHT", "PARTS", "THEIR LEFT")):
            heading.addWidget(named(QLabel(text), "caption"), 0, column, aligns[column])
        grid.setSpacing(5)
        inner = named(QWidget(), "panel")
        inside = laid(QVBoxLayout(inner), heading, grid, None, gap=4, margins=(12, 8, 12, 10))
        inside.setStretchFactor(grid, 100)
        self.setWidgetResizable(True)
        self.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        self.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self.setWidget(inner)
        self.tiles: dict[int, PartTile] = {}
        for row, parts in enumerate(BODY_GRID):
            for column, part in enumerate(parts):
                grid.addWidget(self._tile(part, settings.key(PARTS[part].name)), row, column)
        grid.addWidget(self._tile(UNDEFINED, settings.key("undefined")), len(BODY_GRID), 0, 1, 3)

    def _tile(self, part: int, key: str) -> PartTile:
        tile = self.tiles[part] = PartTile(part, key, self)
        if part == UNDEFINED:
            tile.setFixedHeight(scaled(HEIGHTS_PX[0] - 4))
        return tile

    def show_edits(self, edits: EditController, theme: Theme) -> None:
        """Update counts, choice, locks and eyes."""
        counts, display = edits.frame.counts(), edits.display
        for part, tile in self.tiles.items():
            tile.theme, tile.count = theme, counts[part]
            tile.chosen, tile.locked = part == edits.part, part in edits.locks
            alone = display.alone and not tile.chosen
            tile.visibility = "hidden" if alone else display.visibility.get(part, "shown")
            held = [f"{tile.count} pixels", "chosen" * tile.chosen, "locked" * tile.locked, tile.visibility]
            tile.setAccessibleDescription(", ".join(filter(None, held)))
            tile.update()
