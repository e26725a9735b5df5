"""Labels that a confident prediction contradicts: the first to look at when searching for wrong ones.

Each part of each frame is ranked by the mean probability that the prediction gives to its label, as
cleanlab ranks segments (Lad & Mueller, arXiv 2307.05080, with a soft minimum for whole images). A low rank
says that label and network disagree, not which of them is wrong.
"""

from dataclasses import dataclass

import numpy as np

from annotate.parts import BODY_PARTS
from eval.compare.compare import Comparison
from eval.scores.confusion import ratio
from eval.scores.reliability import LEVELS

MIN_PIXELS = 30
"""Smaller segments are left out: along a border nobody is sure."""


@dataclass(frozen=True)
class Suspect:
    """A part of a frame's truth. quality: mean probability of its label, by so many pixels."""

    frame_id: str
    part_id: int
    quality: float
    pixels: int


def suspicious(comparison: Comparison, worst: int = 50) -> list[Suspect]:
    """The least probable parts of all frames, the worst first; none where there is no confidence."""
    counts = comparison.counts.label_quality[:, [part.id for part in BODY_PARTS]]
    pixels = counts[..., 1]
    quality = np.where(pixels >= MIN_PIXELS, ratio(counts[..., 0], pixels * LEVELS), np.nan)
    order = np.argsort(quality, axis=None, kind="stable")[:worst]
    frames, parts = np.unravel_index(order, quality.shape)
    return [
        Suspect(comparison.frame_ids[f], BODY_PARTS[p].id, float(quality[f, p]), int(pixels[f, p]))
        for f, p in zip(frames, parts, strict=True)
        if not np.isnan(quality[f, p])
    ]
