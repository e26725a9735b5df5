"""Polygons as other tools draw them, filled."""

import numpy as np

from annotate.array_types import Bool, Float64
from sensors.errors import FormatError

POLYGONS = "polygons are filled: their borders are approximate, those of masks exact"
"""Remark on labels that were polygons."""
FEW_CORNERS = "polygons of fewer than three corners are not read"
"""Remark on points and lines among polygons."""
FARTHEST_PX = 1e5
"""Pixels from the origin within which corners lie; some tools let them reach outside the image."""
CELLS = 1 << 22
"""Crossings of edges and rows that are computed at once: bounds memory."""


def check_size(stated: tuple[object, object], shape: tuple[int, int]) -> None:
    """Raise FormatError where the stated (height, width) of an annotated image is not its depth image's.

    Polygons and CVAT's masks are in pixels of the annotated image. A size that is not
    stated is taken for right.
    """
    height, width = (float(str(side)) if side else 0.0 for side in stated)
    if height and width and (height, width) != shape:
        raise FormatError(
            f"labels were drawn on an image of {width:g}x{height:g}, its depth image is "
            f"{shape[1]}x{shape[0]}; annotate images of depth's size"
        )


def polygon_pixels(corners: Float64, shape: tuple[int, int]) -> Bool:
    """Return the pixels (h, w) whose centre lies in a polygon with corners (n, 2), x and y in pixels.

    Pixel centres lie at halves, as in COCO and CVAT. A centre is inside where an odd number of edges is left
    of it, so that a polygon that touches itself has a hole. Raises FormatError.
    """
    if corners.shape[1:] != (2,) or len(corners) < 3 or not (np.abs(corners) < FARTHEST_PX).all():
        raise FormatError("a polygon has fewer than three corners on the image; export it again")
    height, width = shape
    crossed = np.zeros(height * (width + 1), np.int64)
    rows, step = np.arange(height) + 0.5, max(1, CELLS // height)
    ends = np.roll(corners, -1, axis=0)
    for at in range(0, len(corners), step):
        (x0, y0), (x1, y1) = corners[at : at + step].T, ends[at : at + step].T
        edge, row = np.nonzero((y0[:, None] <= rows) != (y1[:, None] <= rows))
        share = (rows[row] - y0[edge]) / (y1 - y0)[edge]
        x = x0[edge] + share * (x1 - x0)[edge]
        column = np.clip(np.ceil(x - 0.5), 0, width).astype(np.intp)
        crossed += np.bincount(row * (width + 1) + column, minlength=crossed.size)
    return np.asarray(np.cumsum(crossed.reshape(height, width + 1), axis=1)[:, :width] % 2 == 1)
