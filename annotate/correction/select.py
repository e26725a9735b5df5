"""Selection of pixels by a gesture: by shapes drawn on a view of the cloud, or by pieces of its surface.

All selections are flat indices (n,) into the depth image. Constants are untuned unless a source is given.
"""

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from annotate.array_types import Bool, Float32, Int32, Int64, UInt8, UInt16
from annotate.cloud.grid import JUMP, components
from annotate.cloud.supervoxels import supervoxels
from annotate.frame_labels import FrameLabels
from annotate.scheme.scheme import BACKGROUND
from sensors.errors import CloudError
from sensors.rig.camera import Intrinsics, unproject

CELL_PX = 3  # side of the screen cells in which the nearest point hides the others
BEHIND = 0.03  # of the distance: a point so far behind its cell's nearest is in front (6 cm at 2 m)
MARGIN_PX = 24  # width of the margin around the person that has pieces
MARGIN_DEPTH = 0.08  # of the depth: largest difference of the margin to the person (16 cm at 2 m)
COLOR_WEIGHT = 4.0  # 20 clicks correct 40 % of the wrong pixels, with 1 36 % (hard, seed 101, 4 frames)


@dataclass(frozen=True)
class ScreenPoints:
    """Screen positions of the points of a cloud, computed once for every camera move.

    xy_px: float32 (n, 2), screen position of each pixel's point, y down; NaN = not on the screen. distance_m:
    float32 (n,), from the eye. size_px: (width, height) of the screen. cell_px: at least twice the distance
    of neighbouring points on the screen; in smaller cells, hidden points show through.
    """

    xy_px: Float32
    distance_m: Float32
    size_px: tuple[int, int]
    cell_px: int = CELL_PX

    @classmethod
    def of_image(cls, depth_mm: UInt16, scale: float = 1.0) -> "ScreenPoints":
        """Return the pixels of a depth image (h, w) as screen points, ``scale`` screen pixels each, with or
        without depth.
        """
        height, width = depth_mm.shape
        v, u = np.divmod(np.arange(depth_mm.size), width)
        xy_px = (np.stack([u, v], axis=1).astype(np.float32) + np.float32(0.5)) * np.float32(scale)
        size = round(width * scale), round(height * scale)
        return cls(xy_px, depth_mm.ravel().astype(np.float32) / np.float32(1000), size)

    @cached_property
    def pixels(self) -> Int64:
        """Return the flat indices (m,) of the points on the screen."""
        x, y = self.xy_px.T
        return np.flatnonzero((x >= 0) & (y >= 0) & (x < self.size_px[0]) & (y < self.size_px[1]))

    @cached_property
    def cells(self) -> Int64:
        """Return the flat screen pixel (m,) under each of ``pixels``."""
        xy = self.xy_px[self.pixels].astype(np.int64)
        return xy[:, 1] * self.size_px[0] + xy[:, 0]

    @cached_property
    def front(self) -> Bool:
        """Return flags (n,), True for points at most ``BEHIND`` farther than the nearest point of
        their cell.
        """
        xy = self.xy_px[self.pixels].astype(np.int64) // self.cell_px
        across = self.size_px[0] // self.cell_px + 1
        cell = xy[:, 1] * across + xy[:, 0]
        distance = self.distance_m[self.pixels]
        nearest = np.full((self.size_px[1] // self.cell_px + 1) * across, np.inf, np.float32)
        np.minimum.at(nearest, cell, distance)
        front = np.zeros(len(self.xy_px), np.bool_)
        front[self.pixels] = distance <= nearest[cell] * np.float32(1 + BEHIND)
        return front


def polygon(view: ScreenPoints, corners_px: NDArray[np.floating], through: bool = False) -> Int64:
    """Return the points inside a polygon (k, 2) in screen pixels. through: also select hidden points."""
    shape = np.zeros(view.size_px[::-1], np.uint8)
    cv2.fillPoly(shape, [_fixed(corners_px)], 1, shift=_SHIFT)
    return _under(view, shape, through)


def brush(
    view: ScreenPoints, path_px: NDArray[np.floating], radius_px: float, through: bool = False
) -> Int64:
    """Return the points within ``radius_px`` of a path (k, 2) in screen pixels; a path of one point is a
    disc.

    through: also select hidden points.
    """
    shape = np.zeros(view.size_px[::-1], np.uint8)
    path = _fixed(path_px)
    radius = round(radius_px * (1 << _SHIFT))
    for x, y in path.tolist():
        cv2.circle(shape, (x, y), radius, 1, cv2.FILLED, shift=_SHIFT)
    cv2.polylines(shape, [path], False, 1, max(1, round(2 * radius_px)), shift=_SHIFT)
    return _under(view, shape, through)


def nearest(view: ScreenPoints, at_px: tuple[float, float], reach_px: float = 12.0) -> int | None:
    """Return the visible point nearest to a screen position within ``reach_px``, or None."""
    found = brush(view, np.array([at_px], np.float64), reach_px)
    if not len(found):
        return None
    away = np.square(view.xy_px[found] - np.array(at_px, np.float32)).sum(axis=1)
    return int(found[away.argmin()])


def edit_supervoxels(labels: FrameLabels, camera: Intrinsics, color_rgb: UInt8 | None = None) -> Int32:
    """Return supervoxel ids (h, w) of the person, things and a margin, -1 elsewhere.

    color_rgb: uint8 (h, w, 3); None = the colours of the parts, so that supervoxels do not cross the labels'
    borders.
    """
    depth_mm, parts = labels.depth_mm, labels.parts
    mask = _near_person(depth_mm, parts)
    ids = np.full(parts.shape, -1, np.int32)
    if mask.any():
        depth_m = np.where(mask, depth_mm, np.nan).astype(np.float32) / np.float32(1000)
        points_m = unproject(camera, depth_m)[mask]
        colors = labels.scheme.palette_rgb()[parts] if color_rgb is None else color_rgb
        ids[mask] = supervoxels(points_m, colors[mask], color_weight=COLOR_WEIGHT).ids
    return ids


def _near_person(depth_mm: UInt16, parts: UInt8) -> Bool:
    """Return the pixels (h, w) with depth on the person, or close to it in the image and in depth."""
    person = (parts != BACKGROUND) & (depth_mm > 0)
    if not person.any():
        return np.asarray(person)
    away_px, nearest = cv2.distanceTransformWithLabels(
        (~person).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5, labelType=cv2.DIST_LABEL_PIXEL
    )
    # Every pixel of the person has its own label, which leads to the depth of the nearest one.
    depth_of = np.zeros(int(nearest.max()) + 1, np.float32)
    depth_of[nearest[person]] = depth_mm[person]
    beside = depth_of[nearest]
    near = (away_px <= MARGIN_PX) & (np.abs(depth_mm - beside) <= MARGIN_DEPTH * beside)
    return np.asarray(person | near & (depth_mm > 0))


def supervoxel(ids: Int32, parts: UInt8, pixel: int) -> Int64:
    """Return the pixels of the supervoxel under a pixel that have the same part as that pixel. ids: -1 =
    none.
    """
    if ids.flat[pixel] < 0:
        return np.empty(0, np.int64)
    return np.flatnonzero((ids == ids.flat[pixel]) & (parts == parts.flat[pixel]))


def patch(parts: UInt8, depth_mm: UInt16, pixel: int) -> Int64:
    """Return the connected surface of one part around a pixel; empty without depth."""
    depth_m = depth_mm.astype(np.float32) / np.float32(1000)
    labels, _ = components((parts == parts.flat[pixel]) & (depth_mm > 0), depth_m)
    return np.flatnonzero(labels == labels.flat[pixel]) if labels.flat[pixel] else np.empty(0, np.int64)


def grow(ids: Int32, parts: UInt8, depth_mm: UInt16, pixels: Int64) -> Int64:
    """Return selected pixels, extended by the pixels of all supervoxels adjacent to them on the surface.

    Only pixels of one part are added: the most frequent part among the selected pixels. ids: supervoxel of
    each pixel (h, w), negative = none. parts, depth_mm: (h, w). pixels: flat indices (n,).
    """
    if not len(pixels):
        return pixels
    part = int(np.bincount(parts.ravel()[pixels]).argmax())
    chosen = np.zeros(parts.shape, np.uint8)
    chosen.reshape(-1)[pixels] = 1
    depth = np.where(chosen > 0, depth_mm, 0).astype(np.float32)
    # The greatest and the least depth of the selection beside every pixel.
    deepest = cv2.dilate(depth, _AROUND)
    near = -cv2.dilate(np.where(chosen > 0, -depth, np.float32(-1e6)), _AROUND)
    slack = JUMP * depth_mm
    goes_on = (deepest > 0) & (depth_mm <= deepest + slack) & (depth_mm >= near - slack)
    same = (parts == part) & (ids >= 0)
    reached = np.unique(ids[goes_on & same])
    return np.flatnonzero((chosen > 0) | (same & np.isin(ids, reached)))


_SHIFT = 4  # fractional bits of the corners that OpenCV draws with
_AROUND = np.ones((5, 5), np.uint8)  # so that dropouts do not cut a surface, as in ``grid``


def _fixed(corners_px: NDArray[np.floating]) -> Int32:
    corners = np.asarray(corners_px, np.float64)
    if corners.ndim != 2 or corners.shape[1] != 2 or not np.isfinite(corners).all():
        raise CloudError(f"corners are {corners.shape}; give finite screen pixels (k, 2)")
    # A screen pixel covers [x, x + 1); OpenCV's centre is at x.
    return np.rint((np.clip(corners, -1e5, 1e5) - 0.5) * (1 << _SHIFT)).astype(np.int32)


def _under(view: ScreenPoints, shape: UInt8, through: bool) -> Int64:
    """Return the points under a drawn shape (height, width). through: also hidden points."""
    found = view.pixels[shape.ravel()[view.cells] > 0]
    return found if through else found[view.front[found]]
