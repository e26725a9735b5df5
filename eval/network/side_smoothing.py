"""Temporal smoothing of a person's left and right, and correction of the joints' sides by the parts;
constants are untuned.
"""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from annotate.array_types import Float64
from annotate.frame_labels import FrameLabels
from annotate.scheme.regions import Region
from annotate.scheme.scheme import Scheme
from annotate.segmentation.segmented_person import Segmentation
from eval.network.body_state import BodyState, body_state_notes
from eval.scores.joints import JOINT

KEPT = 0.8  # weight of the earlier facings, a frame: a turn of half a second is followed
FAR_DEG = 110.0  # off the earlier facings, from which front is taken for back
NEAR_DEG = 60.0  # off the earlier facings, below which the exchanged person fits
SAME_PLACE = 0.6  # least overlap (IoU) with the frame before; a walking person has 0.8 at 30 frames/s
REACH_PX = 4  # around a joint, in which its parts lie: a wrist's thickness at 2 m
_FOREARM = (Region.LEFT_FOREARM, Region.LEFT_HAND, Region.LEFT_FINGERS)
_LOWER_LEG = (Region.LEFT_LOWER_LEG, Region.LEFT_FOOT, Region.LEFT_TOES)
LIMBS = {
    "left_elbow": (Region.LEFT_UPPER_ARM, *_FOREARM),
    "left_wrist": _FOREARM,
    "left_knee": (Region.LEFT_UPPER_LEG, *_LOWER_LEG),
    "left_ankle": _LOWER_LEG,
}
"""Joints that lie in the regions of one side, and these regions."""


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
    if before is not None and _overlap(labelled, before, number) > SAME_PLACE:
        faced = KEPT * _faced(before, number)
    off, other_off = _off_deg(state, faced), _off_deg(state.exchanged(), faced)
    if off > FAR_DEG and other_off < NEAR_DEG and np.hypot(*faced) > np.hypot(*own):
        state = state.exchanged()
        labelled = _exchanged(labelled)
    return replace(labelled, bearing=state.note() | {"faced": np.round(faced + own, 4).tolist()})


def _overlap(labelled: Segmentation, before: FrameLabels, number: int) -> float:
    """Return the IoU of a person's pixels in this and in the previous frame. number: person id."""
    own = labelled.scheme.on_person(labelled.parts)
    earlier = before.on_person if before.persons is None else before.persons == number
    either = int(np.count_nonzero(own | earlier))
    return int(np.count_nonzero(own & earlier)) / either if either else 0.0


def _exchanged(labelled: Segmentation) -> Segmentation:
    kept, scheme = labelled.probabilities, labelled.scheme
    if kept is not None:
        kept = replace(kept, planes=kept.planes[scheme.twin_table[: len(kept.planes)]])
    return replace(labelled, parts=scheme.swap_left_right(labelled.parts), probabilities=kept)


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


def sided_by_parts(state: BodyState, labels: FrameLabels) -> BodyState:
    """Return the state, with sides exchanged where most joints lie on parts of the other side.

    Parts from a suit have reliable sides, parts from a network may not.
    """
    own, other, parts = 0, 0, labels.parts
    for joint, limbs in LIMBS.items():
        for side, twin in (("left", "right"), ("right", "left")):
            u, v = state.joints_px[JOINT[joint.replace("left", side)], :2].round().astype(np.int64)
            top, left = max(0, v - REACH_PX), max(0, u - REACH_PX)
            near = set(parts[top : max(0, v + REACH_PX), left : max(0, u + REACH_PX)].ravel().tolist())
            own += not near.isdisjoint(_ids(limbs, side, labels.scheme))
            other += not near.isdisjoint(_ids(limbs, twin, labels.scheme))
    return state.exchanged() if other > own else state


def _ids(regions: Iterable[Region], side: str, scheme: Scheme) -> tuple[int, ...]:
    """Return the ids of the parts that hold regions of the left, or their twins."""
    return scheme.ids_of(region if side == "left" else region.twin for region in regions)
