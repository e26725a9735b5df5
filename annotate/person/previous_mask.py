"""What the frame before says of this one, while the thermal camera's flag is closed: unchanged depth keeps
its label, what came nearer is likely the person's, what was laid bare is likely the room's."""

import numpy as np

from annotate.array_types import Bool, Float32, UInt8, UInt16
from annotate.frame_labels import FrameLabels
from annotate.parts import BACKGROUND

SAME = 0.012
"""Depth difference, as a share of the depth, that noise alone makes: four standard deviations of a
Kinect v2's at 2 m (Fankhauser et al. 2015)."""
STILL_SHARE = 0.6
"""Of the background: with less of it unchanged the rig has moved, and nothing can be carried over."""
KEPT, CHANGED = 3.0, 1.5
"""Log odds of unchanged pixels, and of those that came nearer or were laid bare."""


def persons_before(before: FrameLabels) -> UInt8:
    """Who was seen (h, w): 0 nobody, 1 the labelled person, 2 and on others."""
    if before.persons is not None:
        return before.persons
    return np.asarray(before.parts != BACKGROUND, np.uint8)


def by_before(depth_mm: UInt16, before: FrameLabels) -> tuple[Float32, Bool] | None:
    """Log odds (h, w) of being any person, and the pixels surely still background.

    None where the frame before has nobody, another size, or shows that the rig itself has moved.
    """
    if before.depth_mm.shape != depth_mm.shape:
        return None
    person = persons_before(before) > 0
    both = (depth_mm > 0) & (before.depth_mm > 0)
    behind = depth_mm.astype(np.float32) - before.depth_mm
    slack = SAME * np.maximum(depth_mm, before.depth_mm).astype(np.float32)
    same = both & (np.abs(behind) <= slack)
    rest = both & ~person
    if not person.any() or not rest.any() or same[rest].mean() < STILL_SHARE:
        return None
    odds = np.where(same, np.where(person, KEPT, -KEPT), 0.0)
    odds[both & (behind < -slack)] = CHANGED
    odds[both & (behind > slack)] = -CHANGED
    return odds.astype(np.float32), same & ~person
