"""The frames from which corrections carry over: corrected ones, near in time, of the same person."""

from collections.abc import Iterable

import numpy as np

from annotate.correction.correction import Correction
from annotate.correction.propagate import FRAMES_COMPARED
from annotate.frame_labels import FrameLabels
from annotate.parts import LEFT_RIGHT, on_body
from sensors.errors import CloudError
from sensors.files.natural_order import in_order

REACH_FRAMES = 30
"""Number of frames to either side within which corrections carry over: one second of a camera at 30 Hz,
15 s of the virtual rig (untuned)."""
SAME_MM, LEAST_SHARED = 200, 0.12
"""Difference of depth in millimetres up to which two frames show one surface at a pixel; least share of the
pixels of the body in either of two successive frames that show one surface of one part, or else the person is
another one. Left and right count as one part, because one frame's may be swapped. Measured on the virtual rig
(two frames a second, seeds 11 and 21 to 23, suit and network): 18 of 20 changes of the person lie below 0.09
and two above 0.2, all 229 other pairs above 0.17."""
_SIDELESS = np.arange(256, dtype=np.uint8)
_SIDELESS[[left for left, _ in LEFT_RIGHT]] = [right for _, right in LEFT_RIGHT]
"""Part ids without their sides."""


def corrected_nearby(correction: Correction, frame_id: str) -> list[str]:
    """Return the ids of frames that people corrected or accepted, the nearest first.

    The search ends REACH_FRAMES before and after the frame, and where the person changes: where a name
    differs, or two successive bodies share hardly any surface. Any thread may call this. Raises
    CloudError where there are none.
    """
    ids = correction.labels.frame_ids
    at = ids.index(frame_id)
    before = range(at - 1, max(-1, at - REACH_FRAMES - 1), -1)
    later = range(at + 1, min(len(ids), at + REACH_FRAMES + 1))
    found = {
        i: abs(i - at)
        for way in (before, later)
        for i in _same_person(correction, ids, at, way)
        if correction.state(ids[i]) not in ("auto", "rejected")
    }
    if not found:
        raise CloudError(
            f"Nothing to carry over: no frame of this person is corrected within {REACH_FRAMES} frames"
        )
    return [ids[i] for i in sorted(found, key=lambda i: (found[i], i))[:FRAMES_COMPARED]]


def _same_person(correction: Correction, ids: list[str], at: int, way: Iterable[int]) -> list[int]:
    """Return the places on a way through the frames up to where the person changes or a frame is broken."""
    worked = [i for i in way if correction.state(ids[i]) not in ("auto", "rejected")]
    reached: list[int] = []
    if not worked:
        return reached
    try:
        last = correction.frame(ids[at])
        step = 1 if worked[-1] > at else -1
        for i in range(at + step, worked[-1] + step, step):
            frame = correction.frame(ids[i])
            if _another(last, frame):
                break
            reached.append(i)
            last = frame
    except CloudError:
        # A broken frame ends the reach, because nothing shows whether the person is the same behind it.
        return reached
    return reached


def _another(one: FrameLabels, other: FrameLabels) -> bool:
    """Return whether two successive frames show different persons."""
    if one.subject and other.subject and one.subject != other.subject:
        return True
    first, second = (on_body(frame.parts) & (frame.depth_mm > 0) for frame in (one, other))
    away_mm = np.abs(one.depth_mm.astype(np.int32) - other.depth_mm)
    shared = (first & second & (away_mm <= SAME_MM) & (_SIDELESS[one.parts] == _SIDELESS[other.parts])).sum()
    return bool(shared < LEAST_SHARED * (first | second).sum())


def frames_text(frame_ids: Iterable[str]) -> str:
    """Return frames in words, such as "frames 3, 12, 13", in order of their numbers."""
    numbers = [frame_id.lstrip("0") or "0" for frame_id in in_order(frame_ids)]
    return f"frame {numbers[0]}" if len(numbers) == 1 else f"frames {', '.join(numbers)}"
