"""Frames that a fine-tuning rehearses, so that the network keeps what it knew: sure labels of other frames.

A network that sees corrected frames alone forgets how other frames look (McCloskey & Cohen 1989); its own
labels on these keep it in place (Li & Hoiem, Learning without forgetting, ECCV 2016).
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from annotate.correction.correction import Correction
from annotate.correction.frame_kinds import FrameKinds, farthest_first
from annotate.correction.relabel import untouched
from annotate.frame_labels import FrameLabels
from annotate.scheme.scheme import BACKGROUND, UNDEFINED
from eval.fine_tuning.training_split import CorrectedFrame

MOST = 8  # rehearsed frames; each costs about 3 MB and, with a suit, 2 s; untuned
SURE = 0.9  # least confidence of a part that is rehearsed; untuned


def rehearsed_frames(path: Path) -> list[CorrectedFrame]:
    """Return untouched frames of all kinds in a label set, with unsure pixels undefined."""
    with Correction.open(path, read_only=True) as correction:
        labels, ids = correction.labels, untouched(correction)
        kinds = FrameKinds.of(labels, ids)
        chosen = [int(np.flatnonzero(kinds.kinds == k)[0]) for k in farthest_first(kinds.apart_m, MOST)]
        places = {frame_id: place for place, frame_id in enumerate(labels.frame_ids)}
        found = []
        for frame_id in (ids[n] for n in sorted(chosen)):
            first = labels.read(frame_id, original=labels.has_original(frame_id))
            found.append(CorrectedFrame(first, _sure(first), places[frame_id]))
    return [frame for frame in found if frame.corrected.on_body.any()]


def _sure(first: FrameLabels) -> FrameLabels:
    """Return labels whose unsure parts are undefined. The background stays in a scheme without things; with
    things it is undefined, because things that are not drawn yet lie in it.
    """
    unsure = np.zeros(first.parts.shape, np.bool_)
    if first.confidence is not None:
        unsure = first.on_body & (first.confidence < SURE)
    if first.scheme.is_thing.any():
        unsure |= first.parts == BACKGROUND
    return replace(first, parts=np.where(unsure, np.uint8(UNDEFINED), first.parts))
