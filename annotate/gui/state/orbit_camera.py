"""Camera that orbits the person, pans and zooms, and the projection of a cloud onto its screen.

Screen coordinates are Qt's logical pixels, x right and y down from the view's upper left corner, at every
pixel ratio of the screen. Constants are untuned. No GUI here.
"""

from dataclasses import dataclass, replace

import numpy as np

from annotate.array_types import Bool, Float32, Float64
from annotate.correction.select import CELL_PX, ScreenPoints

DEGREES_PER_PX = 0.35  # turn of the view by one pixel of dragging
ZOOM_PER_STEP = 1.15  # factor of one step of the wheel
STEEPEST_DEG = 88.0  # largest elevation: at 90 degrees the view has no upright
CELL_SPACINGS = 2.2  # side of a view's cells in distances of neighbouring points, without gaps


@dataclass(frozen=True)
class Orbit:
    """Camera that looks at ``target_m`` from a distance, in the depth camera's frame (y down, z forward).

    azimuth_deg: 0 looks along z, positive looks from the right. elevation_deg: positive looks from above.
    angle_deg: the vertical field of view.
    """

    target_m: tuple[float, float, float]
    distance_m: float
    azimuth_deg: float = 0.0
    elevation_deg: float = 0.0
    angle_deg: float = 30.0

    @property
    def axes(self) -> tuple[Float64, Float64, Float64]:
        """Return the unit vectors right, down and forward of the view."""
        a, e = np.radians([self.azimuth_deg, self.elevation_deg])
        forward = np.array([-np.sin(a) * np.cos(e), np.sin(e), np.cos(a) * np.cos(e)])
        right = np.array([np.cos(a), 0.0, np.sin(a)])
        return right, np.cross(forward, right), forward

    @property
    def position_m(self) -> Float64:
        """Return the position (3,) of the eye in the depth camera's frame."""
        return np.asarray(np.array(self.target_m) - self.distance_m * self.axes[2])

    def focal_px(self, height_px: int) -> float:
        """Return the focal length in pixels of a view of this height."""
        return float(height_px / 2 / np.tan(np.radians(self.angle_deg / 2)))

    def turned(self, right_px: float, down_px: float) -> "Orbit":
        """Return the orbit rotated by a drag of the mouse."""
        elevation = np.clip(self.elevation_deg + DEGREES_PER_PX * down_px, -STEEPEST_DEG, STEEPEST_DEG)
        azimuth = (self.azimuth_deg - DEGREES_PER_PX * right_px + 180) % 360 - 180
        return replace(self, azimuth_deg=azimuth, elevation_deg=float(elevation))

    def shifted(self, right_px: float, down_px: float, height_px: int) -> "Orbit":
        """Return the orbit panned by a drag of the mouse; the target follows the pointer."""
        return replace(self, target_m=tuple(self.ray(-right_px, -down_px, height_px).tolist()))

    def neared(self, steps: float, towards_m: Float64 | None = None) -> "Orbit":
        """Return the orbit zoomed by steps of the wheel.

        towards_m: (3,), point that stays in place on the screen; None = the target.
        """
        distance_m = float(np.clip(self.distance_m * ZOOM_PER_STEP**-steps, 0.15, 20.0))
        if towards_m is None:
            return replace(self, distance_m=distance_m)
        eye = towards_m + (self.position_m - towards_m) * (distance_m / self.distance_m)
        return replace(
            self, distance_m=distance_m, target_m=tuple((eye + distance_m * self.axes[2]).tolist())
        )

    def ray(self, right_px: float, down_px: float, height_px: int) -> Float64:
        """Return the point (3,) that a view shows at an offset from its middle, in the target's plane."""
        right, down, _ = self.axes
        metre_per_px = self.distance_m / self.focal_px(height_px)
        return np.asarray(np.array(self.target_m) + metre_per_px * (right_px * right + down_px * down))


def front_view(points_m: Float32, aspect: float) -> Orbit:
    """Return the view along the depth camera that contains points (n, 3), with a margin; n may be 0."""
    if not len(points_m):
        return Orbit((0.0, 0.0, 2.0), 3.0)
    low, high = np.percentile(points_m, [1, 99], axis=0)
    target = (low + high) / 2
    orbit = Orbit(tuple(target.tolist()), 1.0)
    half = max((high - low)[1] / 2, (high - low)[0] / 2 / aspect) * 1.18
    away = half / np.tan(np.radians(orbit.angle_deg / 2)) + float(target[2] - low[2])
    return replace(orbit, distance_m=float(max(away, 0.3)))


def project(
    points_m: Float32, shown: Bool, screen_from_world: Float64, size_px: tuple[int, int], spacing_px: float
) -> ScreenPoints:
    """Project points (n, 3), depth-camera frame, with a VTK composite matrix (4, 4) onto a view.

    shown: bool (n,); other points neither hide points nor can be chosen. size_px: (width, height).
    spacing_px: distance of neighbouring points on the screen. Points at or behind the eye are not on the
    screen.
    """
    matrix = screen_from_world.astype(np.float32)
    at = np.flatnonzero(shown)
    points = points_m[at]
    x, y, w = (points @ matrix[row, :3] + matrix[row, 3] for row in (0, 1, 3))
    with np.errstate(divide="ignore", invalid="ignore"):
        w = np.where(w > 0, w, np.float32(np.nan))
        xy = np.stack([(x / w + 1) / 2 * size_px[0], (1 - y / w) / 2 * size_px[1]], axis=1)
    xy_px = np.full((len(points_m), 2), np.nan, np.float32)
    distance_m = np.full(len(points_m), np.nan, np.float32)
    xy_px[at], distance_m[at] = xy, w
    return ScreenPoints(xy_px, distance_m, size_px, max(CELL_PX, round(CELL_SPACINGS * spacing_px)))
