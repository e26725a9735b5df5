"""Size and place of each region of a person in a depth image."""

import numpy as np

from annotate.array_types import Bool, Float32, Float64, UInt16
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
    seen = np.flatnonzero(values)
    row, column = np.divmod(seen, SIZE)
    cell = crop.side / SIZE
    z = (values[seen] - 0.5) * RANGE_MM
    basis = np.column_stack([np.ones(seen.size), column, row, z]).astype(np.float32)
    sums = (planes.reshape(len(planes), -1)[np.ix_(classes, seen)] @ basis).astype(np.float64)
    count = sums[:, :1]
    middle = float(np.median(depth_mm[mask & (depth_mm > 0)]))
    scale, start = (cell, cell, 1.0), (crop.left + cell / 2 - 0.5, crop.top + cell / 2 - 0.5, middle)
    return np.hstack([count * cell**2, sums[:, 1:] / np.maximum(count, LEAST_PIXELS) * scale + start])
