"""Refined labels in a finer scheme than the refinement network's, from the regions of the first labels."""

from dataclasses import replace

import numpy as np

from annotate.crop import nearest_seen
from annotate.frame_labels import FrameLabels
from annotate.scheme.merging import conversion_table, converts
from annotate.scheme.scheme import BACKGROUND, UNDEFINED, Scheme
from eval.network.refine import in_scheme


def in_finer_scheme(refined: FrameLabels, first: FrameLabels, scheme: Scheme) -> FrameLabels:
    """Return refined labels in ``scheme``, which may split their parts.

    A pixel takes the first label of the nearest pixel whose first label lies within the refined part: its
    own, mostly. A refined part that the first labels lack becomes the lowest id within it. Raises FormatError
    where the first labels do not convert to both schemes.
    """
    if converts(refined.scheme, scheme):
        return in_scheme(refined, scheme)
    coarse = conversion_table(first.scheme, refined.scheme)[first.parts]
    fine = conversion_table(first.scheme, scheme)[first.parts]
    parts = np.where(refined.parts == UNDEFINED, np.uint8(UNDEFINED), np.uint8(BACKGROUND))
    for part in refined.scheme.parts:
        own, within = refined.parts == part.id, coarse == part.id
        if own.any() and within.any():
            parts[own] = fine.ravel()[nearest_seen(within)[own]]
        else:
            parts[own] = min(scheme.ids_of(part.regions))
    return replace(refined, parts=parts, scheme=scheme)
