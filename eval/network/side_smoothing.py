"""Temporal smoothing of a person's left and right, and correction of the joints' sides by the parts;
constants are untuned.
"""

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np

from annotate.array_types import Int8, UInt8
from annotate.frame_labels import FrameLabels
from annotate.scheme.regions import Region
from annotate.scheme.scheme import Scheme
from annotate.segmentation.segmented_person import Segmentation
from eval.network.body_state import BodyState, body_state_notes
from eval.scores.joints import JOINT

KEPT = 0.8  # weight of the earlier frames, a frame: half a second of other sides is followed
SAME_PLACE = 0.6  # least overlap (IoU) with the frame before; a walking person has 0.8 at 30 frames/s
SIDED = 0.2  # share of the person with a side in both frames from which the labels decide alone
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

    number: person id. Sides are exchanged where left and right lie on the other side than in the previous
    frame, and the earlier frames outweigh this frame. The joints then follow the labels. The note ``bearing``
    gets ``sided``: the decayed certainty of the frames so far, so that a wrong start is outvoted.
    """
    state = BodyState.from_note(labelled.bearing)
    if state is None:
        return labelled
    note, sure, trust = earlier_note(labelled, before, number), state.facing_sure, 0.0
    if note is not None and before is not None:
        trust = KEPT * _certainty(note)
        if _agreement(labelled, before, number) + _turned(state, BodyState.from_note(note)) < 0:
            if trust > sure:
                labelled, state, sure = _exchanged(labelled), state.exchanged(), -sure
            else:
                trust = 0.0
            state = sided_by_parts(state, labelled)
    return replace(labelled, bearing=state.note() | {"sided": round(trust + sure, 4)})


def _agreement(labelled: Segmentation, before: FrameLabels, number: int) -> float:
    """Return the agreement of left and right with the previous frame, from -1 (exchanged) to 1 (the same).

    It is nearer to 0 where few pixels have a side in both frames. number: person id.
    """
    earlier = before.on_person if before.persons is None else before.persons == number
    sides = _sides(labelled.scheme, labelled.parts) * _sides(before.scheme, before.parts) * earlier
    least = SIDED * np.count_nonzero(labelled.scheme.on_person(labelled.parts))
    return float(sides.sum() / max(np.count_nonzero(sides), least, 1))


def _sides(scheme: Scheme, parts: UInt8) -> Int8:
    """Return the side of each pixel: 1 left, -1 right, 0 neither."""
    side = np.zeros(256, np.int8)
    for left, right in scheme.twins:
        side[left], side[right] = 1, -1
    return side[parts]


def _turned(state: BodyState, earlier: BodyState | None) -> float:
    """Return the cosine of the turn since the previous frame, times both certainties, [-0.5, 0.5]."""
    return 0.0 if earlier is None else 0.5 * float(state.facing @ earlier.facing)


def earlier_note(labelled: Segmentation, before: FrameLabels | None, number: int) -> dict[str, Any] | None:
    """Return the previous frame's note ``bearing`` of a person; None without one, or in another place.

    number: person id.
    """
    note = None if before is None else body_state_notes(before.notes).get(number)
    if before is None or not isinstance(note, dict) or _overlap(labelled, before, number) <= SAME_PLACE:
        return None
    return note


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


def _certainty(note: dict[str, Any]) -> float:
    """Return the certainty of a person's sides in a note of the previous frame; 0 without any."""
    certainty = note.get("sided")
    return min(certainty, 1 / (1 - KEPT)) if isinstance(certainty, float) and certainty > 0 else 0.0


def sided_by_parts(state: BodyState, labels: FrameLabels | Segmentation) -> BodyState:
    """Return the state, with sides exchanged where most joints lie on parts of the other side.

    labels: from a suit, or from a network and smoothed over the recording.
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
