"""What is counted of one frame against its truth; every score of any set of frames is derived from it."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Self

import numpy as np
from numpy.typing import NDArray

from annotate.crop import window_of
from annotate.labels import FrameLabels
from annotate.parts import N_CLASSES, UNDEFINED, on_body
from eval import boundary, calibration, metrics
from eval.boundary import N_DISTANCES, TOLERANCES_MM, TOLERANCES_PX, WIDTHS_MM, WIDTHS_PX
from eval.metrics import Counts, Labels

NEAR_PX = 3.0
"""A pixel closer than this to a border of the truth is near it: half a limb's width at 4 m is farther."""

SHAPES = {
    "confusion": (N_CLASSES, N_CLASSES),
    "near": (N_CLASSES, N_CLASSES),
    "borders_px": (len(TOLERANCES_PX), 4),
    "borders_mm": (len(TOLERANCES_MM), 4),
    "bands_px": (len(WIDTHS_PX), N_CLASSES, 2),
    "bands_mm": (len(WIDTHS_MM), N_CLASSES, 2),
    "by_distance": (N_CLASSES, N_DISTANCES, 2),
    "reliability": (2, calibration.N_BINS, 3),
    "label_quality": (N_CLASSES, 2),
    "undefined": (3,),
}
"""Shape of each array for one frame."""


@dataclass(frozen=True)
class FrameCounts:
    """Counts, int64, with any leading axes: none for a frame or a sum, (F,) for frames, (R,) for resamples.

    confusion (..., 12, 12): rows truth. near: the same, of the pixels closer than `NEAR_PX` to a border
    of the truth. borders_px, borders_mm (..., 4, 4): by tolerance, see `boundary_counts`. bands_px,
    bands_mm (..., 3, 12, 2): by width and part, see `band_counts`. by_distance (..., 12, 7, 2), see
    `errors_by_distance`. reliability (..., 2, 15, 3), label_quality (..., 12, 2): see `eval.calibration`;
    0 without confidence. undefined (..., 3): see `undefined_pixels`. What is counted in millimetres is 0
    where the scale is unknown. Raises ValueError for arrays that do not fit together.
    """

    confusion: Counts
    near: Counts
    borders_px: Counts
    borders_mm: Counts
    bands_px: Counts
    bands_mm: Counts
    by_distance: Counts
    reliability: Counts
    label_quality: Counts
    undefined: Counts

    def __post_init__(self) -> None:
        leading = self.undefined.shape[:-1]
        for name, shape in SHAPES.items():
            actual = getattr(self, name).shape
            if actual != (*leading, *shape):
                raise ValueError(f"{name} is {actual} instead of {(*leading, *shape)}")

    def __getitem__(self, index: NDArray[np.int64] | slice | int) -> Self:
        """The counts at an index or mask of the leading axes."""
        return type(self)(*(getattr(self, field.name)[index] for field in fields(self)))

    def total(self) -> Self:
        """The sum over the first axis."""
        return type(self)(*(getattr(self, field.name).sum(axis=0) for field in fields(self)))

    def flat(self) -> Counts:
        """All counts side by side (..., K): what a bootstrap sums."""
        leading = self.undefined.shape[:-1]
        return np.concatenate([getattr(self, name).reshape(*leading, -1) for name in SHAPES], axis=-1)

    @classmethod
    def of_flat(cls, flat: Counts) -> Self:
        """Inverse of `flat`."""
        ends = np.cumsum([int(np.prod(shape)) for shape in SHAPES.values()])[:-1]
        pieces = np.split(flat, ends, axis=-1)
        leading = flat.shape[:-1]
        return cls(*(p.reshape(*leading, *s) for p, s in zip(pieces, SHAPES.values(), strict=True)))


def stack(frames: Sequence[FrameCounts]) -> FrameCounts:
    """Single frames' counts on one leading axis."""
    return FrameCounts(*(np.stack([getattr(frame, name) for frame in frames]) for name in SHAPES))


def count(truth: FrameLabels, predicted: FrameLabels, mm_per_px: float) -> FrameCounts:
    """Count one frame. mm_per_px: what a pixel spans at the person's distance; NaN where unknown.

    Raises ValueError for label maps of different shapes.
    """
    box = _box(truth.parts, predicted.parts)
    target, guess = truth.parts[box], metrics.named(predicted.parts[box])
    masked = np.where(target == UNDEFINED, target, guess)
    borders = boundary.border_parts(target), boundary.border_parts(masked)
    away = boundary.distance_to(borders[0]), boundary.distance_to(borders[1])
    scaled = mm_per_px > 0
    tolerances = (*TOLERANCES_PX, *(mm / mm_per_px for mm in TOLERANCES_MM if scaled))
    widths = (*WIDTHS_PX, *(mm / mm_per_px for mm in WIDTHS_MM if scaled))
    matched = boundary.boundary_counts(*borders, tolerances)
    bands = boundary.band_counts(target, masked, away, widths)
    near = away[0] < NEAR_PX
    told = np.where(near, target, np.uint8(UNDEFINED))
    confidence = None if predicted.confidence is None else predicted.confidence[box]
    return FrameCounts(
        confusion=metrics.confusion_matrix(truth.parts, predicted.parts),
        near=metrics.confusion_matrix(told, guess),
        borders_px=matched[: len(TOLERANCES_PX)],
        borders_mm=matched[len(TOLERANCES_PX) :] if scaled else _zeros("borders_mm"),
        bands_px=bands[: len(WIDTHS_PX)],
        bands_mm=bands[len(WIDTHS_PX) :] if scaled else _zeros("bands_mm"),
        by_distance=boundary.errors_by_distance(target, guess, away[0]),
        reliability=_zeros("reliability")
        if confidence is None
        else calibration.reliability_counts(target, guess, confidence, near),
        label_quality=_zeros("label_quality")
        if confidence is None
        else calibration.label_quality(target, guess, confidence),
        undefined=metrics.undefined_pixels(truth.parts, predicted.parts),
    )


def _zeros(name: str) -> Counts:
    return np.zeros(SHAPES[name], np.int64)


def _box(truth: Labels, predicted: Labels) -> tuple[slice, slice]:
    """Where anybody sees a person, and a little more: all borders, and whatever is near one, lie in it."""
    if truth.shape != predicted.shape:
        raise ValueError(f"truth is {truth.shape} but the prediction is {predicted.shape}")
    return window_of(on_body(truth) | on_body(predicted), int(NEAR_PX) + 1)
