"""The simulated annotator: how long a person would need to put a frame's labels right.

It works as a person does with a lasso: the largest wrong patch first, one stroke a patch, until the
frame agrees with the truth. Times come from the keystroke-level model.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from skimage.measure import label as connected

from annotate.labels import FrameLabels
from annotate.parts import BACKGROUND, UNDEFINED

KEY_S, POINT_S, BUTTON_S, MENTAL_S = 0.2, 1.1, 0.1, 1.35
"""Keystroke-level model (Card, Moran & Newell 1983): key, pointing, button down or up, preparation."""
LOOK_S = MENTAL_S + KEY_S
"""Looking at a frame and accepting it with one key."""
STROKE_S = MENTAL_S + KEY_S + POINT_S + BUTTON_S + POINT_S + BUTTON_S
"""One lasso stroke: see the patch, choose the part, point, press, draw round it, release."""
AGREEMENT = 0.99
"""Share of the person's pixels that has to be right before the frame is accepted."""


@dataclass(frozen=True)
class Corrected:
    """A frame put right. strokes: lassos drawn; seconds: of a person's work; agreement: share right now."""

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
    for patch in _patches(parts, truth.parts, counted):
        if _agreement(parts, truth.parts, counted) >= goal:
            break
        parts[patch] = truth.parts[patch]
        strokes += 1
    notes = {**automatic.notes, "strokes": strokes, "active_seconds": round(LOOK_S + strokes * STROKE_S, 2)}
    frame = FrameLabels(
        automatic.frame_id, automatic.depth_mm, parts, automatic.confidence, "corrected", truth.subject, notes
    )
    return Corrected(frame, strokes, LOOK_S + strokes * STROKE_S, _agreement(parts, truth.parts, counted))


def _patches(
    parts: NDArray[np.uint8], truth: NDArray[np.uint8], counted: NDArray[np.bool_]
) -> list[tuple[NDArray[np.intp], ...]]:
    """Connected patches that should become one part, the largest first; indices as ``np.nonzero`` gives."""
    wrong = np.where(counted & (parts != truth), truth.astype(np.int32) + 1, 0)
    patches: NDArray[np.intp] = connected(wrong, background=0, connectivity=2)
    order = np.argsort(patches.ravel(), kind="stable")
    sizes = np.bincount(patches.ravel())
    pieces = np.split(order, np.cumsum(sizes)[:-1])[1:]
    pieces.sort(key=len, reverse=True)
    return [np.unravel_index(piece, parts.shape) for piece in pieces]


def _agreement(parts: NDArray[np.uint8], truth: NDArray[np.uint8], counted: NDArray[np.bool_]) -> float:
    return float((parts == truth)[counted].mean()) if counted.any() else 1.0
