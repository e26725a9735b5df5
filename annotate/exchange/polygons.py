"""Polygons as other tools draw them, filled."""

import cv2
import numpy as np

from annotate.array_types import Bool, Float64
from sensors.errors import FormatError

POLYGONS = "polygons are filled: their borders are approximate, those of masks exact"
"""Remark on labels that were polygons."""


def polygon_pixels(corners: Float64, shape: tuple[int, int]) -> Bool:
    """Return the pixels (h, w) whose centre lies in a polygon with corners (n, 2), x and y in pixels.

    Pixel centres lie at halves, as in COCO and CVAT; OpenCV's lie at whole numbers. Raises FormatError.
    """
    corners = corners - 0.5
    if corners.shape[1:] != (2,) or len(corners) < 3 or not (np.abs(corners) < 1e5).all():
        raise FormatError("a polygon has fewer than three corners on the image; export it again")
    canvas = np.zeros(shape, np.uint8)
    cv2.fillPoly(canvas, [np.rint(corners).astype(np.int32)], 1)
    return canvas.astype(np.bool_)
