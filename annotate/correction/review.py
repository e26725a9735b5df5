"""A second pair of eyes: where two annotators' labels of the same recording differ."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from annotate.labelset.store import LabelSet
from annotate.parts import BACKGROUND, UNDEFINED
from sensors.errors import CloudError


@dataclass(frozen=True)
class Disagreement:
    """One frame of two annotators: share of the body's pixels on which they differ, and how many."""

    frame_id: str
    share: float
    pixels: int


def disagreement(a: NDArray[np.uint8], b: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Pixels on which two labels (h, w) differ; where either is undefined, nothing is said.

    Raises CloudError on shapes that differ.
    """
    if a.shape != b.shape:
        raise CloudError(f"labels are {a.shape} and {b.shape}; compare two of the same frame")
    return np.asarray((a != b) & (a != UNDEFINED) & (b != UNDEFINED))


def disagreements(a: LabelSet, b: LabelSet) -> list[Disagreement]:
    """The frames that both sets hold, the most disputed first.

    Raises CloudError when they have none in common, or show something else under the same id.
    """
    common = sorted(set(a.frame_ids) & set(b.frame_ids))
    if not common:
        raise CloudError(f"{a.path} and {b.path} have no frame in common; give two sets of one recording")
    found = [_compared(a, b, frame_id) for frame_id in common]
    return sorted(found, key=lambda d: (-d.share, d.frame_id))


def _compared(a: LabelSet, b: LabelSet, frame_id: str) -> Disagreement:
    ours, theirs = a.read(frame_id), b.read(frame_id)
    if not np.array_equal(ours.depth_mm, theirs.depth_mm):
        raise CloudError(f"frame {frame_id} of {a.path} and of {b.path} show different depth images")
    differ = int(disagreement(ours.parts, theirs.parts).sum())
    body = int(((ours.parts != BACKGROUND) | (theirs.parts != BACKGROUND)).sum())
    return Disagreement(frame_id, differ / body if body else 0.0, differ)
