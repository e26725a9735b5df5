"""Counts of one frame against its truth, from which every score of any set of frames is derived."""

import math
from dataclasses import dataclass, field
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from annotate.array_types import Int64
from annotate.crop import window_of
from annotate.frame_labels import FrameLabels
from annotate.parts import N_CLASSES, UNDEFINED, on_body
from eval.scores import boundary, confusion, reliability
from eval.scores.boundary import (
    DISTANCE_EDGES_PX,
    N_DISTANCES,
    TOLERANCES_MM,
    TOLERANCES_PX,
    WIDTHS_MM,
    WIDTHS_PX,
)
from eval.scores.confusion import Counts, Labels

NEAR_PX = 3.0
"""Distance below which a pixel is near a border of the truth, less than half a limb at 4 m; untuned."""

SHAPES = {
    "confusion": (N_CLASSES, N_CLASSES),
    "near": (N_CLASSES, N_CLASSES),
    "borders_px": (len(TOLERANCES_PX), 4),
    "borders_mm": (len(TOLERANCES_MM), 4),
    "bands_px": (len(WIDTHS_PX), N_CLASSES, 2),
    "bands_mm": (len(WIDTHS_MM), N_CLASSES, 2),
    "by_distance": (N_CLASSES, N_DISTANCES, 2),
    "reliability": (2, reliability.N_BINS, 3),
    "label_quality": (N_CLASSES, 2),
    "undefined": (3,),
}
"""Shape of each array for one frame."""


_SIZES = [math.prod(shape) for shape in SHAPES.values()]
WIDTH = sum(_SIZES)
"""Numbers counted of one frame."""

BLOCK = 512
"""Rows that are worked on at once where a result would need a multiple of their memory; untuned."""


def blocks(rows: int) -> list[slice]:
    """Return slices of at most BLOCK rows, in order."""
    return [slice(start, min(start + BLOCK, rows)) for start in range(0, rows, BLOCK)]


@dataclass(frozen=True, eq=False)
class FrameCounts:
    """Counts with any leading axes: none for a frame or a sum, (F,) for frames, (R,) for resamples.

    flat: all counts side by side, (..., WIDTH), int32 of frames, int64 of sums; the bootstrap sums it. The
    other fields are views of ``flat`` by SHAPES. confusion (..., 12, 12): rows truth. near: the same, of
    pixels closer than `NEAR_PX` to a border of the truth. borders_px, borders_mm (..., 4, 4): by tolerance,
    see `boundary_counts`. bands_px, bands_mm (..., 3, 12, 2): by width and part, see `band_counts`.
    by_distance (..., 12, 7, 2), see `errors_by_distance`. reliability (..., 2, 15, 3), label_quality (...,
    12, 2): see `reliability`; 0 without confidence. undefined (..., 3): see `confusion.counted`. Counts in
    millimetres are 0 where the scale is unknown. Raises ValueError for another number of counts.
    """

    flat: NDArray[Any]
    confusion: Counts = field(init=False, repr=False)
    near: Counts = field(init=False, repr=False)
    borders_px: Counts = field(init=False, repr=False)
    borders_mm: Counts = field(init=False, repr=False)
    bands_px: Counts = field(init=False, repr=False)
    bands_mm: Counts = field(init=False, repr=False)
    by_distance: Counts = field(init=False, repr=False)
    reliability: Counts = field(init=False, repr=False)
    label_quality: Counts = field(init=False, repr=False)
    undefined: Counts = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if self.flat.shape[-1] != WIDTH:
            raise ValueError(f"{self.flat.shape[-1]} counts of a frame instead of {WIDTH}")
        views = np.split(self.flat, np.cumsum(_SIZES)[:-1], axis=-1)
        for (name, shape), view in zip(SHAPES.items(), views, strict=True):
            object.__setattr__(self, name, view.reshape(*self.flat.shape[:-1], *shape))

    @classmethod
    def of(cls, **counts: Counts) -> Self:
        """Return the counts from arrays by name. Raises ValueError for arrays that do not fit together."""
        leading = counts["undefined"].shape[:-1]
        for name, shape in SHAPES.items():
            if counts[name].shape != (*leading, *shape):
                raise ValueError(f"{name} is {counts[name].shape} instead of {(*leading, *shape)}")
        return cls(np.concatenate([counts[name].reshape(*leading, -1) for name in SHAPES], axis=-1))

    def taken(self, frames: Int64) -> Self:
        """Return the counts of some frames (F,), in this order."""
        return type(self)(self.flat[frames])

    def total(self) -> Self:
        """Return the sum over the first axis."""
        return type(self)(self.flat.sum(axis=0, dtype=np.int64))


def count(truth: FrameLabels, predicted: FrameLabels, mm_per_px: float) -> FrameCounts:
    """Count one frame.

    mm_per_px: millimetres per pixel at the person's distance; NaN if unknown. Raises ValueError for label
    maps of different shapes.
    """
    box = _box(truth.parts, predicted.parts)
    target, guess = truth.parts[box], confusion.named(predicted.parts[box])
    masked = np.where(target == UNDEFINED, target, guess)
    borders = boundary.border_parts(target), boundary.border_parts(masked)
    scaled = mm_per_px > 0
    tolerances = (*TOLERANCES_PX, *(mm / mm_per_px for mm in TOLERANCES_MM if scaled))
    widths = (*WIDTHS_PX, *(mm / mm_per_px for mm in WIDTHS_MM if scaled))
    reach = max(NEAR_PX, *DISTANCE_EDGES_PX, *widths)
    away = (
        boundary.distance_to(borders[0], target, reach, NEAR_PX),
        boundary.distance_to(borders[1], masked, reach, 0),
    )
    matched = boundary.boundary_counts(*borders, tolerances)
    bands = boundary.band_counts(target, masked, away, widths)
    near = away[0] < NEAR_PX
    close = np.where(near, target, np.uint8(UNDEFINED))
    sure = {name: _zeros(name) for name in ("reliability", "label_quality")}
    if predicted.confidence is not None:
        confidence = predicted.confidence[box]
        counted = reliability.confidence_counts(target, guess, confidence, near)
        sure = dict(zip(sure, counted, strict=True))
    matrix, undefined = confusion.counted(truth.parts, predicted.parts)
    return FrameCounts.of(
        confusion=matrix,
        near=confusion.confusion_matrix(close, guess),
        borders_px=matched[: len(TOLERANCES_PX)],
        borders_mm=matched[len(TOLERANCES_PX) :] if scaled else _zeros("borders_mm"),
        bands_px=bands[: len(WIDTHS_PX)],
        bands_mm=bands[len(WIDTHS_PX) :] if scaled else _zeros("bands_mm"),
        by_distance=boundary.errors_by_distance(target, guess, away[0]),
        **sure,
        undefined=undefined,
    )


def _zeros(name: str) -> Counts:
    return np.zeros(SHAPES[name], np.int64)


def _box(truth: Labels, predicted: Labels) -> tuple[slice, slice]:
    """Return the rectangle around the person in either map, with a margin that contains all pixels near a
    border.
    """
    if truth.shape != predicted.shape:
        raise ValueError(f"truth is {truth.shape} but the prediction is {predicted.shape}")
    return window_of(on_body(truth) | on_body(predicted), int(NEAR_PX) + 1)
