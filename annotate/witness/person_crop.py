"""Square crops about people in colour images. Pixel centres are at halves, as in MediaPipe."""

from typing import NamedTuple

import cv2
import numpy as np

from annotate.array_types import Float32, Float64, UInt8

WIDER = 1.25  # side of a crop over the circle about the person (MediaPipe's graph)


class PersonCrop(NamedTuple):
    """Square about a person: centre and side in pixels, and the person's lean in radians, clockwise."""

    x: float
    y: float
    side: float
    lean: float = 0.0

    def placement(self, width: int, height: int) -> Float64:
        """Return the affine map (2, 3) from the crop's pixel indices to the whole image's pixel indices.

        width, height: of the crop's image, whose shorter side is the crop's side.
        """
        cos, sin = np.cos(self.lean), np.sin(self.lean)
        turn = np.array([[cos, -sin], [sin, cos]]) * self.side / min(width, height)
        middle = np.array([width - 1, height - 1]) / 2
        return np.column_stack([turn, np.array([self.x, self.y]) - 0.5 - turn @ middle])

    def cut(self, image: UInt8, width: int, height: int) -> Float32:
        """Return the crop (height, width, 3) of an image, values 0 to 1; pixels outside repeat the border."""
        how, border = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP, cv2.BORDER_REPLICATE
        placed = self.placement(width, height)
        found = cv2.warpAffine(image, placed, (width, height), flags=how, borderMode=border)
        return found.astype(np.float32) / np.float32(255)

    def points(self, at: Float64, width: int, height: int) -> Float64:
        """Return pixels (n, 2) of the whole image of pixels (n, 2) of the crop's image."""
        indices = np.column_stack([at - 0.5, np.ones(len(at))])
        return indices @ self.placement(width, height).T + 0.5

    def pasted(self, plane: Float32, shape: tuple[int, int]) -> Float32:
        """Return a plane (n, n) of the crop on the whole image (h, w), 0 outside the crop."""
        placed = self.placement(len(plane), len(plane))
        return np.asarray(cv2.warpAffine(plane, placed, shape[::-1], flags=cv2.INTER_LINEAR), np.float32)


def upright(centre: Float64, rim: Float64) -> PersonCrop:
    """Return the crop of a circle about a person; rim: its point above the head."""
    dx, dy = rim - centre
    x, y = map(float, centre)
    return PersonCrop(x, y, 2 * WIDER * float(np.hypot(dx, dy)), float(np.arctan2(dx, -dy)))


def crop_of_points(at_px: Float64) -> PersonCrop | None:
    """Return the upright crop about points (n, 2) of a person; None without any."""
    if not len(at_px):
        return None
    low, high = at_px.min(axis=0) - 0.5, at_px.max(axis=0) + 0.5
    x, y = map(float, (low + high) / 2)
    return PersonCrop(x, y, WIDER * float((high - low).max()))
