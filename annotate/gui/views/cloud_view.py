"""View of the cloud in 3D: all points of the person, a thinned room, both thinned further while the view
moves.
"""

from dataclasses import replace
from typing import Any

import numpy as np
import pyvista as pv
from numpy.typing import NDArray
from PySide6.QtCore import QEvent, QObject, QPointF, Qt, QTimer, Signal
from PySide6.QtGui import QMouseEvent, QWheelEvent
from PySide6.QtWidgets import QVBoxLayout, QWidget
from pyvistaqt import QtInteractor

from annotate.array_types import Bool, Float32, Float64, Int64, UInt8
from annotate.correction import select
from annotate.correction.select import ScreenPoints
from annotate.gui.state.drawing import Drawing
from annotate.gui.state.orbit_camera import Orbit, front_view, project
from annotate.gui.state.point_colors import Colors, Look
from annotate.gui.state.scene import FrameScene
from annotate.gui.views.drawing_layer import DrawingLayer, StrokeOptions, samples
from annotate.gui.widgets.building_blocks import laid

MOVING_POINTS = 16_000  # points while the view moves: a frame every 20 ms without a graphics card (measured)
MOVING_MS = 180  # the view counts as moving for so long after a step of the wheel; untuned
IN_VIEW = 0.97  # share of the person on the screen for which the view stays from frame to frame; untuned
POINT_PX = (2.0, 14.0)  # least and greatest size of a point in logical pixels; untuned


class Points:
    """VTK actor of coloured points; each is a pixel of the depth image."""

    def __init__(self, plotter: QtInteractor) -> None:
        self._mesh = pv.PolyData(np.zeros((1, 3), np.float32))
        self._mesh["rgb"] = np.zeros((1, 3), np.uint8)
        self.pixels: Int64 = np.empty(0, np.int64)
        self.actor = plotter.add_mesh(
            self._mesh, scalars="rgb", rgb=True, style="points", lighting=False, render=False
        )
        # Because the search for transparent colours took a quarter of the time of a frame.
        self.actor.ForceOpaqueOn()

    def load(self, pixels: Int64, points_m: Float32, rgb: UInt8) -> None:
        """Replace the points by the pixels (n,) at ``points_m`` (n, 3) in colours (n, 3)."""
        self.pixels = pixels
        self._row = np.full(int(pixels.max(initial=-1)) + 1, -1, np.int32)
        self._row[pixels] = np.arange(len(pixels), dtype=np.int32)
        # Not by the constructor, because it makes a cell of every point: ``show_only`` does.
        self._mesh = pv.PolyData()
        self._mesh.points = points_m if len(points_m) else np.zeros((1, 3), np.float32)
        self._mesh["rgb"] = rgb if len(rgb) else np.zeros((1, 3), np.uint8)
        self.actor.mapper.dataset = self._mesh

    def recolor(self, pixels: Int64, rgb: UInt8) -> None:
        """Set the colours (n, 3) of pixels (n,); pixels that are not drawn here are left out."""
        rows = np.full(len(pixels), -1, np.int64)
        known = pixels < len(self._row)
        rows[known] = self._row[pixels[known]]
        colors: Any = self._mesh["rgb"]
        colors[rows[rows >= 0]] = rgb[rows >= 0]

    def show_only(self, shown: Bool) -> None:
        """Draw only the ``pixels`` (n,) for which ``shown`` (n,) is true."""
        rows = np.flatnonzero(shown) if len(self.pixels) else np.empty(0, np.int64)
        self._mesh.verts = np.r_[len(rows), rows] if len(rows) else np.empty(0, np.int64)


class CloudView(QWidget):
    """View of a frame's cloud. look: its colouring. layer: layer for drawn shapes. moved: signal that the
    view was turned or zoomed.
    """

    name = "Cloud"

    moved = Signal()

    def __init__(self, scene: FrameScene, options: StrokeOptions) -> None:
        super().__init__()
        self.scene, self.look = scene, Look()
        self.setAccessibleName("Cloud of the frame in three dimensions")
        self.plotter = QtInteractor(self, auto_update=False, multi_samples=0)
        laid(QVBoxLayout(self), self.plotter)
        self.layer = DrawingLayer(self.plotter, options)
        # Installed last, so that events that move the view do not reach the layer.
        self.plotter.installEventFilter(self)
        self.plotter.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self._person, self._room, self._moving = (Points(self.plotter) for _ in range(3))
        self.orbit = Orbit((0.0, 0.0, 2.0), 3.0)
        self._shown: Bool = np.zeros(scene.labels.depth_mm.size, np.bool_)
        self._seen: ScreenPoints | None = None
        self._grip: QPointF | None = None
        self._fitted, self._running = True, False
        self._still = QTimer(self, singleShot=True, interval=MOVING_MS)
        self._still.timeout.connect(lambda: self._set_moving(False))

    def end(self) -> None:
        """End drawing, and release all graphics before the window is deleted.

        pyvistaqt refers to the surface that it draws on. After the end of the window, Qt's binding would take
        another object at the same address for that surface.
        """
        self.plotter.close()
        # Qt releases a widget's graphics, with a signal, when the widget leaves its window.
        self.plotter.setParent(None)
        self.plotter.setParent(self)

    # Showing

    def load(self, scene: FrameScene, colors: Colors, shown: Bool, *, keep: bool = False) -> None:
        """Show another frame, from the same viewpoint if the person is in view.

        shown: bool (h * w,). keep: for a running rig: never move the camera, and draw all points while it
        moves.
        """
        self.scene, self._running = scene, keep
        near = np.flatnonzero(scene.near)
        mixed = np.r_[near, scene.room]
        points_m, rgb = scene.points_m[mixed], colors(mixed)
        few = np.linspace(0, len(mixed) - 1, 0 if keep else min(len(mixed), MOVING_POINTS)).astype(np.intp)
        rows: tuple[slice | NDArray[np.intp], ...] = slice(len(near)), slice(len(near), None), few
        for points, at in zip((self._person, self._room, self._moving), rows, strict=True):
            points.load(mixed[at], points_m[at], rgb[at])
        self.set_shown(shown)
        self._set_moving(self._grip is not None)
        if not keep and (self._fitted or not self._in_view(scene)):
            self.fit()

    def recolor(self, pixels: Int64 | None, colors: Colors) -> None:
        """Set the colours of some pixels, or of all."""
        for points in (self._person, self._room, self._moving):
            changed = points.pixels if pixels is None else pixels
            points.recolor(changed, colors(changed))
        self.plotter.update()

    def set_shown(self, shown: Bool) -> None:
        """Set the pixels that are drawn and can be chosen, bool (h * w,)."""
        self._shown, self._seen = shown, None
        for points in (self._person, self._room, self._moving):
            points.show_only(shown[points.pixels])
        self.plotter.update()

    def set_ground(self, rgb: tuple[int, int, int]) -> None:
        """Set the colour behind the cloud."""
        self.plotter.renderer.SetBackground([c / 255 for c in rgb])
        self.plotter.update()

    def look_ahead(self) -> None:
        """Show the person from the depth camera's viewpoint."""
        self.orbit = replace(self.orbit, azimuth_deg=0.0, elevation_deg=0.0)
        self.fit()

    def fit(self) -> None:
        """Fit the whole person into the view, from the same direction."""
        front = front_view(self.scene.points_m[_person(self.scene)], self._aspect)
        turned = self.orbit.azimuth_deg, self.orbit.elevation_deg
        self.orbit = replace(front, azimuth_deg=turned[0], elevation_deg=turned[1])
        self._fitted = True
        self._apply()

    def _in_view(self, scene: FrameScene) -> bool:
        person = np.flatnonzero(_person(scene))
        return not len(person) or float(np.isin(person, self.view().pixels).mean()) > IN_VIEW

    # Choosing pixels

    def view(self) -> ScreenPoints:
        """Return the screen positions of all points, computed once after every move."""
        if self._seen is None:
            self._seen = self._projected(self.scene.points_m, self._shown)
        return self._seen

    def _projected(self, points_m: Float32, shown: Bool) -> ScreenPoints:
        matrix = self.plotter.camera.GetCompositeProjectionTransformMatrix(self._aspect, -1, 1)
        numbers = np.array([[matrix.GetElement(r, c) for c in range(4)] for r in range(4)])
        size = self.plotter.width(), self.plotter.height()
        return project(points_m, shown, numbers, size, self._spacing_px)

    def places_of(self, points_m: Float64) -> Float64:
        """Return the positions (n, 2) of points (n, 3) of space on the view, NaN for unknown ones."""
        known: Bool = np.asarray(np.isfinite(points_m).all(axis=1))
        return self._projected(points_m.astype(np.float32), known).xy_px.astype(np.float64)

    def pixel_at(self, place: QPointF) -> int | None:
        """Return the pixel whose point is drawn at a position of the view, or None."""
        return select.nearest(self.view(), (place.x(), place.y()))

    def pixels_in(self, drawing: Drawing) -> Int64:
        """Return the pixels that a shape drawn on the view selects."""
        return drawing.pixels(self.view())

    def places(self, pixels: Int64) -> tuple[Float32, float]:
        """Return the positions (n, 2) of pixels on the view, NaN outside it, and the spacing of neighbouring
        points.
        """
        return self.view().xy_px[pixels], self._spacing_px

    def bring(self, pixel: int) -> None:
        """Move the camera so that a pixel's point is in the middle of the view, at the same distance."""
        point_m = self.scene.points_m[pixel]
        if np.isfinite(point_m).all():
            self._move(replace(self.orbit, target_m=tuple(point_m.tolist())))
            self._still.start()

    def mark(self, pixel: int | None) -> None:
        """Draw a ring around the point of a pixel; None removes it."""
        x, y = self.view().xy_px[pixel].tolist() if pixel is not None else (np.nan, np.nan)
        self.layer.ring(QPointF(x, y) if np.isfinite(x) else None)

    # Moving the view

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:  # noqa: N802
        """Handle the mouse, and keep all events from VTK's own interaction and keys (Qt's hook)."""
        kind = event.type()
        if isinstance(event, QWheelEvent):
            if event.modifiers() & Qt.KeyboardModifier.ShiftModifier:
                return False
            self._move(self.orbit.neared(event.angleDelta().y() / 120, self._under(event.position())))
            self._still.start()
            return True
        if kind in (QEvent.Type.KeyPress, QEvent.Type.KeyRelease):
            event.ignore()
            return True
        if kind == QEvent.Type.Resize:
            self._seen = None
            QTimer.singleShot(0, self.fit if self._fitted else self._apply)
        return isinstance(event, QMouseEvent) and self._gripped(kind, event)

    def _gripped(self, kind: QEvent.Type, event: QMouseEvent) -> bool:
        """Rotate with the right button, pan with the middle one; return whether the event was handled."""
        grips = (Qt.MouseButton.RightButton, Qt.MouseButton.MiddleButton)
        pressed = QEvent.Type.MouseButtonPress, QEvent.Type.MouseButtonDblClick
        if kind == QEvent.Type.MouseButtonDblClick and event.button() == Qt.MouseButton.RightButton:
            if (pixel := self.pixel_at(event.position())) is not None:
                self.bring(pixel)
            return True
        if samples(event) and self._grip is None:
            return False
        if kind in pressed and event.button() in grips:
            self._grip = event.position()
            return True
        if kind == QEvent.Type.MouseButtonRelease and event.button() in grips:
            self._grip = None
            self._set_moving(False)
            return True
        if kind == QEvent.Type.MouseMove and self._grip is not None:
            by, self._grip = event.position() - self._grip, event.position()
            if event.buttons() & Qt.MouseButton.RightButton:
                self._move(self.orbit.turned(by.x(), by.y()))
            else:
                self._move(self.orbit.shifted(by.x(), by.y(), self.plotter.height()))
            return True
        return False

    def _under(self, place: QPointF) -> Float64:
        """Return the point (3,) under a position; without one, the point at the target's distance."""
        pixel = self.pixel_at(place)
        if pixel is not None:
            return np.asarray(self.scene.points_m[pixel], np.float64)
        middle = self.plotter.rect().center()
        return self.orbit.ray(place.x() - middle.x(), place.y() - middle.y(), self.plotter.height())

    def _move(self, orbit: Orbit) -> None:
        self.orbit, self._fitted = orbit, False
        self._set_moving(True)
        self.moved.emit()

    def _set_moving(self, moving: bool) -> None:
        few = moving and not self._running
        for points, visible in ((self._person, not few), (self._room, not few), (self._moving, few)):
            points.actor.SetVisibility(visible)
        self._apply()

    def _apply(self) -> None:
        """Place the camera on its orbit, and set the point size so that the surface has no gaps."""
        camera, orbit = self.plotter.camera, self.orbit
        camera.position, camera.focal_point = orbit.position_m.tolist(), orbit.target_m
        camera.up, camera.view_angle = (0.0, -1.0, 0.0), orbit.angle_deg
        self.plotter.renderer.ResetCameraClippingRange()
        size_px = float(np.clip(1.25 * self._spacing_px, *POINT_PX))
        for points, factor in ((self._person, 1.0), (self._room, self.scene.room_step), (self._moving, 2.0)):
            points.actor.prop.point_size = size_px * factor * self.devicePixelRatioF()
        self._seen = None
        self.plotter.update()
        self.layer.update()

    @property
    def _aspect(self) -> float:
        return self.plotter.width() / max(1, self.plotter.height())

    @property
    def _spacing_px(self) -> float:
        """Return the distance of neighbouring points of the person on the screen."""
        spacing_m = self.orbit.target_m[2] / self.scene.cloud.camera.fx
        return abs(spacing_m) * self.orbit.focal_px(self.plotter.height()) / self.orbit.distance_m


def _person(scene: FrameScene) -> Bool:
    """Return flags (h * w,) of the person's pixels in the labels as read."""
    return np.asarray((scene.labels.parts.ravel() > 0) & (scene.labels.depth_mm.ravel() > 0))
