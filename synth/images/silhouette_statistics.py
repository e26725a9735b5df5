"""Figures of a person's silhouette that depend on the sensor and its filters."""

import cv2
import numpy as np

from annotate.array_types import Bool, Float64
from annotate.crop import window_of

LEVELS = 12
"""Heights at which a silhouette's width is measured."""
GAP = 0.015
"""An enclosed place without depth that is larger than this share of the person is a gap between limbs, not a
hole. Chosen by eye: between legs and beside arms on hips there is more, holes of sensors are smaller."""
SMOOTHED_PX = 1.5
"""Standard deviation of the Gaussian that smooths a silhouette before its rim is compared. Chosen so that
filtered structured light comes to about 1.1 at some 200 pixels of height."""


def largest_piece(person: Bool) -> Bool:
    """The largest of the connected pieces (8 neighbours) of a mask (h, w); empty where the mask is."""
    count, pieces, sizes, _ = cv2.connectedComponentsWithStats(person.astype(np.uint8), connectivity=8)
    if count == 1:
        return person
    return np.asarray(pieces == 1 + int(sizes[1:, cv2.CC_STAT_AREA].argmax()))


def holes(person: Bool) -> float:
    """Share of the pixels inside the outline of the largest piece that have no depth, in [0, 1].

    person: (h, w) pixels of one person with depth. Enclosed means: no way outside over the four neighbours.
    Places larger than ``GAP`` of the person count as outside.
    """
    piece = np.pad(largest_piece(person), 1)
    empty = ~piece & ~np.pad(person, 1)
    _, places, sizes, _ = cv2.connectedComponentsWithStats(empty.astype(np.uint8), connectivity=4)
    areas = sizes[:, cv2.CC_STAT_AREA]
    areas[[0, int(places[0, 0])]] = 0
    total = int(np.count_nonzero(piece))
    lost = int(areas[areas <= GAP * total].sum())
    return lost / max(total + lost, 1)


def roughness(person: Bool) -> float:
    """Length of the rims of the largest piece over that of the smoothed piece; 1 is as smooth as can be.

    person: (h, w) pixels of one person with depth. Rims of holes count. A length is the number of neighbours,
    one in and one out, along rows and columns: unlike a chain code's it is the same for a slanted edge before
    and after smoothing. Smoothed: Gaussian of ``SMOOTHED_PX``, then a half.
    """
    piece = np.pad(largest_piece(person), 8).astype(np.float32)
    smooth = cv2.GaussianBlur(piece, (0, 0), SMOOTHED_PX) > 0.5
    return _rim(piece > 0) / max(_rim(smooth), 1)


def height_px(person: Bool) -> int:
    """Rows from the highest to the lowest pixel of a person (h, w); 0 without any."""
    rows, _ = window_of(person)
    return int(rows.stop - rows.start)


def widths(person: Bool) -> Float64:
    """Mean number (12,) of a person's pixels in a row, over its height, in ``LEVELS`` bands from the top.

    person: (h, w), ``LEVELS`` rows high at least. Gaps between limbs do not count: it is how wide limbs and
    trunk are that clothes and builds change, not how far arms are stretched.
    """
    rows, _ = window_of(person)
    counts = np.count_nonzero(person[rows], axis=1)
    return np.array([band.mean() for band in np.array_split(counts, LEVELS)]) / len(counts)


def _rim(mask: Bool) -> int:
    return int(np.count_nonzero(mask[1:] != mask[:-1]) + np.count_nonzero(mask[:, 1:] != mask[:, :-1]))
