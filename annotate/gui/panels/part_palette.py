"""Part palette: tiles arranged like a body that faces the user, with things below; the paper's keys are
arranged in the same way.
"""

from PySide6.QtCore import QPoint, QPointF, QRect, QRectF, QSizeF, Qt, Signal
from PySide6.QtGui import QColor, QFont, QMouseEvent, QPainter, QPaintEvent
from PySide6.QtWidgets import QGridLayout, QLabel, QScrollArea, QSizePolicy, QVBoxLayout, QWidget

from annotate.gui.state.edit_controller import EditController
from annotate.gui.state.keys import Settings
from annotate.gui.state.point_colors import Visibility
from annotate.gui.widgets.building_blocks import draw_card, draw_icon, laid, named
from annotate.gui.widgets.theme import DARK, Theme, part_color, scaled
from annotate.scheme.body_grid import COLUMNS, body_grid, thing_grid
from annotate.scheme.scheme import BACKGROUND, UNDEFINED, Scheme

ICON_PX, HEIGHTS_PX = 16, (42, 62)  # size of lock and eye, least and greatest height of a tile; untuned
LINE_PX = 18  # least height of a tile where rows are many; untuned
ONE_LINE_PX, TWO_LINES_PX = 26, 40  # heights below which a tile has one line or two lines of text; untuned
SMALL_ICON_PX = 11  # size of lock and eye in such a tile; untuned
ICON_SIZE = QSizeF(ICON_PX + 2, ICON_PX + 4)  # of lock and eye in ``draw_icon``
USUAL_ROWS = 4  # rows of parts, above which tiles may be of one line: the paper's


class PartTile(QWidget):
    """Tile of one part: its key, colour, name and number of pixels, with a lock and an eye to click.

    least_px: least height. A tile with less than three lines has no number.
    """

    def __init__(self, part: int, key: str, least_px: int, palette: "Palette") -> None:
        super().__init__()
        self.part, self.key, self.theme, self._palette = part, key, DARK, palette
        scheme = palette.scheme
        self.count, self.chosen, self.locked = 0, False, False
        self.visibility: Visibility = "shown"
        self.setMinimumSize(scaled(78), scaled(least_px))
        self.setMaximumHeight(scaled(HEIGHTS_PX[1]))
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Expanding)
        self.setMouseTracking(True)
        name = "Undefined" if part == UNDEFINED else scheme.by_id[part].title
        own = {BACKGROUND: "Erase", UNDEFINED: "Undefined"}.get(part)
        self.name = own or scheme.short_title(part)
        self.setAccessibleName(name)
        by_key = f"{name}: {key} chooses it, Shift+{key} locks it, Alt+{key} fades, then hides it"
        by_click = f"{name}: a click chooses it, its lock locks it, its eye fades, then hides it"
        self.setToolTip(by_key if key else by_click)

    @property
    def lock_rect(self) -> QRect:
        """Return the rectangle of the lock icon."""
        return self._icon_rect(2)

    @property
    def eye_rect(self) -> QRect:
        """Return the rectangle of the eye icon."""
        return self._icon_rect(1)

    def _icon_rect(self, place: int) -> QRect:
        """Return the rectangle of an icon. place: number from the right, from 1."""
        if self._lines < 3:
            size, left = SMALL_ICON_PX, self.width() - place * (SMALL_ICON_PX + 2) - 4
            return QRect(left, 3 if self._lines == 2 else (self.height() - size) // 2, size, size + 1)
        left = self.width() - place * ICON_PX - 2 - 4 * place
        return QRect(QPoint(left, self._icon_top), ICON_SIZE.toSize())

    @property
    def _is_low(self) -> bool:
        """Return True if the tile is too low for three lines of normal text."""
        return self.height() < scaled(HEIGHTS_PX[1] - 8)

    @property
    def _lines(self) -> int:
        """Return the number of lines of text, at most three; a low and wide tile of normal height has three
        in one row.
        """
        if self.height() < scaled(ONE_LINE_PX):
            return 1
        return 2 if self.height() < scaled(TWO_LINES_PX) and self.part != UNDEFINED else 3

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
        draw_card(painter, body, theme, self.chosen, part_color(self._palette.scheme, self.part, theme))
        if self.visibility == "hidden":
            painter.setOpacity(0.5)
        self._write(painter)
        painter.setOpacity(1)
        lock, lock_color = ("locked", theme.warn) if self.locked else ("unlocked", theme.line)
        for place, name, color in (
            (self.lock_rect, lock, lock_color),
            (self.eye_rect, self.visibility, theme.quiet),
        ):
            painter.save()
            painter.translate(place.topLeft())
            painter.scale(place.width() / ICON_SIZE.width(), place.height() / ICON_SIZE.height())
            draw_icon(painter, QRectF(QPointF(), ICON_SIZE), name, color, 1.5)
            painter.restore()

    def _write(self, painter: QPainter) -> None:
        """Draw the key at the top, the name in the middle, and the count at the bottom."""
        if self._lines < 3:
            self._write_small(painter)
            return
        number = f"{self.count:,}" if self.count and self.part != BACKGROUND else ""
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
            (centre, left | middle, self.name, sizes_px[1], self.chosen, self.theme.text),
            (inside, side | beneath, number, sizes_px[2], False, quiet),
        ):
            self._set_font(painter, size_px, bold)
            painter.setPen(QColor(color))
            painter.drawText(place, align, text)

    def _write_small(self, painter: QPainter) -> None:
        """Draw key and name in one line, or the name below the key; a long name is cut."""
        left = Qt.AlignmentFlag.AlignLeft
        middle, beneath = left | Qt.AlignmentFlag.AlignVCenter, left | Qt.AlignmentFlag.AlignBottom
        inside = self.rect().adjusted(9, 2, -4, -3 if self._lines == 2 else -2)
        self._set_font(painter, 10, True)
        painter.setPen(QColor(self.theme.quiet))
        painter.drawText(inside, middle if self._lines == 1 else left, self.key)
        if self._lines == 1:
            inside.setRight(self.lock_rect.left() - 2)
            if self.key:
                inside.setLeft(inside.left() + painter.fontMetrics().horizontalAdvance(self.key) + 3)
        self._set_font(painter, 10 if self._lines == 1 else 11, self.chosen)
        painter.setPen(QColor(self.theme.text))
        name = painter.fontMetrics().elidedText(self.name, Qt.TextElideMode.ElideRight, inside.width())
        painter.drawText(inside, middle if self._lines == 1 else beneath, name)

    def _set_font(self, painter: QPainter, size_px: int, bold: bool) -> None:
        font = QFont(self.font())
        font.setPixelSize(scaled(size_px))
        font.setBold(bold)
        painter.setFont(font)


class Palette(QScrollArea):
    """Scrollable palette of tiles. chosen, locked, faded: signals that a tile, its lock or its eye was
    clicked.
    """

    chosen = Signal(int)
    locked = Signal(int)
    faded = Signal(int)

    def __init__(self, scheme: Scheme, settings: Settings) -> None:
        super().__init__()
        self.scheme = scheme
        body, things = body_grid(scheme), thing_grid(scheme)
        self._is_dense = len(body) + len(things) > USUAL_ROWS
        inner = named(QWidget(), "panel")
        inside = laid(QVBoxLayout(inner), gap=4, margins=(12, 8, 12, 10))
        heading = ("THEIR RIGHT", "PARTS", "THEIR LEFT") if _has_sides(scheme) else ("PARTS",)
        inside.addLayout(_heading(*heading))
        self.setWidgetResizable(True)
        self.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        self.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self.setWidget(inner)
        self.tiles: dict[int, PartTile] = {}
        for number, rows in enumerate((body, things)):
            if not rows:
                continue
            grid = QGridLayout()
            grid.setSpacing(2 if self._is_dense else 5)
            for row, parts in enumerate(rows):
                for column, part in enumerate(parts):
                    if part is not None:
                        grid.addWidget(self._tile(part, settings), row, column)
            if number == 0:
                grid.addWidget(self._tile(UNDEFINED, settings), len(rows), 0, 1, COLUMNS)
            else:
                inside.addLayout(_heading("THINGS"))
            for column in range(COLUMNS):
                grid.setColumnStretch(column, 1)
            inside.addLayout(grid)
            inside.setStretchFactor(grid, 25 * len(rows))
        inside.addStretch(1)

    @property
    def needed_px(self) -> int:
        """Return the height of a palette with many parts that needs no scroll bar, 0 for one with few."""
        inner = self.widget()
        return inner.minimumSizeHint().height() + 2 if self._is_dense and inner else 0

    def _tile(self, part: int, settings: Settings) -> PartTile:
        least_px = LINE_PX if self._is_dense else HEIGHTS_PX[0]
        tile = self.tiles[part] = PartTile(part, settings.part_key(part), least_px, self)
        if part == UNDEFINED:
            tile.setFixedHeight(scaled(LINE_PX + 2 if self._is_dense else HEIGHTS_PX[0] - 4))
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


def _has_sides(scheme: Scheme) -> bool:
    """Return whether a scheme has left and right parts of the body."""
    return any(not scheme.is_thing[left] for left, _ in scheme.twins)


def _heading(*texts: str) -> QGridLayout:
    """Return a row of captions: at the left, in the middle and at the right."""
    heading = QGridLayout()
    heading.setContentsMargins(2, 0, 2, 0)
    aligns = Qt.AlignmentFlag.AlignLeft, Qt.AlignmentFlag.AlignCenter, Qt.AlignmentFlag.AlignRight
    for column, text in enumerate(texts):
        heading.addWidget(named(QLabel(text), "caption"), 0, column, aligns[column])
    return heading
