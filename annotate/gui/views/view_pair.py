"""Cloud view and depth view of the open frame: their colourings, and marks in both."""

from collections.abc import Iterator
from functools import partial

import numpy as np
from PySide6.QtCore import QObject, QPointF, Signal

from annotate.array_types import Int64
from annotate.gui.state.edit_controller import EditController
from annotate.gui.state.outcome import NOTHING
from annotate.gui.state.point_colors import Colors, Look, colourings, legend
from annotate.gui.views.cloud_view import CloudView
from annotate.gui.views.depth_pane import DepthPane
from annotate.gui.views.drawing_layer import StrokeOptions
from annotate.gui.widgets.overlay import outline
from annotate.gui.widgets.theme import DARK, Rgb, Theme
from annotate.gui.widgets.witness import Witness
from annotate.scheme.colours import mark_rgb

View = CloudView | DepthPane
EDGE = 0.1  # share of a view at each edge from which a shown place is moved; untuned


class ViewPair(QObject):
    """Two views of the open frame.

    last: the view that the pointer was in last. peeking: True while the views are drawn without parts.
    changed: signal that the colouring of a view, or ``last``, changed.
    """

    changed = Signal()

    def __init__(self, edits: EditController, options: StrokeOptions, theme: Theme) -> None:
        super().__init__()
        self._edits, self.options, self._theme = edits, options, theme
        self.cloud, self.depth = CloudView(edits.frame.scene, options), DepthPane(edits.frame.scene, options)
        self.last: View = self.cloud
        self.peeking = False
        self._shown = edits.shown()
        for view in self:
            view.layer.witness = partial(self._witness, view)

    def __iter__(self) -> Iterator[View]:
        yield from (self.cloud, self.depth)

    # Colours

    def load(self) -> None:
        """Show the open frame."""
        self._shown = self._edits.shown()
        self.cancel()
        for view in self:
            view.layer.show_under_pointer(None, "")
            view.load(self._edits.frame.scene, self.colors(view), self._shown)

    def look(self, view: View) -> Look:
        """Return the colouring of a view; while the user peeks, without the parts' colours."""
        if not self.peeking:
            return view.look
        there = colourings(self._edits.frame.scene)
        wanted = view.look.colouring if view.look.colouring != "part" else "colour"
        return Look(wanted if wanted in there else "depth", outlines=False)

    def ground(self, view: View) -> Rgb:
        """Return the background colour of a view: dark for camera colours, in which light gaps would look
        like noise.
        """
        is_picture = self.look(view).colouring == "colour" and "colour" in colourings(self._edits.frame.scene)
        return (DARK if is_picture else self._theme).ground_rgb

    def colors(self, view: View) -> Colors:
        """Return a function from flat pixels to their current colours in a view."""
        return self._edits.colors(self.look(view), self.ground(view))

    def recolor(self, pixels: Int64 | None = None) -> None:
        """Redraw some pixels and their neighbours, or all, and parts whose visibility changed."""
        before, self._shown = self._shown, self._edits.shown()
        if pixels is not None:
            height, width = self._edits.parts.shape
            beside = np.concatenate([pixels + step for step in (0, -1, 1, -width, width)])
            pixels = np.unique(np.clip(beside, 0, height * width - 1))
            pixels = pixels[self._edits.frame.scene.labels.depth_mm.ravel()[pixels] > 0]
        for view in self:
            if not np.array_equal(before, self._shown):
                view.set_shown(self._shown)
            view.recolor(pixels, self.colors(view))
            view.layer.update()

    def _witness(self, view: View) -> Witness | None:
        """Return what a colour network shows of the frame's people, if it is to be drawn over a view."""
        people = self._edits.frame.scene.witnessed
        if not self._edits.display.witness or not people:
            return None
        # In space the outline of an image has no place.
        outlines = [one for person in people for one in person.outlines] if view is self.depth else []
        return Witness(
            [view.places_of(person.joints_mm / 1000) for person in people],
            [self.depth.places_at(one) for one in outlines],
        )

    def set_look(self, view: View, look: Look) -> None:
        """Set the colouring of a view."""
        view.look = look
        view.set_ground(self.ground(view))
        view.recolor(None, self.colors(view))
        self.changed.emit()

    def set_theme(self, theme: Theme) -> None:
        """Set the background colours of the views."""
        self._theme = theme
        for view in self:
            view.set_ground(self.ground(view))

    def peek(self, peeking: bool) -> None:
        """Draw both views without parts, or with parts again."""
        if peeking != self.peeking:
            self.peeking = peeking
            self.set_theme(self._theme)
            self.recolor()
            self.changed.emit()

    def show_scales(self) -> None:
        """Show the scale of each view's colours."""
        for view in self:
            view.layer.scale = legend(self._edits.frame.scene, self.look(view).colouring)
            view.layer.update()

    # Places

    def pointed(self) -> View | None:
        """Return the view under the pointer."""
        return next((view for view in self if view.layer.place is not None), None)

    def under_pointer(self) -> int | None:
        """Return the pixel under the pointer, in either view."""
        view = self.pointed()
        return view.pixel_at(view.layer.place) if view and view.layer.place else None

    def cancel(self) -> bool:
        """Drop the shapes being drawn and a command that waits for a click; return whether there were any."""
        once, self.options.once = self.options.once, ""
        return sum(view.layer.cancel() for view in self) > 0 or bool(once)

    def hover_again(self) -> None:
        """Update the marks under the pointer, because labels or the tool changed."""
        for view in self:
            if view.layer.place is not None and not view.layer.drawing:
                self.show_hovered(view, view.layer.place)

    def show_hovered(self, view: View, place: QPointF | None) -> None:
        """Show marks for a hovered position: text on its pixel, the outline of a click's effect, and a ring
        in the other view.
        """
        other = self.depth if view is self.cloud else self.cloud
        pixel = view.pixel_at(place) if place is not None else None
        if place is not None and view is not self.last:
            self.last = view
            self.changed.emit()
        other.mark(pixel)
        is_piece = self.options.tool == "piece" and not self.options.once
        taken = self._edits.would_take(pixel) if is_piece else NOTHING
        color = self.options.color
        for each in self:
            mark = None
            if len(taken):
                size = each.layer.width(), each.layer.height()
                mark = outline(*each.places(taken), size, (color.red(), color.green(), color.blue()))
            words = self._edits.frame.read_out(pixel) if pixel is not None and each is view else ""
            each.layer.show_under_pointer(mark, words)

    def show_place(self, pixels: Int64, middle: int) -> None:
        """Outline pixels in both views; a view moves only where their middle is near its edge."""
        for view in self:
            size = np.array([view.layer.width(), view.layer.height()])
            place = view.places(np.array([middle]))[0][0] / size
            if not (np.abs(place - 0.5) < 0.5 - EDGE).all():
                view.bring(middle)
            mark = outline(*view.places(pixels), (int(size[0]), int(size[1])), mark_rgb(self._edits.scheme))
            view.layer.show_under_pointer(mark, "")
