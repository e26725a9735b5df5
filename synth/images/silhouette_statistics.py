"""Statistics of a person's silhouette that depend on the sensor and its filters.

Masks are bool (h, w): the pixels of one person with depth.
"""

import cv2
import numpy as np

from annotate.array_types import Bool, Float64
from annotate.crop import window_of

LEVELS = 12  # heights at which widths are measured
GAP = 0.015  # share of the person above which an enclosed place is a gap between limbs; untuned
SMOOTHED_PX = 1.5  # filtered structured light then has a roughness of 1.1 at a height of 200 pixels


def largest_piece(person: Bool) -> Bool:
    """Return the largest connected piece (8 neighbours) of a mask."""
    count, pieces, sizes, _ = cv2.connectedComponentsWithStats(person.astype(np.uint8), connectivity=8)
    if count == 1:
        return person
    return np.asarray(pieces == 1 + int(sizes[1:, cv2.CC_STAT_AREA].argmax()))


def holes(person: Bool) -> float:
    """Return the share of pixels without depth inside the outline of the largest piece.

    A hole is enclosed by 4-neighbours and covers at most the share ``GAP`` of the person.
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
    """Return the outline length of the largest piece, divided by the length after smoothing; 1 is smoothest.

    Length: number of pairs of row or column neighbours of which one is outside. A smoothed slanted edge keeps
    this length, unlike a chain code's.
    """
    piece = np.pad(largest_piece(person), 8).astype(np.float32)
    smooth = cv2.GaussianBlur(piece, (0, 0), SMOOTHED_PX) > 0.5
    return _rim(piece > 0) / max(_rim(smooth), 1)


def height_px(person: Bool) -> int:
    """Return the number of rows from the highest to the lowest pixel."""
    rows, _ = window_of(person)
    return int(rows.stop - rows.start)


def widths(person: Bool) -> Float64:
    """Return the mean number of person pixels per row, divided by the height, in ``LEVELS`` bands from the
    top.

    Gaps between limbs do not count, so that the width of limbs shows clothes and build. The person needs at
    least ``LEVELS`` rows.
    """
    rows, _ = window_of(person)
    counts = np.count_nonzero(person[rows], axis=1)
    return np.array([band.mean() for band in np.array_split(counts, LEVELS)]) / len(counts)


def _rim(mask: Bool) -> int:
    return int(np.count_nonzero(mask[1:] != mask[:-1]) + np.count_nonzero(mask[:, 1:] != mask[:, :-1]))
