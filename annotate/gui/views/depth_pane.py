"""View of the depth image in 2D with the parts over it: painting as in 3D, its own zoom and pan."""

import numpy as np
from PySide6.QtCore import QPointF, QRectF, Qt, Signal
from PySide6.QtGui import QColor, QImage, QMouseEvent, QPainter, QPaintEvent, QResizeEvent, QWheelEvent
from PySide6.QtWidgets import QWidget

from annotate.array_types import Bool, Float32, Float64, Int64, UInt8
from annotate.correction import select
from annotate.correction.select import ScreenPoints
from annotate.crop import window_of
from annotate.gui.state.drawing import Drawing
from annotate.gui.state.point_colors import Colors, Look
from annotate.gui.state.scene import FrameScene
from annotate.gui.views.drawing_layer import DrawingLayer, StrokeOptions
from annotate.gui.widgets.theme import DARK
from sensors.rig.camera import project

SCALES = (0.2, 40.0)  # least and greatest zoom, logical pixels per pixel of the image
REACH_PX = 6.0  # from the pointer to a pixel with depth that a click finds, in logical pixels; untuned


class DepthPane(QWidget):
    """View of a frame's depth image. look: its colouring. layer: layer for drawn shapes. moved: signal that
    the view was panned or zoomed.
    """

    name = "Depth image"

    moved = Signal()

    def __init__(self, scene: FrameScene, options: StrokeOptions) -> None:
        super().__init__()
        self.scene, self.look = scene, Look()
        self.setAccessibleName("Depth image of the frame")
        self.layer = DrawingLayer(self, options)
        self.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self.setMinimumSize(120, 90)
        self.ground = QColor("black")
        self._hole_rgb = DARK.ground_rgb
        self._rgb: UInt8 = np.zeros((*scene.labels.parts.shape, 3), np.uint8)
        self._view = ScreenPoints.of_image(scene.labels.depth_mm)
        self._scale, self._corner = 1.0, QPointF(0, 0)
        self._marked: int | None = None
        self._grip: QPointF | None = None
        self._fitted = True

    # Showing

    def load(self, scene: FrameScene, colors: Colors, shown: Bool) -> None:
        """Show another frame at the same zoom, or fitted to it. shown: bool (h * w,)."""
        self.scene = scene
        self.set_shown(shown)
        self.recolor(None, colors)
        if self._fitted:
            self.fit()

    def recolor(self, pixels: Int64 | None, colors: Colors) -> None:
        """Set the colours of some pixels, or of all with depth; hidden pixels get the background colour."""
        ground = (self.ground.red(), self.ground.green(), self.ground.blue())
        changed = pixels
        if changed is None:
            changed = np.flatnonzero(self.scene.labels.depth_mm)
            self._rgb[:] = self._hole_rgb
        rgb = colors(changed)
        rgb[np.isnan(self._view.xy_px[changed, 0])] = ground
        self._rgb.reshape(-1, 3)[changed] = rgb
        self.update()

    def set_shown(self, shown: Bool) -> None:
        """Set the pixels that can be chosen, bool (h * w,)."""
        view = ScreenPoints.of_image(self.scene.labels.depth_mm)
        self._view = ScreenPoints(np.where(shown[:, None], view.xy_px, np.nan), view.distance_m, view.size_px)

    def set_ground(self, rgb: tuple[int, int, int]) -> None:
        """Set the colour around the image."""
        self.ground = QColor(*rgb)
        self.update()

    def fit(self) -> None:
        """Zoom to the person, or to the whole image without a person."""
        there = self.scene.labels.parts > 0
        rows, columns = window_of(there if there.any() else np.ones_like(there))
        across, down = columns.stop - columns.start, rows.stop - rows.start
        scale = 0.86 * min(self.width() / across, self.height() / down)
        self._scale = float(np.clip(scale, *SCALES))
        middle = QPointF(columns.start + across / 2, rows.start + down / 2) * self._scale
        self._corner = QPointF(self.width() / 2, self.height() / 2) - middle
        self._fitted = True
        self._moved()

    def paintEvent(self, event: QPaintEvent) -> None:  # noqa: N802
        """Draw the image and its frame (Qt's hook)."""
        painter = QPainter(self)
        painter.fillRect(self.rect(), self.ground)
        height, width = self._rgb.shape[:2]
        image = QImage(self._rgb.data, width, height, 3 * width, QImage.Format.Format_RGB888)
        painter.setRenderHint(QPainter.RenderHint.SmoothPixmapTransform, self._scale < 2)
        size = QPointF(width, height) * self._scale
        painter.drawImage(QRectF(self._corner, self._corner + size), image)

    # Choosing pixels

    def pixel_at(self, place: QPointF) -> int | None:
        """Return the flat index of the pixel under a position of the pane.

        Without a shown pixel there, returns the nearest shown pixel within ``REACH_PX``, or None.
        """
        at = (place - self._corner) / self._scale
        (height, width), (u, v) = self._rgb.shape[:2], (int(at.x() // 1), int(at.y() // 1))
        under = v * width + u
        if 0 <= v < height and 0 <= u < width and np.isfinite(self._view.xy_px[under, 0]):
            return int(under)
        return select.nearest(self._view, (at.x(), at.y()), max(1.0, REACH_PX / self._scale))

    def pixels_in(self, drawing: Drawing) -> Int64:
        """Return the pixels that a shape drawn on the pane selects; in an image no pixel hides another."""
        drawing = drawing.scaled(self._corner.x(), self._corner.y(), self._scale)
        drawing.through = True
        return drawing.pixels(self._view)

    def place_of(self, pixel: int) -> QPointF:
        """Return the position of a pixel's centre on the pane."""
        v, u = divmod(pixel, self._rgb.shape[1])
        return self._corner + QPointF(u + 0.5, v + 0.5) * self._scale

    def places(self, pixels: Int64) -> tuple[Float32, float]:
        """Return the positions (n, 2) of pixels on the pane, and the spacing of neighbouring pixels."""
        v, u = np.divmod(pixels, self._rgb.shape[1])
        corner = np.array([self._corner.x(), self._corner.y()])
        xy_px = corner + (np.stack([u, v], axis=1) + 0.5) * self._scale
        return xy_px.astype(np.float32), self._scale

    def places_of(self, points_m: Float64) -> Float64:
        """Return the positions (n, 2) of points (n, 3) of space on the pane, NaN for unknown ones."""
        return self.places_at(project(self.scene.cloud.camera, points_m))

    def places_at(self, at_px: Float64) -> Float64:
        """Return the positions (n, 2) of columns and rows (n, 2) of the image on the pane."""
        return np.array([self._corner.x(), self._corner.y()]) + (at_px + 0.5) * self._scale

    def bring(self, pixel: int) -> None:
        """Pan so that a pixel is in the middle of the pane."""
        self._corner += QPointF(self.width() / 2, self.height() / 2) - self.place_of(pixel)
        self._fitted = False
        self._moved()

    def mark(self, pixel: int | None) -> None:
        """Draw a ring around a pixel; None removes it."""
        self._marked = pixel
        self.layer.ring(self.place_of(pixel) if pixel is not None else None)

    # Moving the view

    def wheelEvent(self, event: QWheelEvent) -> None:  # noqa: N802
        """Zoom about the pointer (Qt's hook)."""
        at = event.position()
        scale = float(np.clip(self._scale * 1.2 ** (event.angleDelta().y() / 120), *SCALES))
        self._corner = at - (at - self._corner) * (scale / self._scale)
        self._scale, self._fitted = scale, False
        self._moved()

    def mousePressEvent(self, event: QMouseEvent) -> None:  # noqa: N802
        """Start to pan the image with any button that does not draw (Qt's hook)."""
        self._grip = event.position()

    def mouseDoubleClickEvent(self, event: QMouseEvent) -> None:  # noqa: N802
        """Pan the place under the right button to the middle (Qt's hook)."""
        if event.button() == Qt.MouseButton.RightButton:
            if (pixel := self.pixel_at(event.position())) is not None:
                self.bring(pixel)
        else:
            self.mousePressEvent(event)

    def mouseMoveEvent(self, event: QMouseEvent) -> None:  # noqa: N802
        """Pan the image while a button is held (Qt's hook)."""
        if self._grip is not None and event.buttons():
            self._corner += event.position() - self._grip
            self._grip, self._fitted = event.position(), False
            self._moved()

    def mouseReleaseEvent(self, event: QMouseEvent) -> None:  # noqa: N802
        """End panning (Qt's hook)."""
        self._grip = None

    def resizeEvent(self, event: QResizeEvent) -> None:  # noqa: N802
        """Keep the person in view (Qt's hook)."""
        if self._fitted:
            self.fit()

    def _moved(self) -> None:
        self.mark(self._marked)
        self.update()
        self.moved.emit()
