"""Joints and outlines of a colour network, drawn over a view."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from PySide6.QtCore import QPointF, Qt
from PySide6.QtGui import QColor, QPainter, QPen, QPolygonF

from annotate.array_types import Float64
from annotate.joint_names import BONES
from annotate.witness.skeleton import JOINT, SIDES

RGB = (255, 92, 214)  # unlike the parts of shipped schemes
DOT_PX = 4.0  # radius of a joint in logical pixels; untuned
ENDS = (("wrist", "hand"), ("ankle", "toes"))
LINES = (*BONES, *((f"{side}_{a}", f"{side}_{b}") for side in SIDES for a, b in ENDS))
"""Pairs of connected joints."""


class Witness(NamedTuple):
    """Positions on a view: joints (19, 2) of each person, NaN for unknown ones; outlines (n, 2)."""

    joints: Sequence[Float64]
    outlines: Sequence[Float64]


def draw_witness(painter: QPainter, witness: Witness) -> None:
    """Draw people: bones, joints, and dashed outlines."""
    painter.save()
    painter.setRenderHint(QPainter.RenderHint.Antialiasing)
    for color, width in ((QColor(0, 0, 0, 200), 4.0), (QColor(*RGB), 2.0)):
        solid, dashed = QPen(color, width), QPen(color, width, Qt.PenStyle.DashLine)
        painter.setPen(dashed if width < 4 else solid)
        for outline in witness.outlines:
            painter.drawPolygon(QPolygonF([QPointF(x, y) for x, y in outline]))
        painter.setPen(solid)
        for joints in witness.joints:
            for a, b in ((joints[JOINT[first]], joints[JOINT[second]]) for first, second in LINES):
                if np.isfinite(a + b).all():
                    painter.drawLine(QPointF(*a), QPointF(*b))
            for x, y in joints[np.isfinite(joints).all(axis=1)]:
                painter.drawEllipse(QPointF(x, y), DOT_PX, DOT_PX)
    painter.restore()
