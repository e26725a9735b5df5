"""Steady left and right of a person: where the sides flicker from frame to frame, they are swapped back."""

from dataclasses import replace

import numpy as np

from annotate.array_types import Float64, UInt8
from annotate.frame_labels import FrameLabels
from annotate.parts import BACKGROUND, TWIN_PARTS, swap_left_right
from annotate.segmentation.segmented_person import Segmentation
from eval.network.body_state import Bearing, bearing_notes

KEPT = 0.8
"""Share of what was seen so far that a frame leaves: a turn of half a second is followed; chosen by eye."""
FAR_DEG, NEAR_DEG = 110.0, 60.0
"""A frame that faces further than the first from the frames before, and exchanged nearer than the second, has
taken front for back; chosen by eye: half a turn from frame to frame is 5,400 degrees a second."""
SAME_PLACE = 0.6
"""Least overlap (intersection over union) of a person's pixels with those in the frame before; with less,
time has passed, or somebody else lies there. Chosen by eye: who walks keeps 0.8 at 30 frames a second."""


def steady(labelled: Segmentation, before: FrameLabels | None, number: int = 1) -> Segmentation:
    """Labels of a person with left and right exchanged where the frames before outweigh this one.

    number: the person's. The note ``bearing`` gets ``faced``: the sum (2,) of the facings so far, as
    they were seen and not as they were turned, so that a wrong beginning is outvoted.
    """
    bearing = Bearing.from_note(labelled.bearing)
    if bearing is None:
        return labelled
    seen, faced = bearing.facing, np.zeros(2)
    if before is not None and _overlap(labelled.parts, before, number) > SAME_PLACE:
        faced = KEPT * _faced(before, number)
    own, other = _off_deg(bearing, faced), _off_deg(bearing.exchanged(), faced)
    if own > FAR_DEG and other < NEAR_DEG and np.hypot(*faced) > np.hypot(*seen):
        bearing = bearing.exchanged()
        labelled = _exchanged(labelled)
    return replace(labelled, bearing=bearing.note() | {"faced": np.round(faced + seen, 4).tolist()})


def _overlap(parts: UInt8, before: FrameLabels, number: int) -> float:
    """Intersection over union of a person's parts (h, w) and their pixels in the frame before."""
    own = parts != BACKGROUND
    earlier = before.parts != BACKGROUND if before.persons is None else before.persons == number
    either = int(np.count_nonzero(own | earlier))
    return int(np.count_nonzero(own & earlier)) / either if either else 0.0


def _exchanged(labelled: Segmentation) -> Segmentation:
    """Labels with left and right exchanged, their probabilities too."""
    kept = labelled.probabilities
    if kept is not None:
        kept = replace(kept, planes=kept.planes[TWIN_PARTS])
    return replace(labelled, parts=swap_left_right(labelled.parts), probabilities=kept)


def _faced(before: FrameLabels, number: int) -> Float64:
    """Sum of a person's facings over the frames so far (2,); none is zero."""
    note = bearing_notes(before.notes).get(number)
    faced = np.array(note.get("faced", ()) if isinstance(note, dict) else (), np.float64)
    return faced if faced.shape == (2,) and np.isfinite(faced).all() else np.zeros(2)


def _off_deg(bearing: Bearing, faced: Float64) -> float:
    """Angle between a facing and that of the frames so far, degrees; 0 where these have none."""
    x, y = bearing.facing, faced
    return float(np.degrees(np.arctan2(abs(x[0] * y[1] - x[1] * y[0]), x @ y))) if y.any() else 0.0
