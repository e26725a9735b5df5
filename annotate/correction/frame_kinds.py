"""Kinds of frames: depth images of one view, room and posture resemble each other.

The distance of two frames is the root mean square difference of their thumbnails, in metres. Constants are
untuned.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import cv2
import numpy as np

from annotate.array_types import Float32, Int64, UInt16
from annotate.labelset import images
from annotate.labelset.label_set import FRAMES, LabelSet
from sensors.errors import CloudError

CELLS = (16, 12)  # columns and rows of a thumbnail; a cell covers a hand at 2 m
MOST_READ = 240  # frames of a set that are read, 2 s; the frames after each count as the same kind


@dataclass(frozen=True)
class FrameKinds:
    """Distances of a set's frames. kinds: (n,), the read frame that stands for each. apart_m: (k, k)."""

    kinds: Int64
    apart_m: Float32

    @classmethod
    def of(cls, labels: LabelSet, frame_ids: Sequence[str]) -> Self:
        """Return the distances of frames; unreadable ones count as images without depth."""
        every = -(-len(frame_ids) // MOST_READ) or 1
        read = [thumbnail_m(_depth(labels, frame_id)) for frame_id in frame_ids[::every]]
        return cls(np.arange(len(frame_ids)) // every, distances_m(read))

    def distance_m(self, frame: int) -> Float32:
        """Return the distance (n,) of all frames from one, by its index."""
        from_it: Float32 = self.apart_m[self.kinds[frame]]
        return from_it[self.kinds]


def thumbnail_m(depth_mm: UInt16) -> Float32:
    """Return the mean depth in metres of a grid's cells, flat; 0 in a cell without depth."""
    there = cv2.resize((depth_mm > 0).astype(np.float32), CELLS, interpolation=cv2.INTER_AREA)
    mean_mm = cv2.resize(depth_mm.astype(np.float32), CELLS, interpolation=cv2.INTER_AREA)
    return (mean_mm / np.maximum(there, 1e-3) / 1000).astype(np.float32).ravel()


def distances_m(thumbnails: Sequence[Float32]) -> Float32:
    """Return the distances (n, n) of thumbnails."""
    stack = np.array(thumbnails, np.float32).reshape(len(thumbnails), CELLS[0] * CELLS[1])
    rows = [np.sqrt(np.square(stack - one).mean(axis=1)) for one in stack]
    return np.array(rows, np.float32).reshape(len(stack), len(stack))


def farthest_first(apart_m: Float32, count: int) -> list[int]:
    """Return the indices of at most ``count`` items: the first, then always the one farthest from all chosen.

    apart_m: distances (n, n). Source: Gonzalez, Theoretical Computer Science 38, 1985.
    """
    chosen: list[int] = []
    away = np.full(len(apart_m), np.inf)
    while len(chosen) < min(count, len(apart_m)):
        chosen.append(int(away.argmax()))
        away = np.minimum(away, apart_m[chosen[-1]])
        away[chosen] = -1.0
    return chosen


def _depth(labels: LabelSet, frame_id: str) -> UInt16:
    try:
        return images.read_image(labels.path / FRAMES / f"{frame_id}.depth.png", images.decode_depth)
    except CloudError:
        return np.zeros(labels.intrinsics.shape, np.uint16)
