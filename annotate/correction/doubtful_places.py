"""Places of a frame that are worth a look, and the reason for each."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from annotate.array_types import Bool, Float32, Int64, UInt8
from annotate.cleanup import without_islands
from annotate.frame_labels import FrameLabels
from annotate.labelset.stroke import Stroke
from annotate.parts import BACKGROUND, PARTS, UNDEFINED

UNSURE = 0.6
"""Confidence below which a pixel of the body is doubtful. Untuned."""
LEAST_PX = 15
"""Least pixels of a doubtful place: smaller ones are within the borders' tolerance. Untuned."""


@dataclass(frozen=True)
class Doubt:
    """One doubtful place. pixels: flat indices (n,), connected; middle: one of them in its middle; reason: in
    a few words; weight: expected number of wrong pixels."""

    pixels: Int64
    middle: int
    reason: str
    weight: float


def doubts(
    frame: FrameLabels, parts: UInt8, other: UInt8 | None = None, strokes: Sequence[Stroke] = ()
) -> list[Doubt]:
    """The doubtful places of a frame, the heaviest first.

    frame: as labelled automatically. parts: uint8 (h, w), as they stand. other: uint8 (h, w) of a set to
    compare, or None. strokes: of people, that stand: what they touched is doubtful no longer.
    """
    untouched = np.ones(parts.size, np.bool_)
    for stroke in strokes:
        untouched[stroke.pixels] = False
    here = frame.depth_mm > 0
    found = _of_islands(parts, frame, here)
    if frame.confidence is not None:
        unsure = here & (frame.confidence < UNSURE) & (parts != BACKGROUND) & untouched.reshape(parts.shape)
        found += _of_confidence(parts, frame.confidence, unsure)
    if other is not None:
        found += _of_difference(parts, other, here & (parts != other) & untouched.reshape(parts.shape))
    return sorted(found, key=lambda doubt: -doubt.weight)


def part_title(part: int) -> str:
    """A part's name in sentences."""
    return "undefined" if part == UNDEFINED else PARTS[part].title.lower()


def pixels_text(count: int) -> str:
    """A number of pixels in words."""
    return "1 pixel" if count == 1 else f"{count:,} pixels"


def _of_confidence(parts: UInt8, confidence: Float32, unsure: Bool) -> list[Doubt]:
    found = []
    for pixels in _places(unsure):
        mean = float(confidence.ravel()[pixels].mean())
        reason = f"{part_title(_commonest(parts, pixels))}: {pixels_text(len(pixels))}, confidence {mean:.2f}"
        found.append(Doubt(pixels, _middle(pixels, parts.shape[1]), reason, len(pixels) * (1 - mean)))
    return found


def _of_difference(parts: UInt8, other: UInt8, differs: Bool) -> list[Doubt]:
    found = []
    for pixels in _places(differs):
        one, two = (part_title(_commonest(labels, pixels)) for labels in (parts, other))
        reason = f"{one}: {pixels_text(len(pixels))}, {two} in the other set"
        found.append(Doubt(pixels, _middle(pixels, parts.shape[1]), reason, len(pixels) / 2))
    return found


def _of_islands(parts: UInt8, frame: FrameLabels, here: Bool) -> list[Doubt]:
    found = []
    for pixels in _places(here & (without_islands(parts, frame.depth_mm) != parts)):
        reason = f"{part_title(_commonest(parts, pixels))}: {pixels_text(len(pixels))}, an island"
        found.append(Doubt(pixels, _middle(pixels, parts.shape[1]), reason, float(len(pixels))))
    return found


def _places(mask: Bool) -> list[Int64]:
    """Flat pixels (n,) of every connected place of at least LEAST_PX; gaps of two pixels are bridged."""
    joined = cv2.dilate(mask.astype(np.uint8), np.ones((3, 3), np.uint8))
    count, ids = cv2.connectedComponents(joined, connectivity=8)
    at = np.flatnonzero(mask)
    ids = ids.ravel()[at]
    order = np.argsort(ids, kind="stable")
    groups = np.split(at[order], np.searchsorted(ids[order], np.arange(1, count)))
    return [pixels for pixels in groups if len(pixels) >= LEAST_PX]


def _commonest(parts: UInt8, pixels: Int64) -> int:
    return int(np.bincount(parts.ravel()[pixels]).argmax())


def _middle(pixels: Int64, width: int) -> int:
    """The pixel nearest to the median."""
    v, u = np.divmod(pixels, width)
    return int(pixels[np.hypot(v - np.median(v), u - np.median(u)).argmin()])
