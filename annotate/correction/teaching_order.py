"""Order in which correcting frames helps fine-tuning most: unsure frames of all kinds."""

import numpy as np

from annotate.correction.correction import Correction
from annotate.correction.frame_kinds import FrameKinds
from annotate.correction.relabel import untouched
from annotate.correction.review_queue import confidence_of


def teaching_order(correction: Correction) -> list[str]:
    """Return the untouched frames in the order in which correcting them helps fine-tuning most.

    The first has the lowest confidence. Each next one belongs to the kind that is farthest from the kinds of
    all corrected and earlier frames; among its neighbours, within half of that distance, it is the least
    confident.
    """
    ids, free = correction.labels.frame_ids, set(untouched(correction))
    kinds = FrameKinds.of(correction.labels, ids)
    doubt = np.array([1 - (confidence_of(correction, i) or 0.0) for i in ids])
    left = np.array([i in free for i in ids])
    away = np.full(len(ids), np.inf)
    for known in np.flatnonzero(~left).tolist():
        away = np.minimum(away, kinds.distance_m(known))
    order: list[str] = []
    while left.any():
        farthest = int(np.where(left, away, -1).argmax())
        near = kinds.distance_m(farthest) <= away[farthest] / 2
        best = int(np.where(left & near, doubt, -np.inf).argmax())
        order.append(ids[best])
        left[best], away = False, np.minimum(away, kinds.distance_m(best))
    return order
