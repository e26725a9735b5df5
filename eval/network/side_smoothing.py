"""Temporal smoothing of a person's left and right, and correction of the joints' sides by the parts;
constants are untuned.
"""

from dataclasses import replace

import numpy as np

from annotate.array_types import Float64, UInt8
from annotate.frame_labels import FrameLabels
from annotate.parts import BACKGROUND, PART_ID, TWIN_PARTS, swap_left_right
from annotate.segmentation.segmented_person import Segmentation
from eval.network.body_state import BodyState, body_state_notes
from eval.scores.joints import JOINT

KEPT = 0.8  # weight of the earlier facings, a frame: a turn of half a second is followed
FAR_DEG = 110.0  # off the earlier facings, from which front is taken for back
NEAR_DEG = 60.0  # off the earlier facings, below which the exchanged person fits
SAME_PLACE = 0.6  # least overlap (IoU) with the frame before; a walking person has 0.8 at 30 frames/s
REACH_PX = 4  # around a joint, in which its parts lie: a wrist's thickness at 2 m
LIMBS = {
    "left_elbow": ("left_upper_arm", "left_forearm"),
    "left_wrist": ("left_forearm",),
    "left_knee": ("left_upper_leg", "left_lower_leg"),
    "left_ankle": ("left_lower_leg",),
}
"""Joints that lie in the parts of one side, and these parts."""


def smooth_sides(labelled: Segmentation, before: FrameLabels | None, number: int = 1) -> Segmentation:
    """Return a person's labels with left and right consistent with the previous frames.

    number: person id. Sides are exchanged where the facings of all earlier frames outweigh this frame. The
    note ``bearing`` gets ``faced``: the sum (2,) of the network's facings so far, so that a wrong start is
    outvoted.
    """
    state = BodyState.from_note(labelled.bearing)
    if state is None:
        return labelled
    own, faced = state.facing, np.zeros(2)
    if before is not None and _overlap(labelled.parts, before, number) > SAME_PLACE:
        faced = KEPT * _faced(before, number)
    off, other_off = _off_deg(state, faced), _off_deg(state.exchanged(), faced)
    if off > FAR_DEG and other_off < NEAR_DEG and np.hypot(*faced) > np.hypot(*own):
        state = state.exchanged()
        labelled = _exchanged(labelled)
    return replace(labelled, bearing=state.note() | {"faced": np.round(faced + own, 4).tolist()})


def _overlap(parts: UInt8, before: FrameLabels, number: int) -> float:
    """Return the IoU of a person's pixels in parts (h, w) and in the previous frame. number: person id."""
    own = parts != BACKGROUND
    earlier = before.parts != BACKGROUND if before.persons is None else before.persons == number
    either = int(np.count_nonzero(own | earlier))
    return int(np.count_nonzero(own & earlier)) / either if either else 0.0


def _exchanged(labelled: Segmentation) -> Segmentation:
    kept = labelled.probabilities
    if kept is not None:
        kept = replace(kept, planes=kept.planes[TWIN_PARTS])
    return replace(labelled, parts=swap_left_right(labelled.parts), probabilities=kept)


def _faced(before: FrameLabels, number: int) -> Float64:
    """Return the decayed sum (2,) of a person's facings over the earlier frames; 0 without any. number:
    person id.
    """
    note = body_state_notes(before.notes).get(number)
    faced = np.array(note.get("faced", ()) if isinstance(note, dict) else (), np.float64)
    return faced if faced.shape == (2,) and np.isfinite(faced).all() else np.zeros(2)


def _off_deg(state: BodyState, faced: Float64) -> float:
    """Return the angle between a frame's facing and the summed facing of earlier frames; 0 without these."""
    x, y = state.facing, faced
    return float(np.degrees(np.arctan2(abs(x[0] * y[1] - x[1] * y[0]), x @ y))) if y.any() else 0.0


def sided_by_parts(state: BodyState, parts: UInt8) -> BodyState:
    """Return the state, with sides exchanged where most joints lie on parts (h, w) of the other side.

    Parts from a suit have reliable sides, parts from a network may not.
    """
    own = other = 0
    for joint, limbs in LIMBS.items():
        for side, twin in (("left", "right"), ("right", "left")):
            u, v = state.joints_px[JOINT[joint.replace("left", side)], :2].round().astype(np.int64)
            top, left = max(0, v - REACH_PX), max(0, u - REACH_PX)
            near = set(parts[top : max(0, v + REACH_PX), left : max(0, u + REACH_PX)].ravel().tolist())
            own += not near.isdisjoint(PART_ID[part.replace("left", side)] for part in limbs)
            other += not near.isdisjoint(PART_ID[part.replace("left", twin)] for part in limbs)
    return state.exchanged() if other > own else state
