"""Details of a comparison as JSON: scores by group, reliability, suspicious labels."""

from typing import Any, NamedTuple

import numpy as np

from annotate.array_types import Index
from annotate.scheme.scheme import Part
from eval.compare.compare import Comparison
from eval.scores.confusion import Counts, ratio
from eval.scores.joint_scores import INSIDE
from eval.scores.reliability import LEVELS, reliability_curve
from eval.scores.scores import plain, scores_of
from eval.scores.traits import groups

SEGMENT_PIXELS = 30  # of the smallest segment listed; untuned
SHOWN = 20  # suspicious labels listed


def details(comparison: Comparison) -> dict[str, Any]:
    """Return scores by trait, reliability by bin and suspicious labels."""
    reliability = comparison.total.reliability
    return {
        "by": {
            kind: {value: _group(comparison, frames) for value, frames in found.items()}
            for kind, found in groups(comparison.subjects, comparison.traits).items()
        },
        "reliability": {"all": _curve(reliability.sum(0)), "near": _curve(reliability[1])}
        if comparison.has_confidence
        else None,
        "suspicious": [
            {"frame": frame_id, "part": part.name, "quality": quality, "pixels": pixels}
            for frame_id, part, quality, pixels in suspicious(comparison)
        ],
    }


def _group(comparison: Comparison, frames: Index) -> dict[str, Any]:
    scores, joints = scores_of(comparison.counts.taken(frames).total()), comparison.only(frames).joints
    return {
        "frames": len(frames),
        "subjects": len({comparison.subjects[i] for i in frames}),
        **{name: plain(scores[name]) for name in ("mean_recall", "miou", "left_right_swap_rate")},
        "joints": joints.estimates.to_json(INSIDE) if joints else None,
    }


def _curve(counts: Counts) -> dict[str, Any]:
    return {name: plain(values) for name, values in reliability_curve(counts)._asdict().items()}


class Suspect(NamedTuple):
    """True part of a frame that may be mislabelled. quality: mean predicted probability of its label, over
    its pixels.
    """

    frame_id: str
    part: Part
    quality: float
    pixels: int


def suspicious(comparison: Comparison, worst: int = SHOWN) -> list[Suspect]:
    """Return the ``worst`` true parts of lowest quality over all frames, lowest first; empty without
    confidence.

    Source: Lad & Mueller, arXiv 2307.05080. A low quality means that label and prediction disagree; either
    can be wrong.
    """
    parts = comparison.scheme.parts
    counts = comparison.counts.label_quality[:, [part.id for part in parts]]
    pixels = counts[..., 1]
    quality = np.where(pixels >= SEGMENT_PIXELS, ratio(counts[..., 0], pixels * LEVELS), np.nan)
    order = np.argsort(quality, axis=None, kind="stable")[:worst]
    return [
        Suspect(comparison.frame_ids[f], parts[p], float(quality[f, p]), int(pixels[f, p]))
        for f, p in zip(*np.unravel_index(order, quality.shape), strict=True)
        if not np.isnan(quality[f, p])
    ]
