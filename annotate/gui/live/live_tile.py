"""Flat picture of the running rig, with joints and facing drawn over it."""

from collections.abc import Sequence

import numpy as np
from PySide6.QtCore import QPointF, QRectF, Qt
from PySide6.QtGui import QColor, QImage, QPainter, QPaintEvent, QPen
from PySide6.QtWidgets import QWidget

from annotate.array_types import Float64, UInt8
from annotate.gui.widgets.overlay import draw_title
from annotate.gui.widgets.theme import Theme
from annotate.live.live_frame import BodyPose

# Logical px; radius of the facing's dial, distance from the edge; untuned.
DIAL_PX, DIAL_MARGIN_PX = 22.0, 10.0
JOINT_PX, BONE_PX = 3.0, 2.0  # logical px; radius of a joint, width of a bone; untuned


class Tile(QWidget):
    """Widget that shows a scaled picture with its title."""

    def __init__(self, title: str, theme: Theme) -> None:
        super().__init__()
        self.setAccessibleName(title)
        self.setMinimumSize(120, 100)
        self.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self.setAttribute(Qt.WidgetAttribute.WA_OpaquePaintEvent)
        self.title, self.theme = title, theme
        self._rgb: UInt8 | None = None
        self._joints_px: Float64 | None = None
        self._body_pose: BodyPose | None = None

    def load(self, rgb: UInt8, joints_px: Float64 | None = None, body_pose: BodyPose | None = None) -> None:
        """Show a picture (h, w, 3), with joints (J, 2) in its pixels and the facing if given."""
        self._rgb, self._joints_px, self._body_pose = np.ascontiguousarray(rgb), joints_px, body_pose
        self.update()

    def paintEvent(self, event: QPaintEvent) -> None:  # noqa: N802
        """Draw picture, title, joints and facing (Qt's hook)."""
        painter = QPainter(self)
        painter.fillRect(self.rect(), QColor(self.theme.ground))
        if self._rgb is not None:
            height, width = self._rgb.shape[:2]
            scale = min(self.width() / width, self.height() / height)
            corner = QPointF(self.width() - scale * width, self.height() - scale * height) / 2
            image = QImage(self._rgb.data, width, height, 3 * width, QImage.Format.Format_RGB888)
            painter.drawImage(QRectF(corner, corner + QPointF(width, height) * scale), image)
            painter.setRenderHint(QPainter.RenderHint.Antialiasing)
            if self._body_pose is not None and self._joints_px is not None:
                centres = (self._joints_px + 0.5).tolist()
                places = [corner + QPointF(*centre) * scale for centre in centres]
                self._draw_bones(painter, places, self._body_pose.bones)
                self._draw_dial(painter, self._body_pose)
        draw_title(painter, self.title)

    def _draw_bones(self, painter: QPainter, places: list[QPointF], bones: Sequence[tuple[int, int]]) -> None:
        for color, width in ((QColor(0, 0, 0, 170), BONE_PX + 2), (QColor("white"), BONE_PX)):
            painter.setPen(QPen(color, width, Qt.PenStyle.SolidLine, Qt.PenCapStyle.RoundCap))
            for a, b in bones:
                painter.drawLine(places[a], places[b])
        painter.setBrush(QColor("white"))
        for place in places:
            painter.drawEllipse(place, JOINT_PX, JOINT_PX)

    def _draw_dial(self, painter: QPainter, body_pose: BodyPose) -> None:
        """Draw a dial with the facing from above: an arrow out of the chest; down is towards the camera."""
        margin = DIAL_PX + DIAL_MARGIN_PX
        middle = QPointF(self.width() - margin, margin)
        painter.setBrush(QColor(0, 0, 0, 120))
        painter.setPen(QPen(QColor("white"), 1))
        painter.drawEllipse(middle, DIAL_PX, DIAL_PX)
        # A camera on the person's left (positive azimuth) sees a person who faces the left of the picture.
        angle = np.radians(body_pose.facing_deg)
        tip = QPointF(-np.sin(angle), np.cos(angle)) * DIAL_PX
        painter.setPen(QPen(QColor("white"), 3 if body_pose.facing_sure > 0.5 else 1))
        painter.drawLine(middle, middle + tip)
