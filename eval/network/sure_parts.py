"""Protection of confidently labelled parts from deletion by a refinement."""

from dataclasses import replace

import numpy as np

from annotate.frame_labels import FrameLabels
from annotate.scheme.scheme import BACKGROUND

LEAST_SHARE = 0.01  # of the person's pixels, below which a part may be deleted; untuned
SURE = 0.5  # mean first confidence, below which a part may be deleted; untuned
MOST_DELETED = 0.5  # share of a part that a refinement may delete from a sure part; untuned


def keep_sure_parts(first: FrameLabels, refined: FrameLabels) -> FrameLabels:
    """Return refined labels in which no sure part of the first labels is deleted.

    A part is sure if it covers ``LEAST_SHARE`` of the person or more with a mean confidence over ``SURE``.
    Where a refinement deletes more than ``MOST_DELETED`` of a sure part, the deleted pixels keep their first
    labels and confidences; both have one scheme. Otherwise a network trained in other rooms deletes whole
    legs on a sofa.
    """
    if first.confidence is None or refined.confidence is None:
        return refined
    on_person = first.on_person
    if first.persons is not None:
        on_person &= first.persons <= 1
    deleted = on_person & (refined.parts == BACKGROUND)
    pixels, lost = (np.bincount(first.parts[mask], minlength=256) for mask in (on_person, deleted))
    confidence = np.bincount(first.parts[on_person], first.confidence[on_person], minlength=256)
    sure = (pixels >= LEAST_SHARE * pixels.sum()) & (confidence > SURE * pixels)
    kept = deleted & (sure & (lost > MOST_DELETED * pixels))[first.parts]
    if not kept.any():
        return refined
    return replace(
        refined,
        parts=np.where(kept, first.parts, refined.parts),
        confidence=np.where(kept, first.confidence, refined.confidence),
        persons=None if refined.persons is None else np.where(kept, np.uint8(1), refined.persons),
    )
