"""Overlay drawn without rendering the view again: outlines of pixels, text, and a scale."""

from typing import NamedTuple

import cv2
import numpy as np
from PySide6.QtCore import QPointF, QRectF, Qt
from PySide6.QtGui import QColor, QImage, QPainter

from annotate.array_types import Float32, UInt8

PAD_PX = 3  # room for the line around the pixels, in logical pixels
MARGIN_PX = 8.0
SCALE_PX = (110.0, 8.0)  # size of the scale in logical pixels; untuned


class Outline(NamedTuple):
    """Outline to draw. image: with transparency. corner: its position on the view."""

    image: QImage
    corner: QPointF


def outline(
    xy_px: Float32, point_px: float, size_px: tuple[int, int], rgb: tuple[int, int, int]
) -> Outline | None:
    """Return the outline of points (n, 2) on a view, filled with a tint; None where no point is on the view.

    point_px: distance of neighbouring points, within which they join to a surface. size_px: of the view.
    """
    on = (xy_px >= 0).all(axis=1) & (xy_px < np.array(size_px, np.float32)).all(axis=1)
    if not on.any():
        return None
    at = xy_px[on].astype(np.intp)
    side = int(np.ceil(1.5 * max(1.0, point_px)))
    pad = PAD_PX + side
    low = at.min(axis=0) - pad
    width, height = (at.max(axis=0) - low + pad + 1).tolist()
    mask = np.zeros((height, width), np.uint8)
    mask[at[:, 1] - low[1], at[:, 0] - low[0]] = 1
    mask = cv2.dilate(mask, np.ones((side, side), np.uint8))
    white, black = (cv2.dilate(mask, np.ones((k, k), np.uint8)) > 0 for k in (3, 5))
    rgba: UInt8 = np.zeros((height, width, 4), np.uint8)
    rgba[black], rgba[white] = (0, 0, 0, 200), (255, 255, 255, 255)
    rgba[mask > 0] = (*rgb, 110)
    image = QImage(rgba.data, width, height, 4 * width, QImage.Format.Format_RGBA8888).copy()
    return Outline(image, QPointF(*low.tolist()))


def draw_words(painter: QPainter, size: QRectF, text: str) -> None:
    """Draw wrapped text at the lower left corner, on a dark background."""
    if not text:
        return
    left = Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignVCenter | Qt.TextFlag.TextWordWrap
    place = painter.boundingRect(size.adjusted(0, 0, -30, 0), left, text)
    box = QRectF(MARGIN_PX, size.bottom() - place.height() - 14, place.width() + 14, place.height() + 6)
    painter.fillRect(box, QColor(0, 0, 0, 170))
    painter.setPen(QColor("white"))
    painter.drawText(box.adjusted(7, 0, 0, 0), left, text)


def draw_title(painter: QPainter, text: str) -> None:
    """Draw a title at the upper left corner, on a dark background."""
    size = painter.fontMetrics().size(0, text)
    box = QRectF(0, 0, size.width() + 2 * MARGIN_PX, size.height() + MARGIN_PX)
    painter.fillRect(box, QColor(0, 0, 0, 170))
    painter.setPen(QColor("white"))
    painter.drawText(box, Qt.AlignmentFlag.AlignCenter, text)


def draw_scale(painter: QPainter, size: QRectF, scale: tuple[str, str, UInt8] | None) -> None:
    """Draw a colour scale at the upper right corner, its ends labelled (``point_colors.legend``)."""
    if scale is None:
        return
    low, high, rgb = scale
    place = QRectF(size.right() - SCALE_PX[0] - MARGIN_PX, size.top() + MARGIN_PX, *SCALE_PX)
    words = QRectF(place.left(), place.bottom(), place.width(), painter.fontMetrics().height() + 2)
    painter.fillRect(place.united(words).adjusted(-4, -4, 4, 2), QColor(0, 0, 0, 170))
    rgb = np.ascontiguousarray(rgb)
    painter.drawImage(place, QImage(rgb.data, len(rgb), 1, 3 * len(rgb), QImage.Format.Format_RGB888))
    painter.setPen(QColor("white"))
    painter.drawText(words, Qt.AlignmentFlag.AlignLeft, low)
    painter.drawText(words, Qt.AlignmentFlag.AlignRight, high)
