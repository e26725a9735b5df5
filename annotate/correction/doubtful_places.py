"""Places of a frame with probably wrong labels, and the reason for each."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np

from annotate.array_types import Bool, Int64, UInt8
from annotate.cleanup import without_islands
from annotate.cloud.pieces import unsure_islands
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.frame_labels import FrameLabels
from annotate.labelset.stroke import Stroke
from annotate.scheme.scheme import BACKGROUND, Scheme

UNSURE = 0.6  # confidence below which a pixel of the body is doubtful; untuned
LEAST_PX = 15  # of a doubtful place: smaller ones are within the borders' tolerance; untuned


@dataclass(frozen=True)
class Doubt:
    """Place with probably wrong labels. pixels: flat indices (n,), connected. middle: the index in the
    middle. weight: expected number of wrong pixels.
    """

    pixels: Int64
    middle: int
    reason: str
    weight: float


def doubts(
    frame: FrameLabels,
    parts: UInt8,
    other: UInt8 | None = None,
    strokes: Sequence[Stroke] = (),
    cloud: ThermalCloud | None = None,
) -> list[Doubt]:
    """Return the doubtful places of a frame, most expected wrong pixels first.

    frame: as labelled automatically. parts: uint8 (h, w), current labels. other: uint8 (h, w), parts in
    another set, or None. strokes: in effect; their pixels are doubtful only as islands. cloud: of the frame,
    which shows pieces apart from the body; None = without them.
    """
    untouched = np.ones(parts.size, np.bool_)
    for stroke in strokes:
        untouched[stroke.pixels] = False
    here, free = frame.depth_mm > 0, untouched.reshape(parts.shape)
    place, title = partial(_doubt, frame.scheme, parts), frame.scheme.title
    found = []
    for pixels in _places(here & (without_islands(parts, frame.depth_mm) != parts)):
        found.append(place(pixels, "an island", 1.0))
    if frame.confidence is not None:
        unsure = here & (frame.confidence < UNSURE) & (parts != BACKGROUND) & free
        for pixels in _islands(frame, parts, cloud):
            if free.flat[pixels].all():
                mean = float(frame.confidence.flat[pixels].mean())
                found.append(place(pixels, f"apart from the body, confidence {mean:.2f}", 1 - mean))
                unsure.flat[pixels] = False
        for pixels in _places(unsure):
            mean = float(frame.confidence.flat[pixels].mean())
            found.append(place(pixels, f"confidence {mean:.2f}", 1 - mean))
    if other is not None:
        for pixels in _places(here & (parts != other) & free):
            found.append(place(pixels, f"{title(_commonest(other, pixels))} in the other set", 0.5))
    return sorted(found, key=lambda doubt: -doubt.weight)


def _islands(frame: FrameLabels, parts: UInt8, cloud: ThermalCloud | None) -> list[Int64]:
    if cloud is None or frame.confidence is None:
        return []
    return unsure_islands(cloud, frame.scheme.on_body(parts), frame.confidence)


def pixels_text(count: int) -> str:
    """Return a number of pixels as text."""
    return "1 pixel" if count == 1 else f"{count:,} pixels"


def _doubt(scheme: Scheme, parts: UInt8, pixels: Int64, why: str, weight: float) -> Doubt:
    """Return a place with its reason. weight: expected share of wrong pixels."""
    v, u = np.divmod(pixels, parts.shape[1])
    middle = int(pixels[np.hypot(v - np.median(v), u - np.median(u)).argmin()])
    reason = f"{scheme.title(_commonest(parts, pixels))}: {pixels_text(len(pixels))}, {why}"
    return Doubt(pixels, middle, reason, len(pixels) * weight)


def _places(mask: Bool) -> list[Int64]:
    """Return the flat pixels (n,) of every connected place of a mask; gaps of two pixels are bridged."""
    joined = cv2.dilate(mask.astype(np.uint8), np.ones((3, 3), np.uint8))
    count, ids = cv2.connectedComponents(joined, connectivity=8)
    at = np.flatnonzero(mask)
    ids = ids.ravel()[at]
    order = np.argsort(ids, kind="stable")
    groups = np.split(at[order], np.searchsorted(ids[order], np.arange(1, count)))
    return [pixels for pixels in groups if len(pixels) >= LEAST_PX]


def _commonest(parts: UInt8, pixels: Int64) -> int:
    return int(np.bincount(parts.ravel()[pixels]).argmax())
