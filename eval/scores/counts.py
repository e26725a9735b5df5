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
from eval.scores import boundary, confusion, kernels, reliability
from eval.scores.boundary import (
    DISTANCE_EDGES_PX,
    FARTHEST_PX,
    N_DISTANCES,
    TOLERANCES_MM,
    TOLERANCES_PX,
    WIDTHS_MM,
    WIDTHS_PX,
)
from eval.scores.confusion import Counts, Labels

NEAR_PX = 3.0  # a pixel closer to a border of the truth is near it; half a limb at 4 m is wider
BLOCK = 512  # rows processed at once where memory would multiply

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


def blocks(rows: int) -> list[slice]:
    """Return slices of at most ``BLOCK`` rows, in order."""
    return [slice(start, min(start + BLOCK, rows)) for start in range(0, rows, BLOCK)]


@dataclass(frozen=True, eq=False)
class FrameCounts:
    """Counts of a frame (...), of frames (F, ...) or of resamples (R, ...).

    flat: int32 of frames, int64 of sums, (..., WIDTH). The other fields are views of ``flat`` by ``SHAPES``.
    confusion: rows are the truth; near: of the pixels near a border of the truth. Others: see
    ``boundary_counts``, ``band_counts``, ``kernels.errors``, ``confidence_counts``, ``counted``.
    Counts in millimetres are 0 for an unknown scale, counts of confidence without it. Raises ValueError for
    another number of counts.
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
        """Return counts from arrays by name. Raises ValueError for wrong shapes."""
        leading = counts["undefined"].shape[:-1]
        for name, shape in SHAPES.items():
            if counts[name].shape != (*leading, *shape):
                raise ValueError(f"{name} is {counts[name].shape} instead of {(*leading, *shape)}")
        return cls(np.concatenate([counts[name].reshape(*leading, -1) for name in SHAPES], axis=-1))

    def taken(self, frames: Int64) -> Self:
        """Return the counts of some frames (n,), in this order."""
        return type(self)(self.flat[frames])

    def total(self) -> Self:
        """Return the sum over the first axis."""
        return type(self)(self.flat.sum(axis=0, dtype=np.int64))


def count(truth: FrameLabels, predicted: FrameLabels, mm_per_px: float) -> FrameCounts:
    """Count one frame. mm_per_px: size of a pixel at the person's distance; NaN if unknown.

    Raises ValueError for label maps of different shapes.
    """
    box = _box(truth.parts, predicted.parts)
    target, guess = np.ascontiguousarray(truth.parts[box]), confusion.named(predicted.parts[box])
    masked = np.where(target == UNDEFINED, target, guess)
    borders = kernels.borders(target), kernels.borders(masked)
    scaled = mm_per_px > 0
    tolerances = (*TOLERANCES_PX, *(mm / mm_per_px for mm in TOLERANCES_MM if scaled))
    widths = (*WIDTHS_PX, *(mm / mm_per_px for mm in WIDTHS_MM if scaled))
    reach = min(max(NEAR_PX, *DISTANCE_EDGES_PX, *widths), FARTHEST_PX)
    away = (
        kernels.distances(target, borders[0], reach, NEAR_PX),
        kernels.distances(masked, borders[1], reach, 0.0),
    )
    near = away[0] < NEAR_PX
    counts = {name: np.zeros(shape, np.int64) for name, shape in SHAPES.items()}
    counts["confusion"], counts["undefined"] = confusion.counted(truth.parts, predicted.parts)
    counts["near"] = confusion.confusion_matrix(np.where(near, target, np.uint8(UNDEFINED)), guess)
    counts["by_distance"] = kernels.errors(target, guess, away[0], np.array(DISTANCE_EDGES_PX, np.float32))
    matched = boundary.boundary_counts(*borders, tolerances)
    bands = boundary.band_counts(target, masked, away, widths)
    counts["borders_px"], counts["bands_px"] = matched[: len(TOLERANCES_PX)], bands[: len(WIDTHS_PX)]
    if scaled:
        counts["borders_mm"], counts["bands_mm"] = matched[len(TOLERANCES_PX) :], bands[len(WIDTHS_PX) :]
    if predicted.confidence is not None:
        images = target, guess, predicted.confidence[box], near
        counts["reliability"], counts["label_quality"] = reliability.confidence_counts(*images)
    return FrameCounts.of(**counts)


def _box(truth: Labels, predicted: Labels) -> tuple[slice, slice]:
    """Return the box of both people with a margin that holds every border and its near pixels."""
    if truth.shape != predicted.shape:
        raise ValueError(f"truth is {truth.shape} but the prediction is {predicted.shape}")
    return window_of(on_body(truth) | on_body(predicted), int(NEAR_PX) + 1)
