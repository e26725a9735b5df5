"""Size and place of each region of a person in a depth image."""

import numpy as np
from numba import njit

from annotate.array_types import Bool, Float32, Float64, Index, UInt8, UInt16
from annotate.crop import RANGE_MM, SIZE, Crop, normalize
from annotate.scheme.regions import N_REGIONS, Region
from annotate.scheme.scheme import BACKGROUND, Scheme

LEAST_PIXELS = 1e-6  # against division by 0


def has_regions(scheme: Scheme) -> bool:
    """Return whether each region is a part of its own in a scheme."""
    ids = set(scheme.table[list(Region)].tolist())
    return len(ids) == N_REGIONS and BACKGROUND not in ids


def region_places(crop: Crop, image: tuple[UInt16, Bool], planes: Float32, scheme: Scheme) -> Float64:
    """Return (24, 4) by ``Region``: expected pixels, and mean column, row and depth in millimetres.

    image: depth in millimetres and the person's pixels, both (h, w). planes: (K, 212, 212), probabilities of
    the classes of a scheme that ``has_regions``, in the crop.
    """
    depth_mm, mask = image
    classes = scheme.class_table[scheme.table[list(Region)]]
    values = normalize(crop.cut(depth_mm, 0), crop.cut(mask, False)).ravel()
    seen, cell = np.flatnonzero(values), crop.side / SIZE
    sums = _sums(planes.reshape(len(planes), -1), classes, seen, (values[seen] - 0.5) * RANGE_MM)
    count = sums[:, :1]
    middle = float(np.median(depth_mm[mask & (depth_mm > 0)]))
    scale, start = (cell, cell, 1.0), (crop.left + cell / 2 - 0.5, crop.top + cell / 2 - 0.5, middle)
    return np.hstack([count * cell**2, sums[:, 1:] / np.maximum(count, LEAST_PIXELS) * scale + start])


@njit(cache=True, nogil=True)  # products of matrices by NumPy would keep another core busy
def _sums(planes: Float32, classes: UInt8, seen: Index, z_mm: Float32) -> Float64:
    """Return sums (k, 4) over pixels (n,), weighted by the probabilities of classes (k,): 1, column, row, z.

    planes: (K, 212 * 212). seen: flat indices of the pixels.
    """
    sums = np.zeros((classes.size, 4))
    for k in range(classes.size):
        plane = planes[classes[k]]
        count, across, down, away = 0.0, 0.0, 0.0, 0.0
        for i in range(seen.size):
            share = np.float64(plane[seen[i]])
            count += share
            across += share * (seen[i] % SIZE)
            down += share * (seen[i] // SIZE)
            away += share * z_mm[i]
        sums[k] = count, across, down, away
    return sums
