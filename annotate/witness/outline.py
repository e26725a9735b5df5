"""Outline of a person: a witness's mask decides where the person is, depth decides where its borders are.

Constants are untuned.
"""

import cv2
import numpy as np
from numba import njit

from annotate.array_types import Bool, Float32, UInt8, UInt16

BORDER = 0.018  # of the crop's side, within which depth decides: five pixels of a mask of 256
SAME_SURFACE = 0.02  # share of the depth at which a neighbour's weight falls to exp(-1/2)
FOUND = 0.3  # vote of the depth network's outline, as a share of all votes
LEAST_PX = 3  # least width of the border
INSIDE, BETWEEN = 2, 1  # zones: the person's pixels, and the border where neighbours vote; 0 = outside


def outline(depth_mm: UInt16, mask: Float32, found: Bool, known: Bool, border_px: float) -> Bool:
    """Return the person's pixels (h, w), all with a reading.

    mask: (h, w) in [0, 1], whether the witness shows the person; NaN where its camera does not see the point.
    found: pixels of people found in depth. known: pixels that belong to the person for other reasons.
    border_px: width of the witness's border, in which each pixel takes the side of its neighbours on the same
    surface.
    """
    shows = np.where(np.isnan(mask), found, mask >= 0.5) | known
    reach = max(LEAST_PX, round(border_px))
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
    outer = cv2.dilate(shows.astype(np.uint8), kernel) > 0
    # A thin limb has no inner pixels; its middle stays.
    inner = (cv2.erode(shows.astype(np.uint8), kernel, borderValue=1) > 0) | (shows & _ridge(shows, reach))
    zone = np.where(inner, INSIDE, np.where(outer, BETWEEN, 0)).astype(np.uint8)
    own: Bool = _voted(depth_mm, zone, found, reach)
    return _largest(own & (depth_mm > 0), shows)


def _ridge(shows: Bool, reach: int) -> Bool:
    """Return the pixels (h, w) of limbs thinner than the border, in their middle."""
    far = cv2.distanceTransform(shows.astype(np.uint8), cv2.DIST_L2, 3)
    highest = cv2.dilate(far, np.ones((3, 3), np.uint8))
    return np.asarray((far >= highest - 0.5) & (far > 1) & (far <= reach), np.bool_)


def _largest(own: Bool, shows: Bool) -> Bool:
    """Return the connected pieces (h, w) of a person of 2 % of it or more, or that the witness shows."""
    count, piece, stats, _ = cv2.connectedComponentsWithStats(own.astype(np.uint8), connectivity=8)
    shown = np.bincount(piece[shows], minlength=count)
    area = stats[:, cv2.CC_STAT_AREA]
    kept = (area >= 0.02 * area[1:].sum()) | (2 * shown > area)
    kept[0] = False
    return np.asarray(kept[piece], np.bool_)


@njit(cache=True, nogil=True)
def _voted(depth_mm: UInt16, zone: UInt8, found: Bool, reach: int) -> Bool:
    """Return the person's pixels: those inside, and those between whose neighbours on their surface are
    mostly inside.
    """
    height, width = zone.shape
    own: Bool = zone == INSIDE
    for v in range(height):
        for u in range(width):
            z = np.float32(depth_mm[v, u])
            if zone[v, u] != BETWEEN or z == 0:
                continue
            inside, total = np.float32(1e-6), np.float32(2e-6)
            for y in range(max(v - 2 * reach, 0), min(v + 2 * reach + 1, height)):
                for x in range(max(u - 2 * reach, 0), min(u + 2 * reach + 1, width)):
                    if zone[y, x] == BETWEEN or depth_mm[y, x] == 0:
                        continue
                    off = (np.float32(depth_mm[y, x]) - z) / (np.float32(SAME_SURFACE) * z)
                    near = np.float32((y - v) ** 2 + (x - u) ** 2) / np.float32(reach * reach)
                    share = np.exp(np.float32(-0.5) * (off * off + near))
                    total += share
                    if zone[y, x] == INSIDE:
                        inside += share
            vote = np.float32(1) if found[v, u] else np.float32(0)
            own[v, u] = (1 - FOUND) * inside / total + FOUND * vote > 0.5
    return own
