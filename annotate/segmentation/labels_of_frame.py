"""Labels of a frame from its segmentation and its persons."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from annotate.array_types import UInt16
from annotate.frame_labels import FrameLabels
from annotate.person.extract import PersonMask
from annotate.scheme.scheme import BACKGROUND
from annotate.segmentation.segment import ILLUMINANT, UNSURE_ISLAND
from annotate.segmentation.segmented_person import Segmentation


def notes_of(result: Segmentation, remarks: Sequence[str] = ()) -> dict[str, Any]:
    """Return a frame's notes on its segmentation, as JSON values.

    The notes are the mean confidence on the person and all remarks. Where the result has them, the position
    of the probabilities' crop and the person's bearing (joints, facing, posture) follow.
    """
    on_person = result.confidence[result.parts != BACKGROUND]
    return {
        "confidence": round(float(on_person.mean()), 4) if on_person.size else 0.0,
        "notes": [*remarks, *result.notes],
        **(result.probabilities.note() if result.probabilities else {}),
        **({"bearing": result.bearing} if result.bearing else {}),
    }


def review_rank(notes: Mapping[str, Any]) -> tuple[bool, float]:
    """Return the sort key of a frame's notes: unsure islands first, then the lowest mean confidence."""
    return UNSURE_ISLAND not in remarks_in(notes), confidence_in(notes) or 0.0


def remarks_in(notes: Mapping[str, Any]) -> list[str]:
    """Return the remarks of a frame's notes; none of malformed notes."""
    remarks = notes.get("notes")
    return [one for one in remarks if isinstance(one, str)] if isinstance(remarks, list) else []


def confidence_in(notes: Mapping[str, Any]) -> float | None:
    """Return the mean confidence of a frame's notes, in [0, 1]; None without one or for another value."""
    value = notes.get("confidence")
    if not isinstance(value, int | float) or isinstance(value, bool):
        return None
    return float(value) if 0 <= value <= 1 else None


def labels_of(
    frame_id: str, depth_mm: UInt16, result: Segmentation, person: PersonMask, left_out: Sequence[str] = ()
) -> FrameLabels:
    """Assemble a frame's labels from its segmentation and person mask.

    depth_mm: (h, w), undistorted. left_out: notes on streams or steps that this frame lacks.
    """
    notes = notes_of(result, [*left_out, *person.notes]) | {"extraction": person.method}
    notes |= {"people": person.tracks.note()} if person.tracks else {}
    notes |= {ILLUMINANT: result.illuminant.log_gain.round(3).tolist()} if result.illuminant else {}
    persons = np.where(person.mask, np.uint8(1), np.where(person.others, person.persons, np.uint8(0)))
    images = depth_mm, result.parts, result.confidence
    return FrameLabels(frame_id, *images, notes=notes, persons=persons, scheme=result.scheme)
