"""Counts of one frame against its truth, from which every score of any set of frames is derived."""

import math
from dataclasses import dataclass, field
from functools import cache
from itertools import accumulate
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from annotate.array_types import Int64
from annotate.crop import window_of
from annotate.frame_labels import FrameLabels
from annotate.scheme.scheme import UNDEFINED, Scheme
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

Shape = tuple[int, ...]


@cache
def shapes(classes: int) -> dict[str, Shape]:
    """Return the shape of each array for one frame. classes: as in ``kernels``."""
    return {
        "confusion": (classes, classes),
        "near": (classes, classes),
        "borders_px": (len(TOLERANCES_PX), 4),
        "borders_mm": (len(TOLERANCES_MM), 4),
        "bands_px": (len(WIDTHS_PX), classes, 2),
        "bands_mm": (len(WIDTHS_MM), classes, 2),
        "by_distance": (classes, N_DISTANCES, 2),
        "reliability": (2, reliability.N_BINS, 3),
        "label_quality": (classes, 2),
        "undefined": (3,),
    }


@cache
def width(classes: int) -> int:
    """Return the number of counts of one frame. classes: as in ``kernels``."""
    return sum(map(math.prod, shapes(classes).values()))


def blocks(rows: int) -> list[slice]:
    """Return slices of at most ``BLOCK`` rows, in order."""
    return [slice(start, min(start + BLOCK, rows)) for start in range(0, rows, BLOCK)]


@dataclass(frozen=True, eq=False)
class FrameCounts:
    """Counts of a frame (...), of frames (F, ...) or of resamples (R, ...).

    flat: int32 of frames, int64 of sums, (..., K), where K is ``width``. scheme: of the part ids. The other
    fields are views of ``flat`` by ``shapes``. confusion: rows are the truth; near: of the pixels near a
    border of the truth. Others: see ``boundary_counts``, ``band_counts``, ``kernels.errors``,
    ``confidence_counts``, ``counted``. Counts in millimetres are 0 for an unknown scale, counts of confidence
    without it. Raises ValueError for another number of counts.
    """

    flat: NDArray[Any]
    scheme: Scheme
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
        found, needed = self.flat.shape[-1], width(self.scheme.n_classes)
        if found != needed:
            raise ValueError(f"{found} counts of a frame instead of {needed}")
        by_name = shapes(self.scheme.n_classes)
        ends = [*accumulate(map(math.prod, by_name.values()))]
        views = np.split(self.flat, ends[:-1], axis=-1)
        for (name, shape), view in zip(by_name.items(), views, strict=True):
            object.__setattr__(self, name, view.reshape(*self.flat.shape[:-1], *shape))

    @classmethod
    def of(cls, scheme: Scheme, **counts: Counts) -> Self:
        """Return counts from arrays by name. Raises ValueError for wrong shapes."""
        leading, by_name = counts["undefined"].shape[:-1], shapes(scheme.n_classes)
        for name, shape in by_name.items():
            if counts[name].shape != (*leading, *shape):
                raise ValueError(f"{name} is {counts[name].shape} instead of {(*leading, *shape)}")
        return cls(np.concatenate([counts[name].reshape(*leading, -1) for name in by_name], axis=-1), scheme)

    def taken(self, frames: Int64) -> Self:
        """Return the counts of some frames (n,), in this order."""
        return type(self)(self.flat[frames], self.scheme)

    def total(self) -> Self:
        """Return the sum over the first axis."""
        return type(self)(self.flat.sum(axis=0, dtype=np.int64), self.scheme)


def count(truth: FrameLabels, predicted: FrameLabels, mm_per_px: float) -> FrameCounts:
    """Count one frame in its scheme. mm_per_px: size of a pixel at the person's distance; NaN if unknown.

    Raises ValueError for label maps of different shapes or schemes.
    """
    scheme, classes = truth.scheme, truth.scheme.n_classes
    if predicted.scheme != scheme:
        raise ValueError(f"truth has scheme {scheme.name!r} but the prediction {predicted.scheme.name!r}")
    box = _box(truth.parts, predicted.parts, scheme)
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
    counts = {name: np.zeros(shape, np.int64) for name, shape in shapes(classes).items()}
    counts["confusion"], counts["undefined"] = confusion.counted(truth.parts, predicted.parts, scheme)
    close = np.where(near, target, np.uint8(UNDEFINED))
    counts["near"] = confusion.confusion_matrix(close, guess, scheme)
    edges = np.array(DISTANCE_EDGES_PX, np.float32)
    counts["by_distance"] = kernels.errors(target, guess, away[0], edges, classes)
    matched = boundary.boundary_counts(*borders, tolerances)
    bands = boundary.band_counts(target, masked, away, widths, classes)
    counts["borders_px"], counts["bands_px"] = matched[: len(TOLERANCES_PX)], bands[: len(WIDTHS_PX)]
    if scaled:
        counts["borders_mm"], counts["bands_mm"] = matched[len(TOLERANCES_PX) :], bands[len(WIDTHS_PX) :]
    if predicted.confidence is not None:
        images = target, guess, predicted.confidence[box], near
        counts["reliability"], counts["label_quality"] = reliability.confidence_counts(*images, classes)
    return FrameCounts.of(scheme, **counts)


def _box(truth: Labels, predicted: Labels, scheme: Scheme) -> tuple[slice, slice]:
    """Return the box of all parts of both maps with a margin that holds every border and its near pixels."""
    if truth.shape != predicted.shape:
        raise ValueError(f"truth is {truth.shape} but the prediction is {predicted.shape}")
    return window_of(scheme.on_part(truth) | scheme.on_part(predicted), int(NEAR_PX) + 1)
