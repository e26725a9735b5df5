"""The simulated annotator: how long a person would need to put a frame's labels right.

It works with a brush that replaces only the part it was started on: the largest wrong patch first, one
stroke a patch, until the frame agrees with the truth. Times come from the keystroke-level model.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from annotate.labels import FrameLabels
from annotate.parts import BACKGROUND, UNDEFINED

KEY_S, POINT_S, BUTTON_S, MENTAL_S = 0.2, 1.1, 0.1, 1.35
"""Keystroke-level model (Card, Moran & Newell 1983): key, pointing, button down or up, preparation."""
LOOK_S = MENTAL_S + KEY_S
"""Looking at a frame and accepting it with one key."""
STROKE_S = MENTAL_S + KEY_S + POINT_S + BUTTON_S + POINT_S + BUTTON_S
"""One stroke: see the patch, choose the part, point, press, draw along it, release."""
REACH_PX = 5
"""Wrong pixels no further apart than twice this are mended in one stroke."""
SLIP_PX = 1
"""The brush paints this far beyond the wrong pixels: right ones of the same part suffer."""
AGREEMENT = 0.99
"""Share of the person's pixels that has to be right before the frame is accepted."""


@dataclass(frozen=True)
class Corrected:
    """A frame put right. strokes: how many; seconds: of a person's work; agreement: share right now."""

    frame: FrameLabels
    strokes: int
    seconds: float
    agreement: float


def correct(automatic: FrameLabels, truth: FrameLabels, goal: float = AGREEMENT) -> Corrected:
    """Correct a frame towards the truth, patch by patch, until ``goal`` of its pixels are right.

    Both frames show the same depth image. Pixels undefined in the truth are left alone.
    """
    parts = automatic.parts.copy()
    counted = (truth.parts != UNDEFINED) & ((truth.parts != BACKGROUND) | (parts != BACKGROUND))
    strokes = 0
    for patch, wrong, right in _patches(parts, truth.parts, counted):
        before = _agreement(parts, truth.parts, counted)
        if before >= goal:
            break
        painted = cv2.dilate(patch, _disc(SLIP_PX)).astype(bool) & (parts == wrong) & (truth.depth_mm > 0)
        mended = np.where(painted, right, parts)
        if _agreement(mended, truth.parts, counted) > before:
            parts, strokes = mended, strokes + 1
    notes = {**automatic.notes, "strokes": strokes, "active_seconds": round(LOOK_S + strokes * STROKE_S, 2)}
    frame = FrameLabels(
        automatic.frame_id, automatic.depth_mm, parts, automatic.confidence, "corrected", truth.subject, notes
    )
    return Corrected(frame, strokes, LOOK_S + strokes * STROKE_S, _agreement(parts, truth.parts, counted))


def _patches(
    parts: NDArray[np.uint8], truth: NDArray[np.uint8], counted: NDArray[np.bool_]
) -> list[tuple[NDArray[np.uint8], np.uint8, np.uint8]]:
    """What one stroke each can mend, the largest first: a mask (h, w), the wrong part and the right one."""
    pairs = np.unique(np.stack([parts, truth], axis=-1)[counted & (parts != truth)], axis=0)
    patches = []
    for wrong, right in pairs:
        apart = (counted & (parts == wrong) & (truth == right)).astype(np.uint8)
        count, ids = cv2.connectedComponents(cv2.dilate(apart, _disc(REACH_PX)))
        patches += [(apart * (ids == i).astype(np.uint8), wrong, right) for i in range(1, count)]
    return sorted(patches, key=lambda patch: -int(patch[0].sum()))


def _disc(radius_px: int) -> NDArray[np.uint8]:
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius_px + 1,) * 2), np.uint8)


def _agreement(parts: NDArray[np.uint8], truth: NDArray[np.uint8], counted: NDArray[np.bool_]) -> float:
    return float((parts == truth)[counted].mean()) if counted.any() else 1.0
