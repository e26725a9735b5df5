"""Who wears the suit: its colours in a frame's light against those of the room and of other clothes."""

import numpy as np
from numpy.typing import NDArray

from annotate.cloud import ThermalCloud
from annotate.color_model import ColorModel, readable, refit_colors, under, unfitted
from annotate.part_clues import means_of, warmth_of
from annotate.patches import patches_of, read_together
from annotate.suit import Suit
from annotate.supervoxels import supervoxels

STRIDE = 2
"""The light is sought on every second pixel of every second row."""
LEAST_POINTS = 60

_Array = NDArray[np.float64]


def light_on(cloud: ThermalCloud, mask: NDArray[np.bool_], suit: Suit) -> ColorModel | None:
    """The suit as it is seen on a person (h, w) with a few things too many or too few, None if it is not."""
    own = np.zeros_like(mask)
    own[::STRIDE, ::STRIDE] = mask[::STRIDE, ::STRIDE]
    rgb, points_m = cloud.color_rgb[own], cloud.points_m[own]
    usable = readable(rgb, cloud.color_valid[own])
    if usable.sum() < LEAST_POINTS:
        return None
    groups = supervoxels(points_m, rgb, seed_m=0.05)
    patches = patches_of(groups, *means_of(rgb, usable, groups), groups.centroids_m(points_m))
    warmth = patches.mean(warmth_of(cloud.temperature_c[own], groups), groups.sizes)
    palette = unfitted(suit)
    belief, log_gain = read_together(patches, palette, warmth)
    return refit_colors(under(palette, log_gain), rgb[usable], belief[patches.ids][groups.ids[usable]])
