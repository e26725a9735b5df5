"""Shape being drawn on a view, from the first press to the last release. No GUI here."""

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from annotate.array_types import Float64, Int64
from annotate.correction import select
from annotate.correction.select import ScreenPoints
from annotate.labelset.stroke import Gesture, GestureKind

Tool = Literal["piece", "lasso", "polygon", "rectangle", "brush"]
TOOLS: tuple[Tool, ...] = ("piece", "lasso", "polygon", "rectangle", "brush")
STEP_PX = 2.0  # distance between points of a drawn line in logical pixels; untuned
LEAST_PX = 4.0  # least extent of a lasso or rectangle in logical pixels: smaller ones are slips; untuned


@dataclass
class Drawing:
    """Shape as drawn so far, in logical pixels.

    start_px: first point. radius_px: of the brush. through: also select hidden points. only: replace only the
    part under the start. room: include the background. points_px: line, corners or path. clicks: number of
    corners of a polygon, 1 for a piece or a rectangle. held_keys: number of held keys.
    """

    tool: Tool
    start_px: tuple[float, float]
    radius_px: float = 0.0
    through: bool = False
    only: bool = False
    room: bool = False
    points_px: list[tuple[float, float]] = field(default_factory=list)
    clicks: int = 1
    held_keys: int = 0

    def __post_init__(self) -> None:
        self.points_px = self.points_px or [self.start_px]
        # The keystroke-level model adds press and release of a drawn line.
        self.clicks = 0 if self.tool in ("lasso", "brush") else self.clicks

    def drag(self, x: float, y: float) -> None:
        """Extend the shape to the pointer."""
        if self.tool == "rectangle":
            self.points_px[1:] = [(x, y)]
        elif self.tool in ("lasso", "brush"):
            last_x, last_y = self.points_px[-1]
            if np.hypot(x - last_x, y - last_y) >= STEP_PX:
                self.points_px.append((x, y))

    def corner(self, x: float, y: float) -> None:
        """Add a corner to a polygon."""
        self.points_px.append((x, y))
        self.clicks += 1

    def without_corner(self) -> bool:
        """Remove a polygon's last corner; return whether any is left."""
        self.points_px.pop()
        self.clicks -= 1
        return bool(self.points_px)

    @property
    def is_slip(self) -> bool:
        """Return True if the shape is so small that it was drawn by accident."""
        if self.tool in ("piece", "brush"):
            return False
        extent = np.ptp(np.array(self.points_px), axis=0)
        return bool(extent.max() < LEAST_PX) or (self.tool != "rectangle" and len(self.points_px) < 3)

    def outline_px(self) -> Float64:
        """Return the points (n, 2) of the line to show; the four corners of a rectangle."""
        points = np.array(self.points_px, np.float64)
        if self.tool == "rectangle" and len(points) == 2:
            (left, top), (right, bottom) = points
            points = np.array([(left, top), (right, top), (right, bottom), (left, bottom)])
        return points

    def pixels(self, view: ScreenPoints) -> Int64:
        """Return the flat indices (n,) of the points that the shape selects in a view."""
        if self.tool == "brush":
            return select.brush(view, self.outline_px(), self.radius_px, self.through)
        return select.polygon(view, self.outline_px(), self.through)

    def scaled(self, left_px: float, top_px: float, scale: float) -> "Drawing":
        """Return the shape in the pixels of a zoomed image.

        left_px, top_px: position of the image's corner. scale: size of an image pixel in logical pixels.
        """
        points = [((x - left_px) / scale, (y - top_px) / scale) for x, y in self.points_px]
        return replace(self, start_px=points[0], radius_px=self.radius_px / scale, points_px=points)

    def gesture(self, kind: GestureKind, keys: int = 0) -> Gesture:
        """Return the gesture for the journal: clicks, points and length."""
        line = np.array(self.points_px, np.float64)
        held = self.tool != "polygon" and len(line) > 1
        path_px = float(np.hypot(*np.diff(line, axis=0).T).sum()) if held else 0.0
        return Gesture(kind, self.clicks, len(line), round(path_px, 1), keys)
