"""Log odds of a person from the frame before, for frames without temperatures (the flag is closed).

Unchanged depth keeps its label; surface nearer than before is likely a person's, farther surface the room's.
"""

import numpy as np

from annotate.array_types import Bool, Float32, UInt8, UInt16
from annotate.frame_labels import FrameLabels
from annotate.parts import BACKGROUND

UNCHANGED_DEPTH = 0.012
"""Depth difference of pure noise as a share of the depth: four standard deviations of a Kinect v2's, measured
at 2 m (Fankhauser et al. 2015)."""
STILL_SHARE = 0.6
"""Least share of the background with unchanged depth; below it the rig has moved. Chosen by eye."""
UNCHANGED_ODDS = 3.0
"""Log odds of a pixel with unchanged depth keeping its label. Chosen by eye."""
CHANGED_ODDS = 1.5
"""Log odds of a pixel nearer than before being a person's, or of a farther one the room's. Chosen by eye."""


def persons_before(before: FrameLabels) -> UInt8:
    """Persons uint8 (h, w) of a frame's labels: 0 nobody, 1 the labelled person, 2 and on others."""
    if before.persons is not None:
        return before.persons
    return np.asarray(before.parts != BACKGROUND, np.uint8)


def previous_odds(depth_mm: UInt16, before: FrameLabels) -> tuple[Float32, Bool] | None:
    """Log odds (h, w) of being any person, and flags (h, w) of unchanged background.

    depth_mm: uint16 (h, w) of this frame. before: labels of the previous frame. None where that frame has
    nobody or another size, or the rig has moved.
    """
    if before.depth_mm.shape != depth_mm.shape:
        return None
    person = persons_before(before) > 0
    both = (depth_mm > 0) & (before.depth_mm > 0)
    behind = depth_mm.astype(np.float32) - before.depth_mm
    slack = UNCHANGED_DEPTH * np.maximum(depth_mm, before.depth_mm).astype(np.float32)
    same = both & (np.abs(behind) <= slack)
    rest = both & ~person
    if not person.any() or not rest.any() or same[rest].mean() < STILL_SHARE:
        return None
    odds = np.where(same, np.where(person, UNCHANGED_ODDS, -UNCHANGED_ODDS), 0.0)
    odds[both & (behind < -slack)] = CHANGED_ODDS
    odds[both & (behind > slack)] = -CHANGED_ODDS
    return odds.astype(np.float32), same & ~person
