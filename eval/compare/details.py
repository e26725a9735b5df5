"""What stands behind a comparison's scores, as JSON: by kind of frame, by confidence, and doubtful labels."""

from dataclasses import asdict
from itertools import compress
from typing import Any

from annotate.array_types import Bool
from annotate.parts import PARTS
from eval.compare.compare import Comparison
from eval.compare.suspicious import suspicious
from eval.scores.confusion import Counts
from eval.scores.reliability import reliability_curve
from eval.scores.scores import scores_of
from eval.scores.summary import plain
from eval.scores.traits import groups

SHOWN = 20
"""Doubtful labels that are listed."""


def details(comparison: Comparison) -> dict[str, Any]:
    """Scores by subject, activity, distance and so on; reliability by bin; labels that look wrong."""
    kinds = groups(comparison.subjects, comparison.traits)
    reliability = comparison.total.reliability
    return {
        "by": {
            kind: {value: _group(comparison, mask) for value, mask in masks.items()}
            for kind, masks in kinds.items()
        },
        "reliability": {"all": _curve(reliability.sum(0)), "near": _curve(reliability[1])}
        if comparison.has_confidence
        else None,
        "suspicious": [
            {
                "frame": suspect.frame_id,
                "part": PARTS[suspect.part_id].name,
                "quality": suspect.quality,
                "pixels": suspect.pixels,
            }
            for suspect in suspicious(comparison, SHOWN)
        ],
    }


def _group(comparison: Comparison, mask: Bool) -> dict[str, Any]:
    scores = scores_of(comparison.counts.total(mask))
    return {
        "frames": int(mask.sum()),
        "subjects": len(set(compress(comparison.subjects, mask))),
        **{name: plain(scores[name]) for name in ("mean_recall", "miou", "left_right_swap_rate")},
    }


def _curve(counts: Counts) -> dict[str, Any]:
    return {name: plain(values) for name, values in asdict(reliability_curve(counts)).items()}
